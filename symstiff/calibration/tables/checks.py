"""Rows against each other and against the robot: duplicates, contradictory poses, markers, joint limits."""

from __future__ import annotations

import numpy as np

from symstiff.arguments import A_ROBOT, A_TABLE, require
from symstiff.arrays import Array
from symstiff.calibration.plausible import SOFTEST
from symstiff.calibration.tables.columns import SHOWN
from symstiff.calibration.tables.measurements import Measurements
from symstiff.errors import UserError, printable
from symstiff.robot import Robot

_SAME_POSE = 1e-3  # rad or m; commanded configurations of one label agree far better than this
_FAR_OUTSIDE = 0.1  # of the joint's range
_SHOWN = 3
_STIFFEST = 1e-8  # m/N; machine tools have 1e-8, robots of any size a hundred times as much
_BENT = 0.1  # of the reach; springs of laboratories, at most
_TINY = float(np.radians(6.4))
_FEW = 3  # configurations that may all be near zero
_LEAST_LOAD = 1e-20  # N, N·m; far below what rounding leaves of a load that is 0
_CHANCE = 0.1  # share of the equal rows that coarse readings explain, above which they pass for honest
_APART = 1e6  # the largest sigma over the smallest; beyond it the weights of rows drown each other's digits


def check_rows(table: Measurements, path: bool = False) -> None:
    """Refuse duplicate rows, one label for two configurations, and numbers that nothing can be computed with.

    These are deflections under no load at all, loads that nothing feels, and sigmas that differ beyond measure. A
    ``path`` may come to the same point again.
    """
    _one_configuration_a_label(table)
    if not path:
        _no_duplicates(table)
    check_sigmas(table)
    size = np.abs(table.w).max(axis=1, initial=0.0)
    unfelt = (size > 0.0) & (size < _LEAST_LOAD)
    if unfelt.any():
        row = int(np.argmax(unfelt))
        raise UserError(
            f"{table.place(row)}: nothing feels a load of {size[row]:g} N: write 0, or correct the unit"
        )
    if table.kind == "deflection" and not table.w.any():
        raise UserError(
            f"{table.place(0)}: every wrench is zero: deflection data need their loads: "
            "give columns fx[N] … mz[N*m]"
        )


def check_sigmas(table: Measurements) -> None:
    """Refuse standard deviations of which one is a million times another, of a metre or a radian alike."""
    known = np.isfinite(table.sigma)
    if not known.any():
        return
    low, high = np.where(known, table.sigma, np.inf), np.where(known, table.sigma, 0.0)
    if low.min() < high.max() / _APART:
        small, large = int(np.argmin(low.min(axis=1))), int(np.argmax(high.max(axis=1)))
        raise UserError(
            f"{table.place(small)}: a sigma of {low.min():g} m or rad, and one of {high.max():g} at "
            f"{table.place(large)}: they differ by more than {_APART:g}: correct them, or drop the columns"
        )


def check_measured(table: Measurements) -> None:
    """Refuse tables without a measurement, and deflections that are 0 in every row: no robot is as stiff as that."""
    if table.kind == "none" or not table.measured.any():
        raise UserError("nothing measured: give deflections (dx[mm] …) or positions (x[mm] …)")
    if table.kind == "deflection" and not np.any(np.nan_to_num(table.values)):
        raise UserError(f"{table.place(0)}: every deflection is 0: the columns hold no measurement")


def _one_configuration_a_label(table: Measurements) -> None:
    same = same_configuration(table.pose, len(table.labels), table.q)
    if not same.all():
        row = int(np.argmin(same))
        label = table.labels[table.pose[row]]
        first = _first_rows(table.pose, len(table.labels))
        raise UserError(
            f"{table.place(row)}: pose {printable(label, SHOWN)!r} has other joint values than at "
            f"{table.place(int(first[table.pose[row]]))}: give each configuration its own label"
        )


def elsewhere(q: Array, other: Array) -> bool:
    """Whether joint values (n,) are those of another configuration than others (n,) are, of the same joints."""
    return q.shape == other.shape and bool(np.abs(q - other).max(initial=0.0) > _SAME_POSE)


def same_configuration(pose: np.ndarray, labels: int, q: np.ndarray) -> np.ndarray:
    """Which rows (M,) have the joint values (M, n) of the first row of their pose (M,), as commands do."""
    first = _first_rows(pose, labels)
    return np.asarray(np.abs(q - q[first[pose]]).max(axis=1, initial=0.0) <= _SAME_POSE)


def _first_rows(index: np.ndarray, count: int) -> np.ndarray:
    first = np.zeros(count, dtype=np.intp)
    first[index[::-1]] = np.arange(len(index))[::-1]
    return first


