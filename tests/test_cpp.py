"""The C++ header is free of cost and says what the C functions say."""

from __future__ import annotations

import re

import numpy as np
import pytest

from tests.generated_c import compiler, model, poses, run, written

STRICT_CPP = [
    "-std=c++17",
    "-Wall",
    "-Wextra",
    "-Wpedantic",
    "-Wconversion",
    "-Wdouble-promotion",
    "-Wshadow",
    "-Werror",
]

PROGRAM = """
#include "{robot}.hpp"
#include <cstdio>
#include <type_traits>

namespace m = {robot};

static_assert(noexcept(m::deflection(m::default_params(), m::joints{{}}, m::wrench{{}}, std::declval<m::twist &>())));
static_assert(static_cast<int>(m::status::range) == -5);
static_assert(m::message(m::status::range).find("_MAX_CORRECTION") != std::string_view::npos);
static_assert(noexcept(m::compensate(m::default_params(), m::joints{{}}, m::wrench{{}}, std::declval<m::joints &>())));
static_assert(std::is_same_v<m::real, {real}>);
static_assert(m::parameter_names.size() == m::n_parameters);
static_assert(m::message(m::status::singular).size() > 0);
static_assert(m::model_hash.size() == 64);
static_assert(m::q_min[0] < m::q_max[0]);
static_assert(m::w_known[2] == 1);

int main()
{{
    const m::joints q{{{q}}};
    const m::wrench w{{{w}}};
    m::twist dt{{}}, many[2];
    const m::joints qs[2] = {{q, q}};
    const m::wrench ws[2] = {{w, w}};
    m::joints q_cmd{{}};
    m::observation_matrix A{{}};
    m::jacobian_matrix J{{}};
    m::pose_matrix T{{}};
    m::stiffness_matrix K{{}};
    m::real worst{{}};
    m::params p = m::default_params();
    if (m::deflection(p, q, w, dt) != m::status::ok || m::compensate(p, q, w, q_cmd) != m::status::ok ||
        m::observation(q, w, A) != m::status::ok || m::jacobian(q, J) != m::status::ok ||
        m::forward(q, T) != m::status::ok || m::selftest(worst) != m::status::ok ||
        m::deflection(p, 2, qs, ws, many) != m::status::ok) {{
        return 1;
    }}
    (void)m::stiffness(p, q, K);
    const m::joints broken{{static_cast<m::real>(1) / static_cast<m::real>(0)}};
    if (m::deflection(p, broken, w, many[0]) != m::status::nonfinite) {{
        return 2;
    }}
    for (const auto x : dt) {{ std::printf("%.17g ", static_cast<double>(x)); }}
    for (const auto x : many[1]) {{ std::printf("%.17g ", static_cast<double>(x)); }}
}}
"""


@pytest.mark.parametrize("precision", ["double", "float"])
@pytest.mark.parametrize("cc", ["gcc", "clang"])
def test_a_program_compiles_strictly_and_gets_the_values_of_the_model(tmp_path, precision, cc):
    robot = "scara"
    folder = written(tmp_path, robot, precision, ("c", "cpp"))
    q, w = poses(robot, 1)
    literal = (lambda x: f"{np.float32(x)!s}f") if precision == "float" else repr
    text = PROGRAM.format(robot=robot, real=precision, q=", ".join(literal(float(x)) for x in q[0]),
                          w=", ".join(literal(float(x)) for x in w[0]))  # fmt: skip
    (folder / "use.cpp").write_text("#include <utility>\n" + text)
    sources = [f"{robot}.c", f"{robot}_batch.c", f"{robot}_selftest.c"]
    run(compiler(cc), "-std=c99", "-O2", "-c", *sources, cwd=folder)
    objects = [s.replace(".c", ".o") for s in sources]
    driver = compiler({"gcc": "g++", "clang": "clang++"}[cc])
    run(driver, *STRICT_CPP, "-Wno-div-by-zero", "-O2", "use.cpp", *objects, "-o", "use", "-lm", cwd=folder)
    found = np.array(run("./use", cwd=folder).split(), float).reshape(2, 6)
    wanted = model(robot).deflection(q, w)[0]
    tolerance = 1e-13 if precision == "double" else 1e-5
    np.testing.assert_allclose(found, [wanted, wanted], rtol=0, atol=tolerance * np.abs(wanted).max())


def test_the_header_can_be_included_twice_and_allocates_nothing(tmp_path):
    folder = written(tmp_path, "scara", "double", ("c", "cpp"))
    for unit in ("a", "b"):
        (folder / f"{unit}.cpp").write_text(
            f'#include "scara.hpp"\n#include "scara.hpp"\nint {unit}() {{ return (int)scara::n_joints; }}\n'
        )
    (folder / "main.cpp").write_text("int a(); int b(); int main() { return a() - b(); }\n")
    run(
        compiler("g++"),
        *STRICT_CPP,
        "-fno-exceptions",
        "a.cpp",
        "b.cpp",
        "main.cpp",
        "-o",
        "twice",
        cwd=folder,
    )
    run("./twice", cwd=folder)
    code = re.sub(r"//.*", "", (folder / "scara.hpp").read_text())
    assert not re.search(r"\b(new|throw|vector|malloc)\b", code)
    functions = re.findall(r"\[\[nodiscard\]\] (.*)", code)
    assert len(functions) >= 9
    assert all("noexcept" in f for f in functions)


def test_errors_of_the_other_targets_have_a_message(tmp_path):
    folder = written(tmp_path, "scara", "double", ("c", "params", "rls", "cpp"))
    (folder / "use.cpp").write_text(
        '#include "scara.hpp"\n'
        'static_assert(scara::message(scara::status{SCARA_E_PARAMS_HASH}) != "unknown error");\n'
        'static_assert(scara::message(scara::status{SCARA_E_RLS_SETTING}) == "a setting is out of its range");\n'
        "int main() { return 0; }\n"
    )
    run(compiler("g++"), *STRICT_CPP, "use.cpp", "-c", "-o", "use.o", cwd=folder)
