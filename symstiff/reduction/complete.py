"""From complete parameters to the identifiable set: links and joints apart, as after M2."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from symstiff.reduction.aggregation import joint_direction
from symstiff.reduction.physical import Parameter, terms_of
from symstiff.reduction.reduce import Reduction
from symstiff.reduction.structural import ExactEngine
from symstiff.symbolic.chain import ElasticChain
from symstiff.symbolic.programs import observation_program

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
    found = reduction.projection @ matrix.T
    if beside:
        found[:, list(beside)] = _combinations(reduction, chain, tuple(beside.values()))
    return np.asarray(found)


def known_values(reduction: Reduction) -> dict[str, float]:
    """Values of π″ for the compliances that the robot file states; what it does not state is zero."""
    stated = np.array([_stated(reduction, p) for p in reduction.stages[2].parameters])
    if not stated.any():
        return dict.fromkeys(reduction.parameters, 0.0)
    P = complete_map(reduction)
    found = P @ stated
    found[np.abs(found) < _ROUNDING * (np.abs(P) @ np.abs(stated))] = 0.0
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


def _combinations(reduction: Reduction, chain: ElasticChain, joints: Sequence[Parameter]) -> np.ndarray:
    """Coefficients (rank × joints) of the identifiable columns in the joints' own, for the class of experiments."""
    parameters = (*reduction.kept, *joints)
    names = tuple(p.name for p in parameters)
    program = observation_program(chain, terms_of(parameters), names, reduction.experiment.points)
    engine = ExactEngine(chain, program, names, reduction.experiment)
    return engine.measured(reduction.parameters, names[len(reduction.kept) :])
