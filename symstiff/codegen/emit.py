"""The folder of C sources: what the templates need, computed here; what the files say, written there."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from importlib import resources
from pathlib import Path
from textwrap import wrap
from typing import Any

from symstiff import __version__
from symstiff.codegen.batch import batch_context, block_size
from symstiff.codegen.compact import Compact, compact
from symstiff.codegen.functions import Functions
from symstiff.codegen.names import (
    LOADS_KNOWN,
    LOADS_MEANING,
    SUMMARIES,
    check_single,
    effect_meaning,
    fixed_joints,
    limits,
    moments,
    seen_between,
)
from symstiff.codegen.options import Options
from symstiff.codegen.quoting import FILTERS
from symstiff.codegen.reference import (
    DIGITS,
    LARGEST_CORRECTION,
    ROUNDED,
    Case,
    cases,
    configurations,
    plausible_values,
    tolerance,
    turning_length,
    unit_length,
)
from symstiff.codegen.targets import TARGETS
from symstiff.codegen.text import CAlgebra, c_body, context_names
from symstiff.robot.schema import Robot
from symstiff.symbolic.algebras import count
from symstiff.symbolic.passes import parameter_symbol
from symstiff.symbolic.program import Program

_IN_A_ROW = 6
"""Numbers of a row of the self-test: compilers need not take lines of more than 4095 characters (C99 5.2.4.1)."""


@cache
def templates() -> Path:
    """The folder of templates: inside the installed package, or beside it in a checkout."""
    installed = Path(str(resources.files("symstiff"))) / "_templates"
    return installed if installed.is_dir() else Path(str(resources.files("symstiff"))).parent / "templates"


def environment() -> Any:
    """Jinja2 as this project uses it: strict about missing values, quiet about white space."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    jinja = Environment(
        loader=FileSystemLoader(templates()),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,
    )
    jinja.filters.update(FILTERS)
    return jinja


def emit_c(functions: Functions, options: Options) -> dict[str, bytes]:
    """File name → contents of the C folder. Same input, same bytes."""
    name = functions.model.robot.name
    context = template_context(functions, options)
    files = {
        f"{name}.h": "header.h.j2",
        f"{name}.c": "source.c.j2",
        f"{name}_batch.c": "batch.c.j2",
        f"{name}_selftest.c": "selftest.c.j2",
        f"test_{name}.c": "test.c.j2",
        f"fuzz_{name}.c": "fuzz.c.j2",
        "MISRA.md": "MISRA.md.j2",
        "main.c": "main.c.j2",
        "CMakeLists.txt": "CMakeLists.txt.j2",
        f"{name}.pc.in": "pc.in.j2",
        "README.md": "README.md.j2",
    }
    jinja = environment()
    return {
        target: jinja.get_template(f"c/{source}").render(context).encode() for target, source in files.items()
    }


def template_context(functions: Functions, options: Options) -> dict[str, Any]:
    """Everything that the C templates print."""
    literal = CAlgebra(options.single).literal
    context = base_context(functions, options) | batch_context(functions, options)
    return context | _selftest(functions, options) | _example(functions, literal)


def deflection_alone(functions: Functions) -> str:
    """The struct of parameters and the function that evaluates the deflection, as the folder of double precision has
    them; nothing else is derived."""
    name, jinja = functions.model.robot.name, environment()
    context: dict[str, Any] = {"name": name, "upper": name.upper(), "real": "double", "single": False}
    context |= _parameters(functions, Options(targets=("c",)))
    core = _function(functions.deflection, functions, context, {})
    struct = jinja.get_template("c/_struct.j2").render(context)
    return str(struct + jinja.get_template("c/_core.j2").render(context, f=core))


def base_context(functions: Functions, options: Options) -> dict[str, Any]:
    """What any template may print: names, options, hashes, parameters, functions."""
    model = functions.model
    counts = operations(functions, options)
    if options.single:
        check_single(functions.model)
    context = _identity(functions, options) | _numbers(functions, options) | _parameters(functions, options)
    context["functions"] = [
        {"name": p.name, "summary": SUMMARIES[p.name], "operations": operations_text(counts[p.name])}
        for p in functions.all
    ]
    context["compact"] = layout = _compact(functions, options)
    context["compact_compliance"] = layout is not None and not model.effects
    context["cores"] = [_function(p, functions, context, counts) for p in _cores(functions, context)]
    return context


def _identity(functions: Functions, options: Options) -> dict[str, Any]:
    """What the files are called, what they are of and what was asked for."""
    model, robot = functions.model, functions.model.robot
    return {
        "generator": __version__,
        "name": robot.name,
        "upper": robot.name.upper(),
        "title": robot.title or robot.name,
        "loads": model.loads,
        "measure": model.measure,
        "loads_meaning": LOADS_MEANING[model.loads],
        "fixed": fixed_joints(model),
        "limits": " ".join(limits(model)),
        "limit_lines": wrap(" ".join(limits(model)), 112, break_long_words=False, break_on_hyphens=False),
        "defaults_meaning": _defaults_meaning(functions),
        "compensation_meaning": _compensation_meaning(robot.dof, unit_length(model)),
        **{key: _triple(value) for key, value in _places(robot).items()},
        "options": [("loads", model.loads), ("measure", model.measure), *options.table().items()],
        "structure_hash": model.structure_hash,
        "model_hash": options.model_hash(model.structure_hash, model.known),
        "casadi": "casadi" in options.targets,
        "targets": options.targets,
        "headers": [
            f"{robot.name}.h",
            *(h for t in options.targets for h in TARGETS[t].files(robot.name, ".h")),
        ],
        "sources": options.sources(robot.name),
    }


