"""From the last diagnosis to the finding: joint identification, what is named and how surely, what is remarked."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from symstiff.calibration.redundant import redundant
from symstiff.calibration.rows import predict
from symstiff.calibration.tables.measurements import Measurements
from symstiff.discrepancy.bridge.assemble import Assembly
from symstiff.discrepancy.bridge.growth import JointFit, fit_told, grow
from symstiff.discrepancy.bridge.ranges import extent_of
from symstiff.discrepancy.climb import Ladder
from symstiff.discrepancy.findings.finding import Finding, Rung, Task
from symstiff.discrepancy.findings.numbers import milli
from symstiff.discrepancy.findings.out_of_range import astray, out_of_range
from symstiff.discrepancy.findings.remarks import inconstant, remarked
from symstiff.discrepancy.findings.result import Diagnosis, Found, Name, Quantity
from symstiff.discrepancy.findings.since import as_told, of_values, since
from symstiff.discrepancy.reasons import Reason, Why
from symstiff.discrepancy.search.proof import FEWEST
from symstiff.discrepancy.search.verdict import AMBIGUOUS, NAMED, NOTHING, UNEXPLAINED, UNTESTABLE
from symstiff.display import few
from symstiff.effects.places import named as named_at
from symstiff.model import StiffnessModel
from symstiff.reduction.structural import Couplings

_MORE = 1.05
"""What a model without some effects leaves, over what it leaves with them, from which that is spoken of."""
_REFUTED, _UNSURE = 0.5, 0.75
"""Most confidence in what poses that were not used speak against, and in what none can confirm or what has no one size.
Of fourteen names of the first kind, of the blind benchmark and of another generator, seven are right."""


@dataclass(frozen=True, eq=False)
class Course:
    """How a diagnosis went: the start model as ``told``, and the ladder from it, as the table shows it, on."""

    task: Task
    table: Measurements
    told: StiffnessModel
    ladder: Ladder
    assembly: Assembly
    first: Diagnosis
    last: Diagnosis
    given: tuple[Name, ...] = ()
    """Effects of the start model that belong to every explanation, in whatever shape."""
    plain: Course | None = None
    """How it went with the start model's effects in the shapes that it gives them, where they got others."""

    @property
    def trusted(self) -> bool:
        """Whether the data are accounted for without errors of all frames, which would hide compliances."""
        return self.last.verdict in (NOTHING, NAMED, AMBIGUOUS) and not self.ladder.effects


Without = Callable[[Course, Sequence[Found]], Course | None]
"""The course without some effects; None where nothing else accounts for the data."""


def _nothing(course: Course, found: Sequence[Found]) -> None:
    """Nothing else accounts for the data."""


def finding_of(
    course: Course,
    remarks: list[str],
    tell: Callable[[str], None],
    without: Without = _nothing,
) -> Finding:
    """Identify all parameters jointly with the leading effects, and say what was found.

    Effects whose sizes go astray there are taken back, and what else there is takes their place.
    """
    task, table, ladder, last = course.task, course.table, course.ladder, course.last
    tell("identification")
    leading = [e for e in last.effects if e.set_number == 0]
    grown = grow(ladder.base, [e.instance for e in leading])
    known = None if last.weights is None else last.weights.alone
    after = _with_shapes(fit_told(grown, table, known, trusted=course.trusted), leading)
    extent = extent_of(course.assembly.situation.view)
    if strays := [e for e in leading if astray([_as_identified(e, after)], task.robot, extent)]:
        other = without(course, strays) or replace(course, last=_taken_back(last))
        return finding_of(other, remarks, tell, _nothing if course.plain is None else without)
    before = after if grown is ladder.start else fit_told(ladder.start, table, after.noise, after)
    verdict, because = last.verdict, last.because
    if ladder.effects and verdict == NOTHING:
        verdict, because = NAMED, ladder.because
    held = [_redundant(task, model, table) for model in ladder.path]
    doubts, changing = _unconfirmed(course), inconstant(last)
    named = _effects(course, after, bool(doubts))
    counted = named if verdict == AMBIGUOUS else tuple(e for e in named if e.set_number == 0)
    left = as_told(ladder.start, before) if task.from_model and any(ladder.start.values.values()) else None
    remarks = [*remarks, *([] if left is None else of_values(left, before))]
    remarks += [*ladder.remarks, *since(ladder.start, after.model)]
    remarks += remarked(course.assembly.situation.view, last)
    remarks += _beyond_code(after.model, table, last.rms.after)
    remarks += _without_value(course, after, held[-1])
    remarks += [*doubts, *changing, *_of_effects(course, counted)]
    testable = verdict != UNTESTABLE
    rms = replace(last.rms, before=course.first.rms.before, held_out_before=course.first.rms.held_out_before)
    return Finding(
        task, table, before, after, course.told, course.first, last, course.assembly,
        verdict if testable else UNEXPLAINED, testable, because,
        counted, tuple(e for e in named if e not in counted),
        _steps(ladder, last, before, [len(h) for h in held]), rms, tuple(remarks), left,
    )  # fmt: skip


