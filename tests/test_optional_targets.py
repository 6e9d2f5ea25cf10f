"""Batches, the reader of parameters and the on-line estimator: on emulated boards, and under the static analysers."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from symstiff.codegen.footprint_machines import CORTEX_M4F, CORTEX_M7, Machine
from symstiff.codegen.params import params_text
from tests.generated_c import compiler, model, poses, run, written

ROBOT = "scara"
TARGETS = ("c", "params", "rls")
FILES = [f"{ROBOT}_{part}.c" for part in ("batch", "params", "rls")]

MAIN = """
#include "board.h"
#include "scara.h"
#include "scara_params.h"
#include "scara_rls.h"
#include <math.h>
#include <string.h>

#define N @N@
#define P SCARA_N_PARAMETERS
static const char text[] = @TEXT@;
static const real_t q[SCARA_N_JOINTS * N] = {@Q@};
static const real_t w[6 * N] = {@W@};
static real_t dt[6 * N], tiles[6 * P * ((N + SCARA_TILE - 1) / SCARA_TILE * SCARA_TILE)];
static scara_params_t read, zero;
static scara_rls_t state;

static int said(const char *what, int good)
{
    board_write(what);
    board_write((good != 0) ? " passed\\n" : " failed\\n");
    return (good != 0) ? 0 : 1;
}

static void pose(int i, real_t one_q[SCARA_N_JOINTS], real_t one_w[6])
{
    for (int c = 0; c < SCARA_N_JOINTS; ++c) one_q[c] = q[c * N + i];
    for (int c = 0; c < 6; ++c) one_w[c] = w[c * N + i];
}

static int params_are_read(void)
{
    size_t line = 9;
    int good = scara_params_read(text, strlen(text), &read, &line) == 0 && line == 0;
    good = good && memcmp(&read, &scara_default_params, sizeof read) == 0;
    return good && scara_params_read(text, strlen(text) / 2, &zero, &line) < 0;
}

static int batches_are_single_calls(void)
{
    const size_t stride[2] = {N, 1};
    real_t a[SCARA_N_JOINTS], b[6], one[6], A[6 * P];
    int good = scara_deflection_batch(&read, N, q, w, dt) == 0;
    good = good && scara_observation_tiles(N, q, stride, w, stride, tiles) == 0;
    for (int i = 0; i < N; ++i) {
        pose(i, a, b);
        good = good && scara_deflection(&read, a, b, one) == 0 && scara_observation(a, b, A) == 0;
        for (int c = 0; c < 6; ++c) good = good && fabs((double)(dt[c * N + i] - one[c])) <= @DEFLECTION@;
        for (int c = 0; c < 6 * P; ++c) {
            const int at = ((6 * P * (i / SCARA_TILE)) + c) * SCARA_TILE + (i % SCARA_TILE);
            good = good && fabs((double)(tiles[at] - A[c])) <= @OBSERVATION@;
        }
    }
    return good;
}

static int the_estimate_converges(void)
{
    const real_t sigma[6] = {@SIGMA@, @SIGMA@, @SIGMA@, @SIGMA@, @SIGMA@, @SIGMA@};
    real_t a[SCARA_N_JOINTS], b[6], one[6];
    int good = scara_rls_init(&state, &zero, 1, 1, 1000) == 0;
    for (int i = 0; i < N; ++i) {
        pose(i, a, b);
        good = good && scara_deflection(&read, a, b, one) == 0 && scara_rls_update(&state, a, b, one, sigma) == 0;
    }
    for (int k = 0; k < P; ++k)
        good = good && fabs((double)(state.params.k[k] - read.k[k])) <= @ESTIMATE@ * fabs((double)read.k[k]);
    return good;
}

int main(void)
{
    int failed = said("params", params_are_read());
    failed |= said("batch", batches_are_single_calls());
    return failed | said("rls", the_estimate_converges());
}
"""


def board_program(precision: str, n: int = 37) -> str:
    """A program that reads parameters, compares batches with single calls and identifies what it read."""
    q, w = poses(ROBOT, n)
    double = precision == "double"
    deflection, observation = (
        abs(model(ROBOT).deflection(q, w)).max(),
        abs(model(ROBOT).observation(q, w)).max(),
    )
    eps = 2.0**-52 if double else 2.0**-23
    parts = {
        "N": n, "TEXT": json.dumps(params_text(model(ROBOT))),
        "Q": ", ".join(repr(float(x)) for x in q.T.ravel()), "W": ", ".join(repr(float(x)) for x in w.T.ravel()),
        "DEFLECTION": 40 * eps * deflection, "OBSERVATION": 40 * eps * observation,
        "SIGMA": 1e-9 if double else 1e-5, "ESTIMATE": 1e-6 if double else 1e-2,
    }  # fmt: skip
    text = f"typedef {precision} real_t;" + MAIN
    for key, value in parts.items():
        text = text.replace(f"@{key}@", str(value))
    return text


def on_board(machine: Machine, folder: Path, precision: str, scratch: Path):
    if machine.missing:
        pytest.skip(f"{machine.missing} is missing")
    (scratch / "program.c").write_text(board_program(precision))
    sources = [str(folder / f) for f in (f"{ROBOT}.c", *FILES)]
    machine.link_board([f"-I{folder}", "program.c", *sources], "program.elf", scratch)
    return machine.run_board(scratch / "program.elf")


@pytest.mark.parametrize(
    ("machine", "precision"),
    [(CORTEX_M7, "double"), (CORTEX_M4F, "float")],
    ids=lambda x: getattr(x, "name", x),
)
def test_batches_reader_and_estimator_work_on_an_emulated_board(machine, precision, tmp_path):
    folder = written(tmp_path / "code", ROBOT, precision, TARGETS)
    done = on_board(machine, folder, precision, tmp_path)
    assert done.stdout.splitlines() == ["params passed", "batch passed", "rls passed"]
    assert done.returncode == 0


def test_what_is_wrong_on_the_board_is_seen_outside(tmp_path):
    folder = written(tmp_path / "code", ROBOT, "double", TARGETS)
    source = folder / f"{ROBOT}_batch.c"
    assert "(turns + 1.0)" in source.read_text()
    source.write_text(source.read_text().replace("(turns + 1.0)", "(turns - 1.0)"))
    done = on_board(CORTEX_M7, folder, "double", tmp_path)
    assert done.stdout.splitlines() == ["params passed", "batch failed", "rls passed"]
    assert done.returncode != 0


@pytest.fixture(scope="module", params=["double", "float"])
def folder(request, tmp_path_factory) -> Path:
    return written(tmp_path_factory.mktemp(request.param), ROBOT, request.param, TARGETS)


def test_gccs_analyser_has_nothing_to_say(folder, tmp_path):
    flags = ["-std=c99", "-O2", "-fanalyzer", "-Wall", "-Wextra", "-Werror", "-c"]
    for source in FILES:
        assert run(compiler(), *flags, source, "-o", tmp_path / "o", cwd=folder) == ""


def test_clang_tidy_has_nothing_to_say(folder):
    if shutil.which("clang-tidy") is None:
        pytest.skip("clang-tidy is missing")
    checks = "-checks=-*,bugprone-*,cert-*,clang-analyzer-*"
    printed = run(
        "clang-tidy", "-quiet", checks, "--warnings-as-errors=*", *FILES, "--", "-std=c99", cwd=folder
    )
    assert "warning:" not in printed