def _no_duplicates(table: Measurements) -> None:
    """Refuse a component that was measured twice; tables may hold one each of a row's components."""
    context = np.column_stack([table.repeat, table.branch, table.load_step, table.station])
    keys = np.column_stack([table.pose, table.point, table.w, context])
    measured = table.measured if table.kind != "none" else np.ones((len(keys), 1), dtype=bool)
    for own in measured.T:
        rows = np.flatnonzero(own)
        first = rows[_first_equal(keys[rows])]
        again = np.flatnonzero(first != rows)
        if again.size:
            row, earlier = int(rows[again[0]]), int(first[again[0]])
            raise UserError(
                f"{table.place(row)}: duplicate of {table.place(earlier)} "
                "(same pose, load and point): drop it, tell the way up from the way down in a column 'branch', or "
                "number repeated measurements in a column 'repeat'"
            )


def _first_equal(keys: np.ndarray) -> np.ndarray:
    """Return for every row the first row that equals it (NaN equals NaN)."""
    keys = np.ascontiguousarray(np.nan_to_num(keys, nan=-1e300) + 0.0)  # + 0.0: -0.0 equals 0.0
    packed = keys.view(np.dtype((np.void, keys.dtype.itemsize * keys.shape[1]))).ravel()
    _, first, inverse = np.unique(packed, return_index=True, return_inverse=True)
    return np.asarray(first[inverse.ravel()])


def without_zeros(table: Measurements) -> tuple[Measurements, list[str]]:
    """The table without deflections that are 0 because nothing loads the arm, and a remark where there are any.

    The row that opens a pose is where its deflections count from: nothing was read twice there. What was read again
    without a load and differs stays.
    """
    zero = ~np.any(table.w, axis=1) & ~np.any(np.nan_to_num(table.values), axis=1)
    if table.kind != "deflection" or not zero.any() or zero.all():
        return table, []
    count = int(zero.sum())
    return table.select(np.flatnonzero(~zero)), [
        f"{count} row{'s' * (count > 1)} without load read{'s' * (count == 1)} 0 in every column: deflections count "
        "from there, which is no reading and is left out"
    ]


def without_copies(table: Measurements) -> tuple[Measurements, list[str]]:
    """The table without rows that are copies of an earlier one, also under another label, and a remark.

    Honest repeats differ, unless readings are coarser than the noise: then single components agree as well. Where most
    repeats are equal, they say nothing of the noise either way.
    """
    rows = np.arange(len(table))
    configuration = _first_equal(table.q[_first_rows(table.pose, len(table.labels))])[table.pose]
    state = np.column_stack([configuration, table.point, table.w, table.branch, table.load_step])
    earlier, equal = _first_equal(state), _first_equal(np.column_stack([state, table.values]))
    again, copies = np.flatnonzero(earlier != rows), np.flatnonzero(equal != rows)
    if 2 * len(copies) <= len(again) and _by_chance(table.values, earlier, again, copies):
        return table, []
    row = int(copies[0])
    return table.select(np.setdiff1d(rows, copies)), [
        f"{len(copies)} of {len(again)} repeats read the same to the last digit as an earlier one (first: "
        f"{table.place(row)}, as {table.place(int(equal[row]))}): copies, or readings coarser than the noise. They say "
        "nothing of the noise and are left out"
    ]


def _by_chance(values: np.ndarray, earlier: np.ndarray, again: np.ndarray, copies: np.ndarray) -> bool:
    """Whether coarse readings explain equal rows, by how often a single component of the other repeats is equal.

    values: (M, 6); earlier: (M,) first row of the same state; again, copies: rows that repeat one, and that equal one.
    """
    others = np.setdiff1d(again, copies)
    pairs = np.isfinite(values[others]) & np.isfinite(values[earlier[others]])
    alike = pairs & (values[others] == values[earlier[others]])
    components = int(np.isfinite(values[copies]).sum(axis=1).min(initial=6))
    if components < 2 or not len(copies):
        return True
    chance = (alike.sum() + 1.0) / (pairs.sum() + 2.0)
    return bool(len(again) * chance**components > _CHANCE * len(copies))


