"""Physically admissible parameters: link compliance matrices positive semidefinite, joints ≥ 0."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from symstiff.arrays import Array
from symstiff.errors import UserError

BEAM_RATIO = 4.0 / 3.0  # k22·k66/k26² of a uniform cantilever: (L³/3EI)·(L/EI)/(L²/2EI)²
LINK = re.compile(r"k(\d+)_([1-6])([1-6])")
JOINT = re.compile(r"c(\d+)")
# Where nothing is known: m/N, rad/N and rad/(N·m) of a heavy robot's links, rad/(N·m) of its joints.
_TYPICAL_TRANSLATION, _TYPICAL_ROTATION, _TYPICAL_JOINT = 1e-8, 1e-7, 1e-6


@dataclass(frozen=True)
class Block:
    """A symmetric matrix that must be positive semidefinite: a coupled part of a link, or a number ≥ 0.

    entries: (row, column, parameter index), row ≤ column, 0-based inside the block; coupling: factor on the
    off-diagonal entries in the condition (√ratio of a beam, 1 otherwise).
    """

    label: str
    size: int
    entries: tuple[tuple[int, int, int], ...]
    coupling: float = 1.0

    def matrix(self, values: Array) -> Array:
        """(size, size) compliance matrix for parameter values (n,), coupling factor included."""
        K = np.zeros((self.size, self.size))
        for row, column, index in self.entries:
            K[row, column] = K[column, row] = values[index] * (1.0 if row == column else self.coupling)
        return K

    def axes(self, scale: Array) -> Array:
        """(size,) √(size of the diagonal term): the block over their outer product is of order one."""
        return np.asarray(
            np.sqrt(np.array([scale[i] for row, column, i in sorted(self.entries) if row == column]))
        )

    def basis(self) -> Array:
        """(entries, size, size): derivative of the matrix by each of its parameters."""
        E = np.zeros((len(self.entries), self.size, self.size))
        for e, (row, column, _) in enumerate(self.entries):
            E[e, row, column] = E[e, column, row] = 1.0 if row == column else self.coupling
        return E


@dataclass(frozen=True)
class AdmissibleSet:
    """Blocks over a complete parameter set; parameters in no block are free (effects without a sign)."""

    names: tuple[str, ...]
    blocks: tuple[Block, ...]

    def eigenvalues(self, values: Array, scale: Array) -> dict[str, Array]:
        """Eigenvalues of every block relative to `scale` (n,), ascending."""
        found: dict[str, Array] = {}
        for block in self.blocks:
            axes = block.axes(scale)
            found[block.label] = np.asarray(np.linalg.eigvalsh(block.matrix(values) / np.outer(axes, axes)))
        return found

    def smallest(self, values: Array, scale: Array) -> dict[str, float]:
        """Smallest eigenvalue of every block relative to `scale` (n,); negative: not admissible."""
        return {label: float(found[0]) for label, found in self.eigenvalues(values, scale).items()}


def admissible_set(
    names: Sequence[str], *, nonnegative: Iterable[str] = (), beam_ratio: float = 1.0
) -> AdmissibleSet:
    """Read the conditions off the names: link matrices of `k<i>_<ab>`, `c<j>` and `nonnegative` ≥ 0.

    A link matrix splits into its coupled parts: a beam gives k11, k44 and the pairs (2,6) and (3,5).
    beam_ratio: the least k_aa·k_bb/k_ab² of those pairs; 1 is plain semidefiniteness, BEAM_RATIO = 4/3 the
    uniform cantilever or anything with more shear. Raises UserError for a coupling without its diagonal
    terms. Source: seed section 3.1, eq. (13).
    """
    if beam_ratio < 1.0:
        raise UserError(
            f"beam ratio {beam_ratio:g} is below 1, where no link matrix is positive: give 1 to 4/3"
        )
    index = {name: i for i, name in enumerate(names)}
    signed = set(nonnegative)
    blocks = []
    for link in sorted({int(m[1]) for m in map(LINK.fullmatch, names) if m}):
        blocks += _link_blocks(link, index, beam_ratio)
    for name in names:
        joint = JOINT.fullmatch(name)
        if joint or name in signed:
            label = f"joint {joint[1]} ({name})" if joint else name
            blocks.append(Block(label, 1, ((0, 0, index[name]),)))
    return AdmissibleSet(tuple(names), tuple(blocks))


def scales(names: Sequence[str], nominal: Mapping[str, float] | None = None) -> Array:
    """(n,) size that each parameter has by its nominal value, so that admissible sets are of order one.

    A diagonal term's own nominal value, or a typical one where that is absent or zero; √(k_aa·k_bb) for k_ab.
    """
    nominal = nominal or {}

    def size(name: str, typical: float) -> float:
        value = abs(float(nominal.get(name, 0.0)))
        return value if value > 0.0 else typical

    result = np.empty(len(names))
    for i, name in enumerate(names):
        link = LINK.fullmatch(name)
        if link:
            ends = [size(f"k{link[1]}_{a}{a}", _typical(int(a))) for a in (link[2], link[3])]
            result[i] = np.sqrt(ends[0] * ends[1])
        else:
            result[i] = size(name, _TYPICAL_JOINT if JOINT.fullmatch(name) else 1.0)
    return result


def link_matrices(names: Sequence[str], values: Array) -> dict[int, Array]:
    """Complete 6 × 6 compliance matrices by link, elastic frame, zeros where the template has none."""
    matrices: dict[int, Array] = {}
    for name, value in zip(names, values, strict=True):
        link = LINK.fullmatch(name)
        if link:
            K = matrices.setdefault(int(link[1]), np.zeros((6, 6)))
            a, b = int(link[2]) - 1, int(link[3]) - 1
            K[a, b] = K[b, a] = value
    return matrices


def joint_compliances(names: Sequence[str], values: Array) -> dict[int, float]:
    """Joint compliances by joint number, rad/(N·m) or m/N."""
    pairs = zip(map(JOINT.fullmatch, names), values, strict=True)
    return {int(joint[1]): float(value) for joint, value in pairs if joint}


def _typical(axis: int) -> float:
    return _TYPICAL_TRANSLATION if axis <= 3 else _TYPICAL_ROTATION


def _link_blocks(link: int, index: Mapping[str, int], beam_ratio: float) -> list[Block]:
    """The coupled parts of one link matrix, each with the axes it joins."""
    terms = {
        (int(m[2]), int(m[3])): i
        for name, i in index.items()
        if (m := LINK.fullmatch(name)) and int(m[1]) == link
    }
    for a, b in terms:
        for axis in (a, b):
            if (axis, axis) not in terms:
                raise UserError(
                    f"k{link}_{a}{b} has no k{link}_{axis}{axis} beside it: a coupling needs both diagonals, "
                    "give the complete parameter set"
                )
    parts: list[set[int]] = []
    for pair in sorted(terms):
        touched = [part for part in parts if part & set(pair)]
        parts = [part for part in parts if part not in touched] + [set(pair).union(*touched)]
    blocks = []
    for axes in sorted(sorted(part) for part in parts):
        inside = sorted(pair for pair in terms if set(pair) <= set(axes))
        entries = tuple((axes.index(min(p)), axes.index(max(p)), terms[p]) for p in inside)
        members = ", ".join(f"k{link}_{a}{b}" for a, b in inside)
        coupling = np.sqrt(beam_ratio) if axes in ([2, 6], [3, 5]) else 1.0
        blocks.append(Block(f"link {link} ({members})", len(axes), entries, float(coupling)))
    return blocks
