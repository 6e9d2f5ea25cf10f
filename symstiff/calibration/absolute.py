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

    ``constants`` are those of geometry and placement that were fitted along, ``told`` those that the model names.
    ``silent`` are parameters that move no row; ``held`` those without a value in the start model that the rows do not
    tell from others; ``untold`` (value and deviation that they would have) are compliances that the geometry hides: any
    size that an arm may have fits, or one that no arm has. None of these three is part of the fit.
    """

    fit: Estimate
    equations: Equations
    residuals: ResidualTable
    constants: tuple[str, ...]
    told: tuple[str, ...] = ()
    silent: tuple[str, ...] = ()
    held: tuple[str, ...] = ()
    untold: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    @property
    def known(self) -> dict[str, tuple[float, float]]:
        """Value and deviation of what the rows determine."""
        fitted = zip(self.fit.names, self.fit.values.tolist(), self.fit.std.tolist(), strict=True)
        return {name: (value, std) for name, value, std in fitted if np.isfinite(std)}


def fit_absolute(model: StiffnessModel, table: Measurements, all_frames: bool = False) -> AbsoluteFit:
    """Fit a model to absolute positions, with what of the geometry it does not tell taken along.

    The excess over the rigid robot at its best placement is explained by deflections under load and weight and by an
    independent set of constants at the links' virtual joints (geometry, tool and placement of the device, called
    ``geometry_<link>_<axis>`` [m, rad]); those that a compliance could mimic are left to the geometry. Where the
    device stood in further files is ``device_<file>_<axis>``, from its closest placement there. A model that names
    errors of frames itself has the geometry that was found: only the placement is taken along, unless ``all_frames``
    are, and nothing is held.
    """
    current = settled(model, table)
    silent = tuple(n for n in model.parameters if n not in current.names)
    told = () if all_frames else tuple(n for n in current.names if n in model.frame_errors)
    own = [replace(c, constant=c.name in told) for c in _elastic(current, model)]
    geometry = _placement(current, model, own) if told else _geometry(current)
    held = () if all_frames else _held(own, model, geometry)
    columns = [*(c for c in own if c.name not in held), *_hidden(current, geometry), *geometry]
    untold: dict[str, tuple[float, float]] = {}
    found = _fitted(current, table, columns)
    while more := implausible(model, found.known):
        untold |= {name: found.known[name] for name in more}
        found = _fitted(current, table, [c for c in columns if c.name not in untold])
    along = tuple(n for n in found.constants if n not in told)
    return replace(found, constants=along, told=told, silent=silent, held=held, untold=untold)


def untold(model: StiffnessModel, table: Measurements) -> tuple[str, ...]:
    """Compliances that absolute positions do not tell beside the geometry, and those that they do not show."""
    found = fit_absolute(model, table, all_frames=True)
    return tuple(p.name for p in model.compliances if p.name not in found.known)


@dataclass(frozen=True, eq=False)
class _Column:
    """A parameter of the fit: values (M,) of its column; whether it is a constant of the geometry."""

    name: str
    unit: str
    values: np.ndarray
    constant: bool = False


def _placement(current: Current, model: StiffnessModel, own: Sequence[_Column]) -> list[_Column]:
    """Where the device stood, and the probe where the robot file does not tell it, as far as no value tells it."""
    joints, known = current.situation.view.joints, [c.values for c in own if model.values.get(c.name)]
    base = [k for k, v in enumerate(joints) if v.kind == "link" and v.body == 0]
    probe = [
        k for k, v in enumerate(joints) if v.kind == "link" and v.body == model.robot.dof and not v.rotational
    ]
    stood = _geometry(current, base)
    if model.file_tool is None:
        return stood
    J = current.situation.view.J
    before = [*(c.values for c in stood), *known]
    free = own_columns(np.column_stack([*before, J[:, probe]]), _INSIDE)
    shifts = [probe[k - len(before)] for k in free if k >= len(before)]
    return [*stood, *(_constant(current, k) for k in shifts)]


def _held(own: Sequence[_Column], model: StiffnessModel, geometry: Sequence[_Column]) -> tuple[str, ...]:
    """Parameters without a value in a start model that has some, which the rows do not tell from the others."""
    known = [c for c in own if model.values.get(c.name)]
    if not known:
        return ()
    unknown = [c for c in own if c not in known]
    first = len(geometry) + len(known)
    told = own_columns(np.column_stack([c.values for c in (*geometry, *known, *unknown)]), _INSIDE)
    return tuple(c.name for k, c in enumerate(unknown, start=first) if k not in told)


def _elastic(current: Current, model: StiffnessModel) -> list[_Column]:
    """The model's own parameters."""
    return [_Column(n, model.units[n], current.A[:, k]) for k, n in enumerate(current.names)]


def _geometry(current: Current, places: Sequence[int] | None = None) -> list[_Column]:
    """Where the device stood in further files, and constants at virtual joints of links, as far as independent.

    At all of the links' where no ``places`` are given. Those that would turn by much to move the point by little come
    last: the point stands on their axes.
    """
    view = current.situation.view
    lever = np.sqrt(np.mean(view.J**2, axis=0)) / view.robot.reach
    links = [k for k, v in enumerate(view.joints) if v.kind == "link"] if places is None else list(places)
    links.sort(key=lambda k: view.joints[k].rotational and lever[k] < _LEVER)
    further = placement_columns(view)[:, len(AXES) :]  # the base's link is the first station
    count = further.shape[1]
    own = own_columns(np.hstack([further, view.J[:, links]]), _INSIDE)
    chosen = sorted(links[k - count] for k in own if k >= count)
    stood = [
        _Column(f"device_{2 + k // 6}_{1 + k % 6}", _unit(k % 6 >= 3), further[:, k], True)
        for k in range(count)
    ]
    return [*stood, *(_constant(current, k) for k in chosen)]


def _constant(current: Current, k: int) -> _Column:
    """A constant at a virtual joint of a link."""
    view = current.situation.view
    v = view.joints[k]
    return _Column(f"geometry_{v.body}_{v.axis}", _unit(v.rotational), view.J[:, k], True)


def _unit(turns: bool) -> str:
    return "rad" if turns else "m"


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
