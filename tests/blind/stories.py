"""What can be hidden: every effect of the catalogue in the simulator's shapes, and others outside of it.

A story makes its effect as large as anyone would believe; the generator scales it down to the wanted
noncentrality.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from symstiff.calibration.simulation import SHAPES, Effect
from symstiff.errors import UserError
from symstiff.robot import Robot

Where = dict[str, Any]
LOADED = 0.02
"""Share of the largest joint load from which a joint counts as loaded."""


@dataclass(frozen=True)
class Draw:
    """What a story may lean on: the robot, its compliances, the loads on its joints, and random numbers."""

    robot: Robot
    values: Mapping[str, float]
    torque: np.ndarray
    """(n,) largest load on each joint, the weight of an arm whose file tells none included."""
    force: float
    """Largest force [N]."""
    span: float
    """Length of the session [s]."""
    angles: np.ndarray
    """Distinct values of joint 2."""
    labels: tuple[str, ...]
    rng: np.random.Generator

    def joint(self, *, turning: bool = False, but: int = 0) -> int:
        """A joint that carries a load, one excepted."""
        return int(self.rng.choice(self.joints(turning=turning, but=but)))

    def joints(self, *, turning: bool = False, but: int = 0) -> list[int]:
        """The joints that carry a load, or all where none does, one excepted."""
        fits = [j + 1 for j in range(self.robot.dof) if not (turning and self.robot.joint[j].prismatic)]
        loaded = [j for j in fits if self.torque[j - 1] > LOADED * self.torque.max()]
        return [j for j in loaded if j != but] or [j for j in fits if j != but]

    def link(self, first: int = 1) -> int:
        return int(self.rng.integers(first, self.robot.dof))

    def load(self, joint: int) -> float:
        return float(self.torque[joint - 1])

    def compliance(self, joint: int) -> float:
        return float(self.values[f"c{joint}"])

    def vector(self, size: float, n: int = 3) -> list[float]:
        v = self.rng.normal(size=n)
        return [float(x) for x in v / np.linalg.norm(v) * size]

    def uniform(self, low: float, high: float) -> float:
        return float(self.rng.uniform(low, high))

    def sign(self) -> float:
        return float(self.rng.choice([-1.0, 1.0]))


Made = tuple[Effect, Where]
Maker = Callable[[Draw], Made]


@dataclass(frozen=True)
class Story:
    """One way of hiding one effect; ``context`` and ``levels`` are what the design must offer."""

    name: str
    kind: str
    make: Maker
    context: str = ""
    levels: int = 1
    robots: tuple[str, ...] = ()
    """Robots that it fits; empty for all."""


TEMPLATE = {"11", "22", "33", "44", "55", "66", "26", "35"}
PAIRS = [f"{r}{c}" for r in range(1, 7) for c in range(r + 1, 7)]


def at_joint(effect: str, shape: str, values: Callable[[Draw, int], dict[str, Any]]) -> Maker:
    def make(d: Draw) -> Made:
        j = d.joint()
        return Effect(effect, {"joint": j}, shape, values(d, j)), {"joint": j}

    return make


def block(effect: str, link: Callable[[Draw], int]) -> Maker:
    """A few entries outside the beam's template, as large as a sound compliance allows."""

    def make(d: Draw) -> Made:
        i = link(d)
        chosen = d.rng.choice([p for p in PAIRS if p not in TEMPLATE], 3, replace=False)
        entries = {}
        for pair in chosen:
            r, c = str(pair)
            size = np.sqrt(d.values[f"k{i}_{r}{r}"] * d.values[f"k{i}_{c}{c}"])
            entries[f"{r}{c}"] = float(d.uniform(0.5, 0.9) * d.sign() * size)
        return Effect(
            effect, {"link": i} if effect == "link_asymmetry" else None, "entries", {"entries": entries}
        ), {"link": i}

    return make


def tilted(d: Draw) -> Made:
    i = d.link()
    values = {"angle": 0.6, "axis": d.vector(1.0)}
    return Effect("link_asymmetry", {"link": i}, "tilted", values), {"link": i}


def rocking(d: Draw) -> Made:
    values = {
        "c": 4.0 * d.values["k0_55"],
        "direction": [d.uniform(-1, 1), d.uniform(-1, 1), 0.0],
        "height": 0.5,
    }
    return Effect("base_compliance", None, "rocking", values), {"link": 0}


