"""Choice of the temporaries' signs, so that as few statements as possible need a change of sign."""

from __future__ import annotations

from collections.abc import Sequence

import sympy as sp

from symstiff.symbolic.program import Emit, Let, Statement, split_sign

_Monomial = tuple[int, frozenset[sp.Symbol]]  # sign, symbols that stand there an odd number of times


def with_fewest_signs(statements: Sequence[Statement]) -> list[Statement]:
    """Replace some temporaries t by −t: a greedy descent on the number of sign changes."""
    search = _Search(statements)
    flipped = search.descend()
    if not flipped:
        return list(statements)
    swap = {s: -s for s in flipped}
    result: list[Statement] = []
    for statement in statements:
        expression = statement.expression.xreplace(swap)
        if isinstance(statement, Emit):
            result.append(Emit(statement.vector, statement.index, expression))
        else:
            result.append(Let(statement.symbol, -expression if statement.symbol in flipped else expression))
    return result


class _Search:
    """The signs' bookkeeping: which statement changes sign under which flips."""

    def __init__(self, statements: Sequence[Statement]) -> None:
        self.own: list[sp.Symbol | None] = []
        self.monomials: list[list[_Monomial]] = []
        self.touching: dict[sp.Symbol, list[int]] = {}
        fixed: set[sp.Symbol] = set()
        for index, statement in enumerate(statements):
            own = statement.symbol if isinstance(statement, Let) else None
            monomials = _monomials(statement.expression)
            if monomials is None:
                fixed |= statement.expression.free_symbols | ({own} if own is not None else set())
                monomials = []
            self.own.append(own)
            self.monomials.append(monomials)
            for symbol in {own, *(s for _, m in monomials for s in m)} - {None}:
                self.touching.setdefault(symbol, []).append(index)
        self.free = [s for s in self.own if s is not None and s not in fixed]
        self.flips: set[sp.Symbol] = set()

    def _cost(self, index: int) -> int:
        monomials = self.monomials[index]
        if not monomials:
            return 0
        own = self.own[index]
        base = -1 if own in self.flips else 1
        return int(all(base * sign * (-1) ** len(m & self.flips) < 0 for sign, m in monomials))

    def _gain(self, symbol: sp.Symbol) -> int:
        before = sum(self._cost(i) for i in self.touching[symbol])
        self.flips ^= {symbol}
        after = sum(self._cost(i) for i in self.touching[symbol])
        self.flips ^= {symbol}
        return before - after

    def descend(self) -> set[sp.Symbol]:
        """Flip single temporaries while that saves sign changes."""
        improved = True
        while improved:
            improved = False
            for symbol in self.free:
                if self._gain(symbol) > 0:
                    self.flips ^= {symbol}
                    improved = True
        return self.flips


def _monomials(expression: sp.Expr) -> list[_Monomial] | None:
    """Signs and symbols of a sum of products; None where something else stands (a function, a power)."""
    found: list[_Monomial] = []
    for term in sp.Add.make_args(expression):
        sign, positive = split_sign(term)
        factors = sp.Mul.make_args(positive)
        if not all(f.is_Symbol or f.is_Number for f in factors):
            return None
        found.append((sign, frozenset(f for f in factors if f.is_Symbol)))
    return found
