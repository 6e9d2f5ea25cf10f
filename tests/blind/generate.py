"""Cases: a design, a hidden truth scaled to a wanted noncentrality, and the table that the workflow sees."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np

from symstiff.calibration.fits.decomposition import column_space
from symstiff.calibration.simulation import Effect, Noise, Truth, nominal_truth, simulate
from symstiff.calibration.tables.measurements import Measurements, measurements
from symstiff.discrepancy.bridge.assemble import assemble
from symstiff.discrepancy.climb import frames_of
from symstiff.errors import UserError
from symstiff.model import StiffnessModel
from symstiff.reduction.reduce import reduce
from symstiff.robot import Robot, load
from tests.blind.lacking import rigid_links, without
from tests.blind.nuisance import Whitener, drawn, settling, torques_of_weights, weighing
from tests.blind.sizes import Unfit, noise_free, noncentrality, scaled
from tests.blind.stories import BAD_POSE, ONE, OUTSIDE, RARE, Draw, Story, Where, waves

FORCE = {"kuka_kr270": 2200.0, "ur10": 110.0, "franka_panda": 50.0, "scara": 60.0}
LAMBDAS = (10.0, 25.0, 60.0, 150.0, 600.0)
CLASSES = ("nothing", "one", "two", "outside", "confounded", "untestable", "bad_pose")
SHARES = (0.22, 0.42, 0.12, 0.12, 0.04, 0.04, 0.04)
GEOMETRY = 1.5
"""Noncentrality that the second-order geometry of the deflection may have where it is not the story."""
WEIGHING = 0.5
"""Part of the deflections whose arm weighs something that the robot file could tell and does not."""
LEAST_FREEDOM = 30
CONSTANT = ("offset", "geometry")
"""Stories of which nothing is left beside the frames of all links."""
_TRIES = 60


@dataclass(frozen=True)
class Options:
    """What may be drawn; the reduced benchmark draws from less."""

    robots: tuple[str, ...] = tuple(FORCE)
    poses: tuple[int, ...] = (15, 30, 60)
    levels: tuple[int, ...] = (1, 3, 5)
    markers: tuple[int, ...] = (1, 3)
    classes: tuple[str, ...] = CLASSES
    shares: tuple[float, ...] = SHARES
    lambdas: tuple[float, ...] = LAMBDAS
    seed: int = 4
    most_rows: int = 1400
    story: str = ""
    """Of single effects this one alone."""
    mild: bool = False
    """Robots repeat to a third of the noise, and the file tells all masses."""
    off: float = 0.0
    """Absolute positions alone, of arms whose frames are all off by errors of this size, m and rad."""
    waves: bool = False
    """Of pairs waves of two numbers a turn in one gear alone."""
    settling: float = 0.0
    """Error of one joint, another at every reading, in units of sigma at the tool."""


@dataclass(frozen=True)
class Label:
    """The truth: never in the table, never read by the workflow."""

    number: int
    kind: str
    robot: str
    story: tuple[str, ...]
    truth: tuple[tuple[str, Where], ...]
    wanted: float
    noncentrality: tuple[float, ...]
    geometry: float
    design: dict[str, Any]
    stated: float


@dataclass(frozen=True)
class Case:
    """A table, the model to start from, and the label that the scoring keeps."""

    label: Label
    table: Measurements
    model: StiffnessModel
    signal: np.ndarray = field(repr=False)
    """(rows, 6) what the hidden effects add to the noise-free values: for the oracle."""
    parts: tuple[np.ndarray, ...] = field(repr=False)
    """The same for each effect alone."""
    whitened: Callable[[np.ndarray], np.ndarray] = field(repr=False)
    """(rows, 3, …) -> the same in units of the noise, the error that a pose's rows share included."""


@dataclass(frozen=True)
class Scene:
    """A design before anything is hidden; ``basis`` spans the current model, whitened."""

    robot: Robot
    body: Robot
    """The same with what its links weigh, where the file does not tell."""
    values: dict[str, float]
    table: Measurements
    noise: Noise
    loads: str
    model: StiffnessModel
    spread: np.ndarray
    """(rows, 3) each row's own standard deviation."""
    whitened: Callable[[np.ndarray], np.ndarray]
    basis: np.ndarray
    excess: np.ndarray
    """(rows, 6) what the noise-free values hold beyond the rigid robot in the device's placement."""


def cases(count: int, options: Options, start: int = 0) -> list[Case]:
    """Cases ``start`` to ``start + count``; each depends on its number and the options' seed alone."""
    return [case(start + k, options) for k in range(count)]