def compensator(shape: str) -> Maker:
    def make(d: Draw) -> Made:
        c = d.compliance(2)
        if shape in ("spring", "moment"):
            scale = {"kuka_kr270": 1.0, "ur10": 0.4}.get(d.robot.name, 0.3)
            values: dict[str, Any] = {
                "rate": 3.0 / c * scale**-2, "L": 0.18472 * scale, "ax": 0.68593 * scale, "ay": 0.1233 * scale,
                "s0": 0.458 * scale, "zero": d.uniform(-3, 3),
            }  # fmt: skip
            if shape == "moment":  # the file has the anchor's direction right
                values |= {"zero": 0.0, "preload": 1.0}
        elif shape == "cosine":
            values = {"c": 0.6 * c, "phase": d.uniform(-3, 3)}
        else:
            values = {"c": [0.6 * c * d.uniform(-1, 1) for _ in d.angles], "angles": d.angles.tolist()}
        form = "spring" if shape == "moment" else shape
        return Effect("gravity_compensator", {"joint": 2}, form, values), {"joint": 2}

    return make


def coupling(shape: str) -> Maker:
    def make(d: Draw) -> Made:
        n = d.robot.dof
        j, k = sorted(int(x) for x in d.rng.choice([n - 2, n - 1, n], 2, replace=False))
        size = 0.5 * np.sqrt(d.compliance(j) * d.compliance(k))
        extra = {"tau0": 0.5 * max(d.load(j), d.load(k))} if shape == "saturating" else {}
        effect = Effect("wrist_coupling", {"joints": [j, k]}, shape, {"c": float(size) * d.sign(), **extra})
        return effect, {"joints": [j, k]}

    return make


def harmonics(shape: str) -> Maker:
    def make(d: Draw) -> Made:
        j, n = d.joint(turning=True), int(d.rng.integers(2, 13))
        where = {"joint": j, "harmonics": [n]}
        if shape == "triangle":
            values: dict[str, Any] = {"a": 3e-3, "harmonic": float(n), "phase": d.uniform(0, 6)}
        else:
            a, b = d.vector(3e-3, 2)
            values = {"a": a, "b": b, "harmonics": [float(n)]}
            if shape == "loaded":
                values["beta"] = 0.1 / d.load(j)
        return Effect("transmission_error", {"joint": j}, shape, values), where

    return make


def waves(turns: Sequence[int], which: float) -> tuple[Story, ...]:
    """Waves of several numbers a turn in one gear, a story each; ``which`` in [0, 1) tells the joint."""

    def of(n: int) -> Maker:
        def make(d: Draw) -> Made:
            joints = d.joints(turning=True)
            j, (a, b) = joints[int(which * len(joints))], d.vector(3e-3, 2)
            values = {"a": a, "b": b, "harmonics": [float(n)]}
            return Effect("transmission_error", {"joint": j}, "harmonics", values), {
                "joint": j,
                "harmonics": [n],
            }

        return make

    return tuple(Story(f"transmission {n} a turn", "absolute", of(int(n))) for n in turns)


def drift(shape: str, bends: bool = False) -> Maker:
    clock = shape.rsplit("_", maxsplit=1)[-1]

    def make(d: Draw) -> Made:
        per = {"time": 1.0 / d.span, "temperature": 1.0 / 4.0, "exponential": 1.0}[clock]
        values: dict[str, Any] = {"rate": d.vector((1e-4 if bends else 3e-3) * per)}
        if clock == "exponential":
            values["T"] = d.uniform(0.2, 0.8) * d.span
        if bends:
            values["turn"] = d.vector(1e-3 * per)
        where: Where = {"link": d.link()} if shape.startswith("link") else {"measurement": "frame"}
        return Effect("thermal_drift", where, shape, values), where

    return make


def bias(shape: str) -> Maker:
    def make(d: Draw) -> Made:
        values: dict[str, Any] = {"bias": [*d.vector(0.15 * d.force), *d.vector(0.05 * d.force)]}
        if shape == "drifting":
            values["T"] = d.uniform(0.3, 0.8) * d.span
        return Effect("force_sensor_bias", None, shape, values), {"load": "force_sensor"}

    return make


def payload(shape: str) -> Maker:
    def make(d: Draw) -> Made:
        mass = 0.2 * d.force / 9.81
        return Effect("payload_error", None, shape, {"dm": mass, "dmc": d.vector(0.2 * mass)}), {
            "load": "payload"
        }

    return make


def turned(effect: str, where: Where, shape: str = "rotation") -> Maker:
    return lambda d: (Effect(effect, None, shape, {"rotation": d.vector(0.08)}), where)


