"""The candidates' columns side by side, with their priors."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from symstiff.arrays import Array, Index, Mask, numbered
from symstiff.discrepancy.problem import Candidate, Parameter, Problem
from symstiff.effects.base import Shape

UNNAMED = 0.3
"""Prior share of laws without a name: the catalogue holds most of what robots have, and not all."""
BESIDE = 0.25
"""Prior share, beside an effect that is there, of the same effect at the same joint in another form: a gear that is
uneven a few times a turn is often so at other numbers a turn."""
_LEAST_SIZE = 0.02
"""Usual size, against the largest of an effect's, below which no parameter is taken to be."""

_ELSEWHERE = 1e-6
"""Share of a signal's square that may stand outside a joint's own columns, for rounding."""


@dataclass(frozen=True)
class Bank:
    """Columns of all candidates and shapes; entry = one shape of one candidate."""

    candidates: tuple[Candidate, ...]
    generic: Mask
    log_prior: Array
    columns: Array
    """(M, K) columns, each of unit length in the units of ``scale``."""
    scale: Array
    """(K,) lengths before normalisation."""
    start: Index
    """(S,) first column of each entry."""
    width: Index
    """(S,) number of columns of each entry."""
    owner: Index
    """(S,) candidate of each entry, ascending."""
    shape: Index
    """(S,) number of the shape within its candidate."""
    usual: Array
    """(K,) lengths of the columns for parameters of usual size, the longest of an entry one."""
    sized: Mask
    """(S,) whether an entry has several parameters whose usual sizes are known."""
    share: Array
    """(S,) prior share of each entry among its candidate's."""
    place: tuple[str, ...] = ()
    """Virtual joint that each candidate acts at alone; empty where it acts at several, or somewhere else."""

    @property
    def first_entry(self) -> Index:
        """First entry of every candidate (reduceat offsets)."""
        return np.searchsorted(self.owner, np.arange(len(self.candidates)))

    @property
    def last_entry(self) -> Index:
        """The entry behind the last one of every candidate."""
        return np.append(self.first_entry[1:], len(self.start)) if self.candidates else self.first_entry

    @cached_property
    def named(self) -> Mapping[str, int]:
        """Numbers of the candidates that have a name, by their keys."""
        return {c.key: k for k, c in enumerate(self.candidates) if not self.generic[k]}

    def twins(self, entry: int) -> tuple[int, ...]:
        """The candidates whose columns are an entry's by structure, its own among them; its own alone for a shape with
        more parameters than the candidate's first.
        """
        own = int(self.owner[entry])
        first = int(np.searchsorted(self.owner, own))
        return self._grouped[own] if self.width[entry] <= self.width[first] else (own,)

    @cached_property
    def _grouped(self) -> tuple[tuple[int, ...], ...]:
        """For each candidate those of its structural group."""
        groups, found = [c.group or c.key for c in self.candidates], dict[str, list[int]]()
        for k, group in enumerate(groups):
            found.setdefault(group, []).append(k)
        return tuple(tuple(found[group]) for group in groups)

    @cached_property
    def kin(self) -> tuple[tuple[str, str] | None, ...]:
        """Effect and joint of each named candidate that acts at one joint alone."""
        found = zip(self.candidates, self.generic, self.place, strict=True)
        return tuple((c.effect, place) if place and not generic else None for c, generic, place in found)

    def beside(self, whole: Bank, members: Sequence[int]) -> Bank:
        """The bank with the priors that its candidates have beside members of the whole bank that it is a part of.

        An effect at a joint makes more of it there likelier, such as waves of other numbers a turn: it counts in which
        order a set is made.
        """
        there, every = Counter(whole.kin[m] for m in members), Counter(whole.kin)
        left = {kin: every[kin] - n for kin, n in there.items() if kin is not None and every[kin] > n}
        if not left:
            return self
        beside = [BESIDE / (len(left) * left[kin]) if kin in left else 0.0 for kin in self.kin]
        return replace(self, log_prior=np.log((1.0 - BESIDE) * np.exp(self.log_prior) + beside))

    def entries_of(self, candidate: int) -> slice:
        """Entries of a candidate."""
        first, last = np.searchsorted(self.owner, [candidate, candidate + 1])
        return slice(int(first), int(last))

    def alone(self, candidate: int) -> Bank:
        """The bank of one candidate."""
        own, columns = self.entries_of(candidate), self.columns_in(candidate)
        return Bank(
            (self.candidates[candidate],), self.generic[[candidate]], self.log_prior[[candidate]],
            self.columns[:, columns], self.scale[columns], self.start[own] - columns.start, self.width[own],
            np.zeros_like(self.owner[own]), self.shape[own], self.usual[columns], self.sized[own], self.share[own],
            self.place[candidate : candidate + 1],
        )  # fmt: skip

    def columns_in(self, candidate: int) -> slice:
        """Columns of all of a candidate's entries."""
        own = self.entries_of(candidate)
        return slice(int(self.start[own.start]), int(self.start[own.stop - 1] + self.width[own.stop - 1]))

    def parameters(self, entry: int) -> tuple[Parameter, ...]:
        """Parameters of an entry, one a column."""
        candidate = self.candidates[int(self.owner[entry])]
        return candidate.parameters_at(self.shape_of(entry))

    def shape_of(self, entry: int) -> Shape:
        """Shape values of an entry."""
        return self.candidates[int(self.owner[entry])].shapes[int(self.shape[entry])]

    def another_shape(self, entry: int, of: int) -> bool:
        """Whether two entries are laws of one virtual joint, the first by nothing that the second does not depend on.

        Where it is not known what one depends on, the joint decides.
        """
        place = self.place[int(self.owner[entry])]
        if not place or place != self.place[int(self.owner[of])]:
            return False
        own, other = (self.candidates[int(self.owner[e])].driven(self.shape_of(e)) for e in (entry, of))
        return own is None or other is None or own <= other

    def contradict(self, entry: int, others: Sequence[int]) -> bool:
        """Whether an entry takes something else for granted than another law of its virtual joint."""
        owner, place = int(self.owner[entry]), self.place[int(self.owner[entry])]
        return any(
            place == self.place[int(self.owner[other])] != ""
            and self.candidates[owner].assumed == self.candidates[int(self.owner[other])].assumed
            and self._granted(entry) != self._granted(other)
            for other in others
        )

    def alike(self, entry: int) -> list[int]:
        """The entries of its candidate that take the same for granted."""
        own = np.flatnonzero(self.owner == self.owner[entry])
        return [int(e) for e in own if self._granted(int(e)) == self._granted(entry)]

    def _granted(self, entry: int) -> Shape:
        """What an entry's shape takes for granted."""
        keys = self.candidates[int(self.owner[entry])].assumed
        shape = self.shape_of(entry)
        return {key: value for key, value in shape.items() if key in keys}

    def slice(self, entry: int) -> slice:
        """Columns of an entry."""
        return slice(int(self.start[entry]), int(self.start[entry] + self.width[entry]))

    def columns_of(self, entries: Sequence[int] | Index) -> Index:
        """Numbers (k,) of the columns of some entries, one after the other."""
        own = [np.arange(self.start[e], self.start[e] + self.width[e]) for e in entries]
        return np.concatenate([self.start[:0], *own])

    @cached_property
    def batches(self) -> tuple[Index, ...]:
        """Column numbers (n, w) of the entries of several columns: by width, those of known usual sizes apart."""
        kinds = sorted(
            {(int(w), bool(known)) for w, known in zip(self.width, self.sized, strict=True) if w > 1}
        )
        begin = [(w, self.start[(self.width == w) & (self.sized == known)]) for w, known in kinds]
        return tuple(first[:, None] + np.arange(w) for w, first in begin)

    @cached_property
    def pairs(self) -> tuple[Index, Index]:
        """(Q,) numbers of the one and the other of all pairs of columns of one entry, batch by batch."""
        of_batch = [columns[:, np.array(np.triu_indices(columns.shape[1], 1))] for columns in self.batches]
        one, other = (np.concatenate([self.start[:0], *(p[:, k].ravel() for p in of_batch)]) for k in (0, 1))
        return one, other


