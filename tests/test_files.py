"""Folders appear whole or leave nothing behind."""

from __future__ import annotations

import json
import os

import pytest

from symstiff.cli import main
from symstiff.errors import UserError
from symstiff.files import CODE, DIAGNOSIS, check_file, check_folder, new_folder


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


def fill(place, **files):
    with new_folder(place) as folder:
        for name, text in files.items():
            (folder / name).write_text(text)


def test_a_folder_is_written_again_and_loses_what_is_no_longer_written(tmp_path):
    fill(tmp_path / "gen", a="old", b="old")
    before = (tmp_path / "gen").stat().st_ino
    fill(tmp_path / "gen", a="new", c="new")
    assert {p.name: p.read_text() for p in (tmp_path / "gen").iterdir() if p.name != ".symstiff"} == {
        "a": "new",
        "c": "new",
    }
    assert (tmp_path / "gen").stat().st_ino == before  # a shell that stands in it still does
    assert [p.name for p in tmp_path.iterdir()] == ["gen"]


@pytest.mark.parametrize("name", ["manifest.json", "verdict.json"])
def test_a_manifest_of_somebody_else_makes_no_folder_ours(tmp_path, name):
    (tmp_path / "web").mkdir()
    (tmp_path / "web" / name).write_text('{"name": "app"}')
    for job in (check_folder, fill):
        with pytest.raises(UserError, match=f"web holds {name}, which symstiff did not write: move it"):
            job(tmp_path / "web")
    assert [p.name for p in (tmp_path / "web").iterdir()] == [name]


def test_a_diagnosis_does_not_replace_code_nor_code_a_diagnosis(tmp_path, monkeypatch, capsys):
    with new_folder(tmp_path / "gen", CODE) as folder:
        (folder / CODE).write_text("{}")
    with new_folder(tmp_path / "found", DIAGNOSIS) as folder:
        (folder / "code").mkdir()
        for name in ("code/manifest.json", DIAGNOSIS):
            (folder / name).write_text("{}")
    table = tmp_path / "table.csv"
    for words, place, kind in (
        (["diagnose", "scara", str(table), "-o", str(tmp_path / "gen")], "gen", "code"),
        (["generate", "scara", "-o", str(tmp_path / "found")], "found", "a diagnosis"),
    ):
        monkeypatch.setattr("sys.argv", ["symstiff", *words])
        with pytest.raises(SystemExit) as stopped:
            main()
        assert stopped.value.code == 2
        assert f"{place} holds {kind} that symstiff wrote: give a new folder" in capsys.readouterr().err
    check_folder(tmp_path / "gen", CODE)
    check_folder(tmp_path / "found", DIAGNOSIS)


def test_a_folder_below_that_cannot_be_moved_is_told_before_the_work(tmp_path, monkeypatch):
    with new_folder(tmp_path / "found", DIAGNOSIS) as folder:
        (folder / "code").mkdir()
        for name in ("code/manifest.json", DIAGNOSIS):
            (folder / name).write_text("{}")

    def probe(folder):
        if folder.name == "code":
            raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("symstiff.files._probe", probe)
    with pytest.raises(UserError, match=r"cannot write .*found: Permission denied"):
        check_folder(tmp_path / "found", DIAGNOSIS)


def test_what_a_compiler_left_of_a_written_source_stays_where_it_is(tmp_path):
    for content in ("old", "new"):
        fill(tmp_path / "gen", **{"a.c": content})
        (tmp_path / "gen" / "a.o").write_text("built")
    assert (tmp_path / "gen" / "a.c").read_text() == "new"
    (tmp_path / "gen" / "b.o").write_text("mine")
    with pytest.raises(UserError, match=r"gen holds b\.o, which symstiff did not write"):
        fill(tmp_path / "gen", **{"a.c": "newer"})


def test_a_users_file_in_a_generated_folder_stops_the_next_writing(tmp_path):
    fill(tmp_path / "gen", a="old")
    (tmp_path / "gen" / "src").mkdir()
    (tmp_path / "gen" / "src" / "controller.c").write_text("mine")
    with pytest.raises(UserError, match=r"gen holds src/controller\.c, which symstiff did not write"):
        fill(tmp_path / "gen", a="new")
    assert (tmp_path / "gen" / "src" / "controller.c").read_text() == "mine"
    assert (tmp_path / "gen" / "a").read_text() == "old"


def test_what_cmake_built_in_a_folder_stays_there(tmp_path):
    fill(tmp_path / "gen", a="old")
    for place in ("build", "below/build"):
        (tmp_path / "gen" / place).mkdir(parents=True)
        (tmp_path / "gen" / place / "a.o").write_text("object")
    (tmp_path / "gen" / "build" / "CMakeCache.txt").write_text("cache")
    with pytest.raises(UserError, match=r"gen holds below/build/a\.o"):
        fill(tmp_path / "gen", a="new")
    (tmp_path / "gen" / "below" / "build" / "a.o").unlink()
    fill(tmp_path / "gen", a="new")
    assert (tmp_path / "gen" / "a").read_text() == "new"
    assert (tmp_path / "gen" / "build" / "a.o").read_text() == "object"


def test_a_folder_of_an_older_version_without_a_list_is_left_alone(tmp_path):
    (tmp_path / "gen").mkdir()
    (tmp_path / "gen" / "manifest.json").write_text(json.dumps({"generator": "0.1", "model_hash": "x"}))
    with pytest.raises(UserError, match="an older version did, without a list"):
        check_folder(tmp_path / "gen")


def test_the_folder_that_one_stands_in_is_filled(tmp_path, monkeypatch):
    (tmp_path / "gen").mkdir()
    monkeypatch.chdir(tmp_path / "gen")
    for place in (".", ""):
        fill(place, a="here")
        assert sorted(os.listdir()) == [".symstiff", "a"]


def test_an_exchange_that_fails_midway_is_undone(tmp_path, monkeypatch):
    fill(tmp_path / "gen", a="old", b="old")
    replace, calls = os.replace, []

    def once_broken(source, place):
        calls.append(place)
        if len(calls) == 5:
            raise OSError(5, "Input/output error")
        replace(source, place)

    monkeypatch.setattr(os, "replace", once_broken)
    with pytest.raises(UserError, match="Input/output error"):
        fill(tmp_path / "gen", a="new", b="new")
    assert {p.name: p.read_text()[:3] for p in (tmp_path / "gen").iterdir()} == {
        ".symstiff": "# f",
        "a": "old",
        "b": "old",
    }


def test_what_a_command_reads_is_never_its_target(tmp_path):
    (tmp_path / "data.csv").write_text("mine")
    (tmp_path / "link.csv").symlink_to("data.csv")
    for name in ("data.csv", "link.csv"):
        with pytest.raises(UserError, match=r"is read by this command: choose another place with --json"):
            check_file(tmp_path / name, "--json", [tmp_path / "data.csv"])
    check_file(tmp_path / "data.csv", "-o", ["kuka_kr270", tmp_path / "other.csv"])


def _full(*_):
    raise OSError(28, "No space left on device")
