"""What a person should look at beside the verdict: noise that is not as stated, markers and poses unlike the others."""

from __future__ import annotations

import numpy as np

from symstiff.arrays import Array, numbered
from symstiff.calibration.experiment.situation import View
from symstiff.calibration.remarks import of_sag
from symstiff.calibration.tables.measurements import Measurements
from symstiff.discrepancy.bridge.ranges import at_size, extent_of
from symstiff.discrepancy.findings.gross import in_usual, unlike
from symstiff.discrepancy.findings.numbers import p_equals, quantity
from symstiff.discrepancy.findings.otherwise import of_alike, of_files, of_gain
from symstiff.discrepancy.findings.out_of_range import beyond, outside
from symstiff.discrepancy.findings.result import Diagnosis, Inconstancy
from symstiff.discrepancy.laws.drawing import DRAWING
from symstiff.discrepancy.noise.scales import CONTRADICTED, NoiseReport
from symstiff.discrepancy.noise.sharing import JOINTS
from symstiff.discrepancy.problem import Options
from symstiff.discrepancy.reasons import Why
from symstiff.discrepancy.search.verdict import INSUFFICIENT, NAMED, NOTHING, UNEXPLAINED, UNTESTABLE
from symstiff.display import times
from symstiff.effects.arm import ASSUMED, untold_weight
from symstiff.effects.base import Effect, Shape
from symstiff.effects.instance import EffectInstance
from symstiff.effects.places import named as named_at
from symstiff.effects.registry import find
from symstiff.robot.schema import Robot

LOOSE = 1.35
"""How much more than the others a marker scatters that is spoken of."""
FAR = 2.5
"""Error on poses that were not used, against the noise, that is spoken of."""
BESIDE = 6.0
"""Residual of a row, in standard deviations, that is spoken of where few rows have such."""
SURE, NOTABLE = 1e-3, 0.3
"""Probability without it, and size against the noise, of a shared error that is spoken of in absolute data."""
FEW = 20.0
"""Degrees of freedom below which silence says little, and what is left sits in few rows."""
_FEW_ROWS = 0.02
_ALONE = 2.5
"""How far the largest residual of a row stands above the next from which that row alone is spoken of."""
_SUCCESSIVE, _PAIRS = 4.0, 60
"""Standard deviations by which successive readings are alike that is spoken of, and pairs of them that it takes."""
_FOLLOWED = {
    "time": "the time", "order": "the order of the rows", "temperature": "the temperature",
    "load": "the size of the load", "branch": "the branch, up or down",
}  # fmt: skip
_DOUBTS = 2.0
"""Standard deviations by which a size that is spoken of is out of its physical range."""
_MOSTLY = 0.5
"""Share of a variance from which repeats are said to bring most of it."""


def remarked(view: View, last: Diagnosis) -> list[str]:
    """Remarks on a diagnosis of what ``view`` shows, a sentence each."""
    noise = last.noise
    if last.verdict == NOTHING and not last.growth:  # nothing was tested
        return [last.reason]
    return [
        *_of_sigma(noise), *_of_readings(noise), *_of_approach(view.table, last), *_of_markers(noise),
        *_of_poses(view.table, last), *_of_single(last), *_of_proof(last), *_of_rows(view, last),
        *_of_succession(view, last), *_of_drawing(view, last), *_of_weights(view, last), *_of_sizes(view, last),
        *_of_settling(last), *_of_known(view.robot, last), *_of_further(last), *of_alike(last),
        *of_files(view.table, last), *of_gain(view.table, last),
        *(of_sag(view.robot) if view.table.kind == "absolute" else ()),
    ]  # fmt: skip


def _of_sigma(noise: NoiseReport) -> list[str]:
    if noise.stated is None and noise.source == "residual":
        return [
            "no sigma is stated and too little was measured twice: the noise is taken from what is left, and nothing "
            "checks it"
        ]
    if not noise.misstated or noise.ratio_interval is None or noise.ratio is None:
        return []
    low, high = noise.ratio_interval
    why = "no test relies on the stated one"
    if noise.single and low > CONTRADICTED:
        why = (
            "the robot's repeatability, or something missing that no test names: "
            "approach some poses anew, or measure more loads in each"
        )
    return [
        f"what is left varies by {times(noise.ratio)} times the stated sigma ({times(low)} to {times(high)}): {why}"
    ]