def case(number: int, options: Options) -> Case:
    """Draw one case; where a story does not fit the design, another story is drawn."""
    rng = np.random.default_rng([options.seed, number])
    share = np.array(options.shares[: len(options.classes)])
    kind = str(rng.choice(options.classes, p=share / share.sum()))
    wanted = float(rng.choice(options.lambdas)) if kind not in ("nothing", "untestable") else 0.0
    if kind in ("two", "bad_pose", "outside"):
        wanted = float(rng.choice([x for x in options.lambdas if x >= 60] or [options.lambdas[-1]]))
    for _ in range(_TRIES):
        stories = _stories(kind, rng, options)
        try:
            return _case(number, kind, stories, wanted, rng, options)
        except (Unfit, UserError, ZeroDivisionError):  # no equilibrium at that size, or nothing to be seen
            continue
    raise RuntimeError(f"no story of kind {kind} fits case {number}")


def _stories(kind: str, rng: np.random.Generator, options: Options) -> tuple[Story, ...]:
    if kind == "nothing":
        return ()
    pool = {"outside": OUTSIDE, "bad_pose": (BAD_POSE,)}.get(kind, ONE)
    if options.off:
        pool = tuple(s for s in pool if s.kind == "absolute" and s.name not in CONSTANT)
    if kind == "two" and options.waves:
        return waves(rng.choice(np.arange(1, 17), 2, replace=False), float(rng.random()))
    if kind == "two":
        pool = tuple(s for s in pool if s.context not in ("heavy", "start"))
        first = pool[int(rng.integers(len(pool)))]
        pool = tuple(s for s in pool if s.kind == first.kind and s.name.split()[0] != first.name.split()[0])
        return first, pool[int(rng.integers(len(pool)))]
    if kind == "untestable":
        pool = tuple(s for s in ONE if s.name in ("tool", "joint left out", "link left out"))
    if kind == "confounded":
        pool = tuple(
            s for s in ONE if s.name.split()[0] in ("backlash", "compensator", "base", "sensor", "frame")
        )
    if kind == "one" and options.story:
        pool = tuple(s for s in (*pool, *RARE) if s.name == options.story)
    return (pool[int(rng.integers(len(pool)))],)


def _case(
    number: int,
    kind: str,
    stories: Sequence[Story],
    wanted: float,
    rng: np.random.Generator,
    options: Options,
) -> Case:
    scene = _scene(stories, rng, options)
    scene = _limited(scene, rng, wanted if any(s.context == "heavy" for s in stories) else 0.0)
    draw, base = _draw(scene, rng), scene.values
    made = [(story, *story.make(draw)) for story in stories]
    if len({(e.effect, repr(sorted(w.items()))) for _, e, w in made}) < len(made):
        raise Unfit  # two of one name are one
    for story, _, where in made:
        if story.context == "start" and kind != "untestable":
            base = without(base, where)
            scene = _with_model(scene, _lacking(scene, where), base)
    hidden = [e for story, e, _ in made if story.context != "heavy"]
    effects, found = scaled(scene, base, hidden, wanted, kind)
    clean = noise_free(scene, base, ())
    geometry = noncentrality(scene, scene.excess)
    if any(story.context == "heavy" for story, _, _ in made):
        found = (*found, geometry)
    stated = float(rng.choice([1.0, 1.0, 1.0, 0.8, 1.2]))
    truth = Truth(scene.body, base, (*effects, *_off(scene.robot, options.off, rng)), scene.noise)
    table = simulate(truth, scene.table, int(rng.integers(2**31)))
    size = float(np.sqrt(np.mean(scene.spread**2)))
    table = replace(table, sigma=np.where(table.measured, size * stated, np.nan))
    named = () if kind in ("nothing", "outside", "untestable") else tuple((e.effect, w) for _, e, w in made)
    label = Label(
        number, kind, scene.robot.name, tuple(s.name for s in stories), named, wanted, found, geometry,
        _described(scene, size), stated,
    )  # fmt: skip
    parts = tuple(noise_free(scene, base, (e,)) - clean for e in effects)
    signal = noise_free(scene, base, effects) - clean
    return Case(label, table, scene.model, signal, parts, scene.whitened)


def _off(robot: Robot, size: float, rng: np.random.Generator) -> list[Effect]:
    """Errors of all frames, such as an arm has that nobody calibrated."""
    shifts = [size * rng.normal(size=6) for _ in range(robot.dof if size else 0)]
    return [
        Effect("geometric_error", {"link": i}, "constant", {"shift": shift.tolist()})
        for i, shift in enumerate(shifts, 1)
    ]


