"""The ladder: where no few effects account for what a model leaves, all of their kind join it at once.

Rigid links give way to the complete model, the arm as it is drawn to one whose frames are all off. What is missing
besides comes out of the data only then.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import fdtrc

from symstiff.arrays import Index
from symstiff.calibration.experiment.readings import ExperimentClass
from symstiff.calibration.identify import start_model
from symstiff.discrepancy.bridge.growth import JointFit
from symstiff.discrepancy.findings.finding import Rung, Task
from symstiff.discrepancy.findings.result import Diagnosis, Found, Quantity, Step
from symstiff.discrepancy.problem import key_of
from symstiff.discrepancy.reasons import Reason, Why
from symstiff.discrepancy.search.verdict import AMBIGUOUS, INSUFFICIENT, NAMED, NOTHING, UNEXPLAINED
from symstiff.effects.base import Realisation
from symstiff.effects.common import link_axes
from symstiff.effects.instance import EffectInstance
from symstiff.effects.places import named as named_at
from symstiff.effects.registry import catalogue
from symstiff.model import StiffnessModel
from symstiff.reduction.physical import physical_stages
from symstiff.robot.schema import Robot

_SIGNIFICANT = 1e-4
"""Chance below which the complete model takes the place of few links that were named."""
_SUREST = 0.99
"""Confidence, at most, in a test of nested models: what neither holds is not asked."""
_DEAR, _LINKS = 2.0, 1.0
"""What all frames have to be worth, and all links in absolute positions or where something else leads, in Schwarz'
prices of their parameters."""


@dataclass(frozen=True, eq=False)
class Wider:
    """A model that may take the place of a narrower one."""

    model: StiffnessModel
    title: str
    """Of the step of growth."""
    why: Why
    """The reason for the verdict, where nothing else is missing."""
    remark: str
    parts: tuple[EffectInstance, ...] = ()
    """The effects that joined it; none where elastic links did."""
    prices: float = 0.0
    """What it has to be worth where the narrower one does not account for the data, in Schwarz' prices; or it does
    itself, with what is missing besides."""

    def of_verdict(self, found: Diagnosis, fitted: StiffnessModel) -> tuple[Found, ...]:
        """What the narrower model lacked, as effects of the verdict."""
        if not self.parts:
            return tuple(_of_links(found, fitted))
        known = _estimates(fitted)
        held = [(e, [p.name for p in e.realise(fitted.robot).parameters]) for e in self.parts]
        return tuple(_joined(found, e, {n: known[n] for n in names}) for e, names in held)

    def leaves_less(self, wide: Diagnosis, narrow: Diagnosis, component: Index, pose: Index) -> bool:
        """Whether it takes the narrower one's place, by the diagnoses of both.

        component: (M,) 0 … 5 of each row; pose: (M,) of each row.
        """
        # rows of a pose may share their errors
        readings = len(np.unique(6 * pose + component))
        open_end = narrow.verdict in (INSUFFICIENT, UNEXPLAINED)
        if not self.parts:
            dear = (
                not (open_end and self.prices)
                or _worth(wide, narrow, component, readings) > self.prices
                or _ends_well(wide, narrow, component, readings)
            )
            return dear and links_leave_less(wide, narrow, component, readings)
        if open_end and _dearly(wide, narrow, component, readings, self.prices):
            return True
        own = {key_of(e.effect, e.where) for e in self.parts}
        few = sum(key_of(name.effect, name.where) in own for name, *_ in narrow.leading)
        # a law without a name that stands against few frames is absorbed by all of them
        named = narrow.verdict != UNEXPLAINED and few > 1
        return named and _ends_well(wide, narrow, component, readings)


@dataclass(frozen=True, eq=False)
class Ladder:
    """From the start model to the one that the diagnosis ended with, and what joined on the way."""

    start: StiffnessModel
    models: tuple[Wider, ...] = ()
    rungs: tuple[Rung, ...] = ()
    """The models that were left, narrowest first."""
    effects: tuple[Found, ...] = ()
    idle: frozenset[str] = frozenset()
    """Parameters of what joined whose part others bear."""

    @property
    def base(self) -> StiffnessModel:
        """The widest model, to which effects are added one by one."""
        return self.models[-1].model if self.models else self.start

    @property
    def path(self) -> tuple[StiffnessModel, ...]:
        """The start model and those that took its place, to the widest."""
        return (self.start, *(wider.model for wider in self.models))

    @property
    def title(self) -> str:
        """Of the widest model, in the growth path."""
        return self.models[-1].title if self.models else "start model"

    @property
    def because(self) -> Reason:
        """The reason for the verdict, where nothing is missing beside what joined."""
        return Reason(self.models[-1].why if self.models else Why.NOTHING)

    @property
    def remarks(self) -> list[str]:
        """Why models took the place of narrower ones."""
        return [wider.remark for wider in self.models]

    @property
    def count(self) -> int:
        """Parameters of the base but those that others stand for."""
        return len(self.base.parameters) - len(self.idle)

    @property
    def joined(self) -> frozenset[str]:
        """Parameters of the effects that joined."""
        parts = [e.realise(self.start.robot) for wider in self.models for e in wider.parts]
        return frozenset(p.name for part in parts for p in part.parameters)

    def climbed(self, wider: Wider, left: Diagnosis, fitted: JointFit) -> Ladder:
        """With one model more, as fitted; ``left`` is the diagnosis of the base."""
        found = wider.of_verdict(left, fitted.model)
        more = replace(self._beside(wider, left), effects=(*self.effects, *found))
        return replace(more, idle=more.joined & set(fitted.absorbed))

    def without(self, effects: Sequence[EffectInstance], bare: StiffnessModel, left: Diagnosis) -> Ladder:
        """With the ``bare`` model that has some effects no more, which are looked for anew."""
        names = ", ".join(named_at(e.effect, e.where) for e in effects)
        told = "; ".join(
            f"{named_at(e.effect, e.where)} ({', '.join(e.shape_phrases(bare.robot)) or 'the first shape'})"
            for e in effects
        )
        shape, them = ("another shape", "it") if len(effects) == 1 else ("other shapes", "them")
        remark = (
            f"the start model has {told}: these data ask for {shape}, with which the model goes on; the growth path "
            f"takes {them} out and adds {them} anew"
        )
        return self._beside(Wider(bare, f"{self.title} without {names}", Why.NOTHING, remark), left)

    def _beside(self, model: Wider, left: Diagnosis) -> Ladder:
        first = left.growth[0]
        rung = Rung(self.title, self.count, first.residual, first.strata, left.p_missing)
        return replace(self, models=(*self.models, model), rungs=(*self.rungs, rung))


def wider_models(
    model: StiffnessModel, found: Diagnosis, task: Task, experiment: ExperimentClass
) -> Iterator[Wider]:
    """The models that may take a model's place by what its diagnosis found missing."""
    if task.max_effects < 2:
        return
    frames = frames_of(task.robot) if task.table.kind == "absolute" else ()
    ways = _of_all_frames(model, found, frames), _of_all_links(model, found, task, experiment)
    yield from (wider for wider in ways if wider is not None)


