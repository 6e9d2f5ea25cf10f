"""Building a program: expressions are bound to temporaries as they come, and tidied once when all are there."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import count

import sympy as sp

from symstiff.symbolic.program import Constant, Emit, Let, Program, Statement, Vector, negative


@dataclass
class Builder:
    """Collects let-bound statements; equal expressions (up to sign) share one temporary."""

    name: str
    inputs: tuple[Vector, ...]
    statements: list[Statement] = field(default_factory=list)
    constants: list[Constant] = field(default_factory=list)
    _known: dict[sp.Expr, sp.Symbol] = field(default_factory=dict)
    _angles: dict[sp.Expr, tuple[sp.Expr, sp.Expr]] = field(default_factory=dict)
    _outputs: dict[str, tuple[int, ...]] = field(default_factory=dict)

    def let(self, expression: sp.Expr) -> sp.Expr:
        """Bind an expression to a temporary; returns ± its symbol (atoms come back unchanged)."""
        if expression.is_Atom:
            return expression
        if expression.is_Mul and len(expression.args) == 2 and expression.args[0] is sp.S.NegativeOne:
            inner = expression.args[1]
            return expression if inner.is_Atom else -self.let(inner)
        if expression.is_Add:
            expression = sp.Add(*[self._product(a) for a in expression.args])
            if not expression.is_Add:
                return self.let(expression)
        if negative(expression):
            return -self._bound(-expression)
        return self._bound(expression)

    def _bound(self, expression: sp.Expr) -> sp.Symbol:
        symbol = self._known.get(expression)
        if symbol is None:
            symbol = self._known[expression] = sp.Symbol(f"t{len(self._known)}")
            self.statements.append(Let(symbol, expression))
        return symbol

    def _product(self, expression: sp.Expr) -> sp.Expr:
        return self.let(expression) if expression.is_Mul or expression.is_Pow else expression

    def vector(self, expressions: Iterable[sp.Expr]) -> tuple[sp.Expr, ...]:
        """Bind every component."""
        return tuple(self.let(sp.sympify(e)) for e in expressions)

    def turn(self, angle: sp.Expr) -> tuple[sp.Expr, sp.Expr]:
        """Cosine and sine of a constant angle: constants where one of them is irrational, a sine of one half too."""
        cosine, sine = sp.cos(angle), sp.sin(angle)
        if cosine.is_Rational and sine.is_Rational:
            return cosine, sine
        return self._constant(cosine, angle), self._constant(sine, sp.pi / 2 - angle)

    def rotation(self, cosine: sp.Expr, sine: sp.Expr) -> tuple[sp.Expr, sp.Expr]:
        """Constants for an exact rotation given by its cosine and sine: fractions, roots of fractions."""
        if cosine.is_Rational and sine.is_Rational:
            return cosine, sine
        return self._constant(cosine), self._constant(sine)

    def _constant(self, exact: sp.Expr, turn: sp.Expr | None = None) -> sp.Expr:
        """Name a constant; a sign goes outside."""
        if float(exact) < 0:
            return -self._constant(-exact, None if turn is None else turn + sp.pi)
        for known in self.constants:
            if known.exact == exact:
                return known.symbol
        symbol = sp.Symbol(f"const{len(self.constants)}")
        self.constants.append(Constant(symbol, exact, turn))
        return symbol

    def cos_sin(self, angle: sp.Expr, name: str) -> tuple[sp.Expr, sp.Expr]:
        """Cosine and sine of an angle: exact for a constant, multiples of pi/2 folded, else temporaries c…, s…."""
        if not angle.free_symbols:
            return self.turn(angle)
        if angle not in self._angles:
            offset = sp.Add(*[a for a in sp.Add.make_args(angle) if not a.free_symbols])
            quarter = offset / (sp.pi / 2)
            if offset != 0 and quarter.is_Integer:
                self._angles[angle] = _quarter_turns(*self.cos_sin(angle - offset, name), int(quarter) % 4)
            elif (parts := self._parts(angle)) is not None:  # six operations cost less than two functions
                (c, s), (d, t) = parts
                self._angles[angle] = self.let(c * d - s * t), self.let(s * d + c * t)
            else:
                self._angles[angle] = self._trigonometric(angle, name)
        return self._angles[angle]

    def turned(self, expression: sp.Expr) -> sp.Expr | None:
        """A cosine or sine of a constant, or of an angle that is bound; None for anything else."""
        if not isinstance(expression, sp.cos | sp.sin):
            return None
        angle = expression.args[0]
        if angle.free_symbols and angle not in self._angles:
            return None
        return self.cos_sin(angle, "")[isinstance(expression, sp.sin)]

    def _parts(self, angle: sp.Expr) -> tuple[tuple[sp.Expr, sp.Expr], tuple[sp.Expr, sp.Expr]] | None:
        """Cosines and sines of two angles that are bound and add up to this one."""
        for known, pair in self._angles.items():
            rest = angle - known
            if rest in self._angles:
                return pair, self._angles[rest]
        return None

    def _trigonometric(self, angle: sp.Expr, name: str) -> tuple[sp.Expr, sp.Expr]:
        pair = sp.Symbol(f"c{name}"), sp.Symbol(f"s{name}")
        argument = angle if angle.is_Symbol else sp.Symbol(f"a{name}")
        if not angle.is_Symbol:
            self.statements.append(Let(argument, angle))
        self.statements += [Let(pair[0], sp.cos(argument)), Let(pair[1], sp.sin(argument))]
        return pair

    def output(self, name: str, shape: tuple[int, ...], expressions: Sequence[sp.Expr]) -> None:
        """Declare an output and its elements in row-major order."""
        self._outputs[name] = shape
        for index, expression in enumerate(expressions):
            self.statements.append(Emit(name, index, self.let(sp.sympify(expression))))

    def build(self) -> Program:
        """Drop what no output needs, inline what is used once, emit outputs as soon as they can be."""
        from symstiff.symbolic.signs import with_fewest_signs

        statements = _ordered(with_fewest_signs(_inlined(_needed(self.statements))))
        used = set().union(*(s.expression.free_symbols for s in statements)) if statements else set()
        constants = tuple(c for c in self.constants if c.symbol in used)
        return Program(self.name, self.inputs, constants, _renamed(statements), tuple(self._outputs.items()))


def _quarter_turns(c: sp.Expr, s: sp.Expr, turns: int) -> tuple[sp.Expr, sp.Expr]:
    return ((c, s), (-s, c), (-c, -s), (s, -c))[turns]


def _needed(statements: Sequence[Statement]) -> list[Statement]:
    """Keep outputs and what they depend on."""
    needed: set[sp.Symbol] = set()
    kept: list[Statement] = []
    for statement in reversed(statements):
        if isinstance(statement, Emit) or statement.symbol in needed:
            needed |= statement.expression.free_symbols
            kept.append(statement)
    return kept[::-1]


def _inlined(statements: Sequence[Statement]) -> list[Statement]:
    """Put temporaries that are used once where they are used: products into sums, anything into an output."""
    uses: Counter[sp.Symbol] = Counter()
    for statement in statements:
        uses.update(statement.expression.free_symbols)
    pending: dict[sp.Symbol, sp.Expr] = {}
    kept: list[Statement] = []
    for statement in statements:
        expression = statement.expression
        inner = {s: pending.pop(s) for s in expression.free_symbols if s in pending}
        if inner:
            if not all(_may_inline(expression, s, e) for s, e in inner.items()):
                for symbol, value in sorted(inner.items(), key=lambda item: item[0].name):
                    if not _may_inline(expression, symbol, value):
                        kept.append(Let(symbol, value))
                        del inner[symbol]
            expression = expression.xreplace(inner)
        if isinstance(statement, Emit):
            kept.append(Emit(statement.vector, statement.index, expression))
        elif uses[statement.symbol] == 1 and (expression.is_Mul or expression.is_Add):
            pending[statement.symbol] = expression
        else:
            kept.append(Let(statement.symbol, expression))
    return kept


def _may_inline(parent: sp.Expr, symbol: sp.Symbol, value: sp.Expr) -> bool:
    """A product may stand in a sum, and anything as the whole of an output (its sign included)."""
    if parent in (symbol, -symbol):
        return bool(parent == symbol or value.is_Mul)
    return bool(parent.is_Add and value.is_Mul and symbol not in _factors(parent))


def _factors(total: sp.Expr) -> set[sp.Symbol]:
    """Symbols that stand inside products of a sum (other than with a coefficient ±1)."""
    inside: set[sp.Symbol] = set()
    for argument in total.args:
        if argument.is_Symbol or (argument.is_Mul and len(argument.args) == 2 and argument.args[0] == -1):
            continue
        inside |= argument.free_symbols
    return inside


def _ordered(statements: Sequence[Statement]) -> list[Statement]:
    """Move every output up to the place where its last temporary is known."""
    place: dict[sp.Symbol, int] = {}
    lets = [s for s in statements if isinstance(s, Let)]
    for position, let in enumerate(lets):
        place[let.symbol] = position
    due: dict[int, list[Emit]] = {}
    for statement in statements:
        if isinstance(statement, Emit):
            last = max((place[s] for s in statement.expression.free_symbols if s in place), default=-1)
            due.setdefault(last, []).append(statement)
    ordered: list[Statement] = list(due.get(-1, []))
    for position, let in enumerate(lets):
        ordered.append(let)
        ordered += due.get(position, [])
    return ordered


def _renamed(statements: Sequence[Statement]) -> tuple[Statement, ...]:
    """Number the temporaries t0, t1, … in order."""
    names: dict[sp.Symbol, sp.Symbol] = {}
    renamed: list[Statement] = []
    numbers = count()
    for statement in statements:
        expression = statement.expression.xreplace(names)
        if isinstance(statement, Let):
            symbol = statement.symbol
            if symbol.name[0] == "t" and symbol.name[1:].isdigit():
                names[symbol] = sp.Symbol(f"t{next(numbers)}")
            renamed.append(Let(names.get(symbol, symbol), expression))
        else:
            renamed.append(Emit(statement.vector, statement.index, expression))
    return tuple(renamed)
