"""M4–M5, exact: which parameters a class of loads and measurements can tell apart, before any measurement.

The observation matrix is evaluated at random points modulo a prime and brought to reduced row echelon form: rank,
groups and couplings come out without a tolerance; further primes confirm them and lift the couplings to fractions.
Couplings that are irrational are then solved for with fifty digits among the parameters that the primes name.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property
from typing import Any

import mpmath
import numpy as np
import sympy as sp

from symstiff.errors import UserError
from symstiff.reduction.circle import ORDER, order_for, primes
from symstiff.reduction.prime import PRIMES, Angle, PrimeAlgebra, echelon, rational
from symstiff.robot.exact import Exact
from symstiff.robot.frozen import FrozenDict
from symstiff.symbolic.algebras import evaluate_decimal
from symstiff.symbolic.chain import ElasticChain
from symstiff.symbolic.program import Program, evaluate

LOADS = {"wrench": (1, 2, 3, 4, 5, 6), "force": (1, 2, 3), "gravity": (3,)}
MEASURES = {"pose": (0, 1, 2, 3, 4, 5), "position": (0, 1, 2)}


@dataclass(frozen=True)
class Experiment:
    """A class of loads and measurements: which wrench components vary, what is measured, which joints stand still.

    points: markers whose positions are measured, where these are too few to stand for the pose; none are the tool's own
    pose or position.
    """

    loads: str = "wrench"
    measure: str = "pose"
    fixed: Mapping[int, sp.Expr] = field(default_factory=dict)
    points: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not isinstance(self.loads, str) or self.loads not in LOADS:
            raise UserError(f"loads: unknown {self.loads!r}: use {', '.join(LOADS)}")
        if not isinstance(self.measure, str) or self.measure not in MEASURES:
            raise UserError(f"measure: unknown {self.measure!r}: use {', '.join(MEASURES)}")
        object.__setattr__(self, "fixed", FrozenDict(self.fixed))

    @property
    def rows(self) -> tuple[int, ...]:
        """Rows of the observation matrix that are measured."""
        return tuple(range(3 * len(self.points))) if self.points else MEASURES[self.measure]


Couplings = dict[str, dict[str, Any]]


@dataclass(frozen=True)
class Partition:
    """M4a and M5: G1 identifiable, G2 without influence, G3 semi-identifiable, split into coupled groups.

    ``couplings[eliminated][kept]`` is the coefficient with which the kept parameter's column enters the eliminated
    one's: the kept parameter stands for π_kept + Σ coefficient·π_eliminated.
    """

    g1: tuple[str, ...]
    g2: tuple[str, ...]
    g3: tuple[str, ...]
    blocks: tuple[tuple[str, ...], ...]
    kept: tuple[str, ...]
    couplings: Couplings

    def __post_init__(self) -> None:
        rows = {eliminated: FrozenDict(row) for eliminated, row in self.couplings.items()}
        object.__setattr__(self, "couplings", FrozenDict(rows))

    @property
    def rank(self) -> int:
        """Rank of the observation matrix."""
        return len(self.kept)


def partition(names: Sequence[str], kept: Sequence[str], couplings: Couplings) -> Partition:
    """Groups from an echelon form: which eliminated columns are combinations of which kept ones."""
    zero = [n for n in names if n in couplings and not couplings[n]]
    coupled = {k for row in couplings.values() for k in row}
    g1 = [n for n in kept if n not in coupled]
    g3 = [n for n in names if n in coupled or couplings.get(n)]
    real = {n: row for n, row in couplings.items() if row}
    in_order = sorted(kept, key=list(names).index)
    return Partition(
        tuple(n for n in names if n in g1),
        tuple(zero),
        tuple(g3),
        _blocks(g3, real),
        tuple(in_order),
        {n: real[n] for n in names if n in real},
    )


def _blocks(g3: Sequence[str], couplings: Couplings) -> tuple[tuple[str, ...], ...]:
    """Connected groups of coupled parameters (M5a): the components of the linear matroid."""
    group = {n: n for n in g3}

    def root(n: str) -> str:
        while group[n] != n:
            n = group[n]
        return n

    for eliminated, row in couplings.items():
        for kept in row:
            group[root(kept)] = root(eliminated)
    found: dict[str, list[str]] = {}
    for n in g3:
        found.setdefault(root(n), []).append(n)
    return tuple(tuple(block) for block in found.values())


def in_rationals(chain: ElasticChain, experiment: Experiment) -> tuple[ElasticChain, Experiment]:
    """The same chain and experiment with fewer irrational numbers.

    Revolute variables count the DH angle itself, offsets included: compliances do not depend on where a joint's zero
    is. Oblique elastic axes keep the length that makes them rational, which only scales a column (``in_unit_axes``).
    """
    offsets = [Exact() if joint.prismatic else joint.theta for joint in chain.robot.joint]
    rows = tuple(
        joint if joint.prismatic else joint.model_copy(update={"theta": Exact()})
        for joint in chain.robot.joint
    )
    fixed = {i: sp.sympify(v) + offsets[i - 1].sympy() for i, v in experiment.fixed.items()}
    return (
        replace(chain, robot=chain.robot.model_copy(update={"joint": rows}), unit_axes=False),
        replace(experiment, fixed=fixed),
    )


def in_unit_axes(found: Partition, sizes: Mapping[str, sp.Expr]) -> Partition:
    """A partition of columns that are ``sizes`` times too large, with the couplings of the columns themselves."""
    couplings = {
        e: {k: _times(c, sizes[k] / sizes[e]) for k, c in row.items()} for e, row in found.couplings.items()
    }
    return replace(found, couplings=couplings)


def _times(coefficient: Fraction | float, ratio: sp.Expr) -> Fraction | float:
    if ratio.is_Rational and isinstance(coefficient, Fraction):
        return coefficient * Fraction(int(ratio.p), int(ratio.q))
    return float(coefficient) * float(ratio)


@dataclass(frozen=True)
class ExactEngine:
    """The structural engine for one observation program."""

    chain: ElasticChain
    program: Program
    names: tuple[str, ...]
    experiment: Experiment = Experiment()
    seed: int = 1

    @cached_property
    def order(self) -> int:
        """The order of the circle in which every fixed angle of the robot and of the experiment is exact."""
        fixed = [
            sp.sympify(v) for i, v in self.experiment.fixed.items() if not self.chain.rows[i - 1].prismatic
        ]
        return order_for([*self.chain.constant_angles(), *fixed])

    @property
    def primes(self) -> tuple[int, ...]:
        """Primes with a circle of that order."""
        return PRIMES if self.order == ORDER else primes(self.order)

    def algebra(self, prime: int) -> PrimeAlgebra:
        """Arithmetic modulo one of them."""
        return PrimeAlgebra(prime, self.order)

    def matrix(self, prime: int, lengths: Sequence[int] = ()) -> np.ndarray:
        """The aggregated observation matrix modulo a prime, at enough random configurations."""
        algebra = self.algebra(prime)
        rng = np.random.default_rng([self.seed, prime])
        rows = self.experiment.rows
        n = (5 * len(self.names)) // (4 * len(rows)) + 12
        inputs = self.points(algebra, rng, n)
        for vector in self.program.inputs:
            if vector.name == "lengths":
                inputs["lengths"] = list(lengths)
            elif vector.name == "context":
                inputs["context"] = [algebra.random(rng, n) for _ in vector.symbols]
        flat = evaluate(self.program, inputs, algebra)["A"]
        width = len(self.names)
        matrix = np.zeros((n * len(rows), width), dtype=np.int64)
        for k, r in enumerate(rows):
            for c in range(width):
                matrix[k * n : (k + 1) * n, c] = flat[r * width + c]
        return matrix % prime

    def points(self, algebra: PrimeAlgebra, rng: np.random.Generator, n: int) -> dict[str, list[Any]]:
        """Random joint variables ``q`` and wrenches ``w`` of the class of experiments, n of each."""
        return {"q": self._joints(algebra, rng, n), "w": self._wrench(algebra, rng, n)}

    def _joints(self, algebra: PrimeAlgebra, rng: np.random.Generator, n: int) -> list[Any]:
        joints: list[Any] = []
        for i, row in enumerate(self.chain.rows, start=1):
            fixed = self.experiment.fixed.get(i)
            if row.prismatic:
                joints.append(algebra.random(rng, n) if fixed is None else algebra.number(sp.sympify(fixed)))
            else:
                joints.append(_angle(algebra, fixed, rng, n))
        return joints

    def _wrench(self, algebra: PrimeAlgebra, rng: np.random.Generator, n: int) -> list[Any]:
        acting = LOADS[self.experiment.loads]
        return [algebra.random(rng, n) if c in acting else 0 for c in range(1, 7)]

    def reduced(
        self, prime: int, order: Sequence[int], lengths: Sequence[int] = ()
    ) -> tuple[np.ndarray, list[int]]:
        """Echelon form with columns in the given order; pivots as positions in that order."""
        return echelon(self.matrix(prime, lengths)[:, list(order)], prime)

    def partition(self, preference: Sequence[str]) -> Partition:
        """Rank, groups, kept parameters and exact couplings; earlier names in ``preference`` are kept first."""
        order = [self.names.index(n) for n in preference]
        lifted = _Lift()
        for prime in self.primes:
            if lifted.add(*self.reduced(prime, order), prime):
                break
        kept = [preference[p] for p in lifted.pivots]
        free = [position for position in range(len(order)) if position not in lifted.pivots]
        rows = {preference[p]: {kept[r]: c for r, c in lifted.column(p).items()} for p in free}
        irrational = {e: tuple(row) for e, row in rows.items() if None in row.values()}
        solved = self.solved(irrational) if irrational else {}
        couplings = {
            e: {k: solved[e][k] if c is None else c for k, c in row.items()} for e, row in rows.items()
        }
        return partition(self.names, kept, couplings)

    def solved(self, supports: Mapping[str, Sequence[str]]) -> dict[str, dict[str, float]]:
        """Coefficients of the kept columns that make up an eliminated one, for each: at random points, fifty digits."""
        rows, width = self.experiment.rows, len(self.names)
        count = 5 * max(map(len, supports.values())) // (4 * len(rows)) + 12
        exact = {i - 1: str(sp.N(value, 60)) for i, value in self.experiment.fixed.items()}
        inputs, flat = self.random_inputs(count), []
        for n in range(count):
            point = {name: list(values[n]) for name, values in inputs.items()}
            point["q"] = [exact.get(k, x) for k, x in enumerate(point["q"])]
            flat.append(evaluate_decimal(self.program, 50, **point)["A"])
        found = {}
        with mpmath.workdps(50):
            for eliminated, kept in supports.items():
                columns = [self.names.index(n) for n in (*kept, eliminated)]
                A = mpmath.matrix([[a[r * width + c] for c in columns] for a in flat for r in rows])
                solution = mpmath.lu_solve(A[:, : len(kept)], A[:, len(kept)])
                found[eliminated] = dict(zip(kept, map(float, solution), strict=True))
        return found

    def random_inputs(self, n: int) -> dict[str, np.ndarray]:
        """Inputs of n random points of the class of experiments, in doubles."""
        rng = np.random.default_rng(self.seed)
        q, w = rng.uniform(-3.0, 3.0, (n, self.chain.dof)), np.zeros((n, 6))
        for joint, value in self.experiment.fixed.items():
            q[:, joint - 1] = float(value)
        acting = [c - 1 for c in LOADS[self.experiment.loads]]
        w[:, acting] = rng.normal(size=(n, len(acting)))
        inputs: dict[str, np.ndarray] = {"q": q, "w": w}
        for vector in self.program.inputs:
            if vector.name == "context":
                inputs["context"] = rng.uniform(0.5, 1.0, (n, len(vector.symbols)))
        return inputs


def _angle(algebra: PrimeAlgebra, fixed: sp.Expr | None, rng: np.random.Generator, n: int) -> Angle:
    return algebra.random_angle(rng, n) if fixed is None else algebra.fixed_angle(fixed)


class _Lift:
    """Combines echelon forms of several primes to fractions, until one more prime confirms all of them."""

    def __init__(self) -> None:
        self.pivots: list[int] = []
        self.modulus = 1
        self.residues: dict[tuple[int, int], int] = {}
        self.width = 0
        self.unsure: set[tuple[int, int]] = set()
        self._guess: dict[tuple[int, int], Fraction | None] = {}

    def add(self, form: np.ndarray, pivots: list[int], prime: int) -> bool:
        """Take in one prime; returns whether every fraction found before agrees with it."""
        best, this = (-len(self.pivots), self.pivots), (-len(pivots), pivots)
        fresh = self.modulus == 1 or this < best
        if fresh:
            self.pivots, self.modulus, self.width = pivots, 1, form.shape[1]
            self.residues = {}
        elif this > best:
            return False  # an unlucky prime lost rank: leave it out
        free = [c for c in range(self.width) if c not in self.pivots]
        keys = [(r, c) for r in range(len(self.pivots)) for c in free]
        self.unsure = {key for key in keys if not self._combine(key, int(form[key]), prime)}
        self.modulus *= prime
        for key, residue in self.residues.items():
            self._guess[key] = rational(residue, self.modulus)
        return not fresh and not self.unsure

    def _combine(self, key: tuple[int, int], residue: int, prime: int) -> bool:
        old = self.residues.get(key, 0)
        guess = self._guess.get(key)
        agrees = (
            self.modulus > 1
            and guess is not None
            and guess.denominator % prime != 0
            and guess.numerator * pow(guess.denominator, -1, prime) % prime == residue
        )
        step = (residue - old) * pow(self.modulus, -1, prime) % prime
        self.residues[key] = old + self.modulus * step
        return agrees

    def column(self, position: int) -> dict[int, Fraction | None]:
        """Coefficients of one free column over the pivots; None where no fraction was confirmed."""
        keys = [(r, position) for r in range(len(self.pivots)) if self.residues[r, position]]
        return {key[0]: None if key in self.unsure else self._guess[key] for key in keys}
