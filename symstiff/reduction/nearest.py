"""Convex programs on the affine set of complete parameters: its depth, its point nearest to a nominal one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from symstiff.arrays import Array
from symstiff.errors import UserError
from symstiff.reduction.admissible import AdmissibleSet
from symstiff.reduction.conic import Constraint, Solution, block_rows, semidefinite, solve


@dataclass(frozen=True)
class Relation:
    """A soft linear relation Σ coefficient·parameter ≈ 0; weight: against one nominal size off target."""

    coefficients: Mapping[str, float]
    weight: float = 1.0


def cantilever_relations(link: int, length: float, weight: float = 1.0) -> tuple[Relation, ...]:
    """Tip relations of a uniform slender beam of signed length [m] along the link's first elastic axis.

    k26 = L/2·k66, k35 = −L/2·k55, k22 = L²/3·k66, k33 = L²/3·k55 (Timoshenko and Goodier, end load).
    """

    def pair(a: str, b: str, factor: float) -> Relation:
        return Relation({f"k{link}_{a}": 1.0, f"k{link}_{b}": -factor}, weight)

    return (
        pair("26", "66", length / 2),
        pair("35", "55", -length / 2),
        pair("22", "66", length**2 / 3),
        pair("33", "55", length**2 / 3),
    )


@dataclass(frozen=True, eq=False)
class Affine:
    """{x : P·(scale∘x) = reduced} in parameters of order one. P: (r, n), reduced: (r,), scale: (n,)."""

    P: Array
    reduced: Array
    scale: Array

    @cached_property
    def rows(self) -> Array:
        """(r, n): the equations in scaled parameters, each of unit norm."""
        return (self.P * self.scale) / self.norms[:, None]

    @cached_property
    def norms(self) -> Array:
        """(r,): size of each reduced parameter by its nominal members."""
        return np.asarray(np.linalg.norm(self.P * self.scale, axis=1))

    @cached_property
    def rhs(self) -> Array:
        """(r,): the reduced parameters in those sizes."""
        return self.reduced / self.norms

    def equations(self, width: int | None = None) -> Constraint:
        """The equations on the first n of `width` variables."""
        rows = self.rows if width is None else np.pad(self.rows, ((0, 0), (0, width - self.rows.shape[1])))
        return Constraint("zero", rows, self.rhs)

    def restore(self, x: Array) -> Array:
        """The point of the affine set nearest to x: a solver's rounding taken out."""
        for _ in range(2):
            x = x + np.linalg.lstsq(self.rows, self.rhs - self.rows @ x, rcond=None)[0]
        return x

    @cached_property
    def gain(self) -> float:
        """How far the data are from the nominal sizes: programs are solved in sizes times this."""
        return float(np.max(np.abs(self.rhs), initial=0.0)) or 1.0

    def resized(self, gain: float) -> Affine:
        """The same set in sizes times gain."""
        return Affine(self.P, self.reduced, self.scale * gain)

    @cached_property
    def null(self) -> Array:
        """(n, n − r) orthonormal directions that leave the reduced set as it is."""
        return np.asarray(np.linalg.svd(self.rows)[2][len(self.rows) :].T)


def deepest(affine: Affine, rules: AdmissibleSet) -> float:
    """The largest t ≤ 1 with a point in the affine set whose every block is ⪰ t (of nominal sizes)."""
    return float(deepest_point(affine, rules)[-1])


def deepest_point(affine: Affine, rules: AdmissibleSet) -> Array:
    """That point and its t, (n + 1,)."""
    n, gain = len(affine.scale), affine.gain
    affine = affine.resized(gain)
    constraints = [affine.equations(n + 1), _at_most(n, 1.0 / gain)]
    for block, cone in zip(rules.blocks, semidefinite(rules, affine.scale, n + 1), strict=True):
        rows = cone.rows.copy()
        rows[:, n] = block_rows(block, affine.scale, n)[1]
        constraints.append(Constraint(cone.kind, rows, cone.rhs, cone.order))
    # The square keeps directions bounded that no block and no equation holds.
    quadratic = np.append(np.full(n, 1e-9), 0.0)
    return _solved(solve(quadratic, np.append(np.zeros(n), -1.0), constraints), "depth").x * gain


