"""Gross errors: single readings far beside the others of their pose, and poses that are unlike all others.

They hide what is missing, and look like it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import bdtrc

from symstiff.arrays import Array, Index, numbered
from symstiff.calibration.experiment.current import sigma_of
from symstiff.calibration.experiment.situation import View
from symstiff.calibration.fits.decomposition import unit_columns
from symstiff.calibration.rows import predict
from symstiff.calibration.tables.measurements import Measurements
from symstiff.discrepancy.findings.finding import Finding
from symstiff.discrepancy.findings.numbers import milli
from symstiff.discrepancy.findings.result import Diagnosis
from symstiff.discrepancy.search.verdict import INSUFFICIENT, UNEXPLAINED
from symstiff.display import of_poses

FAR = 6.0
"""Usual residuals by which a reading is beside the others of its pose; of normal noise two in a billion are."""
_BEYOND = 3.0
"""Stated standard deviations that it is beside them: where few rows are left to fit, usual residuals are small."""
ALONE = 2.5
"""How far it stands above every other reading of its pose: what bends a pose as a whole is no slip of one reading."""
FEWEST = 3
"""Readings of a component in a pose from which one is told from the others."""
_OF_MEDIAN = 0.6745
"""Median of normal noise's size, in standard deviations."""
FEW, FEW_OF, MOST = 3, 0.01, 0.1
"""Gross errors that need no further proof, in number or share of the rows, and the share that scattered ones may be."""
_BY_CHANCE = 0.01
"""Probability below which so many gross errors at one load or marker are no slips, which come anywhere."""
_REFITS = 8
"""Times that the model is fitted without the gross errors that were found: they drag it, and hide one another."""
_SHOWN = 8
"""Gross errors whose places are told."""
_MOSTLY, _NEARLY_ALL = 0.5, 0.9
"""Share of what is left that few poses bring from which they are spoken of, and left out whatever else there is."""


def nearly_all(last: Diagnosis) -> bool:
    """Whether the poses that are unlike all others bring nearly all that is left: they hide what else there is."""
    return last.localisation is not None and last.localisation.suspected >= _NEARLY_ALL


def unlike(table: Measurements, last: Diagnosis) -> list[int]:
    """Numbers of the few poses that bring most of what the effects leave, worst first; none where nothing is left."""
    where = last.localisation
    if where is None or last.verdict not in (UNEXPLAINED, INSUFFICIENT) or where.suspected < _MOSTLY:
        return []
    return [int(np.unique(table.pose)[p]) for p in where.suspects]


def gross(finding: Finding) -> Index:
    """Rows of the diagnosed table that are gross errors, by what the grown model leaves; none where nothing was fitted.

    A pose of which all readings are off is a bad pose, which is an effect of the catalogue, and so is what few readings
    of a component tell: neither is a gross error. More than a few are scattered over loads and markers.
    """
    last, rows = finding.last, np.zeros(0, dtype=np.intp)
    if not last.growth or len(last.growth[-1].residual) != len(finding.assembly.problem.y):
        return rows
    for _ in range(_REFITS):
        found = _far_off(finding.table, *_beside(finding, rows))
        if np.array_equal(found, rows):
            break
        rows = found
    few = len(rows) <= max(FEW, FEW_OF * len(finding.table))
    return rows if few or _scattered(finding.table, rows) else rows[:0]


def _far_off(table: Measurements, far: Array, stated: Array) -> Index:
    """Rows far beside the middle of their pose, all its usual readings, which are more than half of it, and all others
    of their load: what bends an arm under a load shows at all markers.
    """
    beyond, load = (far > FAR) & (stated > _BEYOND), numbered(*table.w.T)
    found = []
    for r in np.flatnonzero(beyond):
        own = table.pose == table.pose[r]
        usual = own & ~beyond
        others = usual | (own & (load == load[r]) & (np.arange(len(far)) != r))
        if usual.sum() + 1 >= FEWEST and usual.sum() > 0.5 * own.sum() and far[r] > ALONE * far[others].max():
            found.append(r)
    return np.array(found, dtype=np.intp)


