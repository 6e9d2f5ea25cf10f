"""From complete parameters to the identifiable set: links and joints apart, as after M2."""

from __future__ import annotations

import numpy as np

from symstiff.reduction.aggregation import joint_direction
from symstiff.reduction.physical import Parameter
from symstiff.reduction.reduce import Reduction, axis_sizes, engine_of
from symstiff.reduction.structural import in_unit_axes
from symstiff.symbolic.chain import ElasticChain

_ROUNDING = 1e-12


def complete_map(reduction: Reduction) -> np.ndarray:
    """P of π″ = P·π (rank × parameters after M2): both sets predict the same deflections.

    A joint that M3 absorbed adds c·u·uᵀ to the link before it, u its axis in that link's elastic frame (seed M3).
    Where the link's template lacks entries of it, the combination of π″ that moves as the joint does stands for it;
    a joint of ``inexact_aggregations`` has none and is left out: its column is zero.
    """
    before, after = reduction.stages[2], reduction.stages[3]
    chain, column = ElasticChain(reduction.robot), {name: k for k, name in enumerate(after.names)}
    matrix = after.matrix.astype(float)
    beside: dict[int, Parameter] = {}
    for row, p in enumerate(before.parameters):
        if after.stands_for[p.name] is None:
            shares = _shares(chain, p)
            if shares.keys() <= column.keys():
                for name, share in shares.items():
                    matrix[row, column[name]] = share
            elif p.name not in reduction.inexact_aggregations:
                beside[row] = p
    found = np.column_stack([_combined(reduction.projection, shares) for shares in matrix])
    if beside:
        found[:, list(beside)] = _combinations(reduction, tuple(beside.values()))
    return found


def known_values(reduction: Reduction) -> dict[str, float]:
    """Values of π″ for the compliances that the robot file states; what it does not state is zero."""
    stated = np.array([_stated(reduction, p) for p in reduction.stages[2].parameters])
    if not stated.any():
        return dict.fromkeys(reduction.parameters, 0.0)
    P = complete_map(reduction)
    found = _combined(P, stated)
    found[np.abs(found) < _ROUNDING * _combined(np.abs(P), np.abs(stated))] = 0.0
    return dict(zip(reduction.parameters, found.tolist(), strict=True))


def left_out(reduction: Reduction) -> list[str]:
    """Remarks about compliances that the robot file states of joints that π″ cannot stand for: they are left out."""
    stated = {n: reduction.robot.joint[int(n[1:]) - 1].compliance for n in reduction.inexact_aggregations}
    return [
        f"{name}: the file's {value:g} is left out of the values, since no combination of parameters moves the tool as "
        f"joint {name[1:]} does"
        for name, value in stated.items()
        if value
    ]


def _stated(reduction: Reduction, p: Parameter) -> float:
    robot = reduction.robot
    if p.is_joint:
        return float(robot.joint[p.body - 1].compliance)
    return float(robot.links[p.body].compliance.get(f"{p.row}{p.column}", 0.0))


def _shares(chain: ElasticChain, p: Parameter) -> dict[str, float]:
    """Entries of u·uᵀ by the names of the link's parameters."""
    along = joint_direction(chain, p.body)
    return {f"k{p.body - 1}_{r}{c}": u * v for r, u in along.items() for c, v in along.items() if r <= c}


def _combinations(reduction: Reduction, joints: tuple[Parameter, ...]) -> np.ndarray:
    """Coefficients (rank × joints) of the identifiable columns in the joints' own, exact for the class of loads."""
    parameters = (*reduction.kept, *joints)
    engine = engine_of(reduction.robot, parameters, reduction.experiment)
    found = in_unit_axes(engine.partition(engine.names), axis_sizes(engine.chain, parameters))
    matrix = np.zeros((len(reduction.parameters), len(joints)))
    for column, p in enumerate(joints):
        for kept, coefficient in found.couplings.get(p.name, {}).items():
            matrix[reduction.parameters.index(kept), column] = float(coefficient)
    return matrix


def _combined(matrix: np.ndarray, values: np.ndarray) -> np.ndarray:
    """matrix · values, its terms added in order: BLAS rounds as the processor likes, and these numbers are printed."""
    total = np.zeros(len(matrix))
    for column in np.flatnonzero(values):
        total += matrix[:, column] * values[column]
    return total
