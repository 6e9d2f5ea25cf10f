"""The weight of the arm as load on its joints: of the masses in the robot file, or of what an arm may weigh.

A gear sees the sum of all loads. Deflections show what the experiment's load adds to the weight's, so a law that is
not linear needs the weight. Where the file tells no masses, a few are tried, each spread along the arm, evenly or
thinning out towards the tool. Such an arm hardly loads the joints of a wrist, whose axes it follows: there bodies are
tried too that hang beside the axis, in a few directions.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from math import cos, pi, sin
from typing import Any

import numpy as np
import sympy as sp

from symstiff.effects.base import Move, Scales, Shape
from symstiff.effects.common import GRAVITY, exact, load_of
from symstiff.robot.schema import Robot
from symstiff.symbolic.chain import ElasticChain
from symstiff.symbolic.terms import actuated_joint, q

Triple = tuple[sp.Expr, sp.Expr, sp.Expr]

MOMENTS = (0.3, 0.9, 2.7)
"""Largest moment of an arm whose masses are not known, over that of the loads: smooth laws are alike within a step."""
NEARER = (0.3, 0.52, 0.9, 1.56, 2.7, 4.7)
"""The same for laws that jump."""
BESIDE = (0.15, 0.4, 1.0)
"""Largest moment of a body beside a joint's axis, over that of the loads."""
BESIDE_NEARER = (0.1, 0.2, 0.4, 0.7, 1.2)
"""The same for laws that jump."""
DIRECTIONS = 6
"""Directions in which it is taken to hang."""
ALONG = 0.05
"""Lever of an arm's weight about an axis, over the reach, below which the arm follows the axis."""
FARTHEST = 0.006
"""What hangs beside an axis is no more than the heaviest body so far from it, over the reach: 36 kg·m of a KR 270."""
DENSEST = 50.0
"""No body of a robot is heavier than this [kg/m³] times the cube of its reach: a UR10 has 8 in all, a KR 270 35."""
TAPERS = {"mass": 0.0, "tapered_mass": 1.0}
"""What a shape's arm of so many kilograms loses of its mass per length from frame 0 to the tool."""
BESIDE_AXIS, TOWARDS = "beside_axis", "towards"
"""Mass times distance [kg·m] of a body beside a joint's axis, and where it is from the x axis of the joint's link."""
TOLD = {
    "mass": "under an arm of {} kg",
    "tapered_mass": "under a tapering arm of {} kg",
    BESIDE_AXIS: "under {} kg·m beside the joint's axis",
    TOWARDS: "{} rad from the x axis of its link",
}
_ASSUMED = (
    "the robot file tells no masses, so the law was taken under an arm of {{}} kg, {}; masses in the file would "
    "decide"
)
ASSUMED = {
    "mass": _ASSUMED.format("spread evenly along it"),
    "tapered_mass": _ASSUMED.format("which thins out evenly from the base to the tool"),
    BESIDE_AXIS: "the robot file tells no masses, so the law was taken under a body that hangs beside the joint's "
    "axis, its mass times its distance {} kg·m; masses in the file would decide",
}
"""What these mean, and take for granted."""
ARM_MOVES = {
    **dict.fromkeys((*TAPERS, BESIDE_AXIS), Move(1.7)),
    TOWARDS: Move(2.0 * pi / DIRECTIONS, added=True, around=True),
}
"""How these lie between the ones that are tried."""
_SHORTEST = 1e-6
"""Length of an arm without lengths [m]."""
_POSES = 500
_NO_LOAD = 1e-6
"""Load of a kilogram that is rounding: the joint's axis is upright [N or N·m]."""


def of_total_load(law: Callable[[sp.Expr], sp.Expr], robot: Robot, joint: int, shape: Shape) -> sp.Expr:
    """A law of a joint's total load as what a deflection shows of it: law(τ_weight + τ) − law(τ_weight)."""
    load, own = load_of(joint), own_load(robot, joint, shape)
    return law(load) if own == 0 else law(own + load) - law(own)


