"""Weighted least squares for elastic parameters, with everything one needs to trust the result."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from scipy.special import chdtrc, ndtri, stdtrit

from symstiff.arrays import Array
from symstiff.calibration.fits.compact import Compact, checked, compact
from symstiff.calibration.fits.components import doubt_of
from symstiff.calibration.fits.rank import Combination, RankDecision, combinations, decide_rank, resolved_root
from symstiff.calibration.fits.shared import Blocks, SharedError, shared_error
from symstiff.display import finite
from symstiff.errors import UserError
from symstiff.reduction.svd import svd

_TOGETHER = 0.95
"""Correlation from which estimates are said to move together."""


@dataclass(frozen=True, eq=False)
class Estimate:
    """Identified parameters with their uncertainty.

    values, std, lower, upper: (P,) in `units` (std infinite where the data do not determine the parameter);
    covariance: (P, P) of the resolved part; residuals: (M,) measured minus predicted, in m and rad; whitened:
    (M,) residuals over sigma; s0_squared: whitened residual sum over `dof` (nan without degrees of freedom);
    unit_variance: the variance factor of independent rows, 1 where sigma was given; condition: of the resolved
    part of the column-scaled matrix; fit_p: probability of a residual sum this large when sigma holds (None
    without sigma); shared: the error that rows share, which std holds (None where they look independent); freedom:
    (P,) degrees of freedom of each interval, infinite where sigma was given.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Array
    std: Array
    lower: Array
    upper: Array
    covariance: Array
    residuals: Array
    whitened: Array
    s0_squared: float
    unit_variance: float
    dof: int
    condition: float
    confidence: float
    fit_p: float | None
    rank: RankDecision
    combinations: tuple[Combination, ...]
    compact: Compact
    freedom: Array
    shared: SharedError | None = None

    def __repr__(self) -> str:
        from symstiff.display import counted

        found = int(np.isfinite(self.std).sum())
        some = "" if found == len(self.names) else f", {found} of them determined"
        left = f"s0² = {self.s0_squared:.3g}" if self.dof else "no degree of freedom left"
        return (
            f"Estimate({counted(len(self.names), 'parameter')}{some}, {len(self.residuals)} readings, {left})"
        )

    @property
    def correlation(self) -> Array:
        """(P, P) correlations of the resolved part."""
        deviation = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        deviation = np.where(deviation > 0, deviation, 1.0)
        return np.asarray(self.covariance / np.outer(deviation, deviation))

    def correlated(self) -> tuple[tuple[str, str, float], ...]:
        """Pairs of parameters whose estimates move together, strongest first."""
        table = self.correlation
        pairs = [
            (self.names[i], self.names[j], float(table[i, j]))
            for i in range(len(self.names))
            for j in range(i)
            if abs(table[i, j]) >= _TOGETHER
        ]
        return tuple(sorted(pairs, key=lambda pair: -abs(pair[2])))

    def to_dict(self) -> dict[str, Any]:
        """A JSON-ready record: parameters, rank decision, fit; null for what is not finite."""
        keys = ("value", "std", "lower", "upper")
        columns = zip(self.values, self.std, self.lower, self.upper, strict=True)
        rows = [{key: finite(v) for key, v in zip(keys, row, strict=True)} for row in columns]
        named = zip(self.names, self.units, rows, strict=True)
        return {
            "parameters": {name: row | {"unit": unit} for name, unit, row in named},
            "confidence": self.confidence,
            "rank": self.rank.to_dict(),
            "combinations": [
                {"kept": c.kept, "others": c.others, "value": c.value, "std": finite(c.std)}
                for c in self.combinations
            ],
            "condition": finite(self.condition),
            "rows": len(self.residuals),
            "degrees_of_freedom": self.dof,
            "s0_squared": finite(self.s0_squared),
            "fit_p": finite(self.fit_p),
            "shared_error": None
            if self.shared is None
            else {"ratio": self.shared.ratio, "p_value": self.shared.p_value},
            "correlated": [{"parameters": [a, b], "correlation": value} for a, b, value in self.correlated()],
        }