def _numbers(functions: Functions, options: Options) -> dict[str, Any]:
    """The real type, its literals and functions, and sizes."""
    model, robot, single = functions.model, functions.model.robot, options.single
    literal, suffix = CAlgebra(single).literal, "f" if single else ""
    return {
        "real": options.precision,
        "single": single,
        "zero": literal(0.0),
        "one": literal(1.0),
        "half": literal(0.5),
        "fabs": f"fabs{suffix}",
        "sqrt": f"sqrt{suffix}",
        "digits": DIGITS,
        "n": robot.dof,
        "q_min": ", ".join(literal(float(j.range[0])) for j in robot.joint),
        "q_max": ", ".join(literal(float(j.range[1])) for j in robot.joint),
        "w_known": ", ".join(map(str, LOADS_KNOWN[model.loads])),
        "seen": [(name, ", ".join(map(literal, bounds))) for name, bounds in seen_between(model)],
        "limits_told": all(j.limits is not None for j in robot.joint),
        "prismatic": ", ".join(f"q{i}" for i, j in enumerate(robot.joint, 1) if j.prismatic),
        "redundant": robot.dof > 6,
        "tile": block_size(functions.observation.size("A"), single),
        "solve_rows": max(robot.dof, 6),
        "solve_columns": min(robot.dof, 6),
        "unit_length": literal(unit_length(model)),
        "turning_length": literal(turning_length(model)),
        "singular": literal(1e-5 if single else 1e-10),
        "largest_correction": literal(LARGEST_CORRECTION),
        "rounded": literal(ROUNDED),
        "largest_input": "1.0e9f" if single else "1.0e75",
        "compliances_propagate": _compliances_propagate(functions),
        "reciprocal": functions.reciprocal,
    }


def _parameters(functions: Functions, options: Options) -> dict[str, Any]:
    """The fields of the struct of parameters: compliances, effects, and what holds at the call."""
    model, literal = functions.model, CAlgebra(options.single).literal
    values, by_name = model.known, {p.name: p for p in model.compliances}
    return {
        "parameters": [
            {"name": n, "unit": model.units[n], "default": literal(values[n]), "meaning": by_name[n].meaning}
            for n in model.stiffness_parameters
        ],
        "effect_parameters": [
            {
                "name": e.name,
                "field": e.name,
                "unit": e.unit,
                "default": literal(values[e.name]),
                "typical": literal(float(e.typical)),
                "meaning": effect_meaning(model, e.name),
            }
            for e in model.effect_parameters
        ],
        "states": [
            {
                "name": m.name,
                "meaning": m.meaning,
                "default": literal(m.default),
                "held": [literal(x) for x in m.held or ()],
                "clock": m.name in ("time", "temperature"),
                "size": m.size and (m.size[0], literal(m.size[1])),
            }
            for m in moments(model, functions.deflection)
        ],
    }


def _compliances_propagate(functions: Functions) -> bool:
    """Whether no compliance that is NaN or infinite leaves Δt finite: each is a factor, and no law may hide it."""
    used = set().union(*(s.expression.free_symbols for s in functions.deflection.statements), set())
    model = functions.model
    return not model.effects and all(parameter_symbol(n) in used for n in model.stiffness_parameters)


def _defaults_meaning(functions: Functions) -> str:
    if functions.model.deviations:
        rigid = "" if functions.model.bends else " All compliances are zero: nothing bends under loads."
        return f"Default parameters: identified from measurements.{rigid}"
    if functions.defaults_known:
        return "Default parameters: what the robot file knows; others are zero until they are identified."
    return "Default parameters: given with the model."


def _places(robot: Robot) -> dict[str, Sequence[Any]]:
    return {
        "base_xyz": robot.base.xyz, "base_rpy": robot.base.rpy, "tool_xyz": robot.tool.xyz, "tool_rpy": robot.tool.rpy,
    }  # fmt: skip


def _triple(values: Sequence[Any]) -> str:
    return "(" + ", ".join(f"{float(x):.6g}" for x in values) + ")"


def _compensation_meaning(dof: int, unit: float) -> str:
    if dof == 6:
        return "to first order in the deflection"
    if dof > 6:
        return "the smallest joint motions that do"
    return f"as well as {dof} joints can: least squares in which a radian counts as {unit:g} m"