def own_load(robot: Robot, joint: int, shape: Shape) -> sp.Expr:
    """Load of the arm's weight on a joint, as a shape takes it [N or N·m].

    Of the file's masses; none with ``weights = 0``; with one of ``TAPERS`` that of an arm of so many kilograms, with
    ``beside_axis`` that of a body beside the axis.
    """
    if BESIDE_AXIS in shape:
        along, across = hung_load(robot, joint)
        angle = shape[TOWARDS]
        return exact(shape[BESIDE_AXIS]) * (_short(cos(angle)) * along + _short(sin(angle)) * across)
    for name, taper in TAPERS.items():
        if name in shape:
            return exact(shape[name]) * arm_load(robot, joint, taper)
    return weight_load(robot, joint) if shape.get("weights", 1.0) else sp.S.Zero


def weighed(kind: str) -> dict[str, float]:
    """The shape entry for a kind of data: in absolute data τ holds the links' weight already."""
    return {"weights": 0.0} if kind == "absolute" else {}


def assumed_arms(
    robot: Robot, joint: int, scales: Scales, sharp: bool = False
) -> tuple[tuple[Shape, float], ...]:
    """Weights to try where the file tells no mass, as parts of a shape, and the largest load on the joint under each.

    None where they do not load the joint; the heaviest that a robot can be in place of those that are heavier. More of
    them for ``sharp`` laws, which jump.
    """
    if scales.kind == "absolute" or not untold_weight(robot, joint):
        return ()
    top = scales.of(actuated_joint(joint))
    along = tuple(
        ({name: mass}, top + mass * most)
        for name, taper in TAPERS.items()
        if (most := _most_arm_load(robot, joint, taper))
        for mass in _masses(top / most, heaviest(robot), NEARER if sharp else MOMENTS)
    )
    if not (hung := _most_hung_load(robot, joint)) or not _follows(robot, joint):
        return along
    moments = _masses(
        top / hung, FARTHEST * robot.reach * heaviest(robot), BESIDE_NEARER if sharp else BESIDE
    )
    angles = [float(f"{2.0 * pi * k / DIRECTIONS:.4g}") for k in range(DIRECTIONS)]
    return along + tuple(
        ({BESIDE_AXIS: moment, TOWARDS: angle}, top + moment * hung) for moment in moments for angle in angles
    )


def assumed_weights(robot: Robot, scales: Scales) -> tuple[Shape, ...]:
    """The same for what all of the arm's weight does: as parts of a shape, by the joint that it loads most."""
    loaded = {j: _most_arm_load(robot, j, 0.0) for j in range(1, robot.dof + 1)}
    heaviest_on = max(loaded, key=lambda j: loaded[j])
    arms = assumed_arms(robot, heaviest_on, scales)
    return tuple(arm for arm, _ in arms if TAPERS.keys() & arm.keys())


def odds(robot: Robot, shape: Shape) -> float:
    """Prior weight of a shape: directions are ways to be one thing."""
    return 1.0 / DIRECTIONS if TOWARDS in shape else 1.0


def untold_weight(robot: Robot, joint: int) -> bool:
    """Whether the arm's weight may load a joint and the robot file does not tell by how much."""
    if robot.has_weights:
        return False
    return _most_arm_load(robot, joint, 0.0) > 0 or _most_hung_load(robot, joint) > 0


def _follows(robot: Robot, joint: int) -> bool:
    """Whether the arm follows a joint's axis, so that what hangs beside it decides its load."""
    return _most_arm_load(robot, joint, 0.0) < ALONG * robot.reach * float(GRAVITY)


def _masses(unit: float, limit: float, moments: tuple[float, ...]) -> tuple[float, ...]:
    """Masses [kg] for moments over those of the loads, of which ``unit`` makes one."""
    tried = [moment * unit for moment in moments]
    kept = [mass for mass in tried if mass < limit]
    if kept and len(kept) < len(tried):
        kept.append(limit)
    return tuple(dict.fromkeys(min(float(f"{m:.2g}"), limit) for m in kept))


def heaviest(robot: Robot) -> float:
    """What no body of a robot weighs more than [kg]."""
    return max(DENSEST * robot.reach**3, 1.0)


