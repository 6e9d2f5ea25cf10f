"""Closed forms for reading: what a Program lets be temporaries, written out in the joint variables.

For eyes, not for evaluation: the expressions repeat what a Program computes once.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import product

import sympy as sp
from sympy.simplify.fu import TR8

from symstiff.arguments import A_CHAIN, require, several
from symstiff.display import html_table
from symstiff.errors import UserError
from symstiff.symbolic.chain import ElasticChain
from symstiff.symbolic.latex import aligned, decimals, latex
from symstiff.symbolic.program import Let, Program
from symstiff.symbolic.programs import virtual_jacobian_program
from symstiff.symbolic.terms import AXES, Term, VirtualJoint, joint_terms, link_terms, tau, w

_READ_AT_ONCE, _EXPANDED = 12, 200
"""Operations up to which a part of a law stands in it, and up to which sums of angles are tried."""


def written_out(program: Program) -> dict[str, sp.Matrix]:
    """Outputs of a program as matrices of expressions in its inputs, by name; a vector is one column."""
    values = {c.symbol: c.exact for c in program.constants}
    outputs = {name: sp.zeros(*(*shape, 1)[:2]) for name, shape in program.outputs}
    for statement in program.statements:
        expression = statement.expression.xreplace(values)
        if isinstance(statement, Let):
            values[statement.symbol] = expression
        else:
            outputs[statement.vector][statement.index] = expression
    return outputs


def virtual_jacobian(chain: ElasticChain) -> sp.Matrix:
    """J_θ(q), 6 × m: base axes at the tool centre point, columns in the order of ``chain.virtual_joints`` (seed eq. 2).

    A translation's column is an axis e, a rotation's is lever arm and axis (e × ρ, e). Units: 1, m, rad.
    """
    require(chain, ElasticChain, *A_CHAIN)
    return written_out(virtual_jacobian_program(chain))["J"]


def observation_matrix(
    chain: ElasticChain, W: Sequence[sp.Expr] | None = None, terms: Sequence[Term] | None = None
) -> sp.Matrix:
    """A(q, W) in closed form: the column of a parameter is Σ J_v·g(JᵀW) over its terms (seed eq. 5, 12).

    ``W`` is the wrench at the tool centre point in base axes, w_1 … w_6 where not given [N, N·m]. ``terms`` default to
    those of the original model: all joints, 36 parameters a link. Parameters stand in the order of the terms.
    Raises UserError for other than six components, and for a term of the load, of the measuring device or of a weight,
    which is at no column of J.
    """
    J = virtual_jacobian(chain)
    require(W if W is not None else (), Iterable, "a wrench W", "[0, 0, -F, 0, 0, 0] is a vertical force")
    terms = original_terms(chain) if terms is None else several(terms, Term, "terms", "model.terms")
    wrench = sp.Matrix([w(c) for c in AXES] if W is None else list(W))
    if len(wrench) != len(AXES):
        raise UserError(
            f"W: expected six components, forces first, found {len(wrench)}: [0, 0, -F, 0, 0, 0] is a vertical force"
        )
    column = {v: J[:, k] for k, v in enumerate(chain.virtual_joints)}
    loads = {tau(v): (j.T * wrench)[0] for v, j in column.items()}
    columns: dict[str, sp.Matrix] = {}
    for term in terms:
        if term.at not in column:
            raise UserError(
                f"{term.parameter} acts at {term.at.name}, which is no virtual joint of {chain.robot.name}: leave its "
                "terms out here; model.observation(q, w) has its column in numbers"
            )
        part = column[term.at] * term.factor.xreplace(loads)
        columns[term.parameter] = columns.get(term.parameter, sp.zeros(6, 1)) + part
    return sp.Matrix.hstack(*columns.values())


def original_terms(chain: ElasticChain) -> tuple[Term, ...]:
    """Terms of the original model, base to tip: full 6 × 6 links, one compliance a joint (seed eq. 3)."""
    terms: list[Term] = []
    for i in range(chain.dof + 1):
        terms += joint_terms(i, f"c{i}") if i else ()
        for r, c in product(AXES, AXES):
            terms += link_terms(i, r, c, f"k{i}_{r}{c}", symmetric=False)
    return tuple(terms)


def laws_latex(terms: Sequence[Term], lawless: Sequence[str] = ()) -> str:
    """The laws of a model, one line a place: Δθ_v = Σ π·g at virtual joints, ΔW what effects add to the wrench at the
    tool centre point or on a body, δt what a device adds to the predicted deflection.

    Long sums of joints' sines and cosines, as the links' weight at a joint, are functions f_1, f_2 …, which stand below
    them; last ``lawless`` effects by name, which add to the deflection without a law at a place.
    """
    lines: dict[VirtualJoint, sp.Expr] = {}
    for term in terms:
        law = sp.Symbol(term.parameter) * term.factor
        lines[term.at] = lines.get(term.at, 0) + law
    inside = [at for at in lines if at.kind in ("link", "joint")]
    beside = sorted(set(lines) - set(inside))
    functions: dict[sp.Expr, sp.Symbol] = {}
    shown = [(_left_side(at), _with_functions(lines[at], functions)) for at in (*inside, *beside)]
    shown += [(f"{latex(f)}(q)", known) for known, f in functions.items()]
    equations = [f"{left} &= {latex(decimals(right))}" for left, right in shown]
    return aligned([*equations, *(rf"\Delta t &\;\text{{also by {name}}}" for name in lawless)])


def _with_functions(law: sp.Expr, functions: dict[sp.Expr, sp.Symbol]) -> sp.Expr:
    """A law whose long sums of joints' sines and cosines are symbols; new ones are added to ``functions``."""
    if not law.args:
        return law
    own = [a for a in law.args if _of_posture(a)] if law.is_Add or law.is_Mul else []
    rest = [_with_functions(a, functions) for a in law.args if a not in own]
    known = law.func(*own) if own else None
    if known is not None and known.count_ops() > _READ_AT_ONCE:
        own = [_function(_readable(known), functions)]
    return law.func(*own, *rest)


