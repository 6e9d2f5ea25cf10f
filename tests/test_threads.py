"""Work side by side: in order, with the same bits for any number of processors."""

from __future__ import annotations

from itertools import chain

import numpy as np
import pytest

from symstiff import threads
from symstiff.discrepancy.statistics.null import null
from symstiff.discrepancy.statistics.prepare import prepare
from symstiff.discrepancy.statistics.scan import extend
from symstiff.threads import in_threads
from tests.test_discrepancy_engine import arm, measured


@pytest.mark.parametrize("processors", [1, 3])
def test_results_come_in_order_and_failures_come_through(
    monkeypatch: pytest.MonkeyPatch, processors: int
) -> None:
    monkeypatch.setattr(threads, "_processors", lambda: processors)
    assert in_threads(lambda x: x * x, range(50)) == [x * x for x in range(50)]
    assert in_threads(lambda x: x, []) == []
    with pytest.raises(ZeroDivisionError):
        in_threads(lambda x: 1 / (x - 7), range(20))


def test_the_number_of_processors_changes_no_bit_of_a_scan(monkeypatch: pytest.MonkeyPatch) -> None:
    a = arm(12)
    problem = measured(a.problem, 30.0, 3)
    seen = []
    for processors in (1, 3):
        monkeypatch.setattr(threads, "_processors", lambda n=processors: n)
        scan = prepare(problem, a.candidates).scan
        drawn = null(scan, 300, 5)
        scans = [scan, extend(scan, (2,)), extend(scan, (1, 4))]
        layers = [(la.y, la.left2, la.bases.scale, la.bases.variance) for s in scans for la in s.layers]
        seen.append([*chain.from_iterable(layers), *(s.squares for s in scans), drawn.named, drawn.generic])
    for one, other in zip(*seen, strict=True):
        np.testing.assert_array_equal(one, other)
