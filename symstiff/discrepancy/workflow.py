"""The whole workflow on a table: start model, diagnosis, growth, joint identification.

A start model climbs a ladder: where no few effects account for the data and what is missing is the robot's own
compliances, the complete model (reduced for the experiment) takes the place of rigid links, and the diagnosis goes
on from there. So joints → links → what is missing from both comes out of the data (the seed's J1 → C1 → C2). In
absolute positions an arm whose frames are all off takes the place of the drawn one in the same way.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from symstiff.arguments import require, whole
from symstiff.calibration.checks import check_measured, check_robot
from symstiff.calibration.experiment.readings import experiment_of
from symstiff.calibration.experiment.situation import Laws
from symstiff.calibration.identify import start_model
from symstiff.calibration.kept import seen_in
from symstiff.calibration.loading import as_loading
from symstiff.calibration.measurements import Measurements
from symstiff.calibration.point import find_point
from symstiff.calibration.redundant import redundant
from symstiff.calibration.rows import predict
from symstiff.calibration.soundness import outside_class, outside_fixed
from symstiff.discrepancy.assemble import Assembly, added_loads, assemble
from symstiff.discrepancy.climb import Ladder, wider_model
from symstiff.discrepancy.diagnose import diagnose
from symstiff.discrepancy.doubts import doubted
from symstiff.discrepancy.finding import Finding, Found, Rung, Task
from symstiff.discrepancy.gross import gross, remark
from symstiff.discrepancy.growth import Fitted, fit, fit_told, grow
from symstiff.discrepancy.numbers import milli
from symstiff.discrepancy.prepare import at_first
from symstiff.discrepancy.problem import Options
from symstiff.discrepancy.proof import FEWEST
from symstiff.discrepancy.ranges import extent_of
from symstiff.discrepancy.remarks import astray, out_of_range, remarked
from symstiff.discrepancy.result import Diagnosis, Estimate, Name, Rms
from symstiff.discrepancy.speech import named as named_at
from symstiff.discrepancy.used import used
from symstiff.discrepancy.verdict import AMBIGUOUS, NAMED, NOTHING, UNEXPLAINED, UNTESTABLE
from symstiff.display import few
from symstiff.effects.instance import EffectInstance
from symstiff.model import StiffnessModel
from symstiff.reduction.remarks import reduction_remarks
from symstiff.reduction.structural import Couplings
from symstiff.threads import one_thread

Tell = Callable[[str], None]
_WORTH, _FAR = 0.01, 3e-3
"""Load that an effect adds, against the largest, and angle [rad] by which it turns an unloaded arm, from which laws are
looked at again with it: the square of such an angle shifts a tool by some hundredths of a millimetre."""
_MORE = 1.05
"""What a model without some effects leaves, over what it leaves with them, from which that is spoken of."""
_AGAIN = 2
"""Times that gross errors are left out: one may hide behind others."""
_UNCONFIRMED = 0.75
"""Most confidence in what poses that were not used do not confirm."""


@one_thread()
def run(task: Task, tell: Tell = lambda stage: None) -> Finding:
    """Diagnose a table. Raises UserError for data that do not fit the robot or hold nothing measured."""
    require(task, Task, "a task", "Task(robot, table) is one")
    whole(task.max_effects, "max_effects", 1)
    whole(task.seed, "seed")
    if task.max_poses is not None:
        whole(task.max_poses, "max_poses", 1)
    warnings = check_robot(task.table, task.robot)
    check_measured(task.table)
    task = replace(task, table=as_loading(task.table))
    table, left_out = used(task.table, task.max_poses)
    remarks = [*warnings, *left_out]
    finding = _of_table(task, table, remarks, tell)
    for _ in range(_AGAIN):
        rows = gross(finding)
        if not len(rows):
            break
        remarks.append(remark(finding, rows))
        table = table.select(np.setdiff1d(np.arange(len(table)), rows))
        tell("without gross errors")
        finding = _of_table(task, table, remarks, tell)
    return finding


def _of_table(task: Task, table: Measurements, remarks: Sequence[str], tell: Tell) -> Finding:
    """The diagnosis of the part of the task's table that is used, of which there are remarks."""
    remarks = list(remarks)
    tell("model")
    experiment = experiment_of(table, task.robot).wished(task.loads, task.measure)
    model, reduction = start_model(task.robot, task.start, experiment)
    remarks += reduction_remarks(reduction) if reduction is not None else []
    remarks += [*outside_class(table.w, model.loads), *outside_fixed(table.q, model)]
    told = model
    model, unseen = seen_in(model, table.kind)
    remarks += unseen
    model, of_point = find_point(model, table, task.robot)
    remarks += [of_point] if of_point else []
    doubt = doubted(model, table)
    assembly, first = _diagnosed(model, table, _options(task, task.max_effects), tell, doubt)
    ladder, last = Ladder(model), first
    while (wider := wider_model(ladder.base, last, task, experiment)) is not None:
        tell(wider.title)
        grown, found = _diagnosed(wider.model, table, _options(task, task.max_effects), tell)
        if found.verdict == UNTESTABLE or not wider.leaves_less(found, last, grown.problem.axis):
            break
        ladder = ladder.climbed(wider, last, fit(wider.model, table))
        assembly, last = grown, found
    return _finding(task, table, told, ladder, assembly, first, last, remarks, tell)


