"""50-digit reference values by mpmath: deflections of linear models from the observation's columns.

Compliance matrices, and deflections of models with further laws, come from the programs that are emitted, so that the
self-test shows what a compiler and its precision make of them; the tests hold these programs against other ways.
"""

from __future__ import annotations

import random
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import mpmath
import numpy as np
import sympy as sp

from symstiff.codegen.bending import Input, bending
from symstiff.codegen.functions import Functions
from symstiff.codegen.names import moments
from symstiff.codegen.text import context_names
from symstiff.effects.places import named
from symstiff.errors import UserError
from symstiff.model import StiffnessModel
from symstiff.symbolic.algebras import DecimalAlgebra, evaluate_numpy
from symstiff.symbolic.program import Constant, Program, evaluate

DIGITS = 50
LARGEST_CORRECTION = 0.25  # rad, m: a compensation that moves a joint further is no small correction
ROUNDED = 1.001  # of two squares of errors, up to which rounding may be the difference
OK, SINGULAR, RANGE, NO_GAIN = 0, -3, -5, -6  # what the generated functions return
_SIZES = {"m/N": 5e-8, "rad/N": 5e-8, "rad/(N*m)": 5e-7}
_SEED = 7  # of plausible values
_DEFICIENT = 1e-8
_OVERFLOW = 1e30  # m, rad: defaults that give more are in no self-test


@dataclass(frozen=True)
class Case:
    """One configuration with its 50-digit values.

    K is None where the compliance has no inverse; condition is 0 there, and −1 where rounding decides whether it has.
    compensation: what ``compensate`` returns, None where rounding decides that; q_cmd is q where it is an error.
    dt_default: the deflection dt by the model's own values. sizes, default_sizes: what these two are added up from,
    translation and rotation, so that values which cancel each other are held to what rounding leaves of them.
    """

    q: tuple[float, ...]
    w: tuple[float, ...]
    dt: list[Any]
    A: list[Any]
    J: list[Any]
    T: list[Any]
    C: list[Any]
    K: list[Any] | None
    condition: float
    q_cmd: list[Any]
    compensation: int | None
    sizes: tuple[float, float]
    dt_default: list[Any]
    default_sizes: tuple[float, float]

    @property
    def overflows(self) -> bool:
        """Whether the model's own values are absurd: their deflections might not be finite."""
        return not max(self.default_sizes) < _OVERFLOW


def unit_length(model: StiffnessModel) -> float:
    """Metres that weigh as much as a radian: a quarter of the reach, a hundredth where position comes first."""
    return round(model.robot.reach * (0.25 if model.robot.dof >= 6 else 0.01), 4) or 0.01


def turning_length(model: StiffnessModel) -> float:
    """Metres that weigh as much as a radian where a compliance is inverted: a quarter of the reach."""
    return round(0.25 * model.robot.reach, 4) or 0.01


def tolerance(single: bool) -> float:
    """Greatest relative error of a correct function at a regular pose, some hundred roundings."""
    return 2e-5 if single else 1e-12


def plausible_values(model: StiffnessModel) -> dict[str, float]:
    """Plausible parameter values, exact in single precision, for tests only."""
    rng = random.Random(_SEED)
    values = {}
    for p in model.compliances:
        size = _SIZES[p.unit] * (0.1 if p.is_coupling else 1.0)
        values[p.name] = float(np.float32(size * rng.uniform(0.5, 1.5)))
    for e in model.effect_parameters:
        values[e.name] = float(np.float32(e.typical * rng.uniform(0.5, 1.5)))
    return {n: values[n] for n in model.parameters}


