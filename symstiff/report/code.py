"""The effect as formulas, and what it changed in the C code."""

from __future__ import annotations

import difflib
import hashlib
import math
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from symstiff.effects.instance import EffectInstance
from symstiff.robot.schema import Robot

if TYPE_CHECKING:
    import sympy as sp

    from symstiff.model import StiffnessModel

_MOST_TERMS, _MOST_LINES = 8, 90
_LONG = 20
"""Operations from which a sum that depends on several joints alone, as an arm's weight does, stands as a letter."""
_READ, _WRITTEN = 4, 6
"""Significant digits of long fractions in a formula, and in the text of it that one copies."""
_TEMPORARY = re.compile(r"\bt(\d+)\b")
_PLAIN, _DIGIT, _LARGE, _ENDS, _WHOLE = 4, 9, 10**5, 5, 1e-9
"""Denominators and numerators up to which a fraction stands as one in a formula, and denominators of one over a whole
number; digits of a decimal that has an end; what a whole number may be off."""
_MEANT = {
    "branch": "branch: 1 where the load rises and −1 where it falls",
    "turn": "turn: the joint's load where it last turned over its present one, 1 while it grows",
    "up": "up: the vertical in the axes of the link's frame",
    "time": "time in s",
    "temperature": "temperature in °C",
}
"""What stands in a law beside its parameter, load and angles."""


@dataclass(frozen=True)
class Formula:
    """A law: as MathML for reading, as SymPy's text for copying, and what its letters stand for."""

    mathml: str
    text: str
    letters: str = ""


def formulas(robot: Robot, instance: EffectInstance) -> list[Formula]:
    """The terms that an effect added to the model, one law a virtual joint."""
    import sympy as sp
    from sympy.printing.mathml import mathml

    laws: dict[str, tuple[str, sp.Expr]] = {}
    for term in instance.realise(robot).terms:
        kind, place = term.at.kind, f"{term.at.body}" + (f",{term.at.axis}" if term.at.axis else "")
        slides = kind == "joint" and robot.joint[term.at.body - 1].prismatic
        turned = f"q_{place}" if slides else f"theta_{place}"
        symbol = {
            "measure": f"t_{term.at.axis}", "load": f"W_{term.at.axis}", "body": f"W_{place}"
        }.get(kind, turned)  # fmt: skip
        with sp.evaluate(False):
            symbol_of = sp.Symbol(term.parameter)
            law = symbol_of if term.factor == 1 else symbol_of * term.factor
            before = laws.get(term.at.name)
            laws[term.at.name] = (symbol, law if before is None else before[1] + law)
    out = []
    names = [p.name for p in instance.realise(robot).parameters]
    for name, (symbol, law) in list(laws.items())[:_MOST_TERMS]:
        letters: dict[sp.Expr, sp.Symbol] = {}
        told = _abridged(law, letters)
        body = mathml(_readable(told, names), printer="presentation", mul_symbol="dot")
        for k, parameter in enumerate(names):
            body = body.replace(f"<mi>{_stand_in(k)}</mi>", _parameter(parameter))
        body = body.replace("<mo>-</mo>", "<mo>−</mo>").replace("<mo> </mo>", "<mo>,</mo>")
        left = mathml(sp.Symbol(symbol), printer="presentation")
        out.append(
            Formula(
                f'<math display="block"><mrow><mi>Δ</mi>{left}<mo>=</mo>{body}</mrow></math>',
                "\n".join(
                    [
                        f"{name} += {_rounded(told, _WRITTEN)}",
                        *(f"{letter} = {_rounded(own, _WRITTEN)}" for own, letter in letters.items()),
                    ]
                ),
                "; ".join(
                    [
                        *(
                            f"{letter}: a function of {_joints(own)} alone, written out below"
                            for own, letter in letters.items()
                        ),
                        *_meant(told),
                    ]
                ),
            )
        )
    return out


def _abridged(law: sp.Expr, letters: dict[sp.Expr, sp.Symbol]) -> sp.Expr:
    """The law with a letter, kept in ``letters``, for every long part of a sum that depends on several joints alone."""
    import sympy as sp

    if not law.is_Add:
        return law.func(*(_abridged(x, letters) for x in law.args), evaluate=False) if law.args else law
    parts = [_abridged(x, letters) for x in law.args if not _of_joints(x)]
    own = sp.Add(*(x for x in law.args if _of_joints(x))).xreplace(letters)
    if _of_joints(own) and len(own.free_symbols) > 1 and own.count_ops() > _LONG:
        own = letters.setdefault(own, sp.Symbol(_letter(len(letters))))
    return sp.Add(*parts, own, evaluate=False) if parts and own != 0 else sp.Add(*parts, own)


def _letter(count: int) -> str:
    """The next letter, a to h, and from the ninth on with a number."""
    turn, which = divmod(count, 8)
    return "abcdefgh"[which] + (str(turn + 1) if turn else "")


def _of_joints(x: sp.Expr) -> bool:
    return bool(x.free_symbols) and all(s.name.startswith("q_") for s in x.free_symbols)


def _joints(x: sp.Expr) -> str:
    return ", ".join(sorted(s.name.replace("_", "") for s in x.free_symbols))


def _stand_in(k: int) -> str:
    """A name that MathML does not take apart at underscores."""
    return "PARAMETER" + "".join(chr(ord("A") + int(digit)) for digit in str(k))


def _parameter(name: str) -> str:
    """A parameter as MathML: a compliance with its indices, another effect's by its whole name."""
    head, underscore, axes = name.partition("_")
    if underscore and head[0] == "k" and head[1:].isdigit() and axes.isdigit():
        return f"<msub><mi>k</mi><mtext>{head[1:]},{axes}</mtext></msub>"
    return f"<mtext>{name}</mtext>"