def geometry(d: Draw) -> Made:
    i = d.link(1)
    return (
        Effect("geometric_error", {"link": i}, "constant", {"shift": [*d.vector(5e-3), *d.vector(5e-3)]}),
        {"link": i},
    )


def link_weight(d: Draw) -> Made:
    i = d.link(2)
    mass = 0.6 * d.force / 9.81
    return (
        Effect("link_weight", {"link": i}, "lumped", {"mass": mass, "com": d.vector(0.15)}),
        {"link": i},
    )


def one_bad(d: Draw) -> Made:
    label = str(d.rng.choice(d.labels))
    return Effect("bad_poses", None, "shift", {"poses": [label], "shift": d.vector(5e-3)}), {"rows": [label]}


def hidden_compliance(effect: str) -> Maker:
    """The model lacks what the robot has: the generator leaves it out of the start model."""

    def make(d: Draw) -> Made:
        if effect == "joint_compliance":
            j = d.joint()
            return Effect(effect, {"joint": j}, "linear", {"c": d.compliance(j)}), {"joint": j}
        i = d.link()
        entries = {k.split("_")[1]: v for k, v in d.values.items() if k.startswith(f"k{i}_")}
        return Effect(effect, {"link": i}, "entries", {"entries": entries}), {"link": i}

    return make


ONE: tuple[Story, ...] = (
    Story("backlash tanh", "deflection", at_joint("backlash", "tanh", lambda d, j: {
        "gap": 2e-3, "knee": d.uniform(0.005, 0.05) * d.load(j)})),
    Story("backlash ramp", "deflection", at_joint("backlash", "ramp", lambda d, j: {
        "gap": 2e-3, "knee": d.uniform(0.01, 0.1) * d.load(j)})),
    Story("backlash arctan", "deflection", at_joint("backlash", "arctan", lambda d, j: {
        "gap": 2e-3, "knee": d.uniform(0.005, 0.05) * d.load(j)})),
    Story("nonlinear cubic", "deflection", at_joint("nonlinear_stiffness", "polynomial", lambda d, j: {
        "c3": 2 * d.sign() * d.compliance(j) / d.load(j) ** 2})),
    Story("nonlinear tanh", "deflection", at_joint("nonlinear_stiffness", "tanh", lambda d, j: (lambda t: {
        "a": 2 * d.compliance(j) * t, "tau0": t})(d.uniform(0.25, 0.6) * d.load(j)))),
    Story("nonlinear two slopes", "deflection", at_joint("nonlinear_stiffness", "two_slope", lambda d, j: {
        "c": 2 * d.compliance(j), "knee": d.uniform(0.2, 0.6) * d.load(j)})),
    Story("nonlinear power", "deflection", at_joint("nonlinear_stiffness", "power", lambda d, j: {
        "a": 2 * d.compliance(j) * d.load(j), "tau0": d.load(j), "exponent": 0.6})),
    Story("hysteresis constant", "deflection", at_joint("hysteresis", "constant", lambda d, j: {
        "width": 1e-3, "knee": 0.03 * d.load(j)}), "branch", 3),
    Story("hysteresis sqrt", "deflection", at_joint("hysteresis", "sqrt", lambda d, j: {
        "width": 1e-3, "knee": 0.03 * d.load(j), "tau_ref": 0.5 * d.load(j)}), "branch", 3),
    Story("hysteresis loop", "deflection", at_joint("hysteresis", "loop", lambda d, j: {
        "width": 1e-3, "knee": 0.03 * d.load(j), "tau_max": 1.2 * d.load(j)}), "branch", 3),
    Story("compensator spring", "deflection", compensator("spring"), robots=("kuka_kr270", "ur10")),
    Story("compensator cosine", "deflection", compensator("cosine"), robots=("kuka_kr270", "ur10")),
    Story("compensator by angle", "deflection", compensator("per_angle"), "levels", robots=("kuka_kr270",)),
    Story("coupling", "deflection", coupling("linear"), robots=("kuka_kr270", "ur10", "franka_panda")),
    Story("coupling saturating", "deflection", coupling("saturating"), robots=("kuka_kr270", "ur10")),
    Story("asymmetry", "deflection", block("link_asymmetry", lambda d: d.link())),
    Story("asymmetry tilted", "deflection", tilted),
    Story("base", "deflection", block("base_compliance", lambda d: 0)),
    Story("base rocking", "deflection", rocking),
    Story("tool", "deflection", block("tool_compliance", lambda d: d.robot.dof)),
    Story("link left out", "deflection", hidden_compliance("link_compliance"), "start"),
    Story("joint left out", "deflection", hidden_compliance("joint_compliance"), "start"),
    Story("bias", "deflection", bias("constant")),
    Story("sensor turned", "deflection", turned("force_sensor_misalignment", {"load": "force_sensor"})),
    Story("flange sensor turned", "deflection",
        turned("force_sensor_misalignment", {"load": "force_sensor"}, "tool")),
    Story("flange sensor bias", "deflection", bias("tool")),
    Story("frame turned", "deflection", turned("frame_misalignment", {"measurement": "frame"})),
    Story("payload", "deflection", payload("load")),
    *(Story(f"drift {s}", "deflection", drift(s), "clock") for s in (
        "time", "temperature", "exponential", "link_time", "link_temperature")),
    Story("large deflection", "deflection", lambda d: (Effect("large_deflection"), {"robot": "all"}), "heavy", 3),
    Story("offset", "absolute", at_joint("joint_offset", "constant", lambda d, j: {"offset": 5e-3 * d.sign()})),
    *(Story(f"transmission {s}", "absolute", harmonics(s)) for s in ("harmonics", "triangle", "loaded")),
    Story("geometry", "absolute", geometry),
    Story("weight", "absolute", link_weight),
    Story("payload absolute", "absolute", payload("tool")),
)  # fmt: skip