def nearest_relative(
    affine: Affine,
    rules: AdmissibleSet,
    target: Array,
    relations: Sequence[Relation] = (),
    margin: float = 0.0,
) -> tuple[Array, float]:
    """Point with every block ⪰ margin of least Σ(x − target)² + Σ weight²·relation², and that value."""
    n, gain = len(target), max(affine.gain, float(np.max(np.abs(target), initial=0.0)))
    affine, target, margin = affine.resized(gain), target / gain, margin / gain
    soft = _relation_rows(relations, rules.names, affine.scale)
    width = n + len(soft)
    links = Constraint("zero", np.hstack([soft, -np.eye(len(soft))]), np.zeros(len(soft)))
    constraints = [affine.equations(width), *([links] if len(soft) else [])]
    constraints += semidefinite(rules, affine.scale, width, margin)
    linear = np.concatenate([-2.0 * target, np.zeros(len(soft))])
    x = _solved(solve(np.full(width, 2.0), linear, constraints), "nearest admissible set").x[:n]
    return gain * x, gain**2 * float(np.sum((x - target) ** 2) + np.sum((soft @ x) ** 2))


def project_reduced(affine: Affine, rules: AdmissibleSet, covariance: Array | None, margin: float) -> Array:
    """The nearest reduced set, (r,), that has a complete set with every block ⪰ margin.

    Nearest in standard deviations where a covariance is given, in nominal sizes otherwise. Raises UserError for a
    covariance that is not positive definite.
    """
    n, r = len(affine.scale), len(affine.reduced)
    margin /= affine.gain
    affine = affine.resized(affine.gain)
    whiten = np.eye(r)
    if covariance is not None:
        whiten = in_deviations(covariance, np.diag(affine.norms))
    size = max(1.0, float(np.linalg.norm(whiten, 2)))
    rows = np.hstack([whiten @ affine.rows / size, -np.eye(r)])
    constraints = [Constraint("zero", rows, whiten @ affine.rhs / size)]
    constraints += semidefinite(rules, affine.scale, n + r, margin)
    # A trace of the parameters' own size keeps what the reduced set does not hold from drifting away.
    quadratic = np.concatenate([np.full(n, 1e-10), np.ones(r)])
    x = _solved(solve(quadratic, np.zeros(n + r), constraints), "nearest admissible reduced set").x[:n]
    return np.asarray(affine.P @ (affine.scale * x))


def in_deviations(covariance: Array, X: Array) -> Array:
    """X (r,) or (r, k) in independent standard deviations; UserError for a covariance that is not positive definite."""
    root = _root(covariance)
    if root is None:
        raise UserError(
            "covariance is not positive definite, so it tells no distance: correct it, or leave it out, and sizes are "
            "nominal ones"
        )
    deviation, factor = root
    return np.asarray(np.linalg.solve(factor, (X.T / deviation).T))


def is_definite(covariance: Array) -> bool:
    """Whether a covariance (r, r) tells every direction's noise: of a fit that left no freedom it does not."""
    return _root(covariance) is not None


def _root(covariance: Array) -> tuple[Array, Array] | None:
    """Standard deviations (r,), and Cholesky's factor (r, r) of the correlations: free of units; None for neither."""
    variance = np.diag(covariance)
    if not (np.isfinite(covariance).all() and (variance > 0.0).all()):
        return None
    deviation = np.sqrt(variance)
    try:
        return deviation, np.linalg.cholesky(covariance / np.outer(deviation, deviation))
    except np.linalg.LinAlgError:
        return None


def _relation_rows(relations: Sequence[Relation], names: Sequence[str], scale: Array) -> Array:
    """(relations, n) on scaled parameters, each row with its largest term at the relation's weight."""
    index = {name: i for i, name in enumerate(names)}
    rows = np.zeros((len(relations), len(names)))
    for row, relation in zip(rows, relations, strict=True):
        for name, coefficient in relation.coefficients.items():
            if name not in index:
                raise UserError(f"relation names {name}, which is no parameter of this model")
            row[index[name]] = coefficient * scale[index[name]]
        row *= relation.weight / (np.max(np.abs(row)) or 1.0)
    return rows


def _at_most(n: int, most: float) -> Constraint:
    return Constraint("nonnegative", np.append(np.zeros(n), 1.0)[None, :], np.array([most]))


def _solved(solution: Solution, what: str) -> Solution:
    if solution.status != "solved":
        raise ArithmeticError(f"{what}: the conic solver stopped with {solution.status}")
    return solution
