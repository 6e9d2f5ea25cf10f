"""The loads a plan may apply: the force of gravity, a force in any direction, any wrench, or given cases."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from symstiff.arguments import real
from symstiff.calibration.tables.units import LARGEST_LOAD
from symstiff.errors import UserError

Kind = Literal["gravity", "force", "wrench"]
_LEVER = 0.5  # m; moment of a wrench candidate per newton, where the user gives none
_SHARE = 2 / 3
"""The longest such lever as a share of the arm's reach."""


@dataclass(frozen=True)
class Load:
    """A load class with its magnitude [N]; ``moment`` [N·m] of wrenches; ``cases`` (k, 6) fix them.

    ``kind``: "gravity" is a weight at the tool centre point, f_z = −force in world axes; "force" is a force in any
    direction, "wrench" a force and a moment in any directions.
    """

    kind: Kind = "gravity"
    force: float = 1000.0
    moment: float | None = None
    cases: tuple[tuple[float, ...], ...] = ()

    def __post_init__(self) -> None:
        if self.kind not in ("gravity", "force", "wrench"):
            raise UserError(f"loads {self.kind!r}: use gravity, force or wrench")
        real(self.force, "force", "newtons")
        if self.moment is not None:
            real(self.moment, "moment", "newton metres")
        if not 0 < self.force <= LARGEST_LOAD:
            raise UserError(
                f"a load of {self.force:g} N: give a magnitude in newtons, up to {LARGEST_LOAD:g}"
            )
        if self.moment is not None and not 0 < self.moment < np.inf:
            raise UserError(f"a moment of {self.moment:g} N·m: give a positive magnitude")
        for case in self.cases:
            if len(case) != 6 or not np.all(np.isfinite(case)) or not any(case):
                raise UserError(f"load case {case}: six finite numbers (N, N·m), not all zero")

    def on_arm(self, reach: float) -> Load:
        """The load with its moment told: of a wrench, where none was, 0.5 m times the force, on a small arm less."""
        if self.kind != "wrench" or self.moment is not None or self.cases:
            return self
        return replace(self, moment=min(_LEVER, _SHARE * reach) * self.force)

    @property
    def directions(self) -> int:
        """Number of three-vectors whose direction is free: 0, 1 (force) or 2 (force and moment)."""
        return 0 if self.cases else {"gravity": 0, "force": 1, "wrench": 2}[self.kind]

    @property
    def coordinates(self) -> int:
        """Number of uniform random numbers that draw one load."""
        return 1 if len(self.cases) > 1 else 2 * self.directions

    @property
    def magnitudes(self) -> tuple[float, ...]:
        """Magnitude of each free three-vector."""
        moment = _LEVER * self.force if self.moment is None else self.moment
        return (self.force, moment)[: self.directions]


def draw_loads(load: Load, uniform: np.ndarray) -> np.ndarray:
    """Turn uniform numbers (N, coordinates) in [0, 1) into wrenches at the tool, base axes, (N, 6)."""
    count = len(uniform)
    if load.cases:
        cases = np.array(load.cases, dtype=float)
        pick = (uniform[:, 0] * len(cases)).astype(int) if len(cases) > 1 else np.zeros(count, dtype=int)
        return np.asarray(cases[pick])
    w = np.zeros((count, 6))
    if load.kind == "gravity":
        w[:, 2] = -load.force
    for k, magnitude in enumerate(load.magnitudes):
        w[:, 3 * k : 3 * k + 3] = magnitude * _on_sphere(uniform[:, 2 * k], uniform[:, 2 * k + 1])
    return w


def wrench_of_directions(load: Load, directions: Any, norm: Any) -> list[Any]:
    """Return the six components of a wrench from its free direction vectors, of any non-zero length.

    ``directions`` is a sequence of 3·k scalars of the backend; ``norm`` maps three scalars to their length.
    """
    components: list[Any] = []
    for k, magnitude in enumerate(load.magnitudes):
        vector = [directions[3 * k + axis] for axis in range(3)]
        length = norm(*vector)
        components += [magnitude * v / length for v in vector]
    return components + [0.0 * components[0]] * (6 - len(components))


def _on_sphere(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    height = 1.0 - 2.0 * u
    radius = np.sqrt(np.maximum(0.0, 1.0 - height**2))
    return np.stack([radius * np.cos(2 * np.pi * v), radius * np.sin(2 * np.pi * v), height], axis=1)