@lru_cache(maxsize=256)
def weight_load(robot: Robot, joint: int) -> sp.Expr:
    """Load of the robot file's masses on an actuated joint, −∂U/∂q_j, an expression in q [N or N·m]."""
    heavy = {i: link for i, link in enumerate(robot.links) if link.mass}
    bodies = {i: (exact(link.mass), tuple(map(exact, link.com))) for i, link in heavy.items()}
    return _load_of_bodies(ElasticChain(robot), joint, bodies)


@lru_cache(maxsize=256)
def most_weight_load(robot: Robot, joint: int) -> float:
    """The largest size of ``weight_load`` in random poses within the joints' limits [N or N·m]; 0 for rounding."""
    return _but_rounding(float(np.max(np.abs(_in_poses(robot, weight_load(robot, joint))))))


@lru_cache(maxsize=256)
def arm_load(robot: Robot, joint: int, taper: float) -> sp.Expr:
    """The same of one kilogram along the arm, from frame 0 to the tool: even, or down to nothing with a taper of 1."""
    return _load_of_bodies(ElasticChain(robot), joint, _along(robot, taper))


def under_arm(robot: Robot, shape: Shape) -> Robot:
    """The robot with the links' masses that a shape takes for granted with one of ``TAPERS``; as it is without."""
    for name, taper in TAPERS.items():
        if name in shape:
            hung = _along(robot, taper)
            joints = (
                j.model_copy(update={"link": j.link.model_copy(update=_heavy(shape[name], *hung[i]))})
                for i, j in enumerate(robot.joint, 1)
            )
            return robot.model_copy(update={"joint": tuple(joints)})
    return robot


def _heavy(arm: float, share: sp.Expr, com: Triple) -> dict[str, Any]:
    """What a link of an arm of so many kilograms has of it."""
    return {"mass": arm * float(share), "com": tuple(map(float, com))}


def _along(robot: Robot, taper: float) -> dict[int, tuple[sp.Expr, Triple]]:
    """Masses and centres of mass, in the DH frames of its links, of one kilogram that is spread along the arm.

    What slides is as long as its stroke, and hangs whole at the frame that it moves.
    """
    chain = ElasticChain(robot)
    tip = chain.tool_offset()
    ends = [(row.a.sympy(), row.d.sympy()) for row in chain.rows] + [tip]
    stretches = [float(sp.sqrt(sum(x**2 for x in end))) for end in ends]
    strokes = [float(np.ptp(joint.range)) if joint.prismatic else 0.0 for joint in robot.joint]
    hung = [exact(f"{x:.4f}") for x in _hung(stretches, strokes, taper)]
    n = chain.dof
    bodies: dict[int, tuple[sp.Expr, Triple]] = {i: (hung[i], (sp.S.Zero,) * 3) for i in range(1, n)}
    last = hung[n] + hung[n + 1]
    bodies[n] = (last, tuple(x * hung[n + 1] / last for x in tip) if last else (sp.S.Zero,) * 3)
    return bodies


def _hung(stretches: Sequence[float], strokes: Sequence[float], taper: float) -> list[float]:
    """Shares of an arm's mass at frame 0, …, n and the tool that load the joints as the arm does.

    A stretch between two frames hangs at both of them, by where its centre of mass is.
    """
    whole = max(sum(stretches) + sum(strokes), _SHORTEST)
    shares, begin = [0.0] * (len(stretches) + 1), 0.0
    for k, (stretch, stroke) in enumerate(zip(stretches, [*strokes, 0.0], strict=True)):
        length, slid = stretch / whole, stroke / whole
        mass = length * (1.0 - taper * (begin + length / 2.0))
        beyond = length * ((1.0 - taper * begin) / 2.0 - taper * length / 3.0)
        begin += length
        shares[k] += mass - beyond
        shares[k + 1] += beyond + slid * (1.0 - taper * (begin + slid / 2.0))
        begin += slid
    return [share / max(sum(shares), _SHORTEST) for share in shares]


