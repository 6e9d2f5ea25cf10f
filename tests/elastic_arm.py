"""A three-joint arm with every complication, its kinematics by plain matrices, and its twin in MuJoCo."""

import math

import numpy as np
from scipy.spatial.transform import Rotation

from symstiff.calibration.simulation import Truth
from symstiff.robot import from_table

ARM = {
    "format": 1,
    "name": "arm",
    "base": {"xyz": ["0.1", 0, "0.4"], "rpy": ["0.1", "-0.2", "0.3"]},
    "joint": [
        {
            "a": "0.2",
            "alpha": "-pi/2",
            "d": "0.3",
            "link": {"beam_axis": "x", "mass": "8", "com": ["-0.1", "0.02", "0.03"]},
        },
        {
            "a": "0.6",
            "alpha": "0.3",
            "d": "0.1",
            "theta": "0.2",
            "link": {"beam_axis": "y", "mass": "5", "com": ["-0.3", 0, "0.01"]},
        },
        {
            "a": "0.4",
            "alpha": "pi/2",
            "d": "-0.05",
            "link": {"beam_axis": ["0.4", "0.1", "-0.2"], "mass": "2", "com": ["-0.2", "0.01", 0]},
        },
    ],
    "tool": {"xyz": ["0.05", "0.1", "0.15"]},
    "marker": [{"name": "m1", "xyz": ["0.1", "-0.1", "0.05"]}],
}


def arm(**changes):
    return from_table({**ARM, **changes})


def random_truth(robot, seed, size=1e-5, **keys):
    """Full symmetric positive definite blocks at every link, and elastic joints."""
    rng = np.random.default_rng(seed)
    values = {f"c{j + 1}": size * rng.uniform(0.5, 2) for j in range(robot.dof)}
    for i in range(robot.dof + 1):
        root = rng.normal(size=(6, 6)) * np.repeat([0.2, 1.0], 3)[:, None]
        block = size / 6 * root @ root.T
        values |= {f"k{i}_{r + 1}{c + 1}": block[r, c] for r in range(6) for c in range(r, 6)}
    return Truth(robot, values, **keys)


def poses(robot, rows, seed):
    limits = np.array([j.range for j in robot.joint])
    return np.random.default_rng(seed).uniform(limits[:, 0], limits[:, 1], (rows, robot.dof))


def number(text):
    """Read the arm's numbers, without the package's parser."""
    return {"pi/2": math.pi / 2, "-pi/2": -math.pi / 2}.get(text) or float(text)


# An independent forward model for the tests: homogeneous matrices, one row at a time.


def matrix(rotation=None, shift=(0, 0, 0)):
    t = np.eye(4)
    t[:3, :3] = np.eye(3) if rotation is None else rotation.as_matrix()
    t[:3, 3] = shift
    return t


def tip(q, theta, table=ARM):
    """Pose of the tool for a standard DH table; theta in the simulator's order."""
    t = matrix(
        Rotation.from_euler("xyz", [number(x) for x in table["base"]["rpy"]]),
        [number(x) for x in table["base"]["xyz"]],
    )
    axes = [np.eye(3), *(elastic(j["link"]["beam_axis"]) for j in table["joint"])]
    for i in range(len(table["joint"]) + 1):
        if i:
            row = table["joint"][i - 1]
            t = t @ matrix(
                Rotation.from_rotvec([0, 0, number(row.get("theta", 0)) + q[i - 1] + theta[7 * i - 1]])
            )
            t = t @ matrix(shift=[number(row["a"]), 0, number(row["d"])])
            t = t @ matrix(Rotation.from_rotvec([number(row["alpha"]), 0, 0]))
        spring = theta[7 * i : 7 * i + 6]
        turns = Rotation.from_euler("XYZ", spring[3:])
        e = matrix()
        e[:3, :3] = axes[i]
        t = t @ e @ matrix(turns, spring[:3]) @ e.T
    return t @ matrix(shift=[number(x) for x in table["tool"]["xyz"]])


def elastic(beam_axis):
    if isinstance(beam_axis, str):
        return np.roll(np.eye(3), -"xyz".index(beam_axis), axis=1)
    x = np.array([float(v) for v in beam_axis])
    x /= np.linalg.norm(x)
    y = np.cross([0, 0, 1], x)
    y /= np.linalg.norm(y)
    return np.column_stack([x, y, np.cross(x, y)])


