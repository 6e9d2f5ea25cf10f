"""An arm that is not as its file draws it: where its points are, and what equations about the drawn one miss."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from symstiff.arrays import Array
from symstiff.calibration.experiment.situation import Laws, View, look, under_weights


@dataclass(frozen=True, eq=False)
class Arm:
    """An arm under its loads, base axes."""

    points: Array
    """(N, 3) where the measured points are."""
    beyond: Array
    """(N, 6) twists by which equations that are linear about the arm of the file miss that."""
    laws: Laws
    """By which it gives way."""


def drawn(view: View, laws: Laws) -> Arm:
    """The arm as its file draws it, bent by some laws."""
    moved = np.einsum("nrv,nv->nr", replace(view, turn=np.eye(3)[None]).at_point, laws(view.tau))
    return Arm(view.found.T[:, :3, 3] + view.offset + moved[:, :3], np.zeros_like(moved), laws)


def standing(view: View, laws: Laws, off: Array) -> Arm:
    """The arm whose virtual joints are ``off`` (V,) without load, besides what the laws say of that.

    One whose frames are off by a milliradian stands some micrometres beside what linear equations say, by a hundredth
    of a radian some tenths of a millimetre, and bends by other levers.
    """
    view = replace(view, turn=np.eye(3)[None])
    rest = replace(laws, view=view)(np.zeros_like(view.tau))
    there = under_weights(look(view.robot, view.table, stand=rest + off))
    bent = replace(laws, view=there)(there.tau + view.more) - rest
    moved = np.einsum("nrv,nv->nr", there.at_point, bent)
    beyond = moved - np.einsum("nrv,nv->nr", view.at_point, laws(view.tau + view.more) + off)
    points = there.found.T[:, :3, 3] + there.offset
    beyond[:, :3] += points - view.found.T[:, :3, 3] - view.offset
    beyond[:, 3:] += turns_between(view.found.T[:, :3, :3], there.found.T[:, :3, :3])
    return Arm(points + moved[:, :3], beyond, laws)


def turns_between(one: Array, other: Array) -> Array:
    """Rotation vectors (N, 3) from attitudes (N, 3, 3) to others."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(other @ one.transpose(0, 2, 1)).as_rotvec())