def operations_text(counts: dict[str, int]) -> str:
    """Operation counts in words."""
    other = f", {counts['other']} other functions" if counts["other"] else ""
    neg = f", {counts['neg']} neg" if counts["neg"] else ""
    return f"{counts['add']} add, {counts['mul']} mul{neg}, {counts['trig']} sin/cos{other}"


def operations(functions: Functions, options: Options) -> dict[str, dict[str, int]]:
    """Operation counts of every function as these options emit it."""
    counts = dict(functions.operations)
    layout = _compact(functions, options)
    if layout is not None:
        looped = ("observation",) if functions.model.effects else ("observation", "compliance")
        counts |= {name: layout.operations(name) for name in looped}
    return counts


def _compact(functions: Functions, options: Options) -> Compact | None:
    """The tables of the compact layout; None where it is not asked for or no compliance is left to loop over."""
    wanted = options.layout == "compact" and functions.model.stiffness_parameters
    return compact(functions.model) if wanted else None


def _cores(functions: Functions, context: dict[str, Any]) -> list[Program]:
    """The programs that are unrolled: a compact layout loops over the others."""
    layout = context["compact"]
    if layout is None:
        return list(functions.all)
    looped = ("observation", "compliance") if context["compact_compliance"] else ("observation",)
    return [layout.columns, *(p for p in functions.all if p.name not in looped)]


def _function(
    program: Program, functions: Functions, context: dict[str, Any], counts: dict[str, dict[str, int]]
) -> dict[str, Any]:
    model, real = functions.model, context["real"]
    names = {v.name for v in program.inputs}
    output = program.outputs[0][0]
    # No two neighbours of one type: arguments cannot be swapped unseen.
    arguments = [f"const {real} q[{model.robot.dof}]", f"{real} {output}[{program.size(output)}]"]
    if "p" in names:
        arguments.append(f"const {context['name']}_params_t *p")
    if "w" in names:
        arguments.append(f"const {real} w[6]")
    fields = {n: f"p->k[{k}]" for k, n in enumerate(model.stiffness_parameters)}
    fields |= {e.name: f"p->{e.name}" for e in model.effect_parameters}
    order = model.parameters
    body = c_body(
        program,
        {
            "p": lambda k: fields[order[k]],
            "q": lambda k: f"q[{k}]",
            "w": lambda k: f"w[{k}]",
            "context": lambda k: f"p->{context_names(program)[k]}",
        },
        single=bool(context["single"]),
    )
    unused = [n for n in ("p", "q", "w") if n in names and f"{n}[" not in body and f"{n}->" not in body]
    prologue = "".join(f"    (void){n};\n" for n in unused)
    return {
        "name": program.name,
        "summary": SUMMARIES[program.name],
        "operations": operations_text(counts.get(program.name) or count(program)),
        "arguments": ", ".join(arguments),
        "prologue": prologue,
        "body": body,
    }


def _selftest(functions: Functions, options: Options) -> dict[str, Any]:
    """Stored cases as literals."""
    model, algebra = functions.model, CAlgebra(options.single)
    values = plausible_values(model)
    found = cases(functions, values, single=options.single)
    overflows = any(c.overflows for c in found)
    stiffness = len(model.stiffness_parameters)
    parameters = [algebra.literal(values[n]) for n in model.parameters]

    def literals(values: Sequence[Any]) -> str:
        written = [algebra.literal(float(x)) for x in values]
        rows = (", ".join(written[k : k + _IN_A_ROW]) for k in range(0, len(written), _IN_A_ROW))
        return "{" + ",\n         ".join(rows) + "}"

    def members(c: Case) -> list[str]:
        condition = algebra.literal(round(c.condition) + 1.0 if c.K is not None else c.condition)
        default = () if overflows else (c.dt_default, c.default_sizes)
        given = (
            c.q,
            c.w,
            c.dt,
            c.sizes,
            *default,
            *([c.A] if stiffness else []),
            c.J,
            c.T,
            c.K or [0.0] * 36,
        )
        arrays = [literals(x) for x in given]
        expected = 1 if c.compensation is None else c.compensation
        return [*arrays, condition, literals(c.q_cmd), str(expected)]

    return {
        "cases": [members(c) for c in found],
        "defaults_tested": not overflows,
        "tolerance": algebra.literal(tolerance(options.single)),
        "beyond": algebra.literal(1e30),
        "test_parameters": parameters[:stiffness],
        "test_effect_parameters": parameters[stiffness:]
        + [algebra.literal(m.tested) for m in moments(functions.model, functions.deflection)],
    }


def _example(functions: Functions, literal: Any) -> dict[str, Any]:
    """A pose and a load for main.c, where the model holds."""
    (drawn, _), fixed = configurations(functions, 1, seed=11)[0], functions.model.fixed
    q = [fixed.get(j, round(x, 3)) for j, x in enumerate(drawn, start=1)]
    w = [0.0, 0.0, -1000.0, 0.0, 0.0, 0.0]
    return {"example_q": [literal(float(x)) for x in q], "example_w": [literal(x) for x in w]}


__all__ = [
    "base_context",
    "emit_c",
    "environment",
    "operations_text",
    "template_context",
    "templates",
]
