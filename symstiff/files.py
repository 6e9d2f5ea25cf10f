"""Files written whole or not at all: into a temporary sibling first, then moved into place."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from symstiff.errors import UserError


def write_file(path: str | Path, data: bytes | str) -> None:
    """Write one file atomically; a device or pipe is written to, never replaced. Raises UserError."""
    target = Path(os.path.realpath(path))  # a link stays a link
    content = data.encode() if isinstance(data, str) else data
    temporary = target.with_name(f".{target.name}.part")
    try:
        if target.exists() and not target.is_file() and not target.is_dir():
            target.write_bytes(content)
            return
        temporary.write_bytes(content)
        os.replace(temporary, target)
    except OSError as error:
        _remove(temporary)
        raise cannot_write(Path(path), error) from error


@contextmanager
def new_folder(path: str | Path) -> Iterator[Path]:
    """Fill a folder that appears only when all of it is there; an old one with the same files is replaced.

    Yields the temporary folder. Raises UserError where the place cannot be written, or holds something else.
    """
    target = Path(path)
    if target.is_file():
        raise UserError(f"{target} is a file: give a folder")
    temporary = None
    missing = [p for p in target.parents if not p.exists()]  # the innermost first
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        if target.exists() and not os.access(target, os.W_OK):
            raise PermissionError(13, "Permission denied")
        temporary = Path(tempfile.mkdtemp(prefix=f".{target.name}.", dir=target.parent.resolve()))
        temporary.chmod(0o755)
        yield temporary
        _moved(temporary, target)
    except OSError as error:
        raise cannot_write(target, error) from error
    finally:
        if temporary is not None:
            shutil.rmtree(temporary, ignore_errors=True)
        _remove_empty(missing)


def check_folder(path: str | Path) -> None:
    """Refuse a place for a folder before the work for it begins. Raises UserError as ``new_folder`` does."""
    target = Path(path)
    if target.is_file():
        raise UserError(f"{target} is a file: give a folder")
    kept = _foreign(target) if target.is_dir() else None
    if kept:
        raise _not_ours(target, kept)


def write_tree(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write files below a folder, sub-folders included."""
    for name, content in files.items():
        place = folder / name
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(content)


def _moved(temporary: Path, target: Path) -> None:
    if not target.exists():
        os.replace(temporary, target)
        return
    kept = _foreign(target)
    if kept:
        raise _not_ours(target, kept)
    old = Path(tempfile.mkdtemp(prefix=f".{target.name}.old.", dir=target.parent))
    os.replace(target, old / "was")
    os.replace(temporary, target)
    shutil.rmtree(old, ignore_errors=True)


def _foreign(target: Path) -> str | None:
    """A name in an old folder that shows that it is not one of ours, if any."""
    names = sorted(p.name for p in target.iterdir())
    if not names or "manifest.json" in names or "verdict.json" in names:
        return None
    return names[0]


def _not_ours(target: Path, kept: str) -> UserError:
    return UserError(f"{target} holds {kept}, which symstiff did not write: give a new or generated folder")


def _remove(path: Path) -> None:
    try:
        path.unlink(missing_ok=True)
    except OSError:
        return


def _remove_empty(folders: Iterable[Path]) -> None:
    """Remove folders that hold nothing, innermost first."""
    for folder in folders:
        try:
            folder.rmdir()
        except OSError:  # it holds something, or was never made
            return


def cannot_write(target: Path, error: OSError) -> UserError:
    """The message for a place that cannot be written."""
    reason = error.strerror or str(error)
    return UserError(f"cannot write {target}: {reason}: choose another place with -o")
