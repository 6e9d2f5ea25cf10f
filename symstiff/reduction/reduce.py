"""The reduction M1–M5 of a robot's stiffness model for a class of loads and measurements (seed section 3)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from numbers import Integral
from typing import Any

import numpy as np
import sympy as sp

from symstiff.arguments import A_ROBOT, require, words
from symstiff.display import few
from symstiff.errors import UserError
from symstiff.reduction.aggregation import inexact_aggregations
from symstiff.reduction.physical import Parameter, Stage, physical_stages, terms_of
from symstiff.reduction.structural import ExactEngine, Experiment, Partition, in_rationals, in_unit_axes
from symstiff.robot.exact import parse_exact
from symstiff.robot.frozen import FrozenDict, frozen_numbers
from symstiff.robot.quantities import LONGEST, WIDEST, in_parts_of_pi
from symstiff.robot.schema import Robot
from symstiff.symbolic.chain import ElasticChain
from symstiff.symbolic.programs import observation_program
from symstiff.symbolic.terms import Term

_TENTHS = 1800
"""Tenths of a degree in half a turn."""
_WIDER = {
    "gravity": "--loads force or wrench",
    "force": "--loads wrench and --measure pose",
    "wrench": "--measure pose",
}
"""By class of loads, what may show a model that is empty: positions that no force moves no moment moves either."""


@dataclass(frozen=True)
class Reduction:
    """All stages of a reduction, the partition of the last one, and the maps between full and reduced parameters.

    inexact_aggregations: joints that M3 gave to a link whose template cannot stand for them.
    """

    robot: Robot
    experiment: Experiment
    stages: tuple[Stage, ...]
    partition: Partition
    inexact_aggregations: tuple[str, ...] = ()

    @property
    def full(self) -> tuple[Parameter, ...]:
        """π′: the parameters after M3."""
        return self.stages[3].parameters

    @property
    def parameters(self) -> tuple[str, ...]:
        """π″: the identifiable set, in the order of π′."""
        return self.partition.kept

    @property
    def kept(self) -> tuple[Parameter, ...]:
        """π″ as parameters."""
        names = set(self.parameters)
        return tuple(p for p in self.full if p.name in names)

    @property
    def counts(self) -> tuple[tuple[str, int], ...]:
        """Steps and numbers of parameters, as the seed's Table 1."""
        found = [(s.step, len(s.parameters)) for s in self.stages]
        remaining = len(self.full) - len(self.partition.g2)
        return (*found, ("M4", remaining), ("M5", self.partition.rank))

    def check_any(self) -> None:
        """Raise UserError where no parameter is left: what bends moves nothing that is measured."""
        if self.parameters:
            return
        e = self.experiment
        raise UserError(
            f"the model has no parameter: under {e.loads} loads nothing that bends in {self.robot.name} moves the "
            f"measured {e.measure}: use {_WIDER[e.loads]}, or links that bend (--start complete, or another template "
            "in the robot file)"
        )

    @cached_property
    def terms(self) -> tuple[Term, ...]:
        """The terms of the kept parameters."""
        return terms_of(self.kept)

    @cached_property
    def standing(self) -> dict[int, sp.Expr]:
        """The fixed joints that matter: were they free, more could be identified: what is kept holds there alone."""
        e, fixed = self.experiment, dict(self.experiment.fixed)
        for joint in sorted(fixed):
            others = {j: v for j, v in fixed.items() if j != joint}
            engine = engine_of(self.robot, self.full, replace(e, fixed=others))
            _, pivots = engine.reduced(engine.primes[0], range(len(engine.names)))
            # moving a joint only adds rows: with the same rank they have the same null space
            if len(pivots) == self.partition.rank:
                fixed = others
        return FrozenDict(fixed)

    @cached_property
    def projection(self) -> np.ndarray:
        """P of π″ = P·π′ (rank × len(full)): what every kept parameter stands for."""
        names = [p.name for p in self.full]
        matrix = np.zeros((len(self.parameters), len(names)))
        for r, kept in enumerate(self.parameters):
            matrix[r, names.index(kept)] = 1.0
            for eliminated, row in self.partition.couplings.items():
                if kept in row:
                    matrix[r, names.index(eliminated)] = float(row[kept])
        matrix.setflags(write=False)
        return matrix

    def reduced_values(self, full: Mapping[str, float]) -> dict[str, float]:
        """Values of π″ that give the deflections of a full set π′, the parameters after M3 (absent ones zero).

        Links and joints apart, as before M3, are led by ``symstiff.reduction.complete.complete_map``.
        """
        full = self._known(full, "full", [p.name for p in self.full], "parameter after M3")
        vector = np.array([full.get(p.name, 0.0) for p in self.full])
        return dict(zip(self.parameters, (self.projection @ vector).tolist(), strict=True))

    def full_values(
        self, reduced: Mapping[str, float], constants: Mapping[str, float] | None = None
    ) -> dict[str, float]:
        """Values of π′ with the eliminated parameters fixed at constants (M5c); what is given of neither is zero."""
        eliminated = [p.name for p in self.full if p.name not in self.parameters]
        reduced = self._known(reduced, "reduced", self.parameters, "parameter of the identifiable set")
        fixed = self._known(constants or {}, "constants", eliminated, "eliminated parameter")
        values = {n: fixed.get(n, 0.0) for n in eliminated}
        shift = self.reduced_values(values)
        values |= {n: reduced.get(n, 0.0) - shift[n] for n in self.parameters}
        return {p.name: values[p.name] for p in self.full}

    def _known(
        self, values: Mapping[str, float], what: str, names: Sequence[str], kind: str
    ) -> Mapping[str, float]:
        """The values, checked. Raises UserError for a name that is none of ``names``."""
        values = frozen_numbers(values, what)
        if unknown := sorted(set(values) - set(names), key=str):
            raise UserError(f"{what}: {unknown[0]!r:.40} is no {kind} of {self.robot.name}: {few(names)} are")
        return values

    def as_dict(self) -> dict[str, Any]:
        """What ``inspect --json`` writes."""
        p = self.partition
        return {
            "robot": self.robot.name,
            "loads": self.experiment.loads,
            "measure": self.experiment.measure,
            "fixed": {f"q{i}": str(v) for i, v in self.experiment.fixed.items()},
            "stages": [{"step": step, "parameters": n} for step, n in self.counts],
            "groups": {"G1": list(p.g1), "G2": list(p.g2), "G3": list(p.g3)},
            "blocks": [list(b) for b in p.blocks],
            "parameters": list(p.kept),
            "rank": p.rank,
            "couplings": {e: {k: shown(c) for k, c in row.items()} for e, row in p.couplings.items()},
            "inexact_aggregations": list(self.inexact_aggregations),
        }

    def __repr__(self) -> str:
        e, (_, first), (_, last) = self.experiment, self.counts[0], self.counts[-1]
        return f"Reduction({self.robot.name}, {e.loads}, {e.measure}: {first} to {last} parameters)"

    def _repr_html_(self) -> str:
        from symstiff.reduction.reading import reduction_html

        return reduction_html(self)