def _described(scene: Scene, size: float) -> dict[str, Any]:
    table = scene.table
    return {
        "data": table.kind,
        "loads": scene.loads,
        "poses": len(table.labels),
        "levels": len(np.unique(np.round(np.linalg.norm(table.w[table.pose == 0], axis=1), 6))),
        "coordinates": 3 * len(table.points),
        "sigma_mm": size * 1e3,
        "approach_mm": float(scene.noise.approach_mm[0]),
        "approach_mrad": float(scene.noise.approach_mrad),
        "unloaded_mm": float(scene.noise.unloaded_mm[0]),
        "weighs": sum(link.mass for link in scene.body.links) if scene.body is not scene.robot else 0.0,
        "freedom": 3 * len(table) - scene.basis.shape[1],
        "branch": bool(np.isfinite(table.branch).any()),
        "clock": bool(np.isfinite(table.time).any()),
    }


def _scene(stories: Sequence[Story], rng: np.random.Generator, options: Options) -> Scene:
    fits = [r for r in options.robots if all(not s.robots or r in s.robots for s in stories)]
    if not fits:
        raise Unfit
    robot = load(str(rng.choice(fits)))
    data = stories[0].kind if stories else str(rng.choice(["deflection", "deflection", "absolute"]))
    data = "absolute" if options.off else data
    if any(s.name == "joint left out" for s in stories):
        robot = rigid_links(robot)
    least = max((s.levels for s in stories), default=1)
    levels = [n for n in options.levels if n >= least]
    if not levels:
        raise Unfit
    contexts = {s.context for s in stories}
    table = _design(robot, data, int(rng.choice(levels)), contexts, rng, options)
    values = {n: v * float(np.exp(0.25 * rng.normal())) for n, v in nominal_truth(robot).items()}
    for link in range(
        robot.dof + 1
    ):  # couplings between bending and shift keep the size that a beam gives them
        for diagonal, moment, mixed, sign in (("22", "66", "26", 1), ("33", "55", "35", -1)):
            if f"k{link}_{mixed}" in values:
                size = np.sqrt(values[f"k{link}_{diagonal}"] * values[f"k{link}_{moment}"])
                values[f"k{link}_{mixed}"] = sign * 0.75 * float(size)
    noise = drawn(robot, table, rng, options.mild)
    if options.settling:
        noise = replace(
            noise, settling_mrad=settling(robot, table, options.settling * noise.sigma_mm[0], rng)
        )
    loads = "wrench" if table.w[:, [0, 1, 3, 4, 5]].any() else "gravity"
    if data == "absolute":
        loads = "wrench"
    model = _complete(robot, loads)
    model = model.with_effects(frames_of(robot)) if options.off else model
    spread = simulate(Truth(robot, values, (), noise), table, 1).sigma[:, :3]
    white = Whitener(robot, table, noise, spread)
    unknown = data == "deflection" and not options.mild and not any(link.mass for link in robot.links)
    body = weighing(robot, FORCE[robot.name], rng) if unknown and rng.random() < WEIGHING else robot
    bare = Scene(robot, body, values, table, noise, loads, model, spread, white, np.ones((1, 1)), np.ones(1))
    return _with_model(bare, model, values)


