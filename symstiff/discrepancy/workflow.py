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

from symstiff.arguments import listener, require, whole
from symstiff.calibration.doubts.point import find_point
from symstiff.calibration.doubts.soundness import other_weights, outside_class, outside_fixed
from symstiff.calibration.doubts.stations import check_stations
from symstiff.calibration.experiment.readings import ExperimentClass, experiment_of
from symstiff.calibration.experiment.situation import Laws
from symstiff.calibration.identify import start_model
from symstiff.calibration.kept import on_the_clock, seen_in
from symstiff.calibration.remarks import of_stations
from symstiff.calibration.rows import context_of
from symstiff.calibration.tables.checks import check_measured, check_robot, of_units
from symstiff.calibration.tables.loading import as_loading
from symstiff.calibration.tables.measurements import Measurements
from symstiff.calibration.tables.sessions import by_session
from symstiff.discrepancy.bridge.assemble import Assembly, added_loads, assemble
from symstiff.discrepancy.bridge.growth import fit, grow
from symstiff.discrepancy.climb import Ladder, Wider, wider_models
from symstiff.discrepancy.conclusion import Course, finding_of
from symstiff.discrepancy.examine import examine
from symstiff.discrepancy.findings.doubts import doubted
from symstiff.discrepancy.findings.finding import Finding, Task
from symstiff.discrepancy.findings.gross import gross, left_out, nearly_all, remark, unlike
from symstiff.discrepancy.findings.result import Diagnosis, Found, Name
from symstiff.discrepancy.findings.used import used
from symstiff.discrepancy.outgrown import accounts_better, bare_of, outgrown
from symstiff.discrepancy.problem import Options, key_of
from symstiff.discrepancy.reasons import Reason, Why
from symstiff.discrepancy.search.localise import FittedDevice
from symstiff.discrepancy.search.verdict import AMBIGUOUS, NAMED, NOTHING, UNEXPLAINED, UNTESTABLE
from symstiff.discrepancy.statistics.prepare import at_first
from symstiff.display import of_poses
from symstiff.effects.instance import EffectInstance
from symstiff.effects.places import named as named_at
from symstiff.errors import UserError
from symstiff.model import StiffnessModel
from symstiff.reduction.remarks import reduction_remarks
from symstiff.threads import one_thread

Tell = Callable[[str], None]
_WORTH, _FAR = 0.01, 3e-3
"""Load that an effect adds, against the largest, and angle [rad] by which it turns an unloaded arm, from which laws are
looked at again with it: the square of such an angle shifts a tool by some hundredths of a millimetre."""
_LOOKS = 2
"""Times that laws are looked at again under loads that were found."""
_AGAIN = 2
"""Times that gross errors are left out: one may hide behind others."""


@one_thread()
def diagnose(task: Task, tell: Tell | None = None) -> Finding:
    """Find where a table's measurements and a model disagree, name the missing effects and add them to the model.

    ``tell`` is told each stage. The finding holds the verdict (``finding.verdict``: named, ambiguous, unexplained,
    nothing_missing …), ``effects`` with sizes and confidence, the grown ``model``, and what is left (``rms`` [m]);
    ``write_report`` makes the report, verdict.json, model.toml and code of it. Takes some seconds to a minute.
    Raises UserError for data that do not fit the robot or hold nothing measured.
    """
    require(task, Task, "a task", "Task(robot, table) is one")
    listener(tell)
    tell = tell or (lambda stage: None)
    whole(task.max_effects, "max_effects", 1)
    whole(task.seed, "seed")
    if task.max_poses is not None:
        whole(task.max_poses, "max_poses", 2)
    warnings = check_robot(task.table, task.robot)
    warnings = [
        w for w in warnings if w not in of_units(task.table, task.robot)
    ]  # the verdict's sentence begins with these
    check_measured(task.table)
    task = replace(task, table=as_loading(task.table))
    table, unused = used(task.table, task.max_poses)
    table, sessions = by_session(table)
    check_stations(task.robot, table)
    remarks = [*warnings, *unused, *sessions, *of_stations(table)]
    finding = _of_table(task, table, remarks, tell)
    for _ in range(_AGAIN):
        rows = gross(finding)
        if not len(rows):
            break
        remarks.append(remark(finding, rows))
        table = table.select(np.setdiff1d(np.arange(len(table)), rows))
        tell("without gross errors")
        finding = _of_table(task, table, remarks, tell)
    return _but_suspects(finding, remarks, tell)


