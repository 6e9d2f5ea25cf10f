"""What is generated today is what is committed, byte for byte."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.golden import FOLDER, ROBOTS, differences, write

ROOT = FOLDER.parent


@pytest.mark.parametrize("name", sorted(ROBOTS))
def test_the_committed_folder_is_what_the_program_writes(name: str, tmp_path: Path) -> None:
    write(name, tmp_path / name)
    assert differences(name, tmp_path / name) == []


@pytest.mark.slow
def test_fresh_interpreters_under_different_hash_seeds_write_the_same_bytes(tmp_path: Path) -> None:
    code = (
        "import sys; from pathlib import Path; from tests.golden import write; "
        "write('kuka_kr270', Path(sys.argv[1]))"
    )
    for seed in ("1", "2"):
        subprocess.run(
            [sys.executable, "-c", code, str(tmp_path / seed)],
            env={"PYTHONHASHSEED": seed, "PATH": ""},
            cwd=ROOT,
            check=True,
        )
    first, second = ({p.name: p.read_bytes() for p in (tmp_path / seed).iterdir()} for seed in ("1", "2"))
    assert first == second


def test_a_changed_file_is_seen(tmp_path: Path) -> None:
    write("kuka_kr270", tmp_path / "kuka_kr270")
    (tmp_path / "kuka_kr270" / "main.c").write_text("changed")
    assert differences("kuka_kr270", tmp_path / "kuka_kr270") == ["kuka_kr270/main.c"]
