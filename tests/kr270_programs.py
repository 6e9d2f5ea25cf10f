"""The KR 270's programs with all 56 parameters, built once for the tests that look at them."""

from __future__ import annotations

from functools import cache

from symstiff.reduction.physical import physical_stages, terms_of
from symstiff.robot import load
from symstiff.symbolic.chain import ElasticChain
from symstiff.symbolic.program import Program
from symstiff.symbolic.programs import deflection_program, observation_program


@cache
def kr270_programs() -> tuple[Program, Program]:
    """Deflection and observation of the KR 270's 56 parameters."""
    full = physical_stages(load("kuka_kr270"))[-1].parameters
    names, terms = tuple(p.name for p in full), terms_of(full)
    chain = ElasticChain(load("kuka_kr270"))
    return deflection_program(chain, terms, names), observation_program(chain, terms, names)
