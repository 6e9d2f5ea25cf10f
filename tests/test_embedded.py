"""Other machines: Cortex-M boards under QEMU, cross-compilation, and what the code costs there."""

from __future__ import annotations

import importlib.util
import re
import shutil
import struct
import subprocess
import sys
from pathlib import Path

import pytest
from command_line import Run, assert_users_mistake, run_command_line  # noqa: F401

from symstiff.codegen.emit import emit_c, environment
from symstiff.codegen.footprint import markdown, measure, unmeasured
from symstiff.codegen.footprint_machines import CORTEX_M4F, CORTEX_M7, HOST, Machine
from symstiff.codegen.footprint_parse import call_graph, instructions_per_call, symbol_sizes, totals
from symstiff.codegen.functions import Functions
from symstiff.codegen.options import Options
from symstiff.files import write_tree
from symstiff.model import StiffnessModel
from symstiff.reduction import reduce
from symstiff.robot import load

NAME = "kuka_kr270"
STRICT = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wdouble-promotion", "-Werror"]
VARIANTS = [("double", "unrolled"), ("double", "compact"), ("float", "unrolled"), ("float", "compact")]


def selftest_on(machine: Machine, folder: Path, name: str, single: bool, scratch: Path) -> str:
    """Build the self-test for an emulated board, run it there, return what it prints; RuntimeError if it fails."""
    context = {
        "name": name,
        "real": "float" if single else "double",
        "single": single,
        "zero": "0.0f" if single else "0.0",
    }
    (scratch / "board_main.c").write_text(
        environment().get_template("footprint/selftest.c.j2").render(context)
    )
    sources = [str(folder / f"{name}.c"), str(folder / f"{name}_selftest.c")]
    machine.link_board([f"-I{folder}", "board_main.c", *sources], "selftest.elf", scratch)
    done = machine.run_board(scratch / "selftest.elf")
    if done.returncode:
        raise RuntimeError(f"the self-test failed on {machine.name}: {done.stdout}")
    return done.stdout


@pytest.fixture(scope="module")
def functions() -> Functions:
    return Functions(StiffnessModel.of(reduce(load(NAME), "gravity")))


@pytest.fixture(scope="module")
def folders(functions, tmp_path_factory) -> dict[tuple[str, str], Path]:
    found = {}
    for precision, layout in VARIANTS:
        folder = found[precision, layout] = tmp_path_factory.mktemp(f"{precision}_{layout}")
        write_tree(folder, emit_c(functions, Options(precision=precision, layout=layout, targets=("c",))))
    return found


def need(machine: Machine) -> None:
    if machine.missing:
        pytest.skip(f"{machine.missing} is missing")


@pytest.mark.parametrize(
    ("machine", "precision", "layout"),
    [
        (CORTEX_M7, "double", "unrolled"),
        (CORTEX_M7, "double", "compact"),
        (CORTEX_M4F, "float", "unrolled"),
        (CORTEX_M4F, "float", "compact"),
    ],
    ids=lambda x: getattr(x, "name", x),
)
def test_the_selftest_passes_on_an_emulated_board(folders, machine, precision, layout, tmp_path):
    need(machine)
    assert "selftest passed" in selftest_on(
        machine, folders[precision, layout], NAME, precision == "float", tmp_path
    )


def test_a_failing_selftest_is_seen_from_outside_the_board(folders, tmp_path):
    need(CORTEX_M7)
    spoilt = tmp_path / "spoilt"
    shutil.copytree(folders["double", "unrolled"], spoilt)
    source = spoilt / f"{NAME}.c"
    assert "1.25" in source.read_text()  # the length of link 2
    source.write_text(source.read_text().replace("1.25", "1.26"))
    with pytest.raises(RuntimeError, match="failed on cortex-m7"):
        selftest_on(CORTEX_M7, spoilt, NAME, False, tmp_path)


@pytest.mark.slow
def test_cortex_m7_keeps_to_its_budget_of_flash_and_stack(folders, functions):
    need(CORTEX_M7)
    found = measure(folders["double", "unrolled"], functions, False)[CORTEX_M7.name]["functions"]
    assert found["deflection"]["code"] <= 6 * 1024
    assert found["deflection"]["stack"] <= 1024
    assert found["compensate"]["code"] <= 10 * 1024
    assert found["compensate"]["stack"] <= 2048
    assert found["compensate"]["code"] > found["deflection"]["code"]  # it calls it
    assert found["compensate"]["stack"] > found["deflection"]["stack"]
    arithmetic = 121 + 183  # of the recursion, before any sine
    assert arithmetic < found["deflection"]["instructions"] < 20 * arithmetic
    assert found["compensate"]["instructions"] > found["deflection"]["instructions"]


def test_the_compact_layout_saves_flash_on_cortex_m7(folders, tmp_path):
    need(CORTEX_M7)
    sizes = {}
    for layout in ("unrolled", "compact"):
        folder = folders["double", layout]
        CORTEX_M7.compile(["-c", f"-I{folder}", str(folder / f"{NAME}.c"), "-o", "m.o"], tmp_path)
        printed = _printed(["arm-none-eabi-size", "m.o"], tmp_path)
        sizes[layout] = int(printed.splitlines()[1].split()[0])
    assert sizes["compact"] < 0.7 * sizes["unrolled"]