def first_assembly(model: StiffnessModel, table: Measurements) -> Assembly:
    """The assembly of a table by the noise as the model alone shows it."""
    return assemble(model, table, noise=at_first(assemble(model, table, effects=()).problem))


def _diagnosed(
    model: StiffnessModel, table: Measurements, options: Options, tell: Tell, doubt: str = ""
) -> tuple[Assembly, Diagnosis]:
    """The diagnosis of a model; where it finds loads, other laws are looked for once more under the sum.

    A wrong payload or a biased sensor loads the gears too; what turns an arm by an angle that is no small one moves the
    levers, and is looked at again the same way. The second look stands where it says the same with
    better shapes, does without some of the effects, or where the first did not account for the data; never without
    the effects whose loads it takes for granted, and what stood against their names in the first look still does.
    """
    tell("columns")
    assembly = first_assembly(model, table)
    found = diagnose(assembly.problem, assembly.candidates, options, tell, doubt=doubt)
    settled = found.verdict == AMBIGUOUS or (found.verdict == NAMED and len(found.leading) == 1)
    effects = [(EffectInstance(n.effect, dict(n.where), dict(s)), e) for n, s, e in found.leading]
    given = [] if settled else [Name(e.effect, e.where) for e, sizes in effects if _loads(assembly, e, sizes)]
    if not given:
        return assembly, found
    tell("columns under the loads found")
    believed = fit(grow(model, [effect for effect, _ in effects]), table)
    under = assemble(model, table, noise=believed.noise, believed=believed.model)
    again = diagnose(under.problem, under.candidates, options, tell, given)
    enough = again.verdict == NAMED and not Counter(_names(again)) - Counter(_names(found))
    stands = enough if found.verdict == NAMED else again.verdict in (NAMED, AMBIGUOUS)
    kept = {named_at(n.effect, n.where) for n in given} <= set(_names(again))
    return (under, _no_surer(again, found, given)) if stands and kept else (assembly, found)


def _no_surer(again: Diagnosis, found: Diagnosis, given: Sequence[Name]) -> Diagnosis:
    """The second look, no surer than the first of the effects that it took for granted."""
    if found.verdict != NAMED:
        return again
    taken = {named_at(n.effect, n.where) for n in given}
    stated = {named_at(e.effect, e.where): e.confidence for e in found.effects if e.set_number == 0}
    most = {name: stated[name] for name in taken & set(stated)}
    effects = (
        replace(e, confidence=min(e.confidence, most.get(named_at(e.effect, e.where), 1.0)))
        for e in again.effects
    )
    return replace(again, effects=tuple(effects))


def _names(found: Diagnosis) -> list[str]:
    return sorted(named_at(name.effect, name.where) for name, _, _ in found.leading)


