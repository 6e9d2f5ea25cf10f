"""Doubts about a table, before anything is said to be missing from the model."""

from __future__ import annotations

import numpy as np

from symstiff.calibration.doubts.axes import AGAINST, against_loads
from symstiff.calibration.doubts.misread import misread
from symstiff.calibration.doubts.point import FAR, measured_at, moved_to
from symstiff.calibration.doubts.slips import left_by, slip
from symstiff.calibration.experiment.arm import drawn
from symstiff.calibration.experiment.placement import placed
from symstiff.calibration.experiment.situation import Laws, look
from symstiff.calibration.remarks import axis_hint
from symstiff.calibration.rows import equations
from symstiff.calibration.tables.measurements import Measurements
from symstiff.discrepancy.reasons import Reason, Why
from symstiff.model import StiffnessModel
from symstiff.robot.tool import tool_of

_PLACEMENT = 6
"""Numbers that say where the measuring device stood, a station."""
_NEARER = 0.1
"""Part of that distance that another place of the measured point leaves where that is what is wrong."""


def doubted(model: StiffnessModel, table: Measurements, whole: StiffnessModel) -> Reason | None:
    """Why the table is to be looked at first: axes or places that cannot be as they are told.

    ``whole`` is what deflections are explained by whichever way their axes are: a model in which links give way too.
    """
    absolute = table.kind == "absolute"
    slipped, wrong = slip(model, table, _excess if absolute else left_by)
    against = "" if absolute else against_loads(model.robot, table)
    if slipped and not against:
        return Reason(Why.DOUBTED, (slipped, wrong))
    if absolute:
        return _misplaced(model, table)
    hint = axis_hint(whole.parameters, table, equations(whole, table))
    if against and hint is None:
        return Reason(Why.DOUBTED, (AGAINST, f"sign of {against}"))
    told = misread(whole, table, hint)
    return Reason(Why.DOUBTED, told) if told[0] else None


def _excess(model: StiffnessModel, table: Measurements) -> tuple[float, int]:
    """Squares of what positions are beyond the robot at its best placement [m²]; freedom."""
    view = look(model.robot, table)
    view, excess = placed(view, drawn(view, Laws(view, model.terms, model.values)))
    beyond = excess[view.component < 3]
    return float(beyond @ beyond), len(beyond) - _PLACEMENT * _stations(table)


def _stations(table: Measurements) -> int:
    return int(table.station.max(initial=0)) + 1


def _misplaced(model: StiffnessModel, table: Measurements) -> Reason | None:
    """Why absolute positions cannot be this robot's: placed as well as possible it is far from them."""
    away, most = _away(model, table), FAR * model.robot.reach
    if away < most:
        return None
    mm = f"{1e3 * away:.0f} mm rms"
    far = f"the robot of this file, placed as well as it can be, misses the measured positions by {mm}"
    pointed = moved_to(model, measured_at(model, table))
    left = _away(pointed, table)
    if left < min(most, _NEARER * away):
        xyz = ", ".join(f"{x:.4g}" for x in tool_of(pointed.robot))
        nearer = (
            f"xyz = [{xyz}] under [tool], where loads act then, would miss them by {1e3 * left:.1f} mm rms"
        )
        return Reason(Why.DOUBTED, (far, f"place of the tool centre point ({nearer})"))
    wrong = "units, order, signs or zeros of its joints, axes or markers of the table, or the file"
    return Reason(Why.DOUBTED, (far, wrong))


def _away(model: StiffnessModel, table: Measurements) -> float:
    """How far [m] positions are from the robot at its best placement, rms of a point."""
    square, freedom = _excess(model, table)
    return float(np.sqrt(3.0 * square / (freedom + _PLACEMENT * _stations(table))))
