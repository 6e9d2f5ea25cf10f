"""Where the residual sits: back-projection to the virtual joints, and the best smooth law at the accused one."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import fdtrc, logsumexp

from symstiff.arrays import TINY, Array, Index
from symstiff.calibration.fits.decomposition import RANK, column_space
from symstiff.discrepancy.laws.law import Law, largest_load
from symstiff.discrepancy.laws.unnamed import every_law
from symstiff.discrepancy.noise.scales import stated
from symstiff.discrepancy.problem import Problem
from symstiff.discrepancy.statistics.evidence import Evidence
from symstiff.discrepancy.statistics.scan import (
    Layer,
    Scan,
    at_sharing,
    basis_of,
    coefficients,
    likeliest,
)

_ROUNDING = 1e-9
"""What is added to a matrix of which a pose may be all, so that it can be solved."""
_SUSPECTS, _OF_POSES, _LEFT = 3, 5, 10
"""Poses that are suspected at most: so many, one in so many; and degrees of freedom that the others have to have."""
_UNMOVED = 1e-12
"""Share of the largest square of a Jacobian's rows below which a load case does not move with the virtual joint."""
_BEYOND_DOUBT = 1e-6
"""Probability, over all poses, below which one is unlike the others."""
_TERMS, _FOLDS, _GAIN = 3, 5, 0.01
"""Laws that a description is put together from, at most, folds of poses, and the share of squares that each has to gain
on poses left out."""


@dataclass(frozen=True)
class BackProjection:
    """The deflection of one virtual joint that would explain the residual, a value for each pose and load case."""

    virtual_joint: str
    pose: Index
    case: Index
    delta: Array
    """(n,) in rad, or m for a translation."""
    deviation: Array
    """(n,) standard deviation."""
    tau: Array
    explained: float
    """Share of the residual's weighted sum of squares."""


_OF_WEIGHT = re.compile(r"\||tau\^|tau\*tau|sign\(|beyond\(|q\d")
"""What a gear's law shows of an arm's weight: under a heavy one a law that bends is one that goes with the angles."""


@dataclass(frozen=True)
class FittedLaw:
    """A smooth law at a virtual joint, as an expression."""

    virtual_joint: str
    expression: str
    """In tau (divided by ``tau_scale``), tau3 (joint 3's load, divided by its own largest), q, time, branch."""
    tau_scale: float
    explained: float
    """Share of the residual's sum of squares outside the model."""
    cross_validated: float
    """The same on poses that were left out."""
    values: Array
    """(M,) deflection of the virtual joint by the law."""
    other_scales: Mapping[str, float] = field(default_factory=dict)
    """Largest loads by which ``tau3`` and the like (``taux``: along the link) are divided [N, N·m]."""
    deviations: float = 0.0
    """Size in standard deviations, what further terms would explain of noise taken away; 0 where not known."""

    @property
    def may_hold_weight(self) -> bool:
        """Whether an arm's weight on the joint may be behind it: a law that bends, or that goes with the angles."""
        return _OF_WEIGHT.search(self.expression) is not None

    @property
    def scales(self) -> Mapping[str, float]:
        """The largest load behind every load's name in the expression [N, N·m]."""
        own = {"tau": self.tau_scale} if re.search(r"\btau\b", self.expression) else {}
        return own | dict(self.other_scales)


@dataclass(frozen=True)
class FittedDevice:
    """What a sensor, the measuring device or a marker adds, by the best law without a name."""

    place: str
    terms: tuple[tuple[str, float, float, str], ...]
    """Law, coefficient, its standard deviation and its unit."""
    explained: float
    """Share of the residual's sum of squares outside the model."""


@dataclass(frozen=True)
class Localisation:
    """By what the residual can be sorted, and who is accused."""

    back_projections: tuple[BackProjection, ...]
    """Best explanation first."""
    accused: str
    """Virtual joint or measurement axis with the most evidence over all unnamed laws; empty if none."""
    suspects: tuple[int, ...]
    """Poses without which far less is left, if few: mislabelled, or read wrongly."""
    suspected: float
    """Share of the residual's variance that goes with them."""


def localise(problem: Problem, scan: Scan, found: Evidence, residual: Array) -> Localisation:
    """Sort the residual (M,), data's unit, and project it back."""
    scale = np.sqrt(scan.best.rss / max(scan.freedom, 1)) * scan.noise.spread
    z = residual / scale
    tried = [back_project(problem, z, scale, v) for v in range(len(problem.virtual_joints))]
    views = sorted((v for v in tried if v is not None), key=lambda v: -v.explained)
    return Localisation(
        tuple(views),
        _accused(scan, found),
        *_suspected(problem, scan),
    )


