"""M1 symmetrisation, M2 sparsing, M3 aggregation: physical reduction, each with its binary map π = M·π′ (seed eq. 10).

A step says for every parameter which parameter of the reduced set stands for it, or none, and why.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from symstiff.reduction.template import pattern
from symstiff.robot.frozen import FrozenDict
from symstiff.robot.schema import Robot
from symstiff.symbolic.terms import AXES, Term, joint_terms, link_terms

UNITS = {(False, False): "m/N", (False, True): "rad/N", (True, True): "rad/(N*m)"}


@dataclass(frozen=True)
class Parameter:
    """A compliance: of a joint (row = column = 0), or the term k_{row,column} of a link."""

    name: str
    body: int
    row: int = 0
    column: int = 0
    prismatic: bool = False

    @property
    def is_joint(self) -> bool:
        """Whether this is an actuated joint's compliance c."""
        return self.row == 0

    @property
    def is_coupling(self) -> bool:
        """Whether this is an off-diagonal term."""
        return self.row != self.column

    @property
    def unit(self) -> str:
        """SI unit."""
        if self.is_joint:
            return "m/N" if self.prismatic else "rad/(N*m)"
        return UNITS[min(self.row, self.column) > 3, max(self.row, self.column) > 3]

    @property
    def meaning(self) -> str:
        """What the compliance is, in the axes of its link's elastic frame (1 along the beam)."""
        if self.is_joint:
            return f"compliance of joint {self.body}"
        body = "link 0 (pedestal)" if self.body == 0 else f"link {self.body}"
        both = " (and its mirror)" if self.is_coupling else ""
        motion = f"{'rotation about' if self.row > 3 else 'translation along'} {(self.row - 1) % 3 + 1}"
        cause = f"{'moment about' if self.column > 3 else 'force along'} {(self.column - 1) % 3 + 1}"
        return f"{body}: {motion} by {cause}{both}"

    @property
    def length_degree(self) -> int:
        """Power of length in the unit beyond 1/(N·m): 2 for m/N, 1 for rad/N, 0 for rad/(N·m)."""
        return {"m/N": 2, "rad/N": 1, "rad/(N*m)": 0}[self.unit]


@dataclass(frozen=True)
class Stage:
    """A parameter set π′, and how the set before it maps: ``stands_for[old]`` is new, or None where there is none.

    There is none where a parameter is fixed to zero (M2), or is part of several, as a joint of a link before it is
    (M3: ``symstiff.reduction.complete.complete_map`` tells which); ``reasons`` say why.
    """

    step: str
    parameters: tuple[Parameter, ...]
    stands_for: dict[str, str | None]
    reasons: dict[str, str]

    def __post_init__(self) -> None:
        for name in ("stands_for", "reasons"):
            object.__setattr__(self, name, FrozenDict(getattr(self, name)))

    @property
    def names(self) -> tuple[str, ...]:
        """Parameter names, in order."""
        return tuple(p.name for p in self.parameters)

    @property
    def matrix(self) -> np.ndarray:
        """The binary mapping M of π = M·π′, rows before the step, columns after it."""
        index = {name: k for k, name in enumerate(self.names)}
        m = np.zeros((len(self.stands_for), len(index)), dtype=np.int8)
        for row, new in enumerate(self.stands_for.values()):
            if new is not None:
                m[row, index[new]] = 1
        return m

    @property
    def terms(self) -> tuple[Term, ...]:
        """The terms of the stage's parameters: from M1 on, k_ij stands for k_ji as well."""
        return terms_of(self.parameters, symmetric=self.step != "original")

    def __repr__(self) -> str:
        return f"Stage({self.step}: {len(self.parameters)} parameters)"

    def _repr_html_(self) -> str:
        from symstiff.reduction.reading import stage_html

        return stage_html(self)


def original(robot: Robot) -> Stage:
    """n joint compliances and a full 6 × 6 matrix for each of the n + 1 links."""
    parameters: list[Parameter] = []
    for i in range(robot.dof + 1):
        if i:
            parameters.append(Parameter(f"c{i}", i, prismatic=robot.joint[i - 1].prismatic))
        parameters += [Parameter(f"k{i}_{r}{c}", i, r, c) for r in AXES for c in AXES]
    return Stage("original", tuple(parameters), {p.name: p.name for p in parameters}, {})


def symmetrised(before: Stage) -> Stage:
    """M1: one parameter for every pair k_ij = k_ji (Maxwell's reciprocity)."""
    names = {
        p.name: f"k{p.body}_{p.column}{p.row}" if p.row > p.column else p.name for p in before.parameters
    }
    reasons = {
        old: f"equals {new}: compliance matrices are symmetric" for old, new in names.items() if old != new
    }
    return _stage("M1", before, dict(names), reasons)


def sparsed(before: Stage, robot: Robot) -> Stage:
    """M2: terms that vanish in the link's template k⁰ are eliminated."""
    stands: dict[str, str | None] = {}
    reasons: dict[str, str] = {}
    patterns = [pattern(robot, link.template) for link in robot.links]
    for p in before.parameters:
        kept = p.is_joint or patterns[p.body][p.row - 1][p.column - 1]
        stands[p.name] = p.name if kept else None
        if not kept:
            reasons[p.name] = f"zero in the {robot.links[p.body].template} template of link {p.body}"
    return _stage("M2", before, stands, reasons)


def aggregated(before: Stage) -> Stage:
    """M3: a joint's compliance is part of the elastic link before it."""
    elastic = {p.body for p in before.parameters if not p.is_joint}
    stands: dict[str, str | None] = {}
    reasons: dict[str, str] = {}
    for p in before.parameters:
        absorbed = p.is_joint and p.body - 1 in elastic
        stands[p.name] = None if absorbed else p.name
        if absorbed:
            reasons[p.name] = f"acts together with link {p.body - 1} before it"
    return _stage("M3", before, stands, reasons)


def _stage(step: str, before: Stage, stands: dict[str, str | None], reasons: dict[str, str]) -> Stage:
    kept = tuple(p for p in before.parameters if stands[p.name] == p.name)
    return Stage(step, kept, stands, reasons)


def terms_of(parameters: tuple[Parameter, ...], *, symmetric: bool = True) -> tuple[Term, ...]:
    """The terms of compliances; ``symmetric`` where k_ij stands for k_ji as well (after M1)."""
    terms: list[Term] = []
    for p in parameters:
        if p.is_joint:
            terms += joint_terms(p.body, p.name)
        else:
            terms += link_terms(p.body, p.row, p.column, p.name, symmetric=symmetric)
    return tuple(terms)


def physical_stages(robot: Robot) -> tuple[Stage, Stage, Stage, Stage]:
    """Original, M1, M2, M3."""
    first = original(robot)
    m1 = symmetrised(first)
    m2 = sparsed(m1, robot)
    return first, m1, m2, aggregated(m2)
