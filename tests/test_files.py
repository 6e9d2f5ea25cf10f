"""Folders appear whole or leave nothing behind."""

from __future__ import annotations

import pytest

from symstiff.cli import main
from symstiff.errors import UserError
from symstiff.files import new_folder


def test_a_folder_that_fails_leaves_no_parent_that_was_made_for_it(tmp_path):
    (tmp_path / "old").mkdir()

    def fail():
        with new_folder(tmp_path / "old" / "a" / "b" / "c") as folder:
            assert folder.parent == tmp_path / "old" / "a" / "b"
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()
    assert list(tmp_path.rglob("*")) == [tmp_path / "old"]


def test_a_parent_that_somebody_else_uses_by_then_stays(tmp_path):
    def fail():
        with new_folder(tmp_path / "a" / "b") as folder:
            (tmp_path / "a" / "note.txt").write_text("mine")
            (folder / "file").write_text("ours")
            raise OSError(28, "No space left on device")

    with pytest.raises(UserError, match="No space left"):
        fail()
    assert [p.name for p in tmp_path.rglob("*")] == ["a", "note.txt"]


def test_a_folder_that_is_filled_stays_with_its_parents(tmp_path):
    with new_folder(tmp_path / "a" / "b") as folder:
        (folder / "file").write_text("ours")
    assert (tmp_path / "a" / "b" / "file").read_text() == "ours"


def test_a_failed_generation_leaves_the_place_as_it_was(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("symstiff.codegen.generate.write_tree", _full)
    monkeypatch.setattr("sys.argv", ["symstiff", "generate", "scara", "-o", "new/place"])
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as stopped:
        main()
    assert stopped.value.code == 2
    assert "No space left on device" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def _full(*_):
    raise OSError(28, "No space left on device")
