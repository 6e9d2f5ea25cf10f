"""What the generated files say of the stack is what a painted stack shows."""

from __future__ import annotations

import re

import pytest

from tests.generated_c import compiler, model, run, written

CASES = [("kuka_kr270", "double"), ("kuka_kr270", "float"), ("scara", "double")]

PAINTED = """
#include "@.h"
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static REAL q[@N * 64], w[6 * 64], dt[6 * 64], A[6 * @M * 64];
static int chosen;

static void *run(void *nothing)
{
    if (chosen == 1) { (void)@_deflection_batch(&@_default_params, 64, q, w, dt); }
    if (chosen == 2) { (void)@_observation_batch(64, q, w, A); }
    return nothing;
}

/* Bytes of a painted stack that lose their paint. */
static size_t used(int what)
{
    static char *stack;
    const size_t size = (size_t)1 << 20;
    pthread_attr_t a;
    pthread_t t;
    size_t i = 0;
    if (stack == NULL) { stack = malloc(size); }
    memset(stack, 0xA5, size);
    chosen = what;
    pthread_attr_init(&a);
    pthread_attr_setstack(&a, stack, size);
    pthread_create(&t, &a, run, NULL);
    pthread_join(t, NULL);
    while ((i < size) && ((unsigned char)stack[i] == 0xA5)) { ++i; }
    return size - i;
}

int main(void)
{
    int i;
    for (i = 0; i < @N * 64; ++i) { q[i] = (REAL)(i % 7) / 3; }
    for (i = 0; i < 6 * 64; ++i) { w[i] = (REAL)i; }
    q[3] = (REAL)1e7; /* beyond the reach: the scalar function's turn */
    printf("%zu %zu\\n", used(1) - used(0), used(2) - used(0));
    return 0;
}
"""


@pytest.mark.slow
@pytest.mark.parametrize("cc", ["gcc", "clang"])
@pytest.mark.parametrize(("robot", "precision"), CASES)
@pytest.mark.parametrize("flags", ["-O2", "-Os", "-O3 -march=native"])
def test_the_stack_is_what_the_file_says(tmp_path, robot, precision, cc, flags):
    """Measured on a painted stack, symbols bound beforehand, with a pose that the scalar function takes."""
    folder = written(tmp_path, robot, precision)
    m = model(robot)
    text = PAINTED.replace("@N", str(m.robot.dof)).replace("@M", str(len(m.parameters)))
    (folder / "painted.c").write_text(text.replace("@", robot).replace("REAL", precision))
    sources = ["painted.c", f"{robot}.c", f"{robot}_batch.c"]
    run(compiler(cc), *flags.split(), *sources, "-o", "p", "-lm", "-lpthread", "-Wl,-z,now", cwd=folder)
    found = max(int(x) for x in run("./p", cwd=folder).split())
    said = re.search(r"more than (\d+) bytes, and (\d+)\s", (folder / f"{robot}_batch.c").read_text())
    stated = int(said[2 if "native" in flags else 1])
    assert 0.5 * stated < found <= stated