def _but_suspects(finding: Finding, remarks: Sequence[str], tell: Tell) -> Finding:
    """The diagnosis without few poses unlike all others, if nothing is missing there, or if they hide all else."""
    poses = unlike(finding.table, finding.last)
    if not poses:
        return finding
    tell("without the poses unlike the others")
    table, theirs = finding.table, np.isin(finding.table.pose, poses)
    try:
        rest = _of_table(finding.task, table.select(np.flatnonzero(~theirs)), remarks, tell)
    except UserError:  # the others are no experiment by themselves
        return finding
    names = tuple(str(table.labels[p]) for p in poses)
    if rest.verdict == NOTHING:
        last = replace(rest.last, device_law=_of_one(finding.last.device_law, names))
        rest = replace(rest, last=last, verdict=UNEXPLAINED, because=Reason(Why.POSES, names))
    elif not nearly_all(finding.last):
        return finding
    said = left_out(rest, table.select(np.flatnonzero(theirs)), names)
    return replace(rest, remarks=(said, *rest.remarks))


def _of_one(law: FittedDevice | None, names: Sequence[str]) -> FittedDevice | None:
    """A law of the loads of the one pose of that name."""
    return law if law is not None and law.place == of_poses(names) else None


def _of_table(task: Task, table: Measurements, remarks: Sequence[str], tell: Tell) -> Finding:
    """The diagnosis of the part of the task's table that is used, of which there are remarks."""
    remarks = list(remarks)
    tell("model")
    experiment = experiment_of(table, task.robot).wished(task.loads, task.measure)
    model, reduction = start_model(task.robot, task.start, experiment)
    remarks += reduction_remarks(reduction) if reduction is not None else []
    remarks += [*other_weights(model, task.robot), *outside_class(table.w, model.loads)]
    remarks += outside_fixed(table.q, model)
    told, elapsed = on_the_clock(model, table)
    model, unseen = seen_in(told, table.kind)
    remarks += [*unseen, *elapsed]
    context_of(model, table)  # refuses a table without the time or the branch that the model follows
    model, of_point = find_point(model, table, task.robot)
    remarks += [of_point] if of_point else []
    linked = _with_links(model, task, table, experiment)
    assembly, first = _diagnosed(model, table, _options(task), tell, doubted(model, table, linked))
    course = _shaped_anew(Course(task, table, told, Ladder(model), assembly, first, first), tell)
    course = _at_the_top(course, experiment, tell)
    return finding_of(course, remarks, tell, lambda course, found: _without(course, found, experiment, tell))


def _with_links(
    model: StiffnessModel, task: Task, table: Measurements, experiment: ExperimentClass
) -> StiffnessModel:
    """A model in which links give way: the complete one where this one takes them for rigid."""
    if table.kind == "absolute" or any(not p.is_joint for p in model.compliances):
        return model
    return seen_in(start_model(task.robot, "complete", experiment)[0], table.kind)[0]


def _at_the_top(course: Course, experiment: ExperimentClass, tell: Tell) -> Course:
    """The diagnosis from the widest model on that takes the place of a narrower one."""
    wider = wider_models(course.ladder.base, course.last, course.task, experiment)
    climbed = next(filter(None, (_climbed(course, one, tell) for one in wider)), None)
    if climbed is None:
        return course
    # beside narrower links an old shape may pass for theirs
    return _at_the_top(_shaped_anew(climbed, tell), experiment, tell)


