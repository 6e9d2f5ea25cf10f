"""What a diagnosis hands back; everything that verdict.json and the report need."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from symstiff.arrays import Array
from symstiff.discrepancy.noise.scales import Noise, NoiseReport
from symstiff.discrepancy.reasons import Reason, Why
from symstiff.discrepancy.search.localise import FittedDevice, FittedLaw, Localisation
from symstiff.discrepancy.search.proof import HeldOut, closed
from symstiff.discrepancy.statistics.strata import Stratum
from symstiff.effects.base import Shape
from symstiff.effects.instance import EffectInstance


@dataclass(frozen=True)
class Quantity:
    """A coefficient with its standard deviation and unit."""

    value: float
    std: float
    unit: str
    across: tuple[float, float] | None = None
    """Least and largest value in all shapes that account for the data as well, where these are far apart: ``std`` is
    that in one shape."""
    by_shape: float = 0.0
    """What the shape has in ``std``."""


@dataclass(frozen=True)
class Name:
    """An effect at a place."""

    effect: str
    where: Mapping[str, object]


@dataclass(frozen=True)
class Instead:
    """Another effect in the place of a named one, beside the others of its set."""

    name: Name
    behind: float
    """Log evidence by which it trails."""
    worse: float
    """Log likelihood by which it fits worse."""
    own: int
    """Directions that the named one adds to the model's."""
    directions: int
    """Those that it adds."""


@dataclass(frozen=True)
class Found:
    """An effect of the verdict, with everything that is said about it."""

    effect: str
    where: Mapping[str, Any]
    shape: Shape
    parameters: Mapping[str, Quantity]
    p_value: float
    """Family-wise, given the other effects of its set."""
    confidence: float
    confounded_with: tuple[Name, ...]
    set_number: int = 0
    """Effects of one set stand together; an ambiguous verdict has several sets, best first."""
    twins: tuple[Name, ...] = ()
    """Other names for the same columns: nothing that can be measured tells them from this one."""
    instead: tuple[Instead, ...] = ()
    """Those of ``confounded_with`` in its place."""
    carried: tuple[int, float] | None = None
    """The pose that shows nearly all of it, where one does though others could, with its share of the signal."""

    @property
    def instance(self) -> EffectInstance:
        """The effect as a model holds it."""
        return EffectInstance(self.effect, dict(self.where), dict(self.shape))


@dataclass(frozen=True)
class CandidateResult:
    """A candidate of the catalogue, as tested alone on the starting model."""

    effect: str
    where: Mapping[str, object]
    score: float
    """Log evidence with the catalogue-size penalty; -inf where not tested."""
    p_value: float
    testable: bool
    reason: str
    """Why not testable, or not in its plainest form; empty if it is."""
    sufficient: bool | None
    """None where the question did not arise."""
    plausible: bool | None
    shape: Shape
    parameters: Mapping[str, Quantity]
    share_left: float
    """Share of its signal that the model does not absorb."""
    smallest_detectable: Mapping[str, Quantity]
    """Size of each parameter alone seen in 80 % of cases (std is 0)."""
    confused_with: tuple[Name, ...]
    needed: float = float("inf")
    """Noncentrality from which it is seen in 80 % of cases."""
    seen_as: Shape = field(default_factory=dict)
    """The shape that the smallest sizes are of."""


@dataclass(frozen=True)
class RivalLaw:
    """A law without a name that competes with a named effect."""

    place: str
    law: str
    lead: float
    """Log evidence by which it leads."""


@dataclass(frozen=True)
class Inconstancy:
    """A named effect whose size follows something that its law does not depend on."""

    name: Name
    by: str
    """``file``, ``time``, ``order`` of the rows, ``temperature``, ``load``, ``branch`` or ``q<joint>``."""
    p_value: float
    share: float
    """Share of the effect's signal that follows it."""
    low: float
    high: float
    """Least and largest size in the table, by the size in its middle."""
    each: tuple[tuple[str, float], ...] = ()
    """Files with the size in each, by the size in the middle; none where it follows something else."""


