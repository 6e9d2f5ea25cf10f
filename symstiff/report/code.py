"""The effect as formulas, and what it changed in the C code."""

from __future__ import annotations

import difflib
import hashlib
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
_LONE_DOT = re.compile(r"<mo>·</mo>(?=(</mrow>)*(<mo>[+-]</mo>|$))")
"""The dot behind a parameter that nothing is multiplied with."""


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
        body = mathml(_readable(told, names), printer="presentation")
        for k, parameter in enumerate(names):
            body = body.replace(f"<mi>{_stand_in(k)}</mi>", _parameter(parameter))
        body = _LONE_DOT.sub("", body)
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
                    f"{letter}: a function of {_joints(own)} alone, written out below"
                    for own, letter in letters.items()
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
        own = letters.setdefault(own, sp.Symbol("abcdefgh"[len(letters) % 8]))
    return sp.Add(*parts, own, evaluate=False) if parts and own != 0 else sp.Add(*parts, own)


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
    return f"<mtext>{name}</mtext><mo>·</mo>"


def _readable(law: sp.Expr, names: list[str]) -> sp.Expr:
    """Parameters as stand-ins; loads as τ with the virtual joint as index; long fractions to four digits."""
    import sympy as sp

    renamed = {sp.Symbol(name): sp.Symbol(_stand_in(k)) for k, name in enumerate(names)}
    for s in law.free_symbols:
        if s.name.startswith("tau_"):
            renamed[s] = sp.Symbol(
                "tau_" + s.name[4:].replace("_", ",").replace("joint", "").replace("link", "")
            )
    with sp.evaluate(False):
        return _rounded(law, _READ).xreplace(renamed)


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
    from symstiff.codegen.emit import base_context, environment
    from symstiff.codegen.functions import Functions
    from symstiff.codegen.options import Options

    jinja, context = environment(), base_context(Functions(model), Options(targets=("c",)))
    header, source = (jinja.get_template(f"c/{name}.j2").render(context) for name in ("header.h", "source.c"))
    return excerpt(header, source)


def excerpt(header: str, source: str) -> list[str]:
    """The same lines of emitted C."""
    return [*_block(header, "typedef struct"), "", *_block(source, "static void deflection_core(")]


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