def _meant(law: sp.Expr) -> list[str]:
    """What the words of a law mean."""
    words = {s.name.partition("_")[0] for s in law.free_symbols}
    return [meaning for word, meaning in _MEANT.items() if word in words]


def _readable(law: sp.Expr, names: list[str]) -> sp.Expr:
    """Parameters as stand-ins; loads as τ with the virtual joint as index; fractions that one reads at a glance."""
    import sympy as sp

    renamed = {sp.Symbol(name): sp.Symbol(_stand_in(k)) for k, name in enumerate(names)}
    for s in law.free_symbols:
        if s.name.startswith("tau_"):
            renamed[s] = sp.Symbol(
                "tau_" + s.name[4:].replace("_", ",").replace("joint", "").replace("link", "")
            )
    legible = {
        r: _legible(r) for r in law.atoms(sp.Rational) if r.q > _PLAIN or (r.q > 1 and abs(r.p) > _DIGIT)
    }
    with sp.evaluate(False):
        return _flat(_rounded(law.xreplace(legible), _READ)).xreplace(renamed)


def _legible(fraction: sp.Rational) -> sp.Expr:
    """A fraction as a decimal, or as one over a decimal where that has an end: 25/97 is 1/3.88."""
    import sympy as sp

    if fraction < 0:
        return sp.Mul(-1, _legible(-fraction), evaluate=False)
    turned = 1 / fraction
    if turned.q == 1 and turned.p < _LARGE:
        return sp.Pow(turned, -1, evaluate=False)
    for number in (fraction, turned):
        short = f"{float(number):.{_ENDS}g}"
        if "e" not in short and sp.Rational(short) == number:
            decimal = sp.Float(short, _ENDS)
            return decimal if number is fraction else sp.Pow(decimal, -1, evaluate=False)
    return sp.Float(float(fraction), _READ)


def _flat(law: sp.Expr) -> sp.Expr:
    """A product of products as one, with one number in front."""
    import sympy as sp

    if not law.args:
        return law
    parts = [_flat(x) for x in law.args]
    if not law.is_Mul:
        return law.func(*parts, evaluate=False) if law.is_Add or law.is_Pow else law.func(*parts)
    parts = [y for x in parts for y in (x.args if x.is_Mul else (x,))]
    numbers = [x for x in parts if x.is_number]
    others = [x for x in parts if not x.is_number]
    if sum(abs(x) != 1 for x in numbers) > 1:
        value = math.prod(map(float, numbers))
        numbers = [sp.Integer(round(value)) if abs(value - round(value)) < _WHOLE else sp.Float(value, _READ)]
    front = [x for x in numbers if x != 1]
    return (
        sp.Mul(*front, *others, evaluate=False) if len(front) + len(others) > 1 else sp.Mul(*front, *others)
    )


def _rounded(law: sp.Expr, digits: int) -> sp.Expr:
    """The law with its long fractions as decimals."""
    import sympy as sp

    long = (r for r in law.atoms(sp.Rational) if r.q > 1000 or abs(r.p) > 10**6)
    with sp.evaluate(False):
        return law.xreplace({r: sp.Float(float(r), digits) for r in long})


@dataclass(frozen=True)
class Line:
    """A line of a difference; kind: ``+``, ``-``, `` `` or ``@``."""

    kind: str
    text: str


def core(model: StiffnessModel) -> list[str]:
    """Lines of the C function that evaluates the deflection, and of the parameters' struct."""
    from symstiff.codegen.emit import deflection_alone
    from symstiff.codegen.functions import Functions

    return excerpt(deflection_alone(Functions(model)))


def excerpt(emitted: str) -> list[str]:
    """The same lines of emitted C."""
    return [*_block(emitted, "typedef struct"), "", *_block(emitted, "static void deflection_core(")]


def _block(text: str, start: str) -> list[str]:
    """From a line that begins so to the brace that closes at its level."""
    lines = text.splitlines()
    begin = next(
        (k for k, line in enumerate(lines) if line.startswith(start) and not line.endswith(";")), None
    )
    if begin is None:
        return []
    end = next((k for k in range(begin, len(lines)) if lines[k].startswith("}")), len(lines) - 1)
    return lines[begin : end + 1]


def difference(before: list[str], after: list[str]) -> list[Line]:
    """A unified difference that does not mind how temporaries are numbered."""
    a, b = _keys(before), _keys(after)
    matcher = difflib.SequenceMatcher(None, a, b, autojunk=False)
    out: list[Line] = []
    for group in matcher.get_grouped_opcodes(1):
        out.append(Line("@", f"line {group[0][3] + 1}"))
        for tag, i1, i2, j1, j2 in group:
            if tag == "equal":
                out += [Line(" ", text) for text in after[j1:j2]]
                continue
            out += [Line("-", text) for text in before[i1:i2]]
            out += [Line("+", text) for text in after[j1:j2]]
    if len(out) > _MOST_LINES:
        left = len(out) - _MOST_LINES
        out = [*out[:_MOST_LINES], Line("@", f"and {left} lines more: compare with the code folder")]
    return out


def _keys(lines: list[str]) -> list[str]:
    """Every line with its temporaries replaced by a digest of what they stand for."""
    meaning: dict[str, str] = {}
    out = []
    for line in lines:
        head, equals, tail = line.partition("=")
        told = _TEMPORARY.sub(lambda m: meaning.get(m.group(0), m.group(0)), tail)
        target = _TEMPORARY.search(head)
        if equals and target is not None:
            meaning[target.group(0)] = "t_" + hashlib.sha256(told.encode()).hexdigest()[:12]
        out.append(_TEMPORARY.sub(lambda m: meaning.get(m.group(0), m.group(0)), head) + equals + told)
    return out