def _suspected(problem: Problem, scan: Scan) -> tuple[tuple[int, ...], float]:
    """Suspects under the noise that was learned, or that is each reading's own: those that bring more.

    What is wrong with one pose may have passed for what the readings of all share.
    """
    layer, spread = scan.best, stated(problem)
    basis, y = column_space(problem.A / spread[:, None]), problem.y / spread
    left = y - basis @ (basis.T @ y)
    found = suspects(problem, layer.basis, layer.y), suspects(problem, basis, left)
    return max(found, key=lambda one: one[1])


def suspects(problem: Problem, basis: Array, left: Array) -> tuple[tuple[int, ...], float]:
    """Poses, worst first, that are unlike all others beyond doubt, and the share of the variance they bring.

    ``basis`` (M, r) of the model and what it leaves (M,), whitened. A pose's rows left out reduce the residual's square
    by r'r + r'B (I - B'B)⁻¹ B'r, B their rows of the basis.
    """
    rss, whole = float(left @ left), problem.rows - basis.shape[1]
    chosen: list[int] = []
    rows, gained = np.zeros(problem.rows, bool), 0.0
    variance = rss / max(whole, 1)
    for _ in range(min(_SUSPECTS, problem.poses // _OF_POSES)):
        found = {}
        for pose in set(np.unique(problem.pose).tolist()) - set(chosen):
            out = rows | (problem.pose == pose)
            B, r = basis[out], left[out]
            inner = (1.0 + _ROUNDING) * np.eye(B.shape[1]) - B.T @ B
            found[pose] = float(r @ r + (B.T @ r) @ np.linalg.solve(inner, B.T @ r))
        worst = max(found, key=lambda p: found[p])
        own = problem.pose == worst
        freedom = whole - int((rows | own).sum())
        if freedom < _LEFT:
            break
        after = max(rss - found[worst], TINY) / freedom
        ratio = (found[worst] - gained) / int(own.sum()) / after
        if fdtrc(int(own.sum()), freedom, max(ratio, 0.0)) * problem.poses > _BEYOND_DOUBT:
            break
        chosen, rows, gained, variance = [*chosen, worst], rows | own, found[worst], after
    return tuple(chosen), 1.0 - variance * max(whole, 1) / max(rss, TINY) if chosen else 0.0


def back_project(problem: Problem, z: Array, scale: Array, v: int) -> BackProjection | None:
    """Δθ_v of every pose and load case by weighted least squares of the residual on J_v alone."""
    if problem.J is None or problem.tau is None:
        return None
    cells, label = np.unique(np.column_stack([problem.pose, problem.case]), axis=0, return_inverse=True)
    label = label.reshape(-1)
    J = problem.J[:, v] / scale
    weight = np.bincount(label, J**2, minlength=len(cells))
    seen = weight > _UNMOVED * max(float(weight.max()), TINY)
    if not np.any(seen):
        return None
    inner = np.bincount(label, J * z, minlength=len(cells))
    delta = np.where(seen, inner / np.where(seen, weight, 1.0), 0.0)
    deviation = np.where(seen, 1.0 / np.sqrt(np.where(seen, weight, 1.0)), np.inf)
    tau = np.bincount(label, problem.tau[:, v]) / np.bincount(label)
    explained = float(np.sum(inner[seen] ** 2 / weight[seen]) / max(float(z @ z), TINY))
    return BackProjection(
        problem.virtual_joints[v], cells[:, 0].astype(np.intp), cells[:, 1].astype(np.intp),
        delta, deviation, tau, explained,
    )  # fmt: skip


def _accused(scan: Scan, found: Evidence) -> str:
    bank = scan.bank
    places: dict[str, list[float]] = {}
    for i in np.flatnonzero(bank.generic):
        places.setdefault(str(bank.candidates[i].where["at"]), []).append(float(found.score[i]))
    if not places:
        return ""
    return max(places, key=lambda p: (float(logsumexp(places[p])), p))


def with_law(scan: Scan, found: Evidence, place: str) -> Scan:
    """The scan by the noise that is likeliest once the best law without a name at a place is in the model.

    Before it, what is missing may pass for an error that poses share, and the law would seem to explain little.
    """
    entry = _best_at(scan, found, place)
    return scan if entry is None else at_sharing(scan, likeliest(scan, (entry,)).sharing)


def _best_at(scan: Scan, found: Evidence, place: str) -> int | None:
    """The entry of the best law without a name at a place; None where there is none."""
    bank = scan.bank
    here = [k for k in np.flatnonzero(bank.generic) if bank.candidates[k].where["at"] == place]
    return int(found.best_entry[max(here, key=lambda k: found.score[k])]) if here else None


def device_law(problem: Problem, scan: Scan, found: Evidence, place: str) -> FittedDevice | None:
    """The best law at a place that is no virtual joint; None where there is none."""
    layer, entry = scan.best, _best_at(scan, found, place)
    if entry is None or place in problem.virtual_joints:
        return None
    value, std, _ = coefficients(scan, problem.A, problem.y, (entry,))
    P = problem.A.shape[1]
    own = scan.bank.parameters(entry)
    explained = float(np.sum((basis_of(scan, layer, entry).T @ layer.y) ** 2)) / max(layer.rss, TINY)
    numbers = zip(own, value[P:].tolist(), std[P:].tolist(), strict=True)
    return FittedDevice(place, tuple((p.name, v, d, p.unit) for p, v, d in numbers), explained)


def best_law(problem: Problem, scan: Scan, virtual_joint: str) -> FittedLaw | None:
    """Forward choice from the dictionary at one virtual joint, as long as left-out poses gain from it."""
    if problem.J is None or problem.tau is None or virtual_joint not in problem.virtual_joints:
        return None
    v = problem.virtual_joints.index(virtual_joint)
    laws = [law for law in every_law(problem, v) if np.any(law.values)]
    J = problem.J[:, v][:, None]
    layer = scan.best
    blocks = []
    for law in laws:
        W = scan.noise.apply(layer.whiten, J * law.values / scan.noise.spread[:, None])
        blocks.append(W - layer.basis @ (layer.basis.T @ W))
    fold = problem.place % _FOLDS
    chosen: list[int] = []
    best = 0.0
    for _ in range(_TERMS):
        trial = [
            (-np.inf if i in chosen else _gained([blocks[c] for c in [*chosen, i]], layer.y, fold))
            for i in range(len(laws))
        ]
        i = int(np.argmax(trial))
        if trial[i] < best + _GAIN:
            break
        best = trial[i]
        chosen.append(i)
    if not chosen:
        return None
    own = [blocks[c] for c in chosen]
    found = _written(problem, v, [laws[c] for c in chosen], own, layer.y, _validated(layer, own, fold))
    return replace(found, deviations=_deviations(found.explained, sum(b.shape[1] for b in own), scan))


def _deviations(explained: float, terms: int, scan: Scan) -> float:
    """Size of a law in standard deviations, from the share of squares that its terms explain."""
    noise = (1.0 - explained) / max(scan.freedom - terms, 1)
    return float(np.sqrt(max(explained / max(noise, TINY) - (terms - 1), 0.0)))


def _gained(blocks: list[Array], y: Array, fold: Array | Index) -> float:
    """Share of the squares explained on rows of poses that were left out, of what the model of all poses leaves."""
    X = np.hstack(blocks)
    left = 0.0
    for k in np.unique(fold):
        train = fold != k
        beta = np.linalg.lstsq(X[train], y[train], rcond=RANK)[0]
        left += float(np.sum((y[~train] - X[~train] @ beta) ** 2))
    return 1.0 - left / max(float(y @ y), TINY)


def _validated(layer: Layer, blocks: list[Array], fold: Array | Index) -> float:
    """The same with the model, too, fitted without the poses left out, of whose readings it would hold a share.

    So a law that rests on one pose is not confirmed. It scatters more: laws are chosen by the other.
    """
    X = np.hstack([layer.basis, *blocks])
    left = whole = 0.0
    for k in np.unique(fold):
        train = fold != k
        for columns in (layer.basis, X):
            beta = np.linalg.lstsq(columns[train], layer.y[train], rcond=RANK)[0]
            missed = float(np.sum((layer.y[~train] - columns[~train] @ beta) ** 2))
            left, whole = (left + missed, whole) if columns is X else (left, whole + missed)
    return 1.0 - left / max(whole, TINY)


def _written(
    problem: Problem, v: int, laws: list[Law], blocks: list[Array], y: Array, validated: float
) -> FittedLaw:
    X = np.hstack(blocks)
    beta = np.linalg.lstsq(X, y, rcond=RANK)[0]
    text = [t for law in laws for t in law.text]
    expression = " ".join(f"{b:+.4g}*{t}" for b, t in zip(beta, text, strict=True)).lstrip("+")
    residual = y - X @ beta
    return FittedLaw(
        problem.virtual_joints[v], expression, largest if (largest := largest_load(problem, v)) > TINY else 0.0,
        1.0 - float(residual @ residual) / max(float(y @ y), TINY), validated,
        np.hstack([law.values for law in laws]) @ beta, _scales(problem, v, expression),
    )  # fmt: skip


def _scales(problem: Problem, v: int, expression: str) -> dict[str, float]:
    """The largest load behind every other load's name in an expression."""
    link = problem.virtual_joints[v].rpartition(" ")[0]
    named = {f"tau{j + 1}": u for u, j in enumerate(problem.joint_of) if j >= 0}
    if f"{link} 1" in problem.virtual_joints:
        named["taux"] = problem.virtual_joints.index(f"{link} 1")
    used = dict.fromkeys(re.findall(r"\btau(?:\d+|x)\b", expression))
    return {name: largest_load(problem, named[name]) for name in used if name in named}