def estimate(
    A: Array,
    y: Array,
    sigma: Array | None = None,
    names: Sequence[str] | None = None,
    *,
    units: Sequence[str] | None = None,
    blocks: npt.ArrayLike | Blocks | None = None,
    estimated: bool = False,
    confidence: float = 0.95,
    truncate: Literal["noise", "rounding"] = "noise",
) -> Estimate:
    """Identify parameters by weighted least squares, through QR and SVD with scaled columns.

    A: (M, P) observation matrix, y: (M,) measured deflections in m and rad; sigma: (M,) their standard
    deviations, or None for equal ones estimated from the residuals; names, units: (P,), units by the names
    where absent; blocks: (M,) or (M, K) numbers of rows that may share errors, or `Blocks`, which the deviations
    then hold (`shared_error`); estimated: whether sigma comes from residuals of the same rows (`component_sigma`), so
    that no test of the fit can be made of it and the deviations hold what it leaves in doubt; truncate: whether
    directions drowned in noise are dropped like those lost in rounding.
    Raises UserError for shapes, NaN and deviations that cannot be used. Source: seed eq. (7)–(8), (15)–(20).
    """
    names = [f"p{i + 1}" for i in range(np.shape(A)[1])] if names is None else names
    A, y, sigma, named = checked(A, y, sigma, names)
    if not 0.0 < confidence < 1.0:
        raise UserError(f"confidence {confidence:g} is not between 0 and 1: give 0.95 for 95 %")
    form = compact(A, y, sigma)
    decision, root, known = _resolved(form, A, named, sigma is not None, truncate)
    values, dof = root @ known, len(y) - decision.rank
    residuals = y - A @ values
    whitened = residuals if sigma is None else residuals / sigma
    total, told = float(whitened @ whitened), sigma is not None and not estimated
    s0_squared = total / dof if dof > 0 else math.nan
    unit_variance = s0_squared if sigma is None else 1.0
    spread = _spread_of(A, y, sigma, root, residuals, unit_variance, blocks, estimated)
    std = np.sqrt(np.diag(spread.covariance))
    std[[name in decision.affected for name in named]] = np.inf
    half = std * interval_factor(confidence, spread.freedom)
    return Estimate(
        names=named, units=tuple(map(unit_of, named) if units is None else units),
        values=values, std=std, lower=values - half, upper=values + half, covariance=spread.covariance,
        residuals=residuals, whitened=whitened, s0_squared=s0_squared, unit_variance=unit_variance, dof=dof,
        condition=decision.condition, confidence=confidence,
        fit_p=float(chdtrc(dof, total)) if told and dof > 0 else None,
        rank=decision, combinations=combinations(decision, named, form.scale, values, spread.covariance),
        compact=form, freedom=spread.freedom, shared=spread.shared,
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Spread:
    """How an estimate scatters: covariance (P, P), freedom (P,) of each interval, the error that rows share."""

    covariance: Array
    freedom: Array
    shared: SharedError | None


def _spread_of(
    A: Array,
    y: Array,
    sigma: Array | None,
    root: Array,
    residuals: Array,
    unit_variance: float,
    blocks: npt.ArrayLike | Blocks | None,
    estimated: bool,
) -> _Spread:
    """The covariance root·rootᵀ of independent rows, (P, r), with what rows share and what estimated sigmas leave open.

    unit_variance: of a whitened row; the others as in `estimate`.
    """
    told, dof = sigma is not None and not estimated, len(y) - root.shape[1]
    covariance, shared = unit_variance * (root @ root.T), None
    if blocks is not None and dof > 0:
        covariance, shared = _with_shared(covariance, A, y, sigma, root, blocks, 1.0 if told else None)
    if sigma is not None and estimated and dof > 0:
        doubt = doubt_of(A, residuals, sigma, root)
        return _Spread(covariance + doubt.covariance, doubt.freedom, shared)
    return _Spread(covariance, np.full(len(covariance), math.inf if told else float(max(dof, 0))), shared)


def _resolved(
    form: Compact, A: Array, names: tuple[str, ...], given: bool, truncate: Literal["noise", "rounding"]
) -> tuple[RankDecision, Array, Array]:
    """The rank decision, the (P, r) root of the covariance of what is resolved, and the (r,) data along it."""
    U, s, Vt = svd(form.R, full=True)
    singular = np.concatenate([s, np.zeros(len(names) - len(s))])
    known = U.T @ form.z
    noise = _noise(form, s, known, given) if truncate == "noise" else 0.0
    silent = [name for name, column in zip(names, A.T, strict=True) if not column.any()]
    decision = decide_rank(form, singular, Vt, names, noise, silent)
    return decision, resolved_root(form, s, Vt, decision.rank), known[: decision.rank]


def _with_shared(
    covariance: Array,
    A: Array,
    y: Array,
    sigma: Array | None,
    root: Array,
    blocks: npt.ArrayLike | Blocks,
    fixed: float | None,
) -> tuple[Array, SharedError | None]:
    """(P, P) covariance with the errors that rows share; fixed: a row's own variance, None where residuals tell it.

    A sigma from residuals holds the shared error as well: the rows' own part of it takes its place.
    """
    whiten = 1.0 if sigma is None else 1.0 / sigma
    Q = (A.T * whiten).T @ root
    shared = shared_error(Q, y * whiten, blocks, sigma)
    if shared is None:
        return covariance, None
    own = shared.variance if fixed is None else fixed
    among = Q.T @ shared.covariance_times(Q) - np.eye(root.shape[1])
    return own * (root @ root.T) + shared.variance * (root @ among @ root.T), shared


def interval_factor(confidence: float, freedom: Array) -> Array:
    """Half widths of two-sided intervals in standard deviations: Student's t, normal for infinite freedom."""
    above, known = 0.5 + confidence / 2, np.isfinite(freedom) & (freedom > 0)
    factor = np.where(known, stdtrit(np.where(known, freedom, 1.0), above), ndtri(above))
    return np.asarray(np.where(freedom > 0, factor, math.inf))


def unit_of(name: str) -> str:
    """The unit of a parameter by its name (`k2_26` → rad/N, `c3` → rad/(N*m)); empty for other names."""
    body, _, axes = name[1:].partition("_")
    if name[:1] == "c" and name[1:].isdigit():
        return "rad/(N*m)"
    if name[:1] == "k" and body.isdigit() and len(axes) == 2 and set(axes) <= set("123456"):
        rotations = (axes[0] > "3") + (axes[1] > "3")
        return ("m/N", "rad/N", "rad/(N*m)")[rotations]
    return ""


def _noise(form: Compact, s: Array, known: Array, given: bool) -> float:
    """Standard deviation of a whitened row: 1 where sigma is given, else from the residuals."""
    if given:
        return 1.0
    rank = int(np.sum(s > s[0] * form.rows * np.finfo(float).eps)) if s.size else 0
    dof = form.rows - rank
    return math.sqrt((form.rest + float(np.sum(known[rank:] ** 2))) / dof) if dof > 0 else 0.0