def _of_readings(noise: NoiseReport) -> list[str]:
    """What shakes the tool moves all its markers."""
    if noise.reading == 0.0:
        return []
    return [
        f"the markers of one reading share {100 * noise.reading:.0f} % of the noise's variance, as a load or a robot "
        "that is not still makes it: more readings of a load help more than more markers do"
    ]


def _of_approach(table: Measurements, last: Diagnosis) -> list[str]:
    """In deflections a pose's rows share the reading without load, which is no larger than the noise."""
    noise = last.noise
    sure = noise.approach_p < SURE and last.verdict == NOTHING
    if last.verdict == UNTESTABLE or not (sure or noise.mostly_shared):
        return []
    size = f"a pose's rows share an error {noise.approach / noise.sigma:.1f} times the noise"
    of_joints = ", as if the joints had stopped beside their targets" if noise.shared == JOINTS else ""
    if noise.mostly_shared or hiding(table, noise):
        return [f"{size}{of_joints}: {_why_shared(noise.anew)}"]
    if of_joints or table.kind == "absolute":
        return []
    return [
        f"{size}, as one reading without load in each pose would make it: if every reading had its own, something may "
        "be missing that hides in it; loads both ways and more load levels would tell"
    ]


def hiding(table: Measurements, noise: NoiseReport) -> bool:
    """Whether a pose's rows share an error, beyond doubt, that is no reading without load: a law may hide in it."""
    other = noise.shared == JOINTS or table.kind == "absolute"
    return noise.approach_p < SURE and noise.approach > NOTABLE * noise.sigma and other


def _why_shared(anew: float | None) -> str:
    """What makes an error that a pose's rows share, of whose variance ``anew`` is each repeat's own."""
    if anew is None:
        return (
            "the robot's repeatability, or something missing that these data cannot tell from it: approach some poses "
            "anew, or measure more loads"
        )
    if anew >= _MOSTLY:
        return "mostly another one in every repeat, so it is the robot's repeatability"
    return (
        "mostly the same in every repeat, so it is not the robot's repeatability if poses were approached anew: "
        "something is missing that no test names, or the model's geometry is not this robot's"
    )


def _of_markers(noise: NoiseReport) -> list[str]:
    return [
        f"marker {name} scatters {factor:.1f} times as much as the others: look at how it is fixed"
        for name, factor in noise.by_marker.items()
        if factor > LOOSE
    ]


def _of_poses(table: Measurements, last: Diagnosis) -> list[str]:
    poses, where = unlike(table, last), last.localisation
    if not poses or where is None:
        return []
    return [
        f"most of what is left ({100 * where.suspected:.0f} % of its variance) comes with few poses "
        f"({', '.join(table.labels[p] for p in poses)}): look at their labels and joint readings, or measure them again"
    ]


def _of_single(last: Diagnosis) -> list[str]:
    if last.verdict != NAMED:
        return []
    rows = [name.where.get("rows", ()) for name, _, _ in last.leading]
    names = [str(pose) for labels in rows if isinstance(labels, list | tuple) for pose in labels]
    if not names:
        return []
    poses, them = ("pose", "it") if len(names) == 1 else ("poses", "them")
    return [
        f"{poses} {', '.join(names)}: measure {them} again, or leave {them} out; no other pose confirms what was found "
        "there or can be predicted by it"
    ]


def _of_further(last: Diagnosis) -> list[str]:
    """A small rest that passes for the shape of what was named, and may be a further effect."""
    if last.verdict != NAMED or not last.growth:
        return []
    step = last.growth[-1]
    if step.further is None or not step.p_left < Options.alpha_further:
        return []
    return [
        f"a small error is left that is no noise ({p_equals(step.p_left)}), most like "
        f"{named_at(step.further.effect, step.further.where)}: a diagnosis that starts from the grown model (--start "
        "model.toml) tests it as one effect more, and more poses would tell; else it is the shape of what was named, "
        "which is only close"
    ]


def inconstant(last: Diagnosis) -> list[str]:
    """A named effect whose size follows something that its law does not depend on, in a sentence each."""
    effects = {named_at(one.name.effect, one.name.where): one for one in reversed(last.inconstant)}
    return [_followed(effect, one) for effect, one in reversed(effects.items())]