def _of_all_frames(
    model: StiffnessModel, found: Diagnosis, frames: tuple[EffectInstance, ...]
) -> Wider | None:
    """The model of an arm whose frames are all off, where some are missing and few do not do."""
    there = [key_of(e.effect, e.where) for e in model.effects]
    more = tuple(e for e in frames if key_of(e.effect, e.where) not in there)
    off = {key_of(e.effect, e.where) for e in more}
    keys = [key_of(name.effect, name.where) for name, *_ in found.leading]
    keys = keys or [key_of(c.effect, c.where) for c in found.candidates if c.testable][:1]
    # what further frames make may pass for how the robot misses its poses, and those that were named for enough
    least = {INSUFFICIENT: 1, UNEXPLAINED: 1, NAMED: 2, AMBIGUOUS: 2}.get(found.verdict, np.inf)
    if found.doubtful or not more or len(off & set(keys)) < least:
        return None
    return Wider(
        model.with_effects((*model.effects, *more)),
        "frames of all links",
        Why.FRAMES,
        "errors of a few links' frames do not account for the data as well as those of all links do: all of them join "
        "the model, and the diagnosis goes on from there; those that nothing tells from the others are zero",
        more,
        _DEAR,
    )


def _of_all_links(
    model: StiffnessModel, found: Diagnosis, task: Task, experiment: ExperimentClass
) -> Wider | None:
    """The complete model, where links are rigid in this one and elastic links are what is missing, few or not."""
    leading = [sizes for *_, sizes in found.leading]
    first = [c.parameters for c in found.candidates if c.testable][:1]
    open_end = found.verdict in (UNEXPLAINED, INSUFFICIENT)
    missing = first if open_end else leading if found.verdict in (NAMED, AMBIGUOUS) else []
    elastic = bool(missing) and all(_is_compliance(task.robot, sizes) for sizes in missing)
    # beside something else that is missing elastic links may not lead
    beside = open_end and any(_is_compliance(task.robot, sizes) for sizes in leading)
    if any(not p.is_joint for p in model.compliances) or not (elastic or beside):
        return None
    complete = start_model(model.robot, "complete", experiment)[0]  # the tool is where the point was found
    return Wider(
        replace(complete, file_tool=model.file_tool).with_effects(model.effects),
        "complete model (all links elastic)",
        Why.LINKS,
        "a few elastic links do not account for what the joints leave as well as all of them do: the complete model "
        "takes the place of the one with rigid links, and the diagnosis goes on from there",
        prices=_LINKS if task.table.kind == "absolute" or not elastic else 0.0,
    )


