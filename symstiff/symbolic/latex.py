"""Programs and laws as equations for a notebook: no symbol stands for two things, every index counts from 1."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

import numpy as np
import sympy as sp

from symstiff.symbolic.program import Emit, Let, Program

_LINES = 40
_WORDS = re.compile(r"(?P<words>[a-z]{2,}(_[a-z]{2,})+)_(?P<indices>\d.*)")
"""An effect's parameter: words, then the place and what it is of."""
_LONG = 10**5
"""Denominator from which on a fraction is told as a decimal."""


def program_latex(program: Program) -> str:
    r"""Constants, temporaries and outputs in order, at most 40 lines.

    Upright c and s are cosines and sines, \varphi their angles: c_2 is a compliance, a_2 a length.
    """
    names = {c.symbol: _upright(c.symbol) for c in program.constants} | _turning(program)
    lines = [(names[c.symbol], c.exact) for c in program.constants]
    for s in program.statements:
        left = latex(s.symbol, names) if isinstance(s, Let) else _element(program, s)
        lines.append((left, s.expression))
    shown = [f"{left} &= {latex(right, names)}" for left, right in lines[:_LINES]]
    if len(lines) > _LINES:
        shown.append(rf"&\;\;\vdots \quad ({len(lines) - _LINES}\text{{ more}})")
    return aligned(shown)


def latex(expression: sp.Expr, names: Mapping[sp.Symbol, str] | None = None) -> str:
    """An expression with the letters of its symbols: those of ``names``, elsewhere those of ``letter``."""
    letters = {s: letter(s) for s in expression.free_symbols} | dict(names or {})
    return str(sp.latex(expression, symbol_names=letters, mul_symbol=r"\,"))


def decimals(expression: sp.Expr) -> sp.Expr:
    """An expression whose long fractions are decimals of six digits, for eyes."""
    long = [x for x in expression.atoms(sp.Rational) if x.q > _LONG]
    return expression.xreplace({x: sp.Float(float(x), 6) for x in long})


def letter(symbol: sp.Symbol) -> str:
    r"""A symbol with its indices apart, words upright: ``k_{1,35}``, ``\tau_{\mathrm{link1,5}}``.

    An effect's parameter is its identifier, with place and name as indices: ``\mathrm{thermal\ drift}_{\mathrm{2,x}}``.
    """
    if several := _WORDS.fullmatch(symbol.name):
        words, indices = several["words"].replace("_", r"\ "), several["indices"].replace("_", ",")
        return rf"\mathrm{{{words}}}_{{\mathrm{{{indices}}}}}"
    head, below, indices = str(sp.latex(symbol)).partition("_{")
    if head == "dt":
        head = r"\Delta t"
    elif re.fullmatch("[A-Za-z]{2,}", head):
        head = rf"\mathrm{{{head}}}"
    if not below:
        return head
    indices = indices.removesuffix("}").replace(" ", ",")
    return rf"{head}_{{\mathrm{{{indices}}}}}" if re.search("[a-z]{2}", indices) else f"{head}_{{{indices}}}"


def aligned(lines: Iterable[str]) -> str:
    """Equations below each other."""
    return r"$$\begin{aligned}" + r"\\".join(lines) + r"\end{aligned}$$"


def _turning(program: Program) -> dict[sp.Symbol, str]:
    """Letters of the temporaries that are a joint's cosine or sine, or its angle where this is a temporary too."""
    lets = {s.symbol: s.expression for s in program.statements if isinstance(s, Let)}
    turns = {s: e for s, e in lets.items() if isinstance(e, sp.sin | sp.cos) and s.name[0] in "cs"}
    angles = {e.args[0] for e in turns.values() if e.args[0] in lets}
    return {s: _upright(s) for s in turns} | {a: letter(a).replace("a", r"\varphi", 1) for a in angles}


def _upright(symbol: sp.Symbol) -> str:
    told = letter(symbol)
    head, below, indices = told.partition("_")
    return told if head.startswith("\\") else rf"\mathrm{{{head}}}{below}{indices}"


def _element(program: Program, emit: Emit) -> str:
    place = np.unravel_index(emit.index, dict(program.outputs)[emit.vector])
    return f"{emit.vector}_{{{','.join(str(k + 1) for k in place)}}}"