@lru_cache(maxsize=256)
def hung_load(robot: Robot, joint: int) -> tuple[sp.Expr, sp.Expr]:
    """Load of one kilogram in a metre from a turning joint's axis, along its link's x axis and across [N·m]."""
    if robot.joint[joint - 1].prismatic:
        return sp.S.Zero, sp.S.Zero
    chain = ElasticChain(robot)
    upward = _upward(chain)
    for i in range(1, joint):
        upward = _about_x(_about_z(upward, chain.angle(i)), chain.rows[i - 1].alpha.sympy())
    along, across, _ = _about_z(upward, chain.angle(joint))
    return -GRAVITY * sp.diff(along, q(joint)), -GRAVITY * sp.diff(across, q(joint))


@lru_cache(maxsize=256)
def _most_hung_load(robot: Robot, joint: int) -> float:
    """The largest size of ``hung_load`` in any direction, in random poses within the joints' limits [N·m]."""
    found = np.hypot(*(_in_poses(robot, part) for part in hung_load(robot, joint)))
    return _but_rounding(float(np.max(found)))


@lru_cache(maxsize=256)
def _most_arm_load(robot: Robot, joint: int, taper: float) -> float:
    """The largest size of ``arm_load`` in random poses within the joints' limits [N or N·m]; 0 for rounding."""
    return _but_rounding(float(np.max(np.abs(_in_poses(robot, arm_load(robot, joint, taper))))))


def _in_poses(robot: Robot, load: sp.Expr) -> np.ndarray:
    """A load in random poses within the joints' limits."""
    names = [q(i + 1) for i in range(robot.dof)]
    low, high = robot.ranges.T
    poses = np.random.default_rng(0).uniform(low, high, (_POSES, robot.dof))
    return np.asarray(sp.lambdify(names, load, "numpy")(*poses.T))


def _but_rounding(load: float) -> float:
    return load if load > _NO_LOAD else 0.0


def _short(x: float) -> sp.Rational:
    """A direction's cosine or sine."""
    return exact(f"{x:.4f}")


def _load_of_bodies(
    chain: ElasticChain, joint: int, bodies: Mapping[int, tuple[sp.Expr, tuple[sp.Expr, ...]]]
) -> sp.Expr:
    """−∂U/∂q_j of masses [kg] with their centres in the DH frame of their body [m]."""
    if not any(i >= joint for i in bodies):
        return sp.S.Zero
    energy, height, upward = sp.S.Zero, sp.S.Zero, _upward(chain)
    for i in range(1, chain.dof + 1):
        turned = _about_z(upward, chain.angle(i))
        height += sum(x * u for x, u in zip(chain.offset(i), turned, strict=True))
        upward = _about_x(turned, chain.rows[i - 1].alpha.sympy())
        if i in bodies:
            mass, centre = bodies[i]
            own = height + sum(x * u for x, u in zip(centre, upward, strict=True))
            energy += mass * GRAVITY * own
    return -sp.diff(energy, q(joint))


def _upward(chain: ElasticChain) -> Triple:
    """The world's upward direction in the axes of frame 0."""
    axes: Triple = (sp.S.Zero, sp.S.Zero, sp.S.One)
    for motion in chain.base:
        if motion.kind[0] == "r":
            angle = motion.value.sympy()
            axes = (
                _about_x(axes, angle) if motion.kind == "rx"
                else _about_z(axes, angle) if motion.kind == "rz"
                else _about_y(axes, angle)
            )  # fmt: skip
    return axes


def _about_z(v: Triple, angle: sp.Expr) -> Triple:
    """Components of v in axes turned about z: Rzᵀ·v."""
    c, s = sp.cos(angle), sp.sin(angle)
    return c * v[0] + s * v[1], c * v[1] - s * v[0], v[2]


def _about_x(v: Triple, angle: sp.Expr) -> Triple:
    c, s = sp.cos(angle), sp.sin(angle)
    return v[0], c * v[1] + s * v[2], c * v[2] - s * v[1]


def _about_y(v: Triple, angle: sp.Expr) -> Triple:
    c, s = sp.cos(angle), sp.sin(angle)
    return c * v[0] - s * v[2], v[1], c * v[2] + s * v[0]
