"""Irrational numbers of the exact engine: beams whose unit vector has roots."""

from __future__ import annotations

from typing import Any

import pytest
from numerics import assert_couplings_hold, columns, rank

from symstiff.reduction import reduce
from symstiff.reduction.closed_form import closed_form
from symstiff.reduction.structural import LOADS
from symstiff.robot import Robot, from_table
from symstiff.symbolic.chain import ElasticChain

OBLIQUE = [([0.3, -0.5, 0], 0.3, 0.5), ([0.3, -0.4, 0], 0.3, 0.4), (["0.35", -0.675, 0], 0.35, 0.675)]


@pytest.mark.parametrize(("beam", "a", "d"), OBLIQUE)
@pytest.mark.parametrize("loads", list(LOADS))
def test_a_beam_along_its_link_reduces_alike_whether_its_unit_vector_is_rational_or_not(
    beam: Any, a: float, d: float, loads: str
) -> None:
    pedestal = {"a": a, "alpha": "-pi/2", "d": d, "link": {"beam_axis": beam}}
    arm = {"a": 0.6, "alpha": 0, "d": 0, "link": {"beam_axis": "x"}}
    table = {"format": 1, "name": "oblique", "base": {"link": {"beam_axis": "z"}}, "joint": [pedestal, arm]}
    r = reduce(from_table({**table, "tool": {"xyz": [0.05, 0.02, 0.1]}}), loads)
    assert {"k0_26", "k0_35"} <= set(r.partition.g1)
    assert rank(columns(r)) == r.partition.rank
    assert_couplings_hold(r)


def oblique_four() -> Robot:
    """Links of which each is bent, with its beam along the lever; 60 digits find ranks 30 and 26."""
    bent = {"a": 0.1, "alpha": "-pi/2", "d": 0.2, "link": {"beam_axis": [0.1, -0.2, 0.0]}}
    arm = {"a": 0.5, "alpha": 0, "d": 0.1, "link": {"beam_axis": [0.5, 0, 0.1]}}
    wrist = {"a": 0, "alpha": "pi/2", "d": 0.2, "link": {"beam_axis": "y"}}
    base, tool = {"link": {"beam_axis": "z"}}, {"xyz": [0.05, 0.02, 0.1]}
    return from_table(
        {"format": 1, "name": "bent", "base": base, "joint": [bent, arm, bent, wrist], "tool": tool}
    )


@pytest.mark.parametrize(("loads", "count"), [("wrench", 30), ("gravity", 26)])
def test_beams_along_bent_links_give_the_rank_that_sixty_digits_give(loads: str, count: int) -> None:
    r = reduce(oblique_four(), loads)
    assert rank(columns(r)) == r.partition.rank == count
    assert_couplings_hold(r)
    chain = ElasticChain(r.robot, symbolic=True)
    lengths = dict(zip(chain.lengths(), chain.length_values(), strict=True))
    for e, row in closed_form(r).items():
        for k, c in row.items():
            assert float(c.subs(lengths)) == pytest.approx(float(r.partition.couplings[e][k]), rel=1e-12)