def _function(known: sp.Expr, functions: dict[sp.Expr, sp.Symbol]) -> sp.Expr:
    """The symbol of an expression, or minus that of its negative."""
    if (opposite := functions.get(sp.expand(-known))) is not None:
        return -opposite
    return functions.setdefault(known, sp.Symbol(f"f_{len(functions) + 1}", real=True))


def _of_posture(expression: sp.Expr) -> bool:
    """Whether an expression is made of numbers and joint variables, their sines and cosines, by sums and products."""
    parts = expression.atoms(sp.Function) - expression.atoms(sp.sin, sp.cos)
    return (
        not parts
        and all(s.name.startswith("q_") for s in expression.free_symbols)
        and not any(p.base.free_symbols for p in expression.atoms(sp.Pow))
    )


def _readable(expression: sp.Expr) -> sp.Expr:
    """With sums of angles for products of their sines and cosines, where that is shorter."""
    if expression.count_ops() > _EXPANDED:
        return expression
    summed = TR8(sp.expand(expression))
    return min(expression, summed, key=sp.count_ops)


def _left_side(at: VirtualJoint) -> str:
    """What a law at a place gives."""
    if at.kind == "load":
        return rf"\Delta W_{{{at.axis}}}"
    if at.kind == "body":
        return rf"\Delta W_{{\mathrm{{body{at.body},{at.axis}}}}}"
    if at.kind == "measure":
        return rf"\delta t_{{{at.axis}}}"
    return rf"\Delta\theta_{{\mathrm{{{at.name.replace('_', ',')}}}}}"


def chain_html(chain: ElasticChain) -> str:
    """Which virtual joint gives which column of J_θ, counted from 0, and along which axes it gives way."""
    rows: list[tuple[str, str, str]] = []
    for i in range(chain.dof + 1):
        first = 7 * i
        if i:
            kind = "translation along" if chain.rows[i - 1].prismatic else "rotation about"
            rows.append((f"joint {i}", str(first - 1), f"{kind} z of frame {i - 1}"))
        axes = ", ".join(_axis(e) for e in chain.exact_axes(i))
        what = f"translations along, rotations about {axes} of frame {i}"
        rows.append((f"link {i}", f"{first} … {first + 5}", what))
    caption = f"{chain.robot.title or chain.robot.name}: {len(chain.virtual_joints)} virtual joints"
    return html_table(("body", "columns of J_θ", "gives way by"), rows, caption)


def _axis(direction: Sequence[sp.Expr]) -> str:
    """x, y or z of the DH frame; another direction as three components."""
    if sorted(direction) == [0, 0, 1]:
        return "xyz"[list(direction).index(1)]
    return f"({', '.join(f'{float(c):.4g}' for c in direction)})"