def _scattered(table: Measurements, rows: Index) -> bool:
    """Whether rows are a small part of all, and at no load of their poses and no marker more of them than by chance."""
    return len(rows) <= MOST * len(table) and all(
        bdtrc(float(np.sum(part[rows] == k) - 1), len(rows), np.mean(part == k)) * (part.max() + 1)
        > _BY_CHANCE
        for part in (_rank(table), table.point)
        for k in np.unique(part[rows])
    )


def _rank(table: Measurements) -> Index:
    """(N,) the place of each row's load among those of its pose, by size."""
    size, rank = np.linalg.norm(table.w, axis=1), np.zeros(len(table), dtype=np.intp)
    for p in np.unique(table.pose):
        own = np.flatnonzero(table.pose == p)
        rank[own] = np.unique(size[own].round(9), return_inverse=True)[1]
    return rank


def _beside(finding: Finding, without: Index) -> tuple[Array, Array]:
    """(N,) how far each row is beside the middle of its pose, by the largest of its components: in usual distances, and
    in stated standard deviations; by the model as the other rows than those ``without`` have it.
    """
    problem, view = finding.assembly.problem, finding.assembly.situation.view
    residual = finding.last.growth[-1].residual
    if len(without):
        A, kept = unit_columns(problem.A)[0], ~np.isin(view.state, without)
        residual = residual - A @ np.linalg.lstsq(A[kept], residual[kept], rcond=None)[0]
    apart = np.array(residual)
    for k in np.unique(problem.lines):
        own = np.flatnonzero(problem.lines == k)
        apart[own] = residual[own] - np.median(residual[own]) if len(own) >= FEWEST else 0.0
    return in_usual(view, np.abs(apart)), _in_stated(view, np.abs(apart))


def _in_stated(view: View, size: Array) -> Array:
    """(N,) the largest of each row's sizes (M,) in stated standard deviations; infinite where none are stated."""
    sigma = sigma_of(view)
    if sigma is None:
        return np.full(len(view.table), np.inf)
    largest = np.zeros(len(view.table))
    np.maximum.at(largest, view.state, size / sigma)
    return largest


def in_usual(view: View, size: Array) -> Array:
    """(N,) the largest of each row's sizes (M,) in usual ones, as their median tells; translations and rotations apart.

    By a stated sigma they may differ: far from a tracker large ones are usual. What is 0 is none: a middle reading is
    no distance from itself.
    """
    largest, sigma = np.zeros(len(view.table)), sigma_of(view)
    size = size if sigma is None else size / sigma
    for kind in (view.component < 3, view.component >= 3):
        known = kind & (size > 0)
        if np.any(known):
            np.maximum.at(largest, view.state[known], size[known] / (np.median(size[known]) / _OF_MEDIAN))
    return largest


def remark(finding: Finding, rows: Index) -> str:
    """That they are left out, where they are and what to do."""
    far = _beside(finding, rows)[0][rows]
    places = finding.table.places(rows[np.argsort(-far)].tolist(), _SHOWN)
    if len(rows) == 1:
        return (
            f"a reading lies {far[0]:.0f} times the usual residual beside the others of its pose ({places}): a slip of "
            "the reading, or of the pen. It is left out; look at it, or measure it again"
        )
    return (
        f"{len(rows)} readings lie up to {far.max():.0f} times the usual residual beside the others of their poses "
        f"({places}): slips, or readings that changed places. They are left out; look at them, or measure them again"
    )


def left_out(finding: Finding, rows: Measurements, names: Sequence[str]) -> str:
    """A remark on rows of poses that were left out: of deflections how far they are beside the model of the others."""
    told = f"{len(rows)} rows are left out, of {of_poses(names)}, unlike all others"
    measured = rows.measured[:, :3]
    if rows.kind == "deflection" and measured.any():
        apart = (rows.values - predict(finding.model, rows))[:, :3][measured]
        size = milli(float(np.sqrt(np.mean(apart**2))))
        told += (
            f": the readings are {size} mm rms per coordinate beside what the model of the others predicts"
        )
    return f"{told}; look at labels, loads and joint readings there, or measure again"