def check_robot(table: Measurements, robot: Robot) -> list[str]:
    """Check a table against a robot: joints, their kinds, markers; return warnings, one line each.

    Raises UserError where the table cannot belong to the robot. Warned of: joint values far outside the
    limits, compliances that no serial robot has, and sigma of one kind of component alone.
    """
    require(robot, Robot, *A_ROBOT)
    require(table, Measurements, *A_TABLE)
    if table.dof != robot.dof:
        raise UserError(
            f"{table.place(0)}: {table.dof} joint columns, robot {robot.name} has {robot.dof} joints: "
            f"give q1 … q{robot.dof}, or name the right robot"
        )
    for k, (unit, joint) in enumerate(zip(table.joint_units, robot.joint, strict=True), 1):
        fits = "m" if joint.prismatic else "rad"
        if unit != fits:
            kind, units = ("prismatic", "m or mm") if joint.prismatic else ("revolute", "deg or rad")
            raise UserError(f"{table.place(0)}: joint {k} of {robot.name} is {kind}: give q{k} in {units}")
    known = {"tcp", *(m.name for m in robot.marker)}
    for index, name in enumerate(table.points):
        rows = np.flatnonzero(table.point == index)
        if name not in known and rows.size:
            raise UserError(
                f"{table.place(int(rows[0]))}: robot {robot.name} has no marker {printable(name, SHOWN)!r}: "
                f"use one of {', '.join(sorted(known))}, or add a [[marker]] to the robot file"
            )
    return _outside_limits(table, robot) + of_units(table, robot) + _half_stated(table)


def _outside_limits(table: Measurements, robot: Robot) -> list[str]:
    warnings = []
    for k, joint in enumerate(robot.joint):
        low, high = joint.range
        if joint.limits is None and not joint.prismatic:
            continue
        margin = _FAR_OUTSIDE * (high - low)
        rows = np.flatnonzero((table.q[:, k] < low - margin) | (table.q[:, k] > high + margin))
        if rows.size:
            warnings.append(
                f"q{k + 1} is far outside its limits [{low:g}, {high:g}] at {table.places(rows.tolist(), _SHOWN)}: "
                "check its unit, sign and zero"
            )
    return warnings


def _tiny_angles(table: Measurements) -> list[str]:
    """Radians in a column of degrees: all of a file's angles within 2π degrees of zero."""
    turning = [k for k, unit in enumerate(table.joint_units) if unit == "rad"]
    largest = float(np.abs(table.q[:, turning]).max(initial=0.0))
    if not table.files or not 0 < largest <= _TINY or len(np.unique(table.q[:, turning], axis=0)) <= _FEW:
        return []
    return [
        f"no joint turns further than {np.degrees(largest):.2g} degrees from zero: if these are radians, write q1[rad]"
    ]


def of_units(table: Measurements, robot: Robot) -> list[str]:
    """Angles, deflections or forces in another unit than the header says: radians under deg, metres under mm."""
    return [*_tiny_angles(table), *_of_deflections(table, robot)]


def _of_deflections(table: Measurements, robot: Robot) -> list[str]:
    loads = np.linalg.norm(table.w, axis=1)  # moments as of a lever of a metre
    loaded = table.w[:, :3].any(axis=1)
    if table.kind != "deflection" or not loaded.any() or not table.measured[loaded, :3].any():
        return []
    moved = np.sqrt(np.nansum(table.values[loaded, :3] ** 2, axis=1))
    told = _no_robot(float(np.median(moved)), float(np.median(moved / loads[loaded])), robot.reach)
    return [f"the deflections are {told}: look at the units of deflections and forces"] if told else []


def _no_robot(moved: float, a_newton: float, reach: float) -> str:
    """Deflections, absolute and under a newton [m, m/N], that no arm of a reach [m] has, in words; else nothing."""
    if 0.0 < a_newton < _STIFFEST:
        return f"{1e9 * a_newton:.2g} nm a newton, which no serial robot is stiff enough for"
    if a_newton > SOFTEST:
        return f"{1e3 * a_newton:.2g} mm a newton, which no serial robot is soft enough for"
    if moved > _BENT * reach:
        return f"{1e3 * moved:.0f} mm, which no arm that reaches {reach:.2g} m bends by"
    return ""


def _half_stated(table: Measurements) -> list[str]:
    """A sigma of translations without one of rotations, or the other way round: what weighs one against the other."""
    kinds = {"translations": slice(0, 3), "rotations": slice(3, 6)}
    measured = [name for name, part in kinds.items() if table.measured[:, part].any()]
    stated = [
        name
        for name in measured
        if np.isfinite(table.sigma[:, kinds[name]])[table.measured[:, kinds[name]]].any()
    ]
    if len(measured) < 2 or len(stated) != 1:
        return []
    other = next(name for name in measured if name not in stated)
    return [
        f"sigma is stated for {stated[0]} and not for {other}: it is not used, both are told by what the model leaves; "
        f"state that of {other} too"
    ]
