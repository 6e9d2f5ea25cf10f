"""What a robot file says that is probably not what was meant, and what its reduction could not hold."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from fractions import Fraction

import sympy as sp

from symstiff.reduction.complete import left_out
from symstiff.reduction.reduce import Reduction
from symstiff.reduction.template import pattern
from symstiff.robot.exact import Exact
from symstiff.robot.schema import Robot

_NEAR = 2e-4  # rad; an angle rounded to four digits, or printed with three and a little more
_SAME = 1e-12  # rad; the rounding of a double
_QUARTERS, _TWELFTHS = 2, 12  # parts of half a turn


def reduction_remarks(reduction: Reduction) -> list[str]:
    """Remarks about angles that look like rounded ones, and about what has no place in the reduced model."""
    robot = reduction.robot
    return [
        *_of_angles(robot),
        *_of_standing(robot, reduction.experiment.fixed),
        *_of_compliances(robot),
        *_of_aggregations(robot, reduction.inexact_aggregations),
        *left_out(reduction),
    ]


def _of_angles(robot: Robot) -> list[str]:
    """A twist of 1.5708 is no quarter turn: more parameters become identifiable, by a millionth of a radian."""
    found: dict[str, list[str]] = {}
    for place, angle in _angles(robot):
        meant = _meant(float(angle), _QUARTERS)
        if meant is not None:
            told = f'{float(angle):.9g} is not quite {meant}: write "{meant}" where that is meant'
            found.setdefault(told, []).append(place)
    return [f"{', '.join(places)}: {told}" for told, places in found.items()]


def _angles(robot: Robot) -> Iterator[tuple[str, Exact]]:
    """The angles of a robot file, by the place where they stand."""
    for k, joint in enumerate(robot.joint, start=1):
        yield f"alpha of joint {k}", joint.alpha
        yield f"theta of joint {k}", joint.theta
    for name, placement in (("base", robot.base), ("tool", robot.tool)):
        for turn, angle in zip(("roll", "pitch", "yaw"), placement.rpy, strict=True):
            yield f"{turn} in {name}.rpy", angle


def _of_standing(robot: Robot, fixed: Mapping[int, sp.Expr]) -> list[str]:
    """The same of joints that stand still; sums of them make quarter turns too, of parallel axes."""
    found: dict[str, list[str]] = {}
    for joint, angle in fixed.items():
        meant = None if robot.joint[joint - 1].prismatic else _meant(float(angle), _TWELFTHS)
        if meant is not None:
            told = (
                f"standing still at {float(angle):.10g} rad, not quite {meant}: where that is meant, write "
                f'"{meant}", or in a table degrees or all digits'
            )
            found.setdefault(told, []).append(f"q{joint}")
    return [f"{', '.join(joints)} {told}" for told, joints in found.items()]


def _meant(angle: float, parts: int) -> Exact | None:
    """The multiple of pi/parts that an angle [rad] is next to without being it."""
    meant = Exact(pi=Fraction(round(angle / (math.pi / parts)), parts))
    return meant if _SAME < abs(angle - float(meant)) < _NEAR else None


def _of_compliances(robot: Robot) -> list[str]:
    out = []
    for i, link in enumerate(robot.links):
        has = pattern(robot, link.template)
        lost = [k for k, value in link.compliance.items() if value and not has[int(k[0]) - 1][int(k[1]) - 1]]
        if lost:
            place = "base.link" if i == 0 else f"joint[{i}].link"
            out.append(
                f"{place}.compliance: {', '.join(lost)} left out of the model, since template {link.template!r} has no "
                'such term: write template = "full" where it matters'
            )
    return out


def _of_aggregations(robot: Robot, names: Sequence[str]) -> list[str]:
    """Joint compliances that M3 gives to a link whose template cannot hold them."""
    out = []
    for name in names:
        link = int(name[1:]) - 1
        motion = "translation along" if robot.joint[link].prismatic else "rotation about"
        place = "[base.link]" if link == 0 else f"the link of joint {link}"
        out.append(
            f"M3 gives {name} to link {link}, whose template has no terms for a {motion} that joint's axis: "
            f'the model is not complete; write template = "full" in {place}'
        )
    return out
