"""The seed's two tables, reproduced: the reduction of the KR 270 exactly, its calibration on a virtual robot.

The virtual robot is the nonlinear one of ``simulation``: all links elastic, published joint compliances, a gravity
compensator with its spring geometry; 15 planned poses at 5 values of q₂, a vertical load of 2.5 kN, three markers,
tracker noise and a robot that repeats to 0.06 mm.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from symstiff.calibration.fitting import fit_model
from symstiff.calibration.identify import data_rank
from symstiff.calibration.levels import by_level
from symstiff.calibration.plan import Goal, Load, Search
from symstiff.calibration.plan import plan as choose_poses
from symstiff.calibration.planning.region import Region, above_floor
from symstiff.calibration.residuals import ResidualTable, residual_table
from symstiff.calibration.rows import predict
from symstiff.calibration.simulation import Truth, nominal_truth, simulate, truth_from_table
from symstiff.calibration.tables.measurements import Measurements
from symstiff.calibration.tables.poses import with_markers
from symstiff.model import StiffnessModel, joints_only
from symstiff.reduction import reduce
from symstiff.robot import load
from symstiff.robot.schema import Robot

ROBOT, FORCE, POSES, LEVELS = "kuka_kr270", 2500.0, 15, 5
MARKERS = ("p1", "p2", "p3")
REACH = (0.5, 1.9)  # m from the base: the seed's deflections are those of working postures
SOFTNESS = 1.5  # links against the nominal rule: both links and joints bend, as on the seed's robot
SEED = {  # positional MAX and RMS [mm], parameters: Table 2 of the seed
    "uncompensated": (None, 8.18, 4.58),
    "C1": (26, 0.45, 0.22),
    "C2": (30, 0.49, 0.21),
    "J1": (5, 1.78, 0.75),
    "J2": (9, 1.76, 0.73),
}


@dataclass(frozen=True, eq=False)
class Row:
    """One model of Table 2: its parameters, and what it leaves on the calibration and on fresh poses."""

    name: str
    parameters: int
    rank: int
    fitted: ResidualTable
    fresh: ResidualTable
    model: StiffnessModel


def truth() -> Truth:
    """The virtual robot: joints as published, elastic links, the compensator's spring, tracker and robot noise."""
    nominal = nominal_truth(load(ROBOT))
    links = {name: SOFTNESS * value for name, value in nominal.items() if name.startswith("k")}
    return truth_from_table(
        {
            "format": 1,
            "robot": ROBOT,
            "compliance": {"start": "nominal", **links},
            "effect": [
                {"effect": "gravity_compensator", "where": {"joint": 2}, "shape": "spring", "rate": 4.5e6}
            ],
            "noise": {"sigma_mm": 0.03, "approach_mm": 0.06},
        }
    )


def models(robot: Robot, table: Measurements) -> dict[str, StiffnessModel]:
    """C1 and J1 from the reduction for vertical loads, C2 and J2 with one compliance of joint 2 a value of q₂."""
    complete = StiffnessModel.of(reduce(robot, "gravity", "pose"))
    joints = joints_only(robot, "gravity", "pose")
    return {
        "C1": complete,
        "C2": by_level(complete, table, 2),
        "J1": joints,
        "J2": by_level(joints, table, 2),
    }


def table2(
    seed: int = 1, progress: Callable[[str], None] = lambda stage: None
) -> tuple[Measurements, list[Row]]:
    """Plan, measure virtually, fit the four models; returns the measurements and the rows."""
    robot = load(ROBOT)
    progress("planning 15 poses at 5 values of q2")
    design = _design(robot, seed)
    progress("measuring the virtual robot")
    virtual = truth()
    table = simulate(virtual, design, seed)
    fresh = simulate(virtual, _fresh(design, seed), seed + 1)
    rows = []
    for name, model in models(robot, table).items():
        progress(f"fitting {name}")
        fit = fit_model(model, table).estimate
        fitted = model.with_values(dict(zip(fit.names, fit.values.tolist(), strict=True)))
        rows.append(
            Row(
                name,
                len(model.parameters),
                data_rank(model, table),
                residual_table(table.values, predict(fitted, table)),
                residual_table(fresh.values, predict(fitted, fresh)),
                fitted,
            )
        )
    return table, rows


def _design(robot: Robot, seed: int) -> Measurements:
    model = StiffnessModel.of(reduce(robot, "gravity", "pose"))
    plan = choose_poses(
        model,
        Goal(POSES, "D"),
        Load("gravity", FORCE),
        MARKERS,
        (30e-6, 100e-6),
        Region((), (above_floor(0.3),), REACH),
        levels={2: LEVELS},
        search=Search(candidates=4000, starts=3, seed=seed, refine=False),
    )
    return with_markers(plan.q, plan.w, MARKERS)


def _fresh(design: Measurements, seed: int) -> Measurements:
    """Other poses at the same values of q₂: the other joints drawn anew around the planned ones."""
    rng = np.random.default_rng([seed, 77])
    first = design.point == 0
    q, w = design.q[first].copy(), design.w[first]
    other = [0, 2, 3, 4, 5]
    q[:, other] = q[rng.permutation(len(q))][:, other] + rng.normal(0.0, 0.15, (len(q), len(other)))
    return with_markers(q, w, MARKERS)