def shown(coefficient: Any) -> str:
    """A coupling as text: a short fraction exactly, a long or irrational one to 15 digits."""
    if isinstance(coefficient, float) or coefficient.denominator > 10**15:
        return f"{float(coefficient):.15g}"
    return str(coefficient)


def reduce(
    robot: Robot,
    loads: str = "wrench",
    measure: str = "pose",
    fixed: Mapping[int, Any] | None = None,
    prefer: Sequence[str] = (),
    avoid: Sequence[str] = (),
    points: Sequence[str] = (),
) -> Reduction:
    """Reduce a robot's complete model to what a class of loads and measurements identifies.

    ``loads`` at the tool centre point: "wrench" (any forces and moments), "force" (any forces) or "gravity" (f_z in
    world axes alone); ``measure``: "pose" (translations and rotations) or "position" (translations).
    ``fixed`` holds joints at values [rad, m]; ``prefer`` names parameters to keep first, ``avoid`` to eliminate first
    (M5b); ``points`` are markers whose positions are all that is measured.
    Raises UserError for an unknown class, joint or parameter.
    """
    require(robot, Robot, *A_ROBOT)
    experiment = Experiment(
        loads, measure, standing_still(robot, fixed or {}), words(points, "points", "['p1', 'p2']")
    )
    prefer, avoid = (
        words(given, name, "['k2_11']") for given, name in ((prefer, "prefer"), (avoid, "avoid"))
    )
    stages = physical_stages(robot)
    full = stages[-1].parameters
    if not full:
        raise UserError(f"{robot.name}: every link is rigid and no joint is left: nothing to identify")
    engine = engine_of(robot, full, experiment)
    chain = engine.chain
    found = in_unit_axes(engine.partition(preference(chain, full, prefer, avoid)), axis_sizes(chain, full))
    return Reduction(robot, experiment, stages, found, inexact_aggregations(chain, stages, engine.experiment))


