"""Pinocchio for the kinematics, NumPy for the rest: what a Python user would write; timed in Python."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from tests.benchmarks.case import Case, turned


def model_of(case: Case) -> tuple[Any, list[int]]:
    """Pinocchio's model with a frame at every DH frame, and the frames' numbers, base first, tool last."""
    import pinocchio as pin

    model, parent = pin.Model(), 0
    place = pin.SE3(*case.base)
    identifiers = [model.addFrame(pin.Frame("link0", 0, 0, place, pin.FrameType.OP_FRAME))]
    for i, row in enumerate(case.rows, start=1):
        start = place * pin.SE3(turned(2, row.theta), np.zeros(3))
        joint = pin.JointModelPZ() if row.prismatic else pin.JointModelRZ()
        parent = model.addJoint(parent, joint, start, f"joint{i}")
        c, s = row.cos_alpha, row.sin_alpha
        place = pin.SE3(np.array([[1, 0, 0], [0, c, -s], [0, s, c]]), np.array([row.a, 0.0, row.d]))
        identifiers.append(model.addFrame(pin.Frame(f"link{i}", parent, 0, place, pin.FrameType.OP_FRAME)))
    tool = place * pin.SE3(*case.tool)
    identifiers.append(model.addFrame(pin.Frame("tool", parent, 0, tool, pin.FrameType.OP_FRAME)))
    return model, identifiers


def functions(case: Case) -> tuple[Callable[..., np.ndarray], Callable[..., np.ndarray]]:
    """``deflection(q, w)`` and ``observation(q, w)``: poses by Pinocchio, columns and loads of all links at once."""
    import pinocchio as pin

    if any(e.row == 0 for e in case.entries):
        raise ValueError("the parameters of the joints have to be aggregated for this comparison")
    model, identifiers = model_of(case)
    data = model.createData()
    axes = np.stack([case.elastic_axes(i) for i in range(case.dof + 1)])
    first = np.array([6 * e.body + e.row - 1 for e in case.entries])
    second = np.array([6 * e.body + e.column - 1 for e in case.entries])
    coupling = np.flatnonzero(first != second)
    stiffness = np.zeros((6 * (case.dof + 1),) * 2)
    stiffness[first, second] = stiffness[second, first] = case.values

    def columns(q: np.ndarray) -> np.ndarray:
        pin.framesForwardKinematics(model, data, q)
        frames = [data.oMf[i] for i in identifiers]
        tip = frames[-1].translation
        e = np.stack([f.rotation for f in frames[:-1]]) @ axes
        levers = tip - np.stack([f.translation for f in frames[:-1]])
        j = np.zeros((6, len(axes), 2, 3))
        j[:3, :, 0] = j[3:, :, 1] = e.transpose(1, 0, 2)
        j[:3, :, 1] = np.cross(e, levers[:, :, None], axis=1).transpose(1, 0, 2)
        return j.reshape(6, -1)

    def deflection(q: np.ndarray, w: np.ndarray) -> np.ndarray:
        j = columns(q)
        dt: np.ndarray = j @ (stiffness @ (w @ j))
        return dt

    def observation(q: np.ndarray, w: np.ndarray) -> np.ndarray:
        j = columns(q)
        tau = w @ j
        matrix: np.ndarray = j[:, first] * tau[second]
        matrix[:, coupling] += j[:, second[coupling]] * tau[first[coupling]]
        return matrix

    return deflection, observation


def timed(function: Callable[..., np.ndarray], case: Case, repeat: int) -> float:
    """Least ns per call."""
    n, least = case.dof, np.inf
    rows = [(row[:n], row[n:]) for row in case.inputs[:32]]
    for _ in range(repeat):
        start = time.perf_counter()
        for q, w in rows:
            function(q, w)
        least = min(least, (time.perf_counter() - start) / len(rows))
    return 1e9 * least