def _with_shapes(fitted: JointFit, effects: Sequence[Found]) -> JointFit:
    """The fit whose deviations count what the data leave open of the effects' shapes."""
    model, sizes = fitted.model, {name: size for e in effects for name, size in e.parameters.items()}
    wider = {
        name: float(np.hypot(std, sizes[name].by_shape)) if name in sizes else std
        for name, std in model.deviations.items()
    }
    return replace(fitted, model=model.with_values(model.values, wider))


def _effects(course: Course, after: JointFit, unconfirmed: bool) -> tuple[Found, ...]:
    """The effects of all admissible sets; those of the first as they were identified."""
    changing = {named_at(one.name.effect, one.name.where) for one in course.last.inconstant}
    most = _REFUTED if course.last.rms.unconfirmed else _UNSURE if unconfirmed else 1.0
    named = [
        replace(
            e, confidence=min(e.confidence, most, _UNSURE if named_at(e.effect, e.where) in changing else 1.0)
        )
        for e in course.last.effects
    ]
    joined = _told([_as_identified(e, after) for e in course.ladder.effects])
    sets = sorted({e.set_number for e in named}) or [0]  # each holds what joined
    return tuple(
        e
        for s in sets
        for e in (
            *(replace(e, set_number=s) for e in joined),
            *(_as_identified(e, after) if s == 0 else e for e in named if e.set_number == s),
        )
    )


def _told(joined: list[Found]) -> list[Found]:
    """Those of the effects that joined of which the data tell something; all where they tell of none."""
    told = [e for e in joined if any(np.isfinite(size.std) for size in e.parameters.values())]
    return told or joined


def _unconfirmed(course: Course) -> list[str]:
    """Remarks on what poses that were not used do not confirm."""
    remarks = []
    if course.last.rms.unconfirmed:
        remarks.append(
            "poses that were not used do not confirm what was found: there the residual does not fall. "
            "Measure more poses before relying on it"
        )
    if course.last.effects and len(np.unique(course.table.pose)) < FEWEST:
        remarks.append("so few poses leave none to predict: measure more before relying on what was found")
    return remarks


def _of_effects(course: Course, counted: tuple[Found, ...]) -> list[str]:
    """Remarks on what the effects assume, and on those whose sizes are out of their physical range."""
    robot, extent = course.task.robot, extent_of(course.assembly.situation.view)
    assumed = (f"{named_at(e.effect, e.where)}: {a}" for e in counted for a in e.instance.assumptions(robot))
    # what the complete model keeps are sums with signs
    joined = {named_at(e.effect, e.where) for e in course.ladder.effects}
    alone = {  # the first set's, where several hold one effect
        name: e for e in reversed(counted) if (name := named_at(e.effect, e.where)) not in joined
    }
    far = out_of_range([*reversed(alone.values())], robot, extent)
    seen = _by_one_pose(course.table, alone)
    return [*dict.fromkeys(assumed), *dict.fromkeys(far), *seen]  # several sets may hold one effect


