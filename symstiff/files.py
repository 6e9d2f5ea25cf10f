"""Files written whole or not at all: into a temporary sibling first, then moved into place."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from symstiff.arguments import require_path
from symstiff.errors import UserError

LISTING = ".symstiff"
"""File in a written folder that lists its files: what may be replaced when the folder is written again."""
_HEAD = "# files of this folder that symstiff wrote, and replaces when it writes the folder again"
_SCRATCH = ".symstiff-"
_OBJECTS = (".o", ".obj")
"""Endings of what a compiler leaves beside a source."""
CODE, DIAGNOSIS = "manifest.json", "verdict.json"
"""The file that every folder of code, and every one of a diagnosis, holds: neither is taken for the other."""


def write_file(path: str | Path, data: bytes | str, option: str = "") -> None:
    """Write one file atomically; a device or pipe is written to, never replaced. Raises UserError.

    option: of the command line, that named the place.
    """
    require_path(path, "a file to write")
    target = Path(os.path.realpath(path))  # a link stays a link
    content = data.encode() if isinstance(data, str) else data
    temporary = target.with_name(f".symstiff-{os.getpid()}-{os.urandom(4).hex()}.part")
    try:
        if target.exists() and not target.is_file() and not target.is_dir():
            target.write_bytes(content)
            return
        temporary.write_bytes(content)
        os.replace(temporary, target)
    except BaseException as error:  # an interrupt leaves nothing behind either
        _remove(temporary)
        if isinstance(error, OSError):
            raise cannot_write(Path(path), error, option) from error
        raise


@contextmanager
def new_folder(path: str | Path, mark: str | None = None) -> Iterator[Path]:
    """Fill a folder that appears only when all of it is there; in an old one, files that symstiff wrote are replaced.

    Yields the temporary folder. mark: a file that every folder of this kind holds. The list of what was written stays
    in the folder, as ``.symstiff``. Raises UserError where the place cannot be written, or holds anything else than a
    folder of the same kind and a build tree of CMake.
    """
    check_folder(path, mark)
    target = Path(os.path.realpath(path))
    temporary = None
    missing = [p for p in target.parents if not p.exists()]  # the innermost first
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        inside = target.exists()
        temporary = Path(
            tempfile.mkdtemp(
                prefix=_SCRATCH if inside else f".{target.name}.", dir=target if inside else target.parent
            )
        )
        temporary.chmod(0o755)
        yield temporary
        (temporary / LISTING).write_bytes(_listing(temporary))
        if inside:
            check_folder(path, mark)
            _exchange(temporary, target)
        else:
            os.replace(temporary, target)
    except OSError as error:
        raise cannot_write(Path(path), error) from error
    finally:
        if temporary is not None:
            shutil.rmtree(temporary, ignore_errors=True)
        _remove_empty(missing)


def check_folder(path: str | Path, mark: str | None = None) -> None:
    """Refuse a place for a folder before the work for it begins. Raises UserError as ``new_folder`` does."""
    require_path(path, "a folder to write")
    target = Path(os.path.realpath(path))
    if target.is_file():
        raise UserError(f"{path} is a file: give a folder")
    if target.is_dir():
        _check_contents(Path(path), target, mark)
    try:
        _probe(next(p for p in (target, *target.parents) if p.exists()))
        for name in sorted({n.partition("/")[0] for n in _listed(target) if "/" in n}):
            if (target / name).is_dir():  # it is moved away
                _probe(target / name)
    except OSError as error:
        raise cannot_write(Path(path), error) from error


def check_file(path: str | Path, option: str = "-o", inputs: Iterable[str | Path] = ()) -> None:
    """Refuse a place for a file before the work for it begins; what the work reads is never replaced."""
    target = Path(os.path.realpath(path))
    try:
        if any(_same(target, source) for source in inputs):
            raise UserError(f"{path} is read by this command: choose another place with {option}")
        if target.is_dir():
            raise IsADirectoryError(21, "Is a directory")
        if target.is_file() or not target.exists():  # a device or pipe is written to, whatever its folder
            _probe(target.parent)
    except OSError as error:
        raise cannot_write(Path(path), error, option) from error


def write_tree(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write files below a folder, sub-folders included."""
    for name, content in files.items():
        place = folder / name
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(content)


