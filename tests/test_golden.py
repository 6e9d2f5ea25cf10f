"""What is generated today is what is committed, byte for byte."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from symstiff.codegen.targets import TARGETS
from tests.golden import FOLDER, ROBOTS, differences, write

ROOT = FOLDER.parent


@pytest.mark.parametrize("name", sorted(ROBOTS))
def test_the_committed_folder_is_what_the_program_writes(name: str, tmp_path: Path) -> None:
    write(name, tmp_path / name)
    assert differences(name, tmp_path / name) == []


EMIT = """
import hashlib
import zipfile
from io import BytesIO

from symstiff.codegen.functions import Functions
from symstiff.codegen.options import Options
from symstiff.codegen.targets import TARGETS
from tests.generated_c import model

functions = Functions(model("scara"))
for target in TARGETS:
    options = Options(targets=tuple(dict.fromkeys(("c", target))))
    for name, content in TARGETS[target].emitter()(functions, options).items():
        data = content.encode() if isinstance(content, str) else content
        parts = {"": data}
        if name.endswith(".fmu"):  # the library inside is the compiler's
            archive = zipfile.ZipFile(BytesIO(data))
            parts = {n: archive.read(n) for n in archive.namelist() if not n.startswith("binaries/")}
            parts[""] = repr([(i.filename, i.date_time, i.external_attr) for i in archive.infolist()]).encode()
        for part, what in parts.items():
            print(target, name, part, hashlib.sha256(what).hexdigest())
"""


@pytest.mark.slow
def test_fresh_interpreters_under_different_hash_seeds_write_the_same_bytes() -> None:
    """Of every target: an order that a set or a hash decides would differ."""
    first, second = (
        subprocess.run(
            [sys.executable, "-c", EMIT],
            env={**os.environ, "PYTHONHASHSEED": seed}, cwd=ROOT, check=True, capture_output=True, text=True,
        ).stdout.splitlines()
        for seed in ("1", "2")
    )  # fmt: skip
    assert {line.split()[0] for line in first} == set(TARGETS)
    assert first == second


def test_a_changed_file_is_seen(tmp_path: Path) -> None:
    write("kuka_kr270", tmp_path / "kuka_kr270")
    (tmp_path / "kuka_kr270" / "main.c").write_text("changed")
    assert differences("kuka_kr270", tmp_path / "kuka_kr270") == ["kuka_kr270/main.c"]
