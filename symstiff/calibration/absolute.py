"""Identification from absolute positions: the device's placement and the links' weights enter the equations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from symstiff.calibration.experiment.current import Current, settled, sigma_of
from symstiff.calibration.experiment.placement import best_placed, placement_columns
from symstiff.calibration.fits.decomposition import own_columns
from symstiff.calibration.fits.estimate import Estimate, estimate
from symstiff.calibration.plausible import implausible
from symstiff.calibration.residuals import ResidualTable, residual_table, sizes
from symstiff.calibration.rows import Equations, shared_blocks, weights
from symstiff.calibration.tables.measurements import Measurements
from symstiff.model import StiffnessModel
from symstiff.reduction.svd import svd
from symstiff.symbolic.terms import AXES

_INSIDE, _OUTSIDE = 1e-6, 1e-4
"""Least part of a column outside others for it to count: of a constant of the geometry, and of a weight's effect."""
_LEVER = 0.02
"""Lever, as a share of the reach, below which a turned frame is told by what it moves rather than by its angle."""


@dataclass(frozen=True, eq=False)
class AbsoluteFit:
    """A fit to absolute data: the model's parameters, then the geometry; residuals beyond the rigid robot.

    ``constants`` are those of geometry and placement. ``silent`` are parameters that move no row; ``untold`` (value and
    deviation that they would have) are compliances that the geometry hides: any size that an arm may have fits, or one
    that no arm has. Neither is part of the fit.
    """

    fit: Estimate
    equations: Equations
    residuals: ResidualTable
    constants: tuple[str, ...]
    silent: tuple[str, ...] = ()
    untold: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    @property
    def known(self) -> dict[str, tuple[float, float]]:
        """Value and deviation of what the rows determine."""
        fitted = zip(self.fit.names, self.fit.values.tolist(), self.fit.std.tolist(), strict=True)
        return {name: (value, std) for name, value, std in fitted if np.isfinite(std)}


def fit_absolute(model: StiffnessModel, table: Measurements) -> AbsoluteFit:
    """Fit a model to absolute positions, with constant errors of all frames taken along.

    The excess over the rigid robot at its best placement is explained by deflections under load and weight and by an
    independent set of constants at the links' virtual joints (geometry, tool and placement of the device, called
    ``geometry_<link>_<axis>`` [m, rad]); those that a compliance could mimic are left to the geometry. Where the
    device stood in further files is ``device_<file>_<axis>``, from its closest placement there.
    """
    current = settled(model, table)
    silent = tuple(n for n in model.parameters if n not in current.names)
    geometry = _geometry(current)
    columns = [*_elastic(current, model), *_hidden(current, geometry), *geometry]
    untold: dict[str, tuple[float, float]] = {}
    found = _fitted(current, table, columns)
    while more := implausible(model, found.known):
        untold |= {name: found.known[name] for name in more}
        found = _fitted(current, table, [c for c in columns if c.name not in untold])
    return replace(found, silent=silent, untold=untold)


def untold(model: StiffnessModel, table: Measurements) -> tuple[str, ...]:
    """Compliances that absolute positions do not tell beside the geometry, and those that they do not show."""
    found = fit_absolute(model, table)
    return tuple(p.name for p in model.compliances if p.name not in found.known)


@dataclass(frozen=True, eq=False)
class _Column:
    """A parameter of the fit: values (M,) of its column; whether it is a constant of the geometry."""

    name: str
    unit: str
    values: np.ndarray
    constant: bool = False


def _elastic(current: Current, model: StiffnessModel) -> list[_Column]:
    """The model's own parameters."""
    return [_Column(n, model.units[n], current.A[:, k]) for k, n in enumerate(current.names)]


def _geometry(current: Current) -> list[_Column]:
    """Where the device stood in further files, and constants at the links' virtual joints, as far as independent.

    Those that would turn by much to move the point by little come last: the point stands on their axes.
    """
    view = current.situation.view
    lever = np.sqrt(np.mean(view.J**2, axis=0)) / view.robot.reach
    links = [k for k, v in enumerate(view.joints) if v.kind == "link"]
    links.sort(key=lambda k: view.joints[k].rotational and lever[k] < _LEVER)
    further = placement_columns(view)[:, len(AXES) :]  # the base's link is the first station
    count = further.shape[1]
    own = own_columns(np.hstack([further, view.J[:, links]]), _INSIDE)
    chosen = sorted(links[k - count] for k in own if k >= count)
    stood = [(f"device_{2 + k // 6}_{1 + k % 6}", k % 6 >= 3, further[:, k]) for k in range(count)]
    frames = [(f"geometry_{v.body}_{v.axis}", v.rotational, view.J[:, k])
              for k, v in ((k, view.joints[k]) for k in chosen)]  # fmt: skip
    return [_Column(n, "rad" if turns else "m", values, True) for n, turns, values in (*stood, *frames)]


def _hidden(current: Current, geometry: Sequence[_Column]) -> list[_Column]:
    """Compliances that only the links' weights show, as far as model and geometry do not hold them."""
    count = len(current.names)
    beside = current.A[:, count : count + len(current.hidden)]
    held = [current.A[:, :count], *(c.values[:, None] for c in geometry)]
    first = count + len(geometry)
    shown = [k - first for k in own_columns(np.hstack([*held, beside]), _OUTSIDE) if k >= first]
    return [_Column(current.hidden[k].name, current.hidden[k].unit, beside[:, k]) for k in shown]


def _fitted(current: Current, table: Measurements, columns: Sequence[_Column]) -> AbsoluteFit:
    """The fit of some columns."""
    view = current.situation.view
    known = sigma_of(view)
    read = best_placed(view, current.y)
    e = Equations(np.column_stack([c.values for c in columns]), read, known, view.state, view.component)
    joints = [k for k, v in enumerate(view.joints) if v.kind == "joint"]
    fit = estimate(
        e.A, e.y, weights(e), tuple(c.name for c in columns), units=tuple(c.unit for c in columns),
        blocks=shared_blocks(e, table, view.robot, view.J[:, joints]), estimated=known is None,
    )  # fmt: skip
    geometry = np.column_stack([c.values for c in columns if c.constant])
    before, after, alone = (
        e.spread(rows, len(table)) for rows in (e.y, e.A @ fit.values, _explained(e, geometry))
    )
    residuals = replace(residual_table(before, after), geometry=sizes(before - alone))
    return AbsoluteFit(fit, e, residuals, tuple(c.name for c in columns if c.constant))


def _explained(e: Equations, columns: np.ndarray) -> np.ndarray:
    """(M,) what some columns (M, k) explain by themselves."""
    sigma = weights(e)
    spread = np.ones(len(e.y)) if sigma is None else sigma
    basis = svd((columns / np.linalg.norm(columns, axis=0)) / spread[:, None])[0]
    return np.asarray(spread * (basis @ (basis.T @ (e.y / spread))))