def _without(
    course: Course, found: Sequence[Found], experiment: ExperimentClass, tell: Tell
) -> Course | None:
    """The diagnosis without effects that went astray; None where nothing else accounts for the data.

    Where effects of the start model got other shapes, it is that with the shapes that it gives them.
    """
    tell("without what goes astray")
    if course.plain is not None:
        return _at_the_top(course.plain, experiment, tell)
    names = [key_of(e.effect, e.where) for e in found]
    assembly, last = _diagnosed(course.ladder.base, course.table, _options(course.task), tell, without=names)
    if last.verdict not in (NAMED, AMBIGUOUS):
        return None
    first = last if course.first is course.last else course.first
    return replace(course, assembly=assembly, first=first, last=last)


def _shaped_anew(course: Course, tell: Tell) -> Course:
    """The diagnosis with effects of the start model in other shapes, where these account better for the data.

    All of them at once, or else one: what looks like another shape of one may be that of the effect beside it.
    """
    model, found = course.ladder.base, course.last
    if found.verdict in (NOTHING, UNTESTABLE) or not model.effects:
        return course
    tell("shapes of the start model's effects")
    old = outgrown(model, course.table, _leading(found))
    tries = [old] if len(old) < 2 else [old, *((e,) for e in old)]
    return next(filter(None, (_reshaped(course, some, tell) for some in tries if some)), course)


def _reshaped(course: Course, old: Sequence[EffectInstance], tell: Tell) -> Course | None:
    """The diagnosis with some effects of the start model in other shapes; None where these do not account better."""
    model, found = course.ladder.base, course.last
    bare, given = bare_of(model, old), (*course.given, *(Name(e.effect, e.where) for e in old))
    assembly, anew = _diagnosed(bare, course.table, _options(course.task, given), tell, given=given)
    readings = len(np.unique(6 * assembly.problem.pose + assembly.problem.axis))
    if not accounts_better(anew, found, old, assembly.problem.axis, readings):
        return None
    first = replace(course.first, candidates=anew.candidates)
    ladder = course.ladder.without(old, bare, found)
    return replace(
        course, ladder=ladder, assembly=assembly, first=first, last=anew, given=given, plain=course
    )


def _climbed(course: Course, wider: Wider, tell: Tell) -> Course | None:
    """The diagnosis from a wider model on; None where that does not take the place of the one before."""
    tell(wider.title)
    given = course.given
    assembly, last = _diagnosed(wider.model, course.table, _options(course.task, given), tell, given=given)
    if last.verdict == UNTESTABLE or not wider.leaves_less(
        last, course.last, assembly.problem.axis, assembly.problem.pose
    ):
        return None
    ladder = course.ladder.climbed(wider, course.last, fit(wider.model, course.table))
    return replace(course, ladder=ladder, assembly=assembly, last=last)


def first_assembly(model: StiffnessModel, table: Measurements) -> Assembly:
    """The assembly of a table by the noise as the model alone shows it."""
    return assemble(model, table, noise=at_first(assemble(model, table, effects=()).problem))