def configurations(functions: Functions, n: int, seed: int = 3) -> list[Input]:
    """Joint variables within limits and wrenches, multiples of powers of two, away from singular poses.

    Where the Jacobian is deficient at every pose, away from those where its rank is smaller still; where few poses
    are regular, the best of many.
    """
    rng = random.Random(seed)
    robot = functions.model.robot
    drawn: list[Input] = []
    share = np.zeros((0, min(robot.dof, 6)))  # singular values over the greatest
    for _ in range(100):
        new = [_drawn(robot, rng) for _ in range(2 * n)]
        J = evaluate_numpy(functions.jacobian, q=np.array([q for q, _ in new]))["J"]
        J[:, 3:] *= turning_length(functions.model)
        s = np.linalg.svd(J, compute_uv=False)
        drawn, share = drawn + new, np.vstack([share, s / s[:, :1]])
        rank = (share > _DEFICIENT).sum(axis=1).max()
        regular = np.flatnonzero(share[:, rank - 1] > 0.01)
        if len(regular) >= n:
            return [drawn[k] for k in regular[:n]]
    return [drawn[k] for k in np.argsort(-share[:, rank - 1], kind="stable")[:n]]


def _drawn(robot: Any, rng: random.Random) -> Input:
    q = tuple(round(rng.uniform(*joint.range) * 1024) / 1024 for joint in robot.joint)
    w = tuple(round(rng.uniform(-s, s) * 4) / 4 for s in (2000, 2000, 2000, 400, 400, 400))
    return q, w


def cases(
    functions: Functions, values: Mapping[str, float], n: int = 3, seed: int = 3, single: bool = False
) -> list[Case]:
    """Evaluate n random configurations with 50 digits, all at once, and those that a model's laws need beside them.

    single: for functions in single precision.
    """
    model, found = functions.model, configurations(functions, n, seed)
    if model.effects:
        _check_finite(model, values, found)
        rounding = tolerance(single) / float(np.finfo(np.float32 if single else float).eps) / 20
        found = found + bending(model, values, found, configurations(functions, 48, seed + 1), rounding)
    known = model.known
    known = {name: float(np.float32(x)) for name, x in known.items()} if single else known
    with mpmath.workdps(DIGITS):
        inputs = {
            "p": [mpmath.mpf(values[name]) for name in model.parameters],
            "q": _columns([q for q, _ in found]),
            "w": _columns([w for _, w in found]),
            **{m.name: mpmath.mpf(m.tested) for m in moments(model, functions.deflection)},
        }
        A = _evaluated(model.observation_program, inputs, len(found))
        J = _evaluated(functions.jacobian, inputs, len(found))
        T = _evaluated(functions.forward, inputs, len(found))
        C = _evaluated(functions.compliance, inputs, len(found))
        dt = _deflections(model, A, inputs)
        default = _deflections(model, A, inputs | {"p": [mpmath.mpf(x) for x in known.values()]})
        sizes = np.stack([_sizes(model, v, found) for v in (values, known)], axis=1)
        commands = _commands(found, J, dt, functions)
        return [
            _case(
                model,
                found[i],
                [list(x[i]) for x in (dt, A, J, T, C, default)],
                commands[i],
                sizes[i],
                single,
            )
            for i in range(len(found))
        ]


def _check_finite(model: StiffnessModel, values: Mapping[str, float], found: Sequence[Input]) -> None:
    """Raise UserError that names the effects whose laws give no finite number at one of the configurations."""
    if np.isfinite(_sizes(model, values, found)).all():
        return
    alone = {named(e.effect, e.where): model.with_effects([e]) for e in model.effects}
    # alone, compliances come back that another effect stands for
    own = {name: {n: values.get(n, 0.0) for n in one.parameters} for name, one in alone.items()}
    wrong = [name for name, one in alone.items() if not np.isfinite(_sizes(one, own[name], found)).all()]
    raise UserError(
        f"the law of {', '.join(wrong) or 'the effects together'} gives no finite number under loads of the self-test "
        f"(up to {max(abs(x) for _, w in found for x in w):g} N, N·m): write it so that it holds at all loads"
    )


