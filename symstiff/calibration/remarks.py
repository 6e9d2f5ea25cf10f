"""What is remarked on the data and on a fit, beside its numbers."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np
from scipy.special import chdtr, chdtrc

from symstiff.calibration.absolute import AbsoluteFit
from symstiff.calibration.doubts.axes import AxisHint, axis_hint_refit
from symstiff.calibration.doubts.soundness import check_loads, check_poses
from symstiff.calibration.fits.estimate import Estimate
from symstiff.calibration.fits.shared import SharedError
from symstiff.calibration.fitting import Fitted
from symstiff.calibration.residuals import ResidualTable
from symstiff.calibration.rows import Equations, weights
from symstiff.calibration.tables.measurements import Measurements
from symstiff.display import few
from symstiff.model import StiffnessModel
from symstiff.reduction import Reduction
from symstiff.robot.schema import Robot

_HINT_ROWS = 1000
_NO_FIT = 1e-3  # probability of the residual sum below which the fit is questioned
_NO_DRAWING = 0.05  # constant of the geometry, in rad or reaches, that no error of a drawing is
_LITTLE = 0.5  # share of the deflection that a model has to explain not to be warned of
_SMALL = 0.9  # times the stated sigma from which less than that is spoken of


def explained(residuals: ResidualTable) -> list[str]:
    """A warning where the model says little about the data."""
    if not residuals.compensated < _LITTLE:
        return []
    return [
        f"only {100 * max(residuals.compensated, 0.0):.0f} % of the deflection is explained: do not compensate with "
        "this model, look for what is missing with symstiff diagnose"
    ]


def unsettled(found: Fitted) -> list[str]:
    """A warning where the rounds of a fit came to no end."""
    if found.settled:
        return []
    return [
        "the fit did not settle: other parameters than these may fit as well or better, so do not rely on them; look "
        "for bad poses (--robust), or fit fewer parameters"
    ]


def fits(fit: Estimate, e: Equations) -> list[str]:
    """Warnings where a pose's rows share an error, and where what is left is far more or less than the stated sigma."""
    remarks = []
    if fit.shared is not None:
        told = " and ".join(_shared_sizes(fit.shared, e))
        told += ", as if the joints had stopped beside their targets" if fit.shared.mostly_joints else ""
        remarks.append(
            f"the rows of a pose share an error of {told}: the robot's repeatability, or something that is missing "
            "(symstiff diagnose); the deviations above hold it"
        )
    if fit.fit_p is None:
        return remarks
    over = fit.s0_squared if fit.shared is None else fit.shared.variance
    left = f"what is left is {np.sqrt(over):.2g} times the stated sigma"
    if chdtrc(fit.dof, fit.dof * over) < _NO_FIT:
        remarks.append(
            f"{left}, so the model or the stated sigma does not fit these data, and the deviations above, which rest "
            "on it, are too small: symstiff diagnose tells what may be missing"
        )
    elif over < _SMALL**2 and chdtr(fit.dof, fit.dof * over) < _NO_FIT:
        remarks.append(f"{left}: it is too large, and so are the deviations above, which rest on it")
    return remarks


def _shared_sizes(shared: SharedError, e: Equations) -> list[str]:
    """What rows share, of translations and of rotations, in words; none where they share next to nothing."""
    sigma, told = weights(e), []
    for kind, unit in ((e.component < 3, "mm"), (e.component >= 3, "mrad")):
        if kind.any():
            square = 1.0 if sigma is None else float(np.mean(sigma[kind] ** 2))
            variance = shared.shared_variance(kind)
            size, times = 1e3 * np.sqrt(variance * square), np.sqrt(variance / shared.variance)
            told += [f"{size:.2g} {unit} ({times:.1f} times their own noise)"] if size > 0 else []
    return told


def of_loads(table: Measurements, loads: str) -> list[str]:
    """Warnings on the loads of deflections, for a class of loads."""
    if table.kind != "deflection":
        return []
    # a model for vertical loads is reduced for one direction: nothing to warn of
    return [r for r in check_loads(table.w, table.place) if loads != "gravity" or "one direction" not in r]


def of_stations(table: Measurements) -> list[str]:
    """A remark on where the device is taken to have stood, where positions come from several files."""
    if table.kind != "absolute" or len(table.files) < 2:
        return []
    station, names = table.station, np.array(table.files)
    groups = [", ".join(names[np.unique(table.file[station == k])]) for k in np.unique(station)]
    return [
        "where the measuring device stood is found for every file or group of files by itself: "
        f"{'; '.join(groups)}"
    ]