def frames_of(robot: Robot) -> tuple[EffectInstance, ...]:
    """The effects of the catalogue that set a link's six virtual joints off by constants, of all links."""
    return tuple(
        EffectInstance(name, {"link": i})
        for name, effect in catalogue().items()
        for i in range(1, robot.dof + 1)
        if effect.columns is None and {"link": i} in [dict(place) for place in effect.places(robot)]
        and _is_frame(EffectInstance(name, {"link": i}).realise(robot), i)
    )  # fmt: skip


def _is_frame(realised: Realisation, link: int) -> bool:
    """Whether an effect is one constant for each virtual joint of a link."""
    return realised.is_constant and [t.at for t in realised.terms] == list(link_axes(link))


def links_leave_less(wide: Diagnosis, narrow: Diagnosis, component: Index, readings: int) -> bool:
    """Whether the complete model leaves less than the narrow one, also on poses left out where there are any.

    Of a narrow one with links that were named it has to leave significantly less: few links are the simpler account.
    """
    others = narrow.rms.held_out_before
    if narrow.verdict in (NAMED, AMBIGUOUS):
        others = narrow.rms.held_out_after
        if not _chance(wide, narrow, component, readings) < _SIGNIFICANT:
            return False
    elif not wide.rms.before < narrow.rms.before or _told_by_a_law(wide, narrow, component):
        return False
    return _predicts(wide.rms.held_out_before, others)


def _dearly(wide: Diagnosis, narrow: Diagnosis, component: Index, readings: int, prices: float) -> bool:
    """Whether all frames are worth several times their price beside few as well, also on poses left out.

    They bend to almost anything: an error that nobody drew is told from them by what an arm's own frames explain.
    """
    worth = min(_worth(wide, narrow, component, readings, step) for step in {0, len(narrow.growth) - 1})
    return worth > prices and _predicts(wide.rms.held_out_before, narrow.rms.held_out_after)


def _worth(wide: Diagnosis, narrow: Diagnosis, component: Index, readings: int, step: int = 0) -> float:
    """What all parts explain of what a step of the narrow model leaves, in Schwarz' prices of all their parameters.

    A law without a name that was found there takes its share of what the narrow model itself leaves.
    """
    less, left = squares_left(wide, component, wide.growth[0], narrow.growth[step])
    gain = readings * np.log((left if step else _beside_a_law(narrow) * left) / less)
    price = (wide.growth[0].known - narrow.growth[step].known) * np.log(readings)
    return float(gain / price) if price > 0 else -np.inf


def _beside_a_law(narrow: Diagnosis) -> float:
    """Share of what a model leaves that a law without a name, where one was found there, does not explain."""
    return 1.0 - max((f.explained for f in (narrow.device_law, narrow.law) if f is not None), default=0.0)