def build(
    problem: Problem,
    candidates: Sequence[Candidate],
    generic: Sequence[Candidate],
) -> Bank:
    """Evaluate every shape of every available candidate once.

    A candidate whose columns are all zero or not finite keeps no entry and drops out of the bank.
    """
    blocks: list[Array] = []
    owner: list[int] = []
    shape: list[int] = []
    kept: list[Candidate] = []
    is_generic: list[bool] = []
    for candidate, flag in [*((c, False) for c in candidates), *((c, True) for c in generic)]:
        found = _blocks(candidate)
        if not found:
            continue
        for number, block in found:
            blocks.append(block)
            owner.append(len(kept))
            shape.append(number)
        kept.append(candidate)
        is_generic.append(flag)
    columns = np.hstack(blocks) if blocks else np.zeros((problem.rows, 0))
    width = np.array([b.shape[1] for b in blocks], dtype=np.intp)
    length = np.linalg.norm(columns, axis=0)
    length[length == 0] = 1.0
    mask = np.array(is_generic, dtype=bool)
    relative = [
        _usual(kept[c].parameters_at(kept[c].shapes[k]), block)
        for c, k, block in zip(owner, shape, blocks, strict=True)
    ]
    return Bank(
        tuple(kept),
        mask,
        _log_prior(kept, mask),
        columns / length,
        length,
        np.concatenate([[0], np.cumsum(width)[:-1]]).astype(np.intp) if len(width) else width,
        width,
        np.array(owner, dtype=np.intp),
        np.array(shape, dtype=np.intp),
        np.concatenate([r for r, _ in relative]) if relative else length,
        np.array([known for _, known in relative], dtype=bool),
        _shares(kept, owner, shape),
        tuple(_place(problem, blocks[owner.index(i)]) if c.at is None else c.at for i, c in enumerate(kept)),
    )


