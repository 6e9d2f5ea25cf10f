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


@pytest.mark.parametrize("precision", ["double", "float"])
def test_findings_in_batches_reader_and_estimator_are_the_recorded_ones(
    precision: str, tmp_path: Path
) -> None:
    if shutil.which("cppcheck") is None:
        pytest.skip("cppcheck is missing")
    functions = Functions(StiffnessModel.of(reduce(load("scara"))))
    options = Options(precision=precision, targets=("c", "params", "rls"))
    write_tree(tmp_path, emit_c(functions, options))
    for target in ("params", "rls"):
        write_tree(tmp_path, TARGETS[target].emitter()(functions, options))
    files = ["scara_batch.c", "scara_params.c", "scara_rls.c"]
    command = ["cppcheck", "-q", "--std=c99", "--addon=misra", "--template={file}:{id}", *files]
    printed = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False).stderr
    if "misra" not in printed:
        pytest.skip("the MISRA addon of cppcheck is missing")
    found = {(rule, f) for f, rule in re.findall(r"^(.*):misra-c2012-([\d.]+)$", printed, re.M) if f in files}
    table = re.findall(
        r"^\| ([\d.]+) \| \w+ \| `([^`]+)` \| \S.*\|$", (tmp_path / "MISRA.md").read_text(), re.M
    )
    assert found == {(rule, f) for rule, f in table if f in files}