def _followed(effect: str, one: Inconstancy) -> str:
    if one.each:
        sizes = ", ".join(f"{round(size, 1) + 0.0:.1f} in {file}" for file, size in one.each)
        return (
            f"{effect} has no one size in these files: by its mean it is {sizes} ({p_equals(one.p_value)}): it changed "
            "between them, or something else did: diagnose each by itself, a later one also from the model of an "
            "earlier one (--start model.toml)"
        )
    by = _FOLLOWED.get(one.by) or f"the position of joint {one.by.removeprefix('q')}"
    runs = f"runs from {one.low:.1f} to {one.high:.1f} of its mean".replace("-", "−")
    if one.low < -1.0 and one.high > 1.0:  # a mean near zero measures nothing
        runs = "changes its sign"
    return (
        f"{effect} has no one size in these data: it {runs} with {by} "
        f"({p_equals(one.p_value)}): something else may look like it, or its law is only close"
    )


def _of_proof(last: Diagnosis) -> list[str]:
    rms, proof, said = last.rms, last.held_out, list[str]()
    if proof is not None and any(proof.spoken_against) and len(proof.without) == len(last.leading):
        doubts = zip(last.leading, proof.without, proof.spoken_against, strict=True)
        said = [
            f"{named_at(name.effect, name.where)}: poses that were not used are predicted better without it, with "
            f"{one.ratio:.2f} times the error: measure more poses before relying on it"
            for (name, *_), one, doubt in doubts
            if doubt
        ]
    if last.verdict == UNEXPLAINED or rms.held_out_after is None or rms.held_out_after < FAR * rms.noise:
        return said
    return [
        *said,
        f"poses that were not used are predicted with {rms.held_out_after / rms.noise:.1f} times the noise: "
        "these poses are too few, or too unlike each other, to rely on the model beyond them",
    ]


def _of_rows(view: View, last: Diagnosis) -> list[str]:
    """Few readings far beside all others: slips of the pen, or readings that changed places."""
    if not last.growth or last.noise.degrees_of_freedom < FEW:  # few rows hold what the model leaves
        return []
    if last.law is not None or last.device_law is not None:  # a law is told that still is in what is left
        return []
    residual = last.growth[-1].residual
    # a model of many parameters passes through some readings, which makes the usual residual small
    beside = in_usual(view, np.abs(residual)) * min(
        np.sqrt(last.noise.degrees_of_freedom / len(residual)), 1.0
    )
    rows = np.flatnonzero(beside > BESIDE)
    first = np.argsort(-beside)[:2]
    if len(first) == 2 and beside[first[0]] > max(BESIDE, _ALONE * beside[first[1]]):
        rows = first[:1]  # a shift of its pose that takes a part of it bends all rows there
    if not len(rows) or len(rows) > max(_FEW_ROWS * len(beside), 2):
        return []
    shown = view.table.places(rows[np.argsort(-beside[rows])].tolist(), 4)
    return [
        f"{len(rows)} row{'s' * (len(rows) > 1)} lie{'s' * (len(rows) == 1)} {beside.max():.0f} times the usual "
        f"residual off ({shown}): look for slips, or for readings that changed places"
    ]


def _of_sizes(view: View, last: Diagnosis) -> list[str]:
    """What leads by far, but for a size beyond its physical range."""
    leading = next((c for c in last.candidates if c.testable), None)
    if leading is None or leading.plausible is not False or last.verdict not in (UNEXPLAINED, INSUFFICIENT):
        return []
    instance = EffectInstance(leading.effect, dict(leading.where), dict(leading.shape))
    ranges = at_size(instance.realise(view.robot).parameters, extent_of(view))
    known = [(p, e) for p in ranges if (e := leading.parameters.get(p.name)) is not None]
    wrong = [(p, e) for p, e in known if p.low == 0.0 and e.value + _DOUBTS * e.std < p.low]
    odd = wrong or [(p, e) for p, e in known if outside(p, e) > _DOUBTS * e.std]
    if leading.p_value > SURE or not odd:
        return []
    told = "; ".join(beyond(p, e) for p, e in odd)
    why = _of_sign(find(leading.effect)) if wrong else "look at the units of loads, readings and lengths"
    return [f"{named_at(leading.effect, leading.where)} would lead, but {told} is physical: {why}"]


def _of_known(robot: Robot, last: Diagnosis) -> list[str]:
    """Sizes that data may estimate and a model need not: they are known beforehand."""
    leading = [e for e in last.effects if e.set_number == 0]
    return [
        f"{named_at(e.effect, e.where)}: {name} has to be {value:g} by theory, and model.toml holds that; these "
        f"data alone give {quantity(told)}"
        + _but(robot, e.shape, (told.value - value) / told.std if told.std > 0 else 0.0)
        for e in leading
        for name, value in e.instance.realise(robot).nominal.items()
        if (told := e.parameters.get(name)) is not None
    ]