def _listing(folder: Path) -> bytes:
    """The names of all files of a folder, as ``.symstiff`` holds them."""
    names = sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*") if not p.is_dir())
    return ("".join(f"{name}\n" for name in (_HEAD, *names, LISTING))).encode()


def _listed(target: Path) -> frozenset[str]:
    """The files of a folder that symstiff wrote, by its own list; none where there is no such list."""
    try:
        lines = (target / LISTING).read_text(encoding="utf-8").splitlines()
    except (OSError, ValueError):
        return frozenset()
    return frozenset(lines[1:]) if lines[:1] == [_HEAD] else frozenset()


def _check_contents(shown: Path, target: Path, mark: str | None) -> None:
    """Refuse a folder that holds a file which is not on symstiff's list of that folder, or one of another kind."""
    listed = _listed(target)
    for other, kind in ((CODE, "code"), (DIAGNOSIS, "a diagnosis")):
        if mark not in (None, other) and other in listed:
            raise UserError(
                f"{shown} holds {kind} that symstiff wrote: give a new folder, or remove that one"
            )
    for name in sorted(_contents(target)):
        if name not in listed and not _built(name, listed):
            old = (
                ""
                if listed or not _of_older_version(target)
                else " (or an older version did, without a list)"
            )
            raise UserError(
                f"{shown} holds {name}, which symstiff did not write{old}: move it away, or give a new folder"
            )


def _contents(target: Path) -> Iterator[str]:
    """The files of a folder; caches of Python, scratch of other runs and what CMake built in it apart."""
    for folder, below, files in os.walk(target):
        below[:] = [d for d in below if d != "__pycache__" and not d.startswith(_SCRATCH)]
        if Path(folder) == target:  # it stays where it is, and CMake builds anew what has changed
            below[:] = [d for d in below if not (target / d / "CMakeCache.txt").is_file()]
        links = [d for d in below if (Path(folder) / d).is_symlink()]
        yield from ((Path(folder) / name).relative_to(target).as_posix() for name in (*files, *links))


def _built(name: str, listed: frozenset[str]) -> bool:
    """Whether a file is what a compiler leaves of a source that symstiff wrote; it stays where it is."""
    path = Path(name)
    return path.suffix in _OBJECTS and path.with_suffix(".c").as_posix() in listed


def _of_older_version(target: Path) -> bool:
    """Whether a folder without a list holds a manifest or a verdict such as symstiff writes."""
    for name, keys in (
        ("manifest.json", {"generator", "model_hash"}),
        ("verdict.json", {"verdict", "effects"}),
    ):
        try:
            table = json.loads((target / name).read_bytes())
        except (OSError, ValueError):
            continue
        if isinstance(table, dict) and keys <= set(table):
            return True
    return False


def _exchange(temporary: Path, target: Path) -> None:
    """Put new entries in the place of the old ones; the folder itself stays, for shells that stand in it.

    The old ones move into the temporary folder, which lies inside ``target``, and back where anything fails.
    """
    new = sorted(p.name for p in temporary.iterdir())
    old = sorted({name.partition("/")[0] for name in _listed(target)})
    kept = Path(tempfile.mkdtemp(prefix="old.", dir=temporary))
    moves = [(target / n, kept / n) for n in old if (target / n).exists()]
    moves += [(temporary / n, target / n) for n in new]
    try:
        for source, place in moves:
            os.replace(source, place)
    except BaseException:  # a signal too
        for source, place in reversed(moves):
            if place.exists() and not source.exists():
                os.replace(place, source)
        raise


def _probe(folder: Path) -> None:
    """Raise OSError where nothing can be written into a folder."""
    with tempfile.TemporaryFile(dir=folder):
        pass


def _same(target: Path, source: str | Path) -> bool:
    try:
        return os.path.samefile(target, source)
    except (OSError, ValueError):  # one of them is not there
        return False


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


def cannot_write(target: Path, error: OSError, option: str = "-o") -> UserError:
    """The message for a place that cannot be written."""
    reason = error.strerror or str(error)
    return UserError(
        f"cannot write {target}: {reason}: choose another place" + f" with {option}" * bool(option)
    )
