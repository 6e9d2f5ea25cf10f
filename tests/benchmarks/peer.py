"""A competitor: one engine's source for one quantity, with what is known before it is compiled."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from tests.benchmarks.case import Case
from tests.benchmarks.geometry import STYLES, Style

QUANTITIES = ("deflection", "observation")


@dataclass(frozen=True)
class Peer:
    """One competitor for one quantity.

    call: a C statement that computes ``y`` from ``q``, ``w`` and ``k``; entry: the function whose code and stack
    count; by_columns: whether matrices come column by column; operations: add, mul, neg, trig, other.
    """

    name: str
    quantity: str
    derivation: float
    operations: dict[str, int]
    entry: str
    declaration: str
    call: str
    sources: dict[str, str] = field(default_factory=dict)
    by_columns: bool = False
    note: str = ""

    @property
    def total(self) -> int:
        """Additions, multiplications and sign changes (and anything but sines and cosines)."""
        return sum(n for kind, n in self.operations.items() if kind != "trig")


Formula = Callable[[Any, Any, Any], Any]  # of q, w, k
Graph = Callable[[Case, Any, Any, Any, Style], Any]
Make = Callable[[Case, str, str, Formula, str], Peer]


def best(
    case: Case, name: str, quantity: str, make: Make, graph: Graph, styles: Sequence[Style] = STYLES
) -> Peer:
    """The style in which an engine needs the fewest operations."""
    tried = [make(case, name, quantity, partial(_styled, graph, case, style), str(style)) for style in styles]
    return min(tried, key=lambda peer: peer.total)


def _styled(graph: Graph, case: Case, style: Style, q: Any, w: Any, k: Any) -> Any:
    return graph(case, q, w, k, style)
