"""Which compiler is used: $CC, the machine's own, the one of the ziglang wheel, or none."""

import json
import shutil
import sys
from pathlib import Path

import pytest

from symstiff.codegen.compiler import find_compiler
from symstiff.codegen.generate import generate
from symstiff.codegen.options import Options
from symstiff.codegen.runtime import NotCompiled
from symstiff.errors import UserError
from symstiff.model import StiffnessModel
from symstiff.reduction import reduce
from symstiff.robot import load


def test_generation_is_verified_by_the_compiler_of_the_wheel(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("ziglang", reason="the ziglang wheel is not installed")
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    found = find_compiler()
    assert found is not None
    assert found.name == "zig cc"
    generate(StiffnessModel.of(reduce(load("planar2r"))), tmp_path / "out")
    verified = json.loads((tmp_path / "out" / "manifest.json").read_text())["verified"]
    assert verified["compiled"]
    assert verified["compiler"] == "zig cc"
    assert verified["max_relative_error"] < 1e-12


def test_without_any_compiler_the_folder_is_written_and_says_that_it_was_not_compiled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("symstiff.codegen.generate.find_compiler", lambda: None)
    generate(StiffnessModel.of(reduce(load("planar2r"))), tmp_path / "out")
    verified = json.loads((tmp_path / "out" / "manifest.json").read_text())["verified"]
    assert not verified["compiled"]
    assert verified["errors"]["casadi"] < 1e-12


@pytest.fixture
def foreign(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """$CC is a compiler whose programs do not run here."""
    script = tmp_path / "foreign-cc"
    script.write_text('#!/bin/sh\nwhile [ "$1" != -o ]; do shift; done\necho no program > "$2"\n')
    script.chmod(0o755)
    monkeypatch.setenv("CC", str(script))


@pytest.mark.skipif(sys.platform == "win32", reason="the compiler is a shell script")
def test_a_compiler_for_another_machine_is_not_used_and_named_in_the_manifest(
    foreign: None, tmp_path: Path
) -> None:
    assert find_compiler() is None
    made = generate(
        StiffnessModel.of(reduce(load("planar2r"))), tmp_path / "out", Options(targets=("c", "fmi2"))
    )
    assert made.verification.reason == "$CC does not make programs for this machine"
    verified = json.loads((tmp_path / "out" / "manifest.json").read_text())["verified"]
    assert not verified["compiled"]
    assert verified["reason"] == made.verification.reason


@pytest.mark.skipif(sys.platform == "win32", reason="the compiler is a shell script")
def test_a_model_is_evaluated_by_numpy_where_cc_compiles_for_another_machine(foreign: None) -> None:
    model = StiffnessModel.of(reduce(load("planar2r")))
    with pytest.warns(NotCompiled, match=r"\$CC does not make programs for this machine: the model"):
        assert model.compile().backend == "numpy"


@pytest.mark.parametrize("cc", ["arm-none-eabi-gcc", "gcc -fsanitize=address", "gcc -nostdinc"])
def test_a_command_whose_libraries_cannot_be_loaded_serves_nothing(
    cc: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if shutil.which(cc.split()[0]) is None:
        pytest.skip(f"{cc.split()[0]} is missing")
    monkeypatch.setenv("CC", cc)
    assert find_compiler() is None


def test_a_compiler_of_the_users_that_warns_is_no_fault_of_ours(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if shutil.which("gcc") is None:
        pytest.skip("gcc is missing")
    monkeypatch.setenv("CC", "gcc -Wtraditional")
    with pytest.raises(UserError, match=r"\$CC \(gcc -Wtraditional\) refuses the generated C: leave out"):
        generate(StiffnessModel.of(reduce(load("planar2r"))), tmp_path / "out", Options(targets=("c",)))
    assert not (tmp_path / "out").exists()


def test_a_command_with_arguments_keeps_its_name(monkeypatch: pytest.MonkeyPatch) -> None:
    if shutil.which("gcc") is None:
        pytest.skip("gcc is missing")
    monkeypatch.setenv("CC", "gcc -g")
    found = find_compiler()
    assert found is not None
    assert found.name == "gcc -g"