def _loads(assembly: Assembly, effect: EffectInstance, estimates: Mapping[str, Estimate]) -> bool:
    """Whether an effect of that size adds loads, or moves an unloaded arm, by what is worth a second look."""
    view, values = assembly.situation.view, {name: e.value for name, e in estimates.items()}
    if np.max(np.abs(added_loads(view, effect, values))) > _WORTH * np.max(np.abs(view.tau)):
        return True
    off = Laws(view, effect.realise(view.robot).terms, values)(np.zeros_like(view.tau))
    turned = np.einsum("nrv,nv->nr", view.found.J_theta[:, 3:], off)
    return view.table.kind == "absolute" and bool(np.max(np.abs(turned)) > _FAR)


def _options(task: Task, most: int) -> Options:
    return replace(Options(), max_effects=most, seed=Options().seed + task.seed)


def _finding(
    task: Task, table: Measurements, told: StiffnessModel, ladder: Ladder, assembly: Assembly, first: Diagnosis,
    last: Diagnosis, remarks: list[str], tell: Tell,
) -> Finding:  # fmt: skip
    start, base, climbed = ladder.start, ladder.base, ladder.effects
    named = tuple(
        Found(e.effect, e.where, e.shape, e.parameters, e.p_value, e.confidence, e.confounded_with, e.set_number,
              e.twins)
        for e in last.effects
    )  # fmt: skip
    tell("identification")
    grown = grow(base, [e.instance for e in named if e.set_number == 0])
    after = fit_told(grown, table)
    extent = extent_of(assembly.situation.view)
    if astray([_as_identified(e, after) for e in named if e.set_number == 0], task.robot, extent):
        last = _taken_back(last)
        return _finding(task, table, told, ladder, assembly, first, last, remarks, tell)
    before = after if grown is start else fit_told(start, table, after.noise, after)
    verdict, reason = last.verdict, last.reason
    if climbed and verdict == NOTHING:
        verdict, reason = NAMED, ladder.reason
    testable = verdict != UNTESTABLE
    remarks = [*remarks, *ladder.remarks, *remarked(assembly.situation.view, last)]
    remarks += _beyond_code(after.model, table, last.rms.after)
    held = _redundant(task, start, table)
    remarks += _hidden(after, base) or (
        _undetermined(ladder, assembly, last, after, held if base is start else {})
        if last.growth
        else _left_at_zero(after)
    )
    if last.rms.unconfirmed:
        named = tuple(replace(e, confidence=min(e.confidence, _UNCONFIRMED)) for e in named)
        remarks.append(
            "poses that were not used do not confirm what was found: there the residual does not fall. "
            "Measure more poses before relying on it"
        )
    if named and len(np.unique(table.pose)) < FEWEST:
        named = tuple(replace(e, confidence=min(e.confidence, _UNCONFIRMED)) for e in named)
        remarks.append("so few poses leave none to predict: measure more before relying on what was found")
    if climbed:  # every admissible set holds them
        sets = sorted({e.set_number for e in named}) or [0]
        named = tuple(e for s in sets for e in (*(replace(c, set_number=s) for c in climbed),
                                                *(n for n in named if n.set_number == s)))  # fmt: skip
    named = tuple(_as_identified(e, after) if e.set_number == 0 else e for e in named)
    counted = named if verdict == AMBIGUOUS else tuple(e for e in named if e.set_number == 0)
    assumed = (
        f"{named_at(e.effect, e.where)}: {a}" for e in counted for a in e.instance.assumptions(task.robot)
    )
    remarks += dict.fromkeys(assumed)  # several sets may hold one effect
    # what the complete model keeps are sums with signs
    joined = {named_at(e.effect, e.where) for e in climbed}
    alone = {  # the first set's, where several hold one effect
        name: e for e in reversed(counted) if (name := named_at(e.effect, e.where)) not in joined
    }
    remarks += dict.fromkeys(out_of_range([*reversed(alone.values())], task.robot, extent))
    return Finding(
        task, table, before, after, told, first, last, assembly, verdict if testable else UNEXPLAINED, testable, reason,
        counted, tuple(e for e in named if e not in counted),
        _steps(ladder, last, before, len(held)),
        _rms(first, last), tuple(remarks),
    )  # fmt: skip


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
    reason = "what accounts for the data goes far beyond its physical range where all parameters are identified jointly"
    rms = replace(last.rms, after=last.rms.before, held_out_after=last.rms.held_out_before)
    return replace(
        last, verdict=UNEXPLAINED, reason=reason, effects=(), growth=last.growth[:1], rms=rms, held_out=None
    )


