"""Slips of a whole table: markers exchanged, a joint's sign or zero another one. Would it fit far better otherwise?"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from symstiff.calibration.compact import Array
from symstiff.calibration.markers import marker_hint
from symstiff.calibration.measurements import Measurements
from symstiff.model import StiffnessModel

_FAR_BETTER = 0.3
"""Part of the squares left as told up to which other readings are spoken of."""
_SAME = 1.02
"""What is left by readings that are not told apart, over the least."""
_FEWEST = 20
"""Degrees of freedom below which a few readings' noise is made small by chance."""
_ROWS = 3000
"""Rows of which a slip of all of them is seen."""

Left = Callable[[Array], tuple[float, int]]
"""Sum of squares that is left where the joints stand elsewhere (M, n), and degrees of freedom."""


@dataclass(frozen=True)
class Reading:
    """Another reading of a joint (counted from one): sign·q + quarters·90°."""

    joint: int
    sign: int
    quarters: int

    def of(self, q: Array) -> Array:
        """(M, n) joint variables so read."""
        out = np.array(q)
        out[:, self.joint - 1] = self.sign * q[:, self.joint - 1] + self.quarters * np.pi / 2
        return out

    def __str__(self) -> str:
        name = f"{'-' if self.sign < 0 else ''}q{self.joint}"
        return name if not self.quarters else f"{name} {('+ 90', '+ 180', '- 90')[self.quarters - 1]} deg"


def joint_hint(q: Array, turns: Sequence[bool], left: Left) -> str:
    """Which joint looks read the other way round or from another zero; empty if none does, or if too little is left.

    q: (M, n) as told; turns: (n,) whether a joint turns: of one that slides the zero is not asked for.
    """
    now, freedom = left(q)
    if freedom < _FEWEST or now == 0.0:
        return ""
    found = {reading: left(reading.of(q))[0] for reading in _readings(turns)}
    best = min(found, key=lambda reading: found[reading], default=None)
    if best is None or found[best] > _FAR_BETTER * now:
        return ""
    share = 100.0 * float(np.sqrt(found[best] / now))
    alike = " or ".join(f"{r} for q{r.joint}" for r, square in found.items() if square <= _SAME * found[best])
    return f"a joint looks read in another way: {alike} would leave {share:.0f} % of the residual"


def slip(
    model: StiffnessModel,
    table: Measurements,
    left: Callable[[StiffnessModel, Measurements], tuple[float, int]],
) -> tuple[str, str]:
    """What looks exchanged or read in another way, and what to correct then; empty where nothing does.

    ``left`` is the sum of squares that the model leaves of a table, and degrees of freedom; of long tables some rows
    are looked at.
    """
    some = (
        table.select(np.unique(np.linspace(0, len(table) - 1, _ROWS).astype(int)))
        if len(table) > _ROWS
        else table
    )
    hint = marker_hint(some.points, lambda names: left(model, replace(some, points=names)))
    if hint:
        return hint, "column point"
    turns = [not joint.prismatic for joint in model.robot.joint]
    hint = joint_hint(some.q, turns, lambda q: left(model, replace(some, q=q)))
    return hint, "signs and zeros of the table's joints, or the robot file" if hint else ""


def _readings(turns: Sequence[bool]) -> list[Reading]:
    """Other readings of one joint at a time, those that change least first."""
    return [
        Reading(j, sign, quarters)
        for sign, quarters in ((-1, 0), *((s, k) for s in (1, -1) for k in (1, 2, 3)))
        for j, turning in enumerate(turns, start=1)
        if turning or not quarters
    ]
