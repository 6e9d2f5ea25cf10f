"""The optional C targets' MISRA findings are those of the deviation record that travels with them."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from symstiff.codegen.emit import emit_c
from symstiff.codegen.functions import Functions
from symstiff.codegen.options import Options
from symstiff.codegen.targets import TARGETS
from symstiff.files import write_tree
from symstiff.model import StiffnessModel
from symstiff.reduction import reduce
from symstiff.robot import load

FILES = ["scara_batch.c", "scara_params.c", "scara_rls.c"]
PRECISIONS = pytest.mark.parametrize("precision", ["double", "float"])


def written(folder: Path, precision: str) -> Path:
    """The sources of the scara with its optional targets; the test is skipped where cppcheck is missing."""
    if shutil.which("cppcheck") is None:
        pytest.skip("cppcheck is missing")
    functions = Functions(StiffnessModel.of(reduce(load("scara"))))
    options = Options(precision=precision, targets=("c", "params", "rls"))
    write_tree(folder, emit_c(functions, options))
    for target in ("params", "rls"):
        write_tree(folder, TARGETS[target].emitter()(functions, options))
    return folder


def printed(folder: Path, *arguments: str) -> str:
    command = ["cppcheck", "-q", "--std=c99", *arguments]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False).stderr


@pytest.mark.slow
@PRECISIONS
def test_findings_in_batches_reader_and_estimator_are_the_recorded_ones(
    precision: str, tmp_path: Path
) -> None:
    folder = written(tmp_path, precision)
    text = printed(folder, "--addon=misra", "--template={file}:{id}", *FILES)
    if "misra" not in text:
        pytest.skip("the MISRA addon of cppcheck is missing")
    found = {(rule, f) for f, rule in re.findall(r"^(.*):misra-c2012-([\d.]+)$", text, re.M) if f in FILES}
    table = re.findall(
        r"^\| ([\d.]+) \| \w+ \| `([^`]+)` \| \S.*\|$", (folder / "MISRA.md").read_text(), re.M
    )
    assert found == {(rule, f) for rule, f in table if f in FILES}


@PRECISIONS
def test_cppcheck_sees_neither_errors_nor_warnings(precision: str, tmp_path: Path) -> None:
    folder = written(tmp_path, precision)
    assert printed(folder, "--enable=warning", "scara.c", "scara_selftest.c", *FILES) == ""
