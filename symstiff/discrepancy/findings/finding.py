"""What a diagnosis of a table is asked, and everything that it found, for reports and remarks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from symstiff.arrays import Array
from symstiff.calibration.kept import completed, of_table
from symstiff.calibration.tables.measurements import Measurements
from symstiff.discrepancy.bridge.assemble import Assembly
from symstiff.discrepancy.bridge.growth import JointFit, contribution
from symstiff.discrepancy.findings.result import CandidateResult, Diagnosis, Found, Rms
from symstiff.discrepancy.reasons import Reason, Why
from symstiff.discrepancy.search.verdict import EVEN, INSUFFICIENT
from symstiff.discrepancy.statistics.strata import Stratum
from symstiff.display import of_poses
from symstiff.effects.instance import EffectInstance
from symstiff.effects.places import named as named_at
from symstiff.model import StiffnessModel
from symstiff.robot.schema import Robot


@dataclass(frozen=True)
class Task:
    """What to diagnose; ``loads`` and ``measure`` are read from the data where None.

    ``start``: "complete" (joints and links, reduced for the data), "joints" (rigid links), the path of a model.toml, or
    a model. ``max_effects`` are looked for together at most, and with one no model of all links or of all frames is
    tried either; on ``max_poses`` of the poses where given.
    """

    robot: Robot
    table: Measurements
    start: str | StiffnessModel = "complete"
    loads: str | None = None
    measure: str | None = None
    max_effects: int = 3
    max_poses: int | None = None
    seed: int = 0

    @property
    def from_model(self) -> bool:
        """Whether it starts from a model that was made before."""
        return self.start not in ("complete", "joints")

    @property
    def origin(self) -> str:
        """What the diagnosis starts from, as text."""
        return self.start if isinstance(self.start, str) else "a model"


@dataclass(frozen=True, eq=False)
class Rung:
    """A step of the growth path: what was added, and the residual (M,) that it leaves, m and rad."""

    title: str
    parameters: int
    residual: Array
    strata: tuple[Stratum, ...]
    p_left: float


@dataclass(frozen=True, eq=False)
class Finding:
    """What a diagnosis found, and everything that its report needs.

    ``verdict`` and ``reason`` in words; ``effects`` with sizes (SI units) and confidence, ``named`` those of the
    leading set; ``model`` the grown StiffnessModel; ``rms`` what is left before and after, per coordinate
    [m; rad where only rotations were read]; ``candidates`` the catalogue with p-values; ``remarks`` sentences for a
    person.
    """

    task: Task
    table: Measurements
    start: JointFit
    grown: JointFit
    told: StiffnessModel
    """The start model as it was told, with what the data cannot show."""
    first: Diagnosis
    last: Diagnosis
    assembly: Assembly
    """Of the last diagnosis."""
    verdict: str
    testable: bool
    because: Reason
    effects: tuple[Found, ...]
    """The named set; all admissible sets, best first, where the verdict is ambiguous."""
    alternatives: tuple[Found, ...]
    """Admissible sets that trail so far that the verdict does not count them."""
    steps: tuple[Rung, ...]
    rms: Rms
    remarks: tuple[str, ...]
    as_told: float | None = None
    """What a start model's own values leave, rms per coordinate [m]; None where it was none with values."""

    @property
    def reason(self) -> str:
        """Why the verdict is what it is, as a sentence."""
        return str(self.because)

    @property
    def model(self) -> StiffnessModel:
        """The grown model, with what the data cannot show as it was told."""
        return of_table(completed(self.grown.model, self.told, self.task.table.kind), self.table)

    @property
    def accused(self) -> str:
        """Where what has no name comes from; empty where nothing tells."""
        if self.because.why is Why.POSES:
            return of_poses(self.because.told)
        return self.last.localisation.accused if self.last.localisation else ""

    @property
    def named(self) -> tuple[Found, ...]:
        """The leading set."""
        return tuple(e for e in self.effects if e.set_number == 0)

    @property
    def reshaped(self) -> tuple[EffectInstance, ...]:
        """Effects of the start model, as it has them, that the leading set holds in another shape."""
        named = [named_at(e.effect, e.where) for e in self.named]
        return tuple(e for e in self.told.effects if named_at(e.effect, e.where) in named)

    def confidence(self, group: Sequence[Found]) -> tuple[float, bool]:
        """The least confidence of a group of effects, and whether it is an even bet at most.

        What is in doubt of a set that does not suffice is.
        """
        least = min(e.confidence for e in group)
        return least, self.verdict == INSUFFICIENT and least <= EVEN

    @property
    def candidates(self) -> tuple[CandidateResult, ...]:
        """The catalogue on the first model."""
        return self.first.candidates

    def added(self, effect: Found) -> Array:
        """(M,) what an effect adds to the rows of the problem, with its sizes [m, rad]."""
        values = {name: size.value for name, size in effect.parameters.items()}
        return contribution(self.assembly, effect.instance, values)

    def __repr__(self) -> str:
        from symstiff.discrepancy.findings.reading import finding_line

        return f"Finding({finding_line(self)})"

    def _repr_html_(self) -> str:
        from symstiff.discrepancy.findings.reading import finding_html

        return finding_html(self)
