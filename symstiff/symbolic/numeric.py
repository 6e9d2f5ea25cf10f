"""NumPy evaluation of the chain for many configurations at once: the virtual-joint Jacobian, loads, frames."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from symstiff.arguments import A_ROBOT, reals, require
from symstiff.errors import UserError
from symstiff.robot.schema import Robot
from symstiff.symbolic.algebras import evaluate_numpy
from symstiff.symbolic.builder import Builder
from symstiff.symbolic.chain import ElasticChain, frames
from symstiff.symbolic.passes import q_vector
from symstiff.symbolic.program import Program
from symstiff.symbolic.programs import forward_program, jacobian_program, virtual_jacobian_program


@dataclass(frozen=True)
class Kinematics:
    """N configurations: ``J_theta`` (N, 6, V) at the tool centre point in base axes, tool pose ``T`` (N, 4, 4),
    frame axes ``R`` (N, n+1, 3, 3) and levers ``rho`` (N, n+1, 3) from each frame's origin to the tool centre point.
    """

    J_theta: np.ndarray
    T: np.ndarray
    R: np.ndarray
    rho: np.ndarray

    def loads(self, w: np.ndarray) -> np.ndarray:
        """τ_v = J_vᵀ·W: (N, V) for wrenches (N, 6)."""
        return np.asarray(np.einsum("nrv,nr->nv", self.J_theta, np.broadcast_to(w, (len(self.T), 6))))

    def moved(self, theta: np.ndarray) -> Kinematics:
        """The same chain with virtual joints that stand at ``theta`` (N, V) [m, rad] instead of 0, exactly.

        Each turns or shifts, about the axis that it has at 0, all that is behind it (product of exponentials).
        """
        tip = self.T[:, :3, 3]
        v, a = self.J_theta[:, :3].transpose(2, 0, 1), self.J_theta[:, 3:].transpose(2, 0, 1)
        foot = tip - np.cross(v, a)  # (V, N, 3) of the axes
        turn, shift = np.tile(np.eye(3), (len(tip), 1, 1)), np.zeros_like(tip)
        axis, place, R, origin = (
            np.empty_like(a),
            np.empty_like(v),
            np.empty_like(self.R),
            np.empty_like(self.rho),
        )
        for k, angle in enumerate(theta.T):
            axis[k], place[k] = _times(turn, a[k]), _times(turn, foot[k]) + shift
            if a[k].any():
                own = _turns(a[k] * angle[:, None])
                shift = shift + _times(turn, foot[k] - _times(own, foot[k]))
                turn = turn @ own
            else:
                shift = shift + _times(turn, v[k] * angle[:, None])
                place[k] = _times(turn, v[k])
            if k % 7 == 5:
                R[:, k // 7] = turn @ self.R[:, k // 7]
                origin[:, k // 7] = _times(turn, tip - self.rho[:, k // 7]) + shift
        T = np.array(self.T)
        T[:, :3, :3], T[:, :3, 3] = turn @ T[:, :3, :3], _times(turn, tip) + shift
        turning = np.asarray(a.any(axis=(1, 2)))[:, None, None]
        v = np.where(turning, np.cross(axis, T[:, :3, 3] - place), place)
        return Kinematics(
            np.concatenate([v, axis], axis=2).transpose(1, 2, 0), T, R, T[:, None, :3, 3] - origin
        )

    def point_offset(self, robot: Robot, point: str) -> np.ndarray:
        """Tool centre point to a marker, base axes (N, 3); zeros for ``tcp``."""
        if point == "tcp":
            return np.zeros((len(self.T), 3))
        local = np.array([float(x) for x in robot.marker_position(point)])
        return np.asarray(np.einsum("nij,j->ni", self.R[:, -1], local) - self.rho[:, -1])


def _turns(vectors: np.ndarray) -> np.ndarray:
    """Rotations (N, 3, 3) by rotation vectors (N, 3)."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_rotvec(vectors).as_matrix())


def _times(matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Products (N, 3) of matrices (N, 3, 3) and vectors (N, 3)."""
    return np.asarray(np.einsum("nij,nj->ni", matrix, vector))


def kinematics(robot: Robot, q: np.ndarray) -> Kinematics:
    """Evaluate the chain at joint variables ``q`` (N, n) [rad or m]."""
    jacobian, forward, axes = _programs(robot)
    q = np.atleast_2d(np.asarray(q, dtype=float))
    found = evaluate_numpy(axes, q=q)
    return Kinematics(
        evaluate_numpy(jacobian, q=q)["J"], evaluate_numpy(forward, q=q)["T"], found["R"], found["rho"]
    )


def forward(robot: Robot, q: np.ndarray) -> np.ndarray:
    """Pose of the tool centre point in world axes (N, 4, 4), q (N, n) [rad, m]. Raises UserError for other shapes."""
    require(robot, Robot, *A_ROBOT)
    q = np.atleast_2d(reals(q, "q", f"(N, {robot.dof})"))
    if q.ndim != 2 or q.shape[1] != robot.dof:
        raise UserError(f"q: expected an array of shape (N, {robot.dof}), found {q.shape}")
    return evaluate_numpy(_programs(robot)[1], q=q)["T"]


@lru_cache(maxsize=256)
def tool_to_point(robot: Robot, point: str) -> np.ndarray:
    """Tool centre point to a marker in the tool's own axes (3,) [m], the same at all joints."""
    still = kinematics(robot, np.zeros((1, robot.dof)))
    arm: np.ndarray = still.T[0, :3, :3].T @ still.point_offset(robot, point)[0]
    arm.flags.writeable = False  # every caller has this one
    return arm


@lru_cache(maxsize=32)
def _programs(robot: Robot) -> tuple[Program, Program, Program]:
    chain = ElasticChain(robot)
    return virtual_jacobian_program(chain), forward_program(chain), _frames_program(chain)


def _frames_program(chain: ElasticChain) -> Program:
    b = Builder("frames", (q_vector(chain),))
    f = frames(chain, b)
    n = chain.dof + 1
    b.output("R", (n, 3, 3), [axes[k][r] for axes in f.axes for r in range(3) for k in range(3)])
    b.output("rho", (n, 3), [x for lever in f.levers for x in lever])
    return b.build()


@lru_cache(maxsize=32)
def _joint_program(robot: Robot) -> Program:
    return jacobian_program(ElasticChain(robot))


def joint_jacobian(robot: Robot, q: np.ndarray) -> np.ndarray:
    """Jacobian of the actuated joints at the tool centre point in base axes (N, 6, n)."""
    return evaluate_numpy(_joint_program(robot), q=q)["J"]