def _but(robot: Robot, shape: Shape, deviations: float) -> str:
    """What may keep the data from a size that is known, by how far they are from it."""
    if abs(deviations) < _DOUBTS:
        return ""
    higher = "something else, or terms of higher order,"
    if robot.has_weights:
        what = higher
    elif ASSUMED.keys() & shape.keys():
        what = f"how the weight lies along the arm, {higher}"
    else:
        what = "the weight of the arm"
    return f", {abs(deviations):.1f} standard deviations beside it: {what} may be in it"


def _of_sign(effect: Effect) -> str:
    """What to look at where a size has the wrong sign: a column that is the wrong way round."""
    if "branch" in effect.needs:
        return "are up and down of the column branch exchanged? If not, it is another effect"
    return "look at the signs of loads and readings, or it is another effect"


def _of_succession(view: View, last: Diagnosis) -> list[str]:
    """Errors that change slowly: readings that follow each other in a pose are more alike than others of it."""
    if last.verdict not in (UNEXPLAINED, INSUFFICIENT) or not last.growth:
        return []
    z = last.growth[-1].residual / last.noise.by_component()[view.component]
    near, far = _alike(view, z)
    square = float(np.mean(z**2))
    if min(len(near), len(far)) < _PAIRS or square == 0.0:
        return []
    correlation = float(np.mean(near) - np.mean(far)) / square
    if correlation < _SUCCESSIVE * np.sqrt(1.0 / len(near) + 1.0 / len(far)):
        return []
    return [
        f"readings that follow each other in a pose are alike (correlation {correlation:.2f}), as a device that "
        "drifts, a robot that creeps or a load that swings makes them: let it settle before reading, or take loads in "
        "another order each time; laws of time and order, and other small ones, may stand for it"
    ]


def _of_settling(last: Diagnosis) -> list[str]:
    """Joints along which readings of one pose scatter, as no law tells."""
    told = last.noise.settles
    if told is None or last.because.why is Why.SETTLES:  # there the verdict says so
        return []
    joints = {joint.joint for joint in last.noise.settling}
    here = [e for e in last.effects if e.set_number == 0 and e.where.get("joint") in joints]
    besides = "".join(f"; or the law of {named_at(e.effect, e.where)} is only close" for e in here)
    return [f"{told}: read each load several times, coming from both sides{besides}"]


def _alike(view: View, z: Array) -> tuple[Array, Array]:
    """Products of normed residuals (M,) of one component of one point in one pose: next to each other in time, and
    all others.
    """
    table, clock = view.table, view.table.clock[view.state]
    series = numbered(table.pose[view.state], table.point[view.state], view.component)
    near, far = [np.zeros(0)], [np.zeros(0)]
    for k in np.unique(series):
        rows = np.flatnonzero(series == k)
        x = z[rows[np.argsort(clock[rows], kind="stable")]]
        near.append(x[1:] * x[:-1])
        far += [x[lag:] * x[:-lag] for lag in range(2, len(x))]
    return np.concatenate(near), np.concatenate(far)


def _of_drawing(view: View, last: Diagnosis) -> list[str]:
    """Geometry has no name in deflections: the file is to be corrected, not the model."""
    law = last.device_law
    if law is None or not law.place.startswith(DRAWING):
        return []
    title = law.terms[0][0].partition(":")[0]
    sags = "" if view.robot.has_weights else (
        "; or the arm's own weight, of which the file tells nothing, turns it by that much: enter masses first"
    )  # fmt: skip
    return [
        f"a {title} explains more than anything else: look at units, zeros and rows of the robot file, correct it and "
        f"diagnose again, or measure absolute positions, in which geometry has a name{sags}"
    ]


def _of_weights(view: View, last: Diagnosis) -> list[str]:
    """A gear sees the arm's weight, which may be what keeps its law from a name."""
    accused = last.localisation.accused.split() if last.localisation is not None else []
    if view.table.kind == "absolute" or last.verdict not in (UNEXPLAINED, INSUFFICIENT):
        return []
    if last.against_sigma:
        return []
    if len(accused) != 2 or accused[0] != "joint" or not untold_weight(view.robot, int(accused[1])):
        return []
    if last.law is not None and last.law.virtual_joint == " ".join(accused) and not last.law.may_hold_weight:
        return []
    return [
        f"joint {accused[1]} carries the arm's weight, which the robot file does not tell: the law of its gear may "
        "look like none of the catalogue for want of that; enter masses and centres of mass and diagnose again"
    ]