RARE = (
    *(
        Story(f"bending {clock} {kind}", kind, drift(f"link_{clock}", bends=True), "clock")
        for kind in ("deflection", "absolute")
        for clock in ("time", "temperature", "exponential")
    ),
    Story("compensator moment", "absolute", compensator("moment"), robots=("kuka_kr270",)),
)
"""Stories that are told when they are asked for, and not drawn."""

BAD_POSE = Story("bad pose", "deflection", one_bad)


def other(effect: str, shape: str, values: Callable[[Draw, int, int], dict[str, Any]], but: int = 0) -> Maker:
    def make(d: Draw) -> Made:
        j = d.joint(turning=True, but=but)
        k = d.joint(turning=True, but=j)
        if d.load(k) <= LOADED * d.torque.max():
            raise UserError("no second joint carries a load")
        where = {"joint": j} if SHAPES[effect, shape].place == "joint" else {"joints": [j, k]}
        return Effect(effect, where, shape, values(d, j, k)), {}

    return make


def bent_link(d: Draw) -> Made:
    i = d.link()
    values = {"fraction": 0.9, "joint": float(d.joint(turning=True)), "order": 1.0, "phase": d.uniform(0, 6)}
    return Effect("configuration_dependent_link", {"link": i}, "sine", values), {}


def slipping(d: Draw) -> Made:
    values = {"c": 3 * d.values["k0_55"], "axis": 5.0, "threshold": 0.4 * d.force, "width": 0.02 * d.force}
    return Effect("base_slip", None, "threshold", values), {}


OUTSIDE: tuple[Story, ...] = (
    Story("angle of another joint", "deflection", other("angle_dependent_compliance", "cosine", lambda d, j, k: {
        "c": 0.9 * d.compliance(j), "order": float(d.rng.choice([1.0, 2.0])), "phase": d.uniform(0, 6)})),
    Story("product of loads", "deflection", other("load_product", "product", lambda d, j, k: {
        "c": d.compliance(j) / max(d.load(k), 1e-9)})),
    Story("magnitude of a load", "deflection", other("load_product", "magnitude", lambda d, j, k: {
        "c": d.compliance(j) / max(d.load(k), 1e-9)})),
    Story("soft spot", "deflection", other("local_bump", "compliance", lambda d, j, k: {
        "c": 3 * d.compliance(j), "center": d.uniform(-1, 1), "width": 0.9}, but=2)),  # joint 2's is a compensator
    Story("creep", "deflection", other("creep", "exponential", lambda d, j, k: {
        "c": 0.9 * d.compliance(j), "T": 0.4 * d.span}), "clock"),
    Story("softening when warm", "deflection", other("thermal_softening", "linear", lambda d, j, k: {
        "c": 0.3 * d.compliance(j)}), "clock"),
    Story("link that depends on a joint", "deflection", bent_link),
    Story("slipping base", "deflection", slipping),
    Story("device with scales", "deflection", lambda d: (
        Effect("device_scale", None, "axes", {"scale": d.vector(0.05)}), {})),
    Story("sensor with gains", "deflection", lambda d: (
        Effect("force_sensor_gain", None, "axes", {"gain": d.vector(0.1, 6)}), {})),
)  # fmt: skip