def beside_geometry(found: AbsoluteFit, model: StiffnessModel) -> list[str]:
    """What is to be said of a fit to absolute positions: parameters without a value, what was fitted along, the fit."""
    remarks = []
    if found.silent:
        remarks.append(f"no row shows {', '.join(found.silent)}: not determined by these data, and zero")
    if found.untold:
        shown = ", ".join(
            f"{n} ({value:.2g} ± {std:.1g} {model.units[n]})" for n, (value, std) in found.untold.items()
        )
        remarks.append(
            f"{shown}: cannot be told from geometry in these positions (the fit gives sizes that no arm has): not "
            "determined, and zero"
        )
    if found.held:
        remarks.append(
            f"{few(found.held)}: these positions do not tell {'it' if len(found.held) == 1 else 'them'} from the "
            "placement and the model's other parameters: zero, as in the start model"
        )
    known = {*found.constants, *model.parameters}
    beside = [n for n in found.fit.names if n not in known]
    weights = f", and what only the links' weights show: {', '.join(beside)}" if beside else ""
    named = "; errors of frames are those that the start model names, and no others" if found.told else ""
    remarks.append(
        f"absolute positions: {len(found.constants)} constants of {'the' if found.told else 'geometry and'} placement "
        f"were fitted along{weights}{named}"
    )
    return [*remarks, *_of_drawing(found, model.robot), *fits(found.fit, found.equations)]


def _of_drawing(found: AbsoluteFit, robot: Robot) -> list[str]:
    """A warning where constants of the geometry are beyond what a fit of small errors holds for."""
    units = dict(zip(found.fit.names, found.fit.units, strict=True))
    shares = {
        name: abs(value) / (robot.reach if units[name] == "m" else 1.0)
        for name, (value, _) in found.known.items()
        if name.startswith("geometry_")
    }
    largest = max(shares, key=lambda name: shares[name], default="")
    if not shares or shares[largest] < _NO_DRAWING:
        return []
    value, unit = found.known[largest][0], units[largest]
    return [
        f"{largest} would be {value:.3g} {unit}: no drawing is off by that, and the fit holds for small errors alone: "
        "measure more poses, and look at units, signs and zeros of joints and positions, or at the robot file"
    ]


def of_sag(robot: Robot) -> list[str]:
    """A remark for robots whose masses are known: no model, code or compensation holds what they do by themselves."""
    if not robot.has_weights:
        return []
    return [
        "the links' own weight bends the arm as well: absolute data count it, but model, code and compensation give "
        "only what loads at the tool and the model's effects add"
    ]


def repeated(table: Measurements) -> list[str]:
    """A remark on poses that repeat another's joints and load."""
    labels = [table.labels[k] for k in table.pose]
    one = np.asarray(table.point == table.point[0])
    return check_poses(
        table.q[one], table.w[one], [label for label, keep in zip(labels, one, strict=True) if keep]
    )


def below_zero(values: Mapping[str, float], reduction: Reduction) -> list[str]:
    """A remark on diagonal entries of links below zero that stand for differences too, in whatever the fit holds."""
    couplings = {p.name for p in reduction.full if p.is_coupling}
    signed = {
        kept
        for eliminated, row in reduction.partition.couplings.items()
        for kept, coefficient in row.items()
        if coefficient < 0 or eliminated in couplings
    }
    names = [
        p.name
        for p in reduction.kept
        if p.name in signed and not (p.is_coupling or p.is_joint) and values.get(p.name, 0.0) < 0
    ]
    return [
        f"{few(names)}: below zero, as sums of parameters with signs can be (symstiff inspect), not single "
        "compliances: --physical or --reconstruct gives link matrices"
    ] * bool(names)


def of_redundant(held: Collection[str], model: StiffnessModel) -> str:
    """What parameters keep, which no poses and loads tell from the others."""
    shown = few([f"{n} = {model.values.get(n, 0.0):.3g}" for n in held])
    be, them = ("is", "it") if len(held) == 1 else ("are", "them")
    return f"{shown} {be} kept: no poses and loads of this kind tell {them} from the model's other parameters"


def axis_hint(names: Sequence[str], table: Measurements, e: Equations) -> AxisHint | None:
    """A hint where another assignment of the measured axes would fit far better."""
    whole: np.ndarray = np.all(table.measured[:, :3], axis=1)
    if not whole.any():
        return None
    thin = max(1, int(whole.sum()) // _HINT_ROWS)  # a swapped axis shows in any few hundred rows
    whole &= np.cumsum(whole) % thin == 0
    keep = np.flatnonzero(whole[e.row] & (e.component < 3))
    order = keep[np.lexsort((e.component[keep], e.row[keep]))]
    positive = [_cannot_be_negative(name) for name in names]
    return axis_hint_refit(e.A[order], table.values[whole][:, :3], None, positive, table.w[whole][:, :3])


def _cannot_be_negative(name: str) -> bool:
    """Whether a parameter is a compliance along one axis."""
    return (name[0] == "c" and name[1:].isdigit()) or (name[0] == "k" and name[-2] == name[-1])