def _case(
    model: StiffnessModel,
    given: Input,
    evaluated: Sequence[list[Any]],
    command: tuple[list[Any], int | None],
    sizes: np.ndarray,
    single: bool,
) -> Case:
    (q, w), (dt, A, J, T, C, default) = given, evaluated
    K, condition = _inverse(C, turning_length(model), 1e-4 if single else 1e-8)
    q_cmd, compensation = command
    own, by_default = ((float(f"{t:.3g}"), float(f"{r:.3g}")) for t, r in sizes)  # the same on every machine
    return Case(q, w, dt, A, J, T, C, K, condition, q_cmd, compensation, own, default, by_default)


def _deflections(model: StiffnessModel, A: np.ndarray, inputs: Mapping[str, Any]) -> np.ndarray:
    """(N, 6) 50-digit deflections: by columns, or by the program where there are other laws."""
    if model.effects:
        return _evaluated(model.deflection_program, inputs, len(A))
    p = np.array(inputs["p"], dtype=object)
    dt: np.ndarray = (A.reshape(len(A), 6, -1) * p).sum(-1)
    return dt


def _sizes(model: StiffnessModel, values: Mapping[str, float], found: Sequence[Input]) -> np.ndarray:
    """Greatest sums, (N, 2), of what each parameter alone gives to translations and to rotations."""
    program, n, m = model.deflection_program, len(found), len(values)
    given = {
        "p": np.tile(np.diag([values[name] for name in model.parameters]), (n, 1)),
        "q": np.repeat([q for q, _ in found], m, axis=0),
        "w": np.repeat([w for _, w in found], m, axis=0),
        "context": np.tile([x.tested for x in moments(model, program)], (n * m, 1)),
    }
    with np.errstate(all="ignore"):
        dt = evaluate_numpy(program, **{v.name: given[v.name] for v in program.inputs})["dt"]
        total = np.abs(dt.reshape(n, m, 6)).sum(axis=1)
    sizes: np.ndarray = total.reshape(n, 2, 3).max(axis=2)
    return sizes


def _commands(
    found: Sequence[Input], J: np.ndarray, dt: np.ndarray, functions: Functions
) -> list[tuple[list[Any], int | None]]:
    """For every configuration the joint command, q itself where there is none, and what ``compensate`` returns."""
    unit = unit_length(functions.model)
    tried = [_step(one, moved, unit) for one, moved in zip(J, dt, strict=True)]
    q, steps = (np.array(x, dtype=float) for x in ([q for q, _ in found], [step for step, _ in tried]))
    halfway = evaluate_numpy(functions.jacobian, q=q - steps / 2)["J"]
    told = []
    for k, (step, status) in enumerate(tried):
        if status == OK:
            status = _gain(halfway[k], steps[k], np.array(dt[k], dtype=float), unit)
        moved = step if status != NO_GAIN else [0] * len(step)
        told.append(([mpmath.mpf(x) - s for x, s in zip(q[k], moved, strict=True)], status))
    return told


def _step(J: Sequence[Any], dt: Sequence[Any], unit: float) -> tuple[list[Any], int | None]:
    """The step of the joints, zeros where there is none, and OK or why there is none; None where rounding decides."""
    n = len(J) // 6
    status = _singularity(np.array(J, dtype=float).reshape(6, -1) * np.array([[1.0]] * 3 + [[unit]] * 3))
    if status != OK:
        return [mpmath.mpf(0)] * n, status
    step = _solved(J, dt, unit)
    furthest = float(max(map(abs, step))) / LARGEST_CORRECTION
    if furthest > 0.99:
        return [mpmath.mpf(0)] * n, RANGE if furthest > 1.01 else None
    return step, OK


def _gain(J: np.ndarray, step: np.ndarray, dt: np.ndarray, unit: float) -> int | None:
    """NO_GAIN where a step leaves a greater error than dt by J (6, n) half way, None where rounding decides."""
    scale = np.array([1.0, 1.0, 1.0, unit, unit, unit])
    after, before = (float(np.sum((scale * x) ** 2)) for x in (dt - J @ step, dt))
    if after <= (0.5 + ROUNDED / 2) * before:
        return OK
    return NO_GAIN if after > (2 * ROUNDED - 1) * before else None