def engine_of(robot: Robot, parameters: tuple[Parameter, ...], experiment: Experiment) -> ExactEngine:
    """The structural engine for these columns; those of links in lengths of ``axis_sizes`` (``in_rationals``)."""
    chain, from_zero = in_rationals(ElasticChain(robot), experiment)
    names = tuple(p.name for p in parameters)
    program = observation_program(chain, terms_of(parameters), names, experiment.points)
    return ExactEngine(chain, program, names, from_zero)


def axis_sizes(chain: ElasticChain, parameters: Sequence[Parameter]) -> dict[str, sp.Expr]:
    """Lengths of the two elastic axes that belong to a link's parameter, multiplied: the size of its column."""
    sizes = {}
    for p in parameters:
        axes = chain.axis_lengths(p.body)
        sizes[p.name] = sp.S.One if p.is_joint else axes[(p.row - 1) % 3] * axes[(p.column - 1) % 3]
    return sizes


def standing_still(robot: Robot, fixed: Mapping[int, Any]) -> dict[int, sp.Expr]:
    """Exact values [rad, m] of joints that stand still. Raises UserError for what is no joint, or no value of one."""
    values = {}
    require(fixed, Mapping, "fixed joints with their values", "write {1: 0} for q1 = 0")
    for joint in fixed:
        require(joint, Integral, "the number of a fixed joint", "write {1: 0} for q1 = 0")
    for joint, given in sorted(fixed.items()):
        if not 1 <= joint <= robot.dof:
            raise UserError(f"cannot fix q{joint}: {robot.name} has joints 1 to {robot.dof}")
        value = parse_exact(given)
        prismatic = robot.joint[joint - 1].prismatic
        if abs(float(value)) > (LONGEST if prismatic else WIDEST):
            unit, right = ("millimetres", "metres") if prismatic else ("degrees", "radians")
            raise UserError(f"cannot fix q{joint} at {float(value):g}: looks like {unit}, give {right}")
        # tables have decimals: joints may stand square to each other by sums of tenths of a degree
        values[joint] = (value if prismatic else in_parts_of_pi(value, _TENTHS)).sympy()
    return values


def preference(
    chain: ElasticChain, full: Sequence[Parameter], prefer: Sequence[str] = (), avoid: Sequence[str] = ()
) -> list[str]:
    """Names in the order in which to keep them (M5b): a user's wishes, then physical sense.

    A joint's compliance, and the rotation of the link before it about its axis, come first; then other rotations,
    translations, couplings; from the base to the tip.
    """
    names = [p.name for p in full]
    for wish in (*prefer, *avoid):
        if wish not in names:
            raise UserError(
                f"no parameter {wish!r} after M3 of {chain.robot.name}: known are {', '.join(names)}"
            )
    if both := sorted(set(prefer) & set(avoid)):
        raise UserError(f"parameter {both[0]} is to be kept first and last: prefer it or avoid it")
    sense = {p.name: _sense(chain, p) for p in full}

    def key(name: str) -> tuple[int, int, int]:
        wished = prefer.index(name) - len(prefer) if name in prefer else 0
        return (wished, name in avoid, sense[name])

    return sorted(names, key=key)


def _sense(chain: ElasticChain, p: Parameter) -> int:
    if p.is_joint or (not p.is_coupling and p.row in chain.turns_with_joint(p.body)):
        return 0
    if p.is_coupling:
        return 3
    return 1 if p.row > 3 else 2