def _by_one_pose(table: Measurements, effects: Mapping[str, Found]) -> list[str]:
    """Remarks on effects that one pose alone shows."""
    return [
        f"{name}: {100 * e.carried[1]:.0f} % of what shows it is in pose {table.labels[e.carried[0]]} alone: measure "
        "more poses where it would show before relying on its size, and that one again"
        for name, e in effects.items()
        if e.carried is not None
    ]


def _without_value(course: Course, after: JointFit, held: Couplings) -> list[str]:
    """Remarks on parameters that the data do not determine; ``held``: nor do any others."""
    base = course.ladder.base
    if hidden := _hidden(after, base, course.trusted):
        return hidden
    if not course.last.growth:
        return _left_at_zero(after)
    return _undetermined(course, after, held)


def _beyond_code(model: StiffnessModel, table: Measurements, left: float) -> list[str]:
    """A remark on what is found and is no law of a virtual joint, where the model leaves more for want of it.

    ``left`` is what is left with it, rms of a coordinate, of translations where there are any.
    """
    lawless = [e for e, r in zip(model.effects, model.realisations, strict=True) if r.nominal and not r.terms]
    if not lawless or table.kind != "deflection":
        return []
    positions = bool(table.measured[:, :3].any())
    rows = table.measured & (np.arange(6) < 3 if positions else True)
    without = float(np.sqrt(np.mean((table.values - predict(model, table))[rows] ** 2)))
    if without < _MORE * left:
        return []
    names, unit = ", ".join(named_at(e.effect, e.where) for e in lawless), "mm" if positions else "mrad"
    return [
        f"{names}: no law at a virtual joint, so that the model's deflections, its code and compensation go without "
        f"it: they leave {milli(without)} {unit} rms per coordinate of these data"
    ]


def _taken_back(last: Diagnosis) -> Diagnosis:
    """The diagnosis without the effects whose sizes go astray where all parameters are identified jointly."""
    rms = replace(last.rms, after=last.rms.before, held_out_after=last.rms.held_out_before)
    return replace(
        last,
        verdict=UNEXPLAINED,
        because=Reason(Why.ASTRAY),
        effects=(),
        inconstant=(),
        growth=last.growth[:1],
        rms=rms,
        held_out=None,
    )


def _left_at_zero(fitted: JointFit) -> list[str]:
    """A remark on the parameters that a fit leaves at zero, where nothing was tested."""
    if not fitted.absorbed:
        return []
    return [
        f"{len(fitted.absorbed)} of the model's {len(fitted.model.parameters)} parameters are not determined by these "
        "data and are zero, the others bear their part: model.toml is no model of the robot before more poses are "
        "measured"
    ]


def _hidden(fitted: JointFit, base: StiffnessModel, trusted: bool) -> list[str]:
    """Remarks on compliances that absolute positions do not tell, and that the written model lacks, and on those that
    they tell as far as the geometry is right.
    """
    own = set(fitted.model.stiffness_parameters)
    zero = [p.name for p in base.compliances if p.name in own & set(fitted.absorbed)]
    if fitted.assembly.situation.view.table.kind != "absolute":
        return []
    return [*_lacking(fitted, zero, len(own), trusted), *_leaning(fitted.leaning, len(own))]