def _ends_well(wide: Diagnosis, narrow: Diagnosis, component: Index, readings: int) -> bool:
    """Whether the data are accounted for with all parts, where few left no room for what is missing besides.

    Or where what they left passed for how the robot misses its poses. Schwarz' criterion of where both diagnoses end,
    and poses left out.
    """
    if wide.verdict not in (NAMED, AMBIGUOUS, NOTHING):
        return False
    last, end = narrow.growth[-1], wide.growth[-1]
    left, less = squares_left(wide, component, last, end)
    left *= _beside_a_law(narrow) if len(narrow.growth) == 1 else 1.0
    gains = readings * np.log(left / less) > (end.known - last.known) * np.log(readings)
    return bool(gains) and _predicts(wide.rms.held_out_after, narrow.rms.held_out_after)


def _predicts(own: float | None, other: float | None) -> bool:
    """Whether a model leaves less on poses left out than another does, where there are any."""
    return own is None or other is None or own < other


def squares_left(wide: Diagnosis, component: Index, *steps: Step) -> list[float]:
    """Squares that steps of growth leave, in units of the noise that the wider model leaves."""
    spread = wide.noise.by_component()[component]
    return [float(np.sum((step.residual / spread) ** 2)) for step in steps]


def _told_by_a_law(wide: Diagnosis, narrow: Diagnosis, component: Index) -> bool:
    """Whether a law at no virtual joint, such as a device's, is the simpler account by Schwarz' criterion."""
    law = narrow.device_law
    if law is None:
        return False
    left, less = squares_left(wide, component, narrow.growth[0], wide.growth[0])
    more = wide.growth[0].known - narrow.growth[0].known - len(law.terms)
    rows = len(component)
    return bool(rows * np.log(less / (left * (1.0 - law.explained))) + more * np.log(rows) > 0)


def _chance(wide: Diagnosis, narrow: Diagnosis, component: Index, readings: int) -> float:
    """p-value of what the complete model explains beyond links that were named, an F test of nested models.

    What the rows of a pose share is taken to lie in what it explains, which is the worst that it may do.
    """
    last = narrow.growth[-1]
    shared = (wide.noise.approach / wide.noise.sigma) ** 2
    worst = (1.0 + shared * len(component) / readings) / (1.0 + shared)
    left, less = squares_left(wide, component, last, wide.growth[0])
    known, fewer = wide.growth[0].known, last.known
    freedom = len(component) - known
    if known <= fewer or freedom <= 0:
        return 1.0
    ratio = (left - less) / (known - fewer) / (less / freedom)
    return float(fdtrc(known - fewer, freedom, max(ratio / worst, 0.0)))


def _of_links(found: Diagnosis, fitted: StiffnessModel) -> Iterator[Found]:
    """The links of the complete model as effects of the verdict."""
    for link in sorted({p.body for p in fitted.compliances if not p.is_joint}):
        own = {n: e for n, e in _estimates(fitted).items() if n.startswith(f"k{link}_")}
        effect = that_has(fitted.robot, {"link": link}, own)
        if own and effect:
            yield _joined(found, EffectInstance(effect, {"link": link}), own)


def _joined(found: Diagnosis, effect: EffectInstance, parameters: Mapping[str, Quantity]) -> Found:
    """An effect of the verdict that joined the model with others of its kind."""
    p = found.p_missing
    return Found(effect.effect, dict(effect.where), {}, parameters, p, _certain(p), ())


def _estimates(fitted: StiffnessModel) -> dict[str, Quantity]:
    return {
        n: Quantity(value, fitted.deviations.get(n, np.inf), fitted.units[n])
        for n, value in fitted.values.items()
    }


def that_has(robot: Robot, where: Mapping[str, Any], parameters: Iterable[str]) -> str:
    """The effect of the catalogue that has these parameters at a place, and the fewest beside them."""
    wanted, sizes = set(parameters), dict[str, int]()
    for identifier, effect in catalogue().items():
        if effect.columns is None and any(dict(place) == where for place in effect.places(robot)):
            held = {p.name for p in EffectInstance(identifier, where).realise(robot).parameters}
            if wanted <= held:
                sizes[identifier] = len(held)
    return min(sizes, key=lambda e: sizes[e], default="")


def _certain(p: float) -> float:
    """Confidence in a step that is a test of nested models: no rival competes for its name."""
    return float(min(max(1.0 - p, 0.0), _SUREST))


def _is_compliance(robot: Robot, parameters: Mapping[str, Any]) -> bool:
    """Whether an effect's parameters are all compliances of the robot's complete model."""
    known = {p.name for stage in physical_stages(robot) for p in stage.parameters}
    return bool(parameters) and set(parameters) <= known
