"""Whether M3 keeps the model complete: an aggregated joint must act within its link's remaining terms."""

from __future__ import annotations

from collections.abc import Sequence

from symstiff.reduction.physical import Parameter, Stage, terms_of
from symstiff.reduction.structural import ExactEngine, Experiment
from symstiff.symbolic.chain import ElasticChain
from symstiff.symbolic.programs import observation_program


def inexact_aggregations(
    chain: ElasticChain, stages: Sequence[Stage], experiment: Experiment
) -> tuple[str, ...]:
    """Return the joint compliances that M3 drops though the full set π′ cannot stand for them.

    A joint adds c·u·uᵀ to the link before it, u its axis in that link's elastic frame: exact where the template
    has all of these entries, as it does for a beam with an elastic axis along the joint. Elsewhere the rank decides,
    for the class of loads and measurements (seed section 3.1, M3 and completeness).
    """
    suspects = tuple(p for p in _absorbed(stages) if not _inside_template(chain, stages[2], p))
    if not suspects:
        return ()
    full = stages[3].parameters
    names = tuple(p.name for p in (*full, *suspects))
    program = observation_program(chain, terms_of((*full, *suspects)), names, experiment.points)
    engine = ExactEngine(chain, program, names, experiment)
    form, pivots = engine.reduced(engine.primes[0], range(len(names)))
    beyond = [r for r, column in enumerate(pivots) if column >= len(full)]
    return tuple(p.name for c, p in enumerate(suspects, start=len(full)) if form[beyond, c].any())


def joint_direction(chain: ElasticChain, joint: int) -> dict[int, float]:
    """Components of a joint's axis along the elastic axes (1 to 6) of the link before it; zeros left out."""
    shift = 0 if chain.rows[joint - 1].prismatic else 3
    components = {k + shift: axis[2] for k, axis in enumerate(chain.exact_axes(joint - 1), start=1)}
    return {k: float(u) for k, u in components.items() if u != 0}


def _absorbed(stages: Sequence[Stage]) -> tuple[Parameter, ...]:
    return tuple(p for p in stages[2].parameters if p.is_joint and stages[3].stands_for[p.name] is None)


def _inside_template(chain: ElasticChain, sparsed: Stage, p: Parameter) -> bool:
    entries = {(q.row, q.column) for q in sparsed.parameters if q.body == p.body - 1 and not q.is_joint}
    along = joint_direction(chain, p.body)
    return entries.issuperset((r, c) for r in along for c in along if r <= c)