def _lacking(fitted: JointFit, zero: Sequence[str], count: int, trusted: bool) -> list[str]:
    if not zero:
        return []
    size = milli(float(np.sqrt(np.mean(fitted.residual[fitted.assembly.problem.axis < 3] ** 2))))
    be, their = ("is", "its") if len(zero) == 1 else ("are", "their")
    beside = "" if trusted else " beside the geometry"
    lacks = (
        "is no model of the robot under loads" if len(zero) == count else f"lacks {their} part under loads"
    )
    of = f"{len(zero)} of the model's {count}" if len(zero) < count else f"all {count} of the model's"
    which = "the model's one compliance" if count == 1 else f"{of} compliances"
    return [
        f"{which} ({few(zero, 4)}) {be} not determined by these positions"
        f"{beside} and {be} zero: model.toml leaves {size} mm rms per coordinate, and {lacks} until loaded poses, or "
        "deflections, are measured"
    ]


def _leaning(names: Sequence[str], count: int) -> list[str]:
    if not names:
        return []
    be, them = ("is", "it") if len(names) == 1 else ("are", "them")
    return [
        f"{len(names)} of the model's {count} compliances ({few(names, 4)}) {be} told as far as the geometry is right: "
        f"beside errors of all frames these positions would not tell {them}, and deflections would"
    ]


def _undetermined(course: Course, fitted: JointFit, held: Couplings) -> list[str]:
    """Remarks on parameters of the start model that the data do not determine; ``held``: nor do any others."""
    model, deviations = course.ladder.base, course.last.growth[0].model_std
    known = {name for name, std in zip(course.assembly.names, deviations, strict=False) if np.isfinite(std)}
    nominal = {n for r in model.realisations for n in r.nominal}
    open_ones = [n for n in model.parameters if n not in known | nominal | course.ladder.joined]
    if not open_ones:
        return []
    absolute = fitted.assembly.situation.view.table.kind == "absolute"
    sums = {*held, *(n for row in held.values() for n in row), *(model.frame_errors if absolute else ())}
    zero = [n for n in fitted.absorbed if n in sums]
    more = [n for n in open_ones if n not in sums]
    remarks = []
    if zero:
        be, them = ("is", "it") if len(zero) == 1 else ("are", "them")
        remarks.append(
            f"{few(zero, 4)} {be} zero: no poses and loads of this kind tell {them} from the start model's other "
            f"parameters{' or the place of the device' if absolute else ''}, which bear what they would"
        )
    if more:
        remarks.append(
            f"{len(more)} of the start model's {len(model.parameters)} parameters are not determined by these data "
            f"({few(more, 4)}): more poses, or loads in more directions, would show more"
        )
    return remarks


def _redundant(task: Task, model: StiffnessModel, table: Measurements) -> Couplings:
    """What no poses and loads tell apart in a start model that was not reduced here; positions have geometry beside."""
    if task.start in ("complete", "joints") or table.kind != "deflection":
        return {}
    return redundant(model, table)


def _as_identified(effect: Found, fitted: JointFit) -> Found:
    """The effect with the values that the grown model holds, all parameters identified jointly."""
    model, parameters = fitted.model, dict(effect.parameters)
    for name, e in parameters.items():
        if name in model.deviations:
            parameters[name] = replace(e, value=float(model.values[name]), std=float(model.deviations[name]))
        elif name in fitted.absorbed:
            parameters[name] = Quantity(0.0, float("inf"), e.unit)
    return replace(effect, parameters=parameters)


def _steps(ladder: Ladder, last: Diagnosis, before: JointFit, held: Sequence[int]) -> tuple[Rung, ...]:
    """The growth path from the start model on; ``held``: parameters of each model that its others stand for."""
    most = ladder.count - held[-1]
    if not last.growth:
        return (Rung(ladder.title, most, before.residual, last.strata, last.p_missing),)
    out = [replace(r, parameters=r.parameters - h) for r, h in zip(ladder.rungs, held, strict=False)]
    for k, g in enumerate(last.growth):
        title = ladder.title if g.added is None else f"+ {named_at(g.added.effect, g.added.where)}"
        p_left = last.p_missing if k == 0 else g.p_left
        out.append(Rung(title, most + g.gained, g.residual, g.strata, p_left))
    return tuple(out)