def differentiated_jacobian(q, size=27, step=1e-5):
    columns = []
    for v in range(size):
        ahead, behind = (tip(q, sign * step * np.eye(size)[v]) for sign in (1, -1))
        turn = Rotation.from_matrix(ahead[:3, :3] @ behind[:3, :3].T).as_rotvec()
        columns.append(np.concatenate([ahead[:3, 3] - behind[:3, 3], turn]) / (2 * step))
    return np.column_stack(columns)


def compliance_matrix(values, dof):
    k = np.zeros((7 * dof + 6, 7 * dof + 6))
    for name, value in values.items():
        if name[0] == "c":
            k[7 * int(name[1:]) - 1, 7 * int(name[1:]) - 1] = value
        else:
            r, c = 7 * int(name[1]) + int(name[3]) - 1, 7 * int(name[1]) + int(name[4]) - 1
            k[r, c] = k[c, r] = value
    return k


def mujoco_model(mujoco, q, table=ARM):
    """The arm at fixed joint angles: bodies joined by slides and hinges."""

    def pose(t):
        x, y, z, w = Rotation.from_matrix(t[:3, :3]).as_quat()
        return (
            f'pos="{t[0, 3]:.17g} {t[1, 3]:.17g} {t[2, 3]:.17g}" quat="{w:.17g} {x:.17g} {y:.17g} {z:.17g}"'
        )

    base = matrix(
        Rotation.from_euler("xyz", [number(x) for x in table["base"]["rpy"]]),
        [number(x) for x in table["base"]["xyz"]],
    )
    axes = [np.eye(3), *(elastic(j["link"]["beam_axis"]) for j in table["joint"])]
    opening, here = [], base
    for i in range(len(table["joint"]) + 1):
        if i:
            row = table["joint"][i - 1]
            turned = here @ matrix(Rotation.from_rotvec([0, 0, number(row.get("theta", 0)) + q[i - 1]]))
            opening.append(
                f'<body {pose(turned)}><joint type="hinge" axis="0 0 1"/>'
                '<inertial pos="0 0 0" mass="1e-9" diaginertia="1e-9 1e-9 1e-9"/>'
            )
            here = matrix(shift=[number(row["a"]), 0, number(row["d"])]) @ matrix(
                Rotation.from_rotvec([number(row["alpha"]), 0, 0])
            )
        e = matrix()
        e[:3, :3] = axes[i]
        joints = "".join(
            f'<joint type="{kind}" axis="{a[0]} {a[1]} {a[2]}"/>'
            for kind in ("slide", "hinge")
            for a in np.eye(3, dtype=int)
        )
        link = table["joint"][i - 1]["link"] if i else {}
        mass = number(link.get("mass", 0)) or 1e-9
        com = axes[i].T @ np.array([number(x) for x in link.get("com", [0, 0, 0])])
        opening.append(
            f"<body {pose(here @ e)}>{joints}"
            f'<inertial pos="{com[0]:.17g} {com[1]:.17g} {com[2]:.17g}" mass="{mass:.17g}" '
            'diaginertia="1e-3 1e-3 1e-3"/>'
        )
        here = e.T
    tool = here @ matrix(shift=[number(x) for x in table["tool"]["xyz"]])
    opening.append(f'<site name="tcp" {pose(tool)}/>')
    bodies = "".join(opening) + "</body>" * (2 * len(table["joint"]) + 1)
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler autolimits="false" boundmass="0" boundinertia="0"/>'
        '<option gravity="0 0 -9.80665"/>'
        f"<worldbody>{bodies}</worldbody></mujoco>"
    )


def mujoco_rest(mujoco, model, w, k):
    """Where the engine's generalised forces balance the springs: Newton on θ = k·(gravity + JᵀW)."""
    data = mujoco.MjData(model)
    site = model.site("tcp").id
    theta = np.zeros(model.nv)

    def residual(theta):
        data.qpos[:] = theta
        data.qvel[:] = 0
        mujoco.mj_forward(model, data)
        jp, jr = np.zeros((3, model.nv)), np.zeros((3, model.nv))
        mujoco.mj_jacSite(model, data, jp, jr, site)
        return theta - k @ (jp.T @ w[:3] + jr.T @ w[3:] - data.qfrc_bias)

    for _ in range(6):
        r = residual(theta)
        slope = np.column_stack([(residual(theta + 1e-6 * e) - r) / 1e-6 for e in np.eye(model.nv)])
        theta = theta - np.linalg.solve(slope, r)
    assert np.abs(residual(theta)).max() < 1e-12
    return data.site_xpos[site].copy(), data.site_xmat[site].reshape(3, 3).copy()