def _singularity(J: np.ndarray) -> int | None:
    """OK for a regular Jacobian (6, n), SINGULAR where a reduction column by column is sure to see that it is none."""
    columns = J if J.shape[1] <= 6 else J.T
    s = np.linalg.svd(columns, compute_uv=False)
    if s[-1] > 1e-6 * s[0]:
        return OK
    if s[-1] > 1e-13 * s[0]:
        return None
    ranks = [np.linalg.matrix_rank(columns[:, : k + 1], 1e-12 * s[0]) for k in range(columns.shape[1])]
    first = next(k for k, rank in enumerate(ranks) if rank <= k)
    combination = np.linalg.lstsq(columns[:, :first], columns[:, first], rcond=None)[0]
    # the rounding of the columns before comes through these factors: 20 of them stay below single precision's bound
    return SINGULAR if np.abs(combination).sum() < 20 else None


class _DecimalArrays(DecimalAlgebra):
    """mpmath numbers in arrays of objects: one walk of a program serves all configurations."""

    def number(self, value: sp.Expr) -> Any:
        """The number in an array of its own: mpmath's product with an array is slow."""
        return np.array(super().number(value), dtype=object)

    def constant(self, constant: Constant) -> Any:
        """The exact value."""
        return self.number(constant.exact)

    def power(self, base: Any, exponent: sp.Expr) -> Any:
        """x**e."""
        return base ** (int(exponent) if exponent.is_Integer else self.number(exponent))

    def call(self, function: str, arguments: Sequence[Any]) -> Any:
        """mpmath's function of that name, element by element."""
        return np.frompyfunc(lambda *x: super(_DecimalArrays, self).call(function, x), len(arguments), 1)(
            *arguments
        )


def _columns(rows: Sequence[Sequence[float]]) -> list[Any]:
    return [np.array([mpmath.mpf(x) for x in column], dtype=object) for column in zip(*rows, strict=True)]


def _evaluated(program: Program, inputs: Mapping[str, Any], n: int) -> np.ndarray:
    """The only output of a program, (n, size) 50-digit numbers; what holds at the moment is an input each."""
    known = {v.name: inputs[v.name] for v in program.inputs if v.name != "context"}
    known["context"] = [inputs[n] for n in context_names(program)]
    (flat,) = evaluate(program, known, _DecimalArrays()).values()
    result = np.empty((n, len(flat)), dtype=object)
    for k, x in enumerate(flat):
        result[:, k] = x
    return result


def _inverse(C: Sequence[Any], unit: float, regular: float) -> tuple[list[Any] | None, float]:
    scale = [1, 1, 1, unit, unit, unit]
    matrix = mpmath.matrix(6, 6)
    for i in range(6):
        for j in range(6):
            matrix[i, j] = C[6 * i + j] * scale[i] * scale[j]
    s = np.linalg.svd(np.array(matrix.tolist(), dtype=float), compute_uv=False)
    if s[5] <= s[0] * regular:
        return None, 0.0 if s[5] <= s[0] * 1e-13 else -1.0
    inverse = matrix**-1
    K = [inverse[i, j] * scale[i] * scale[j] for i in range(6) for j in range(6)]
    return K, float(s[0] / s[5])


def _solved(J: Sequence[Any], dt: Sequence[Any], unit: float) -> list[Any]:
    """Least squares (tall) or least norm (wide), rotations weighed by ``unit``, by normal equations."""
    n = len(J) // 6
    scale = [1, 1, 1, unit, unit, unit]
    M = mpmath.matrix(6, n)
    for r in range(6):
        for c in range(n):
            M[r, c] = J[r * n + c] * scale[r]
    b = mpmath.matrix([x * s for x, s in zip(dt, scale, strict=True)])
    x = mpmath.lu_solve(M.T * M, M.T * b) if n <= 6 else M.T * mpmath.lu_solve(M * M.T, b)
    return list(x)