def _design(
    robot: Robot, data: str, levels: int, contexts: set[str], rng: np.random.Generator, options: Options
) -> Measurements:
    """Random poses and loads; a load comes in steps, and goes down again where branches are told."""
    poses, markers = int(rng.choice(options.poses)), int(rng.choice(options.markers))
    steps = [(k + 1) / levels for k in range(levels)]
    branch = [1.0] * levels
    told = "branch" in contexts or (levels > 1 and rng.random() < 0.25)
    if told:
        steps, branch = [*steps, *steps[-2::-1]], [*branch, *[-1.0] * (levels - 1)]
    while poses * len(steps) * markers * 3 > options.most_rows and poses > 15:
        poses = {60: 30}.get(poses, 15)
    limits = np.array([j.range for j in robot.joint])
    q = rng.uniform(limits[:, 0], limits[:, 1], (poses, robot.dof))
    if "levels" in contexts or rng.random() < 0.2:
        q[:, 1] = rng.choice(np.linspace(*limits[1], 7)[1:-1], poses)
    force = FORCE[robot.name]
    if rng.random() < 0.35:
        w = np.tile([0.0, 0.0, -force, 0.0, 0.0, 0.0], (poses, 1))
    else:
        w = rng.normal(size=(poses, 6))
        w[:, :3] *= force / np.linalg.norm(w[:, :3], axis=1)[:, None]
        w[:, 3:] *= 0.15 * force / np.linalg.norm(w[:, 3:], axis=1)[:, None]
    each = len(steps) * markers
    n = poses * each
    case = np.repeat(np.arange(poses * len(steps)), markers)
    clock = "clock" in contexts or rng.random() < 0.3
    time = 30.0 * case.astype(float)
    warmth = 20.0 + 4.0 * (1 - np.exp(-time / (0.3 * time.max()))) + 0.3 * np.sin(time / 500.0)
    return measurements(
        np.repeat(q, each, axis=0),
        np.repeat(w, each, axis=0) * np.tile(np.repeat(steps, markers), poses)[:, None],
        pose=np.repeat(np.arange(poses), each),
        points=("p1", "p2", "p3")[:markers],
        point=np.tile(np.arange(markers), n // markers),
        kind=data,  # type: ignore[arg-type]
        joint_units=["m" if j.prismatic else "rad" for j in robot.joint],
        time=time if clock else None,
        temperature=warmth if clock else None,
        branch=np.tile(np.repeat(branch, markers), poses) if told else None,
    )


@lru_cache(maxsize=32)
def _complete(robot: Robot, loads: str) -> StiffnessModel:
    return StiffnessModel.of(reduce(robot, loads))


def _lacking(scene: Scene, where: Where) -> StiffnessModel:
    """The model of a robot in which that joint or link is rigid."""
    if "link" in where:
        return _complete(rigid_links(scene.robot, int(where["link"])), scene.loads)
    kept = tuple(p for p in scene.model.compliances if p.name != f"c{where['joint']}")
    return replace(scene.model, compliances=kept, values={})


def _with_model(scene: Scene, model: StiffnessModel, values: dict[str, float]) -> Scene:
    scene = replace(scene, model=model)
    current = assemble(model, replace(scene.table, values=noise_free(scene, values, ())), effects=())
    if not current.problem.A.shape[1]:
        raise Unfit  # a model has a parameter
    columns = np.zeros((len(scene.table), 3, current.problem.A.shape[1]))
    view = current.situation.view
    columns[view.state, view.component] = current.problem.A
    excess = np.zeros((len(scene.table), 6))
    excess[view.state, view.component] = current.problem.y
    white = scene.whitened(columns)
    return replace(scene, basis=column_space(white.reshape(-1, columns.shape[2])), excess=excess)


def _limited(scene: Scene, rng: np.random.Generator, heavy: float) -> Scene:
    """Scale the loads so that second-order geometry stays below the noise, or has the wanted λ."""
    limit = heavy or GEOMETRY * float(rng.uniform(0.1, 1.0))
    for _ in range(4 if scene.table.kind == "deflection" else 2):
        found = noncentrality(scene, scene.excess)
        factor = (limit / max(found, 1e-12)) ** 0.25
        if not heavy:
            factor = min(factor, 1.0)
        table = replace(scene.table, w=scene.table.w * factor)
        largest = np.linalg.norm(table.w[:, :3], axis=1).max()
        if largest > 3 * FORCE[scene.robot.name]:
            raise Unfit
        scene = _with_model(replace(scene, table=table), scene.model, scene.values)
        if abs(factor - 1.0) < 0.02:
            break
    found = noncentrality(scene, scene.excess)
    if not heavy and found > 3 * GEOMETRY:
        raise Unfit
    freedom = 3 * len(scene.table) - scene.basis.shape[1]
    if freedom < LEAST_FREEDOM:
        raise Unfit
    return scene


def _draw(scene: Scene, rng: np.random.Generator) -> Draw:
    found = assemble(
        scene.model, replace(scene.table, values=noise_free(scene, scene.values, ())), effects=()
    )
    tau = np.abs(found.situation.view.tau).max(axis=0)
    torque = tau[[k for k, v in enumerate(found.situation.view.joints) if v.kind == "joint"]]
    if scene.body is not scene.robot:
        torque = torque + torques_of_weights(scene.body, scene.table)
    span = float(np.nanmax(scene.table.time)) if np.isfinite(scene.table.time).any() else 1.0
    force = float(np.linalg.norm(scene.table.w[:, :3], axis=1).max())
    angles = np.unique(scene.table.q[:, 1])
    return Draw(scene.robot, scene.values, torque, force, span, angles, scene.table.labels, rng)