@dataclass(frozen=True)
class Step:
    """A step of the growth path: the starting model, then one more effect each."""

    added: Name | None
    model: Array
    """(P,) joint estimates of the model's parameters, least norm where the data do not determine them."""
    model_std: Array
    """(P,) inf where the data do not determine the parameter."""
    effects: tuple[tuple[Name, Mapping[str, Quantity]], ...]
    rms: float
    """Residual root mean square of the translations, data's unit."""
    strata: tuple[Stratum, ...]
    p_left: float
    """Family-wise p-value of the best further candidate."""
    residual: Array
    """(M,) data's unit."""
    further: Name | None = None
    """The best further candidate."""
    gained: int = 0
    """Directions that the effects add to the model's: parameters that the data tell apart."""
    known: int = 0
    """All directions of model and effects that the data hold, the device's placement included."""


@dataclass(frozen=True)
class Rms:
    """Root mean squares in the data's unit; held-out ones are None where there are fewer than four poses."""

    before: float
    after: float
    held_out_before: float | None
    held_out_after: float | None
    noise: float

    @property
    def confirmed(self) -> bool | None:
        """Whether poses that were not used are predicted better with what was found; None where nothing was, or none
        tells.
        """
        if self.held_out_before is None or self.held_out_after is None or self.after == self.before:
            return None
        return self.held_out_after < self.held_out_before

    @property
    def unconfirmed(self) -> bool:
        """Whether something was found and poses that were not used are predicted no better with it."""
        return self.confirmed is False

    @property
    def closure(self) -> float | None:
        """Share of the gap on held-out poses that was closed; nan where there is none, None without such poses."""
        if self.held_out_before is None or self.held_out_after is None:
            return None
        return closed(self.held_out_before, self.held_out_after, self.noise)


@dataclass(frozen=True)
class Diagnosis:
    """The result of `examine`."""

    verdict: str
    because: Reason
    effects: tuple[Found, ...]
    candidates: tuple[CandidateResult, ...]
    """Best first, untestable ones last."""
    p_missing: float
    """Family-wise p-value that anything of the catalogue is missing; nan where nothing can be tested."""
    p_unnamed: float
    """The same for laws that have no name."""
    noise: NoiseReport
    strata: tuple[Stratum, ...]
    localisation: Localisation | None
    law: FittedLaw | None
    """For `unexplained`: the best smooth law at the accused virtual joint."""
    device_law: FittedDevice | None
    """The same where a sensor, the device or a marker is accused."""
    growth: tuple[Step, ...]
    rms: Rms
    held_out: HeldOut | None
    confusability: Array
    """(n, n) D_ij of the leading candidates, in the order of ``confusability_names``."""
    confusability_names: tuple[Name, ...]
    leading: tuple[tuple[Name, Shape, Mapping[str, Quantity]], ...] = ()
    """The effects of the set that explains most, whether the verdict names it or not."""
    alike: RivalLaw | None = None
    """What does as well as the leading set of those that are named, or nearly."""
    inconstant: tuple[Inconstancy, ...] = ()
    """What the sizes of the leading set's effects follow, surest first."""
    rival: RivalLaw | None = None
    """What does most in the place of a member of the leading set, named or not."""
    weights: Noise | None = None
    """The noise of data that are accounted for, the sharing first that is likeliest then; None where what is missing
    may be in it.
    """

    @property
    def reason(self) -> str:
        """Why the verdict is what it is, as a sentence."""
        return str(self.because)

    @property
    def doubtful(self) -> bool:
        """Whether the table is to be corrected before anything can be said."""
        return self.because.why is Why.DOUBTED

    @property
    def stratum_alone(self) -> Stratum | None:
        """The stratum that rejects where no test of laws does: then no place is accused."""
        if self.because.why is not Why.ONE_STRATUM:
            return None
        return min((s for s in self.strata if s.p_value is not None), key=lambda s: s.p_value or 0.0)

    @property
    def against_sigma(self) -> bool:
        """Whether nothing but the stated sigma speaks against the model."""
        return self.because.why is Why.SIGMA
