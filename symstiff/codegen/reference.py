"""Reference values with 50 digits: the observation's columns and mpmath's own solvers, not the recursion that is emitted."""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mpmath
import numpy as np

from symstiff.codegen.functions import Functions
from symstiff.model import StiffnessModel
from symstiff.symbolic.algebras import evaluate_decimal, evaluate_numpy

DIGITS = 50
_SIZES = {"m/N": 5e-8, "rad/N": 5e-8, "rad/(N*m)": 5e-7}


@dataclass(frozen=True)
class Case:
    """One configuration with its 50-digit values; K is None where the compliance has no inverse."""

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


def unit_length(model: StiffnessModel) -> float:
    """Length that weighs a radian against a metre: a quarter of the reach, a hundredth where position comes first."""
    return round(model.robot.reach * (0.25 if model.robot.dof >= 6 else 0.01), 4) or 0.01


def test_values(model: StiffnessModel, seed: int = 7) -> dict[str, float]:
    """Plausible parameter values, exact in single precision, for tests only."""
    rng = random.Random(seed)
    values = {}
    for p in model.compliances:
        size = _SIZES[p.unit] * (0.1 if p.is_coupling else 1.0)
        values[p.name] = float(np.float32(size * rng.uniform(0.5, 1.5)))
    for e in model.effect_parameters:
        values[e.name] = float(np.float32(e.typical * rng.uniform(0.5, 1.5)))
    return {n: values[n] for n in model.parameters}


def configurations(model: StiffnessModel, n: int, seed: int = 3) -> list[tuple[tuple[float, ...], tuple[float, ...]]]:
    """Joint variables within limits and wrenches, multiples of powers of two, away from singular poses."""
    rng = random.Random(seed)
    found: list[tuple[tuple[float, ...], tuple[float, ...]]] = []
    jacobian = Functions(model).jacobian
    for _ in range(200 * n):
        q = tuple(round(rng.uniform(*joint.range) * 1024) / 1024 for joint in model.robot.joint)
        w = tuple(round(rng.uniform(-s, s) * 4) / 4 for s in (2000, 2000, 2000, 400, 400, 400))
        J = evaluate_numpy(jacobian, q=np.array([q]))["J"][0]
        J[3:] *= 0.25 * model.robot.reach
        s = np.linalg.svd(J, compute_uv=False)
        if s[-1] > 0.01 * s[0]:
            found.append((q, w))
        if len(found) == n:
            break
    return found


def cases(functions: Functions, values: dict[str, float], n: int = 3, seed: int = 3) -> list[Case]:
    """Evaluate n random configurations with 50 digits."""
    return [_case(functions, values, q, w) for q, w in configurations(functions.model, n, seed)]


def _case(functions: Functions, values: dict[str, float], q: Sequence[float], w: Sequence[float]) -> Case:
    model = functions.model
    p = [values[n] for n in model.parameters]
    context = {"context": [1.0] * len(v.symbols) for v in model.deflection_program.inputs if v.name == "context"}
    A = evaluate_decimal(model.observation_program, DIGITS, q=q, w=w, **_only(model.observation_program, context))["A"]
    J = evaluate_decimal(functions.jacobian, DIGITS, q=q)["J"]
    T = evaluate_decimal(functions.forward, DIGITS, q=q)["T"]
    C = evaluate_decimal(functions.compliance, DIGITS, p=p, q=q, **_only(functions.compliance, context))["C"]
    with mpmath.workdps(DIGITS):
        if model.effects:
            dt = evaluate_decimal(model.deflection_program, DIGITS, p=p, q=q, w=w, **context)["dt"]
        else:
            rows = len(model.stiffness_parameters)
            dt = [mpmath.fsum(A[r * rows + c] * p[c] for c in range(rows)) for r in range(6)]
        K, condition = _inverse(C, unit_length(model))
        step = _solved(J, dt, unit_length(model))
        q_cmd = [mpmath.mpf(x) - s for x, s in zip(q, step, strict=True)]
    return Case(tuple(q), tuple(w), dt, A, J, T, C, K, condition, q_cmd)


def _only(program: Any, context: dict[str, list[float]]) -> dict[str, list[float]]:
    return {"context": [1.0] * len(v.symbols) for v in program.inputs if v.name == "context"}


def _inverse(C: Sequence[Any], unit: float) -> tuple[list[Any] | None, float]:
    scale = [1, 1, 1, unit, unit, unit]
    matrix = mpmath.matrix(6, 6)
    for i in range(6):
        for j in range(6):
            matrix[i, j] = C[6 * i + j] * scale[i] * scale[j]
    s = mpmath.svd_r(matrix, compute_uv=False)
    if s[5] < s[0] * mpmath.mpf(10) ** -8:
        return None, 1.0
    inverse = matrix**-1
    K = [inverse[i, j] * scale[i] * scale[j] for i in range(6) for j in range(6)]
    return K, float(s[0] / s[5])


def _solved(J: Sequence[Any], dt: Sequence[Any], unit: float) -> list[Any]:
    """Least squares (tall) or least norm (wide) with rotations weighed by ``unit``, by normal equations at 50 digits."""
    n = len(J) // 6
    scale = [1, 1, 1, unit, unit, unit]
    M = mpmath.matrix(6, n)
    for r in range(6):
        for c in range(n):
            M[r, c] = J[r * n + c] * scale[r]
    b = mpmath.matrix([x * s for x, s in zip(dt, scale, strict=True)])
    x = mpmath.lu_solve(M.T * M, M.T * b) if n <= 6 else M.T * mpmath.lu_solve(M * M.T, b)
    return list(x)