def _left_at_zero(fitted: Fitted) -> list[str]:
    """A remark on the parameters that a fit leaves at zero, where nothing was tested."""
    if not fitted.absorbed:
        return []
    return [
        f"{len(fitted.absorbed)} of the model's {len(fitted.model.parameters)} parameters are not determined by these "
        "data and are zero, the others bear their part: model.toml is no model of the robot before more poses are "
        "measured"
    ]


def _hidden(fitted: Fitted, base: StiffnessModel) -> list[str]:
    """A remark on compliances that geometry hides in absolute positions, and that the written model lacks."""
    problem, view = fitted.assembly.problem, fitted.assembly.situation.view
    own = set(fitted.model.stiffness_parameters)
    zero = [p.name for p in base.compliances if p.name in own & set(fitted.absorbed)]
    if view.table.kind != "absolute" or not zero:
        return []
    size = milli(float(np.sqrt(np.mean(fitted.residual[problem.axis < 3] ** 2))))
    be, their = ("is", "its") if len(zero) == 1 else ("are", "their")
    lacks = (
        "is no model of the robot under loads" if len(zero) == len(own) else f"lacks {their} part under loads"
    )
    return [
        f"{len(zero)} of the model's {len(own)} compliances ({few(zero, 4)}) {be} not determined by these positions "
        f"beside the geometry and {be} zero: model.toml leaves {size} mm rms per coordinate, and {lacks} until loaded "
        "poses, or deflections, are measured"
    ]


def _undetermined(
    ladder: Ladder, assembly: Assembly, last: Diagnosis, fitted: Fitted, held: Couplings
) -> list[str]:
    """Remarks on parameters of the start model that the data do not determine; ``held``: nor do any others."""
    model = ladder.base
    known = {n for n, s in zip(assembly.names, last.growth[0].model_std, strict=False) if np.isfinite(s)}
    nominal = {n for r in model.realisations for n in r.nominal}
    open_ones = [n for n in model.parameters if n not in known | nominal | ladder.joined]
    if not open_ones:
        return []
    sums = {*held, *(n for row in held.values() for n in row)}
    zero = [n for n in fitted.absorbed if n in sums]
    more = [n for n in open_ones if n not in sums]
    remarks = []
    if zero:
        be, them = ("is", "it") if len(zero) == 1 else ("are", "them")
        remarks.append(
            f"{few(zero, 4)} {be} zero: no poses and loads of this kind tell {them} from the start model's other "
            "parameters, which bear what they would"
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


def _as_identified(effect: Found, fitted: Fitted) -> Found:
    """The effect with the values that the grown model holds, all parameters identified jointly."""
    model, parameters = fitted.model, dict(effect.parameters)
    for name, e in parameters.items():
        if name in model.deviations:
            parameters[name] = Estimate(float(model.values[name]), float(model.deviations[name]), e.unit)
        elif name in fitted.absorbed:
            parameters[name] = Estimate(0.0, float("inf"), e.unit)
    return replace(effect, parameters=parameters)


def _steps(ladder: Ladder, last: Diagnosis, before: Fitted, held: int) -> tuple[Rung, ...]:
    """``held``: parameters of the start model that nothing tells from its others."""
    if not last.growth:
        return (Rung(ladder.title, ladder.count - held, before.residual, last.strata, last.p_missing),)
    out = [replace(r, parameters=r.parameters - held * (k == 0)) for k, r in enumerate(ladder.rungs)]
    most = ladder.count - held * (not out)
    for k, g in enumerate(last.growth):
        title = ladder.title if g.added is None else f"+ {named_at(g.added.effect, g.added.where)}"
        p_left = last.p_missing if k == 0 else g.p_left
        out.append(Rung(title, most + g.gained, g.residual, g.strata, p_left))
    return tuple(out)


def _rms(first: Diagnosis, last: Diagnosis) -> Rms:
    return replace(
        last.rms, before=first.rms.before, held_out_before=first.rms.held_out_before,
    )  # fmt: skip