def _diagnosed(
    model: StiffnessModel, table: Measurements, options: Options, tell: Tell, doubt: Reason | None = None,
    without: Sequence[str] = (), given: Sequence[Name] = (),
) -> tuple[Assembly, Diagnosis]:  # fmt: skip
    """The diagnosis of a model; where it finds loads, other laws are looked for once more under the sum.

    A wrong payload or a biased sensor loads the gears too; what turns an arm by an angle that is no small one moves the
    levers, and is looked at again the same way. The second look stands where it says the same with
    better shapes, does without some of the effects, or where the first did not account for the data; never without
    the effects whose loads it takes for granted, and what stood against their names in the first look still does.
    Where it moves those loads by as much as is worth a look, a third one is taken under the loads as they are then.
    Candidates ``without`` which the data are to be explained, by their keys, take no part; effects that are ``given``
    belong to every explanation.
    """
    tell("columns")
    assembly = _but(first_assembly(model, table), without)
    found = examine(assembly.problem, assembly.candidates, options, tell, given, doubt)
    best, last, again = (assembly, found), assembly, found
    certain, values = list(given), dict[str, float]()
    for _ in range(_LOOKS):
        loads = _loads_of(last, again, values)
        if not loads:
            break
        tell("columns under the loads found")
        certain += [n for n in loads if n not in certain]
        like = found.weights
        believed = fit(grow(model, _leading(again)), table, None if like is None else like.alone)
        values = dict(believed.model.values)
        last = _but(assemble(model, table, noise=believed.noise, believed=believed.model), without)
        again = examine(last.problem, last.candidates, options, tell, certain, like=like)
        if not {named_at(n.effect, n.where) for n in certain} <= set(_names(again)):
            break
        if _stands(again, best[1]):
            best = last, _no_surer(again, found, certain)
        elif best[1].verdict == NAMED:
            break
    return best


def _stands(again: Diagnosis, found: Diagnosis) -> bool:
    """Whether a diagnosis under loads that another found takes its place."""
    if found.verdict == NAMED:
        return again.verdict == NAMED and not Counter(_names(again)) - Counter(_names(found))
    return again.verdict in (NAMED, AMBIGUOUS) or again.because.why is Why.AS_WELL


def _but(assembly: Assembly, without: Sequence[str]) -> Assembly:
    """An assembly without some candidates."""
    why = "where all parameters are identified jointly, its size goes far beyond the physical range"
    candidates = (replace(c, unavailable=why) if c.key in without else c for c in assembly.candidates)
    return replace(assembly, candidates=tuple(candidates)) if without else assembly


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


def _leading(found: Diagnosis) -> list[EffectInstance]:
    """The effects of the leading set, in the order in which they were found."""
    return [EffectInstance(name.effect, dict(name.where), dict(shape)) for name, shape, _ in found.leading]


def _names(found: Diagnosis) -> list[str]:
    return sorted(named_at(name.effect, name.where) for name, _, _ in found.leading)


def _loads_of(assembly: Assembly, found: Diagnosis, taken: Mapping[str, float]) -> list[Name]:
    """Effects of the leading set that are worth another look, beyond what was ``taken`` for granted of them.

    None where a look has nothing to add: one effect alone, or several sets.
    """
    if found.verdict == AMBIGUOUS or (found.verdict == NAMED and len(found.leading) == 1):
        return []
    worth = []
    for effect, (*_, sizes) in zip(_leading(found), found.leading, strict=True):
        beyond = {name: e.value - taken.get(name, 0.0) for name, e in sizes.items()}
        if _loads(assembly, effect, beyond):
            worth.append(Name(effect.effect, effect.where))
    return worth


def _loads(assembly: Assembly, effect: EffectInstance, values: Mapping[str, float]) -> bool:
    """Whether an effect of that size adds loads, or moves an unloaded arm, by what is worth another look."""
    view = assembly.situation.view
    if np.max(np.abs(added_loads(view, effect, values))) > _WORTH * np.max(np.abs(view.tau)):
        return True
    off = Laws(view, effect.realise(view.robot).terms, values)(np.zeros_like(view.tau))
    turned = np.einsum("nrv,nv->nr", view.found.J_theta[:, 3:], off)
    return view.table.kind == "absolute" and bool(np.max(np.abs(turned)) > _FAR)


def _options(task: Task, given: Sequence[Name] = ()) -> Options:
    """What a task asks for; effects that are ``given`` do not count among those that it looks for."""
    most = task.max_effects + len(given)
    return replace(Options(), max_effects=most, seed=Options().seed + task.seed)