def test_footprints_become_a_table_and_leave_out_machines_without_tools(folders, functions, monkeypatch):
    need(HOST)
    monkeypatch.setattr("symstiff.codegen.footprint.MACHINES", (HOST, Machine("z80", "no-such-gcc")))
    found = measure(folders["double", "unrolled"], functions, False)
    assert list(found) == [HOST.name]
    assert unmeasured({"double": found}) == ["z80 (no-such-gcc)"]
    table = markdown({"double": found})
    assert (
        f"| double | {HOST.name} | `deflection` | {found[HOST.name]['functions']['deflection']['code']} |"
        in table
    )


def test_no_footprint_without_any_compiler(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("symstiff.codegen.footprint.MACHINES", (Machine("z80", "no-such-gcc"),))
    assert_users_mistake(
        run("footprint", "planar2r", "--loads", "force"), "no compiler or emulator was found"
    )


@pytest.mark.slow
@pytest.mark.parametrize("machine", [HOST, CORTEX_M7, CORTEX_M4F], ids=lambda m: m.name)
def test_the_readme_tells_what_the_code_takes_today(
    machine: Machine, folders, functions, monkeypatch
) -> None:
    """The columns of its table, code / stack / instructions, where the compiler is the one that it names."""
    need(machine)
    if " 12.2" not in machine.version():
        pytest.skip("the README's figures are gcc 12.2's")
    text = (Path(__file__).parents[1] / "README.md").read_text()
    rows = dict(re.findall(r"^\| `(\w+)` \| (\d+ / .*) \|$", text, re.MULTILINE))
    columns = {HOST: [("double", "unrolled")], CORTEX_M7: VARIANTS[:2], CORTEX_M4F: [("float", "unrolled")]}
    first = {HOST: 0, CORTEX_M7: 1, CORTEX_M4F: 3}[machine]
    monkeypatch.setattr("symstiff.codegen.footprint.MACHINES", (machine,))
    for k, variant in enumerate(columns[machine]):
        found = measure(folders[variant], functions, variant[0] == "float")[machine.name]
        table = {f: " / ".join(str(v) for v in sizes.values()) for f, sizes in found["functions"].items()}
        assert table == {f: row.split(" | ")[first + k] for f, row in rows.items()}
        if machine is CORTEX_M7:
            whole = re.search(r"the whole file has (\d+) instead of (\d+) bytes", text)
            assert whole is not None
            assert found["object_bytes"] == int(whole[2 - k])


def _printed(command: list[str], cwd: Path) -> str:
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.parametrize(
    ("target", "machine"),
    [("aarch64-linux-musl", 0xB7), ("riscv64-linux-musl", 0xF3), ("x86_64-windows-gnu", 0x8664)],
)
def test_zig_compiles_the_sources_for_other_machines(folders, target, machine, tmp_path):
    if importlib.util.find_spec("ziglang") is None:
        pytest.skip("ziglang is missing")
    folder = folders["double", "unrolled"]
    for source in (f"{NAME}.c", f"{NAME}_selftest.c", f"{NAME}_batch.c"):
        place = tmp_path / "object"
        command = [
            sys.executable,
            "-m",
            "ziglang",
            "cc",
            "-target",
            target,
            *STRICT,
            "-O2",
            f"-I{folder}",
            "-c",
        ]
        _printed([*command, str(folder / source), "-o", str(place)], tmp_path)
        head = place.read_bytes()[:20]
        assert struct.unpack_from("<H", head, 18 if head[:4] == b"\x7fELF" else 0)[0] == machine


CALL_GRAPH = r"""
node: { title: "m.c:core" label: "core\nm.c:1:1\n100 bytes (static)" }
node: { title: "sin" label: "sin\nmath.h:1:1" shape : ellipse }
edge: { sourcename: "m.c:core" targetname: "sin" label: "m.c:2:2" }
node: { title: "a" label: "a\nm.c:3:3\n8 bytes (static)" }
edge: { sourcename: "a" targetname: "m.c:core" label: "m.c:4:4" }
node: { title: "m.c:shallow" label: "shallow\nm.c:5:5\n40 bytes (static)" }
edge: { sourcename: "a" targetname: "m.c:shallow" label: "m.c:4:4" }
"""


def test_stack_is_the_deepest_chain_and_code_the_sum_of_what_is_called():
    sizes = symbol_sizes(
        "00000000 00000010 t core\n00000010 00000004 T a\n00000020 00000002 t shallow\n         U sin\n"
    )
    assert totals(call_graph(CALL_GRAPH), sizes, {"a": "a"}) == {"a": {"code": 22, "stack": 108}}


def test_instructions_are_those_of_one_call_with_what_it_calls():
    text = "fn=(1) bench_a\n10 2\ncfn=(2) kr_a\ncalls=4 20\n11 400\nfn=(2)\n20 80\ncfn=(3) sin\ncalls=8 1\n21 320\n"
    assert instructions_per_call(text, "bench_") == {"a": 100}
