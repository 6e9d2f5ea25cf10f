"""A machine without a compiler of its own: the one of the ziglang wheel compiles and runs the self-test."""

import json
from pathlib import Path

import pytest

from symstiff.codegen.compiler import find_compiler
from symstiff.codegen.generate import generate
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