def _shares(kept: Sequence[Candidate], owner: Sequence[int], shape: Sequence[int]) -> Array:
    """Prior shares (S,) of entries that are one ``shape`` each of their ``owner``."""
    weight = [kept[c].weights[k] if kept[c].weights else 1.0 for c, k in zip(owner, shape, strict=True)]
    return np.asarray(weight / np.bincount(owner, weight)[owner]) if weight else np.zeros(0)


def _usual(parameters: Sequence[Parameter], block: Array) -> tuple[Array, bool]:
    """Relative lengths (k,) of columns at the parameters' usual sizes; ones and False where sizes are not known."""
    sizes = np.array([p.typical for p in parameters])
    if block.shape[1] < 2 or len(sizes) != block.shape[1] or not np.all(sizes > 0):
        return np.ones(block.shape[1]), False
    found = sizes * np.linalg.norm(block, axis=0)
    return np.maximum(found / found.max(), _LEAST_SIZE), True


def _place(problem: Problem, block: Array) -> str:
    """The virtual joint of an actuated joint whose Jacobian column carries a candidate's first shape."""
    if problem.J is None:
        return ""
    label = numbered(problem.pose, problem.case)
    total = float(np.sum(block**2))
    for v, j in enumerate(problem.joint_of):
        if j < 0:
            continue
        J = problem.J[:, v]
        weight = np.bincount(label, J**2)
        weight[weight == 0] = 1.0
        inner = np.stack([np.bincount(label, J * c) for c in block.T])
        if float(np.sum(inner**2 / weight)) > (1.0 - _ELSEWHERE) * total:
            return problem.virtual_joints[v]
    return ""


def _blocks(candidate: Candidate) -> list[tuple[int, Array]]:
    if candidate.unavailable:
        return []
    out = []
    for number, shape in enumerate(candidate.shapes):
        block = candidate.block(shape)
        if block.shape[1] and np.all(np.isfinite(block)) and np.any(block):
            out.append((number, block))
    return out


def _log_prior(kept: Sequence[Candidate], generic: Mask) -> Array:
    """Every effect weighs the same and divides its weight among the kinds of its places, and each kind among its own.

    A frame drifts as often as any of the links. Unnamed laws divide ``UNNAMED``. An effect that the model
    has at a place makes its other forms there likelier.
    """
    kinds = [(c.effect, tuple(sorted(c.where))) for c in kept]
    places = Counter(kind for kind, g in zip(kinds, generic, strict=True) if not g)
    several = Counter(effect for effect, _ in places)
    total = int(np.sum(generic))
    weight = [
        UNNAMED / max(total, 1) if g else (1.0 - UNNAMED) / (len(several) * several[kind[0]] * places[kind])
        for kind, g in zip(kinds, generic, strict=True)
    ]
    kin = np.array([c.kin and not g for c, g in zip(kept, generic, strict=True)], dtype=float)
    prior = np.array(weight)
    return np.asarray(np.log((1.0 - BESIDE) * prior + BESIDE * kin / kin.sum() if kin.any() else prior))
