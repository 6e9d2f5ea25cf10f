"""How values and objects show themselves: numbers in JSON, one kind of HTML table in a notebook."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from html import escape
from typing import Any


def finite(value: float | None) -> float | None:
    """A float for JSON, None where it is not finite or not known."""
    return None if value is None or not math.isfinite(value) else float(value)


_MOST = 12
"""Names of a list that is written out."""
_WRITTEN = {"*": "·", "^2": "²", "^3": "³"}


def unit_text(unit: str) -> str:
    """A unit as one writes it: ``rad/(N·m)``."""
    for plain, written in _WRITTEN.items():
        unit = unit.replace(plain, written)
    return unit


def html_table(
    columns: Sequence[str], rows: Iterable[Sequence[Any]], caption: str = "", notes: Sequence[str] = ()
) -> str:
    """An HTML table with a caption above and notes below; text is set left, whole numbers right, all escaped."""
    head = "".join(_cell("th", c) for c in columns)
    body = "".join("<tr>" + "".join(_cell("td", x) for x in row) + "</tr>" for row in rows)
    above = f"<p><b>{escape(caption)}</b></p>" if caption else ""
    below = "".join(f"<p>{escape(note)}</p>" for note in notes)
    return f"{above}<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>{below}"


def _cell(tag: str, content: Any) -> str:
    side = "left" if isinstance(content, str) else "right"
    whole = "" if " " in str(content) else ";white-space:nowrap"  # a number is not broken at its minus
    return f'<{tag} style="text-align:{side}{whole}">{escape(str(content))}</{tag}>'


def shortened(names: Sequence[str]) -> str:
    """Names in a row; of a long list the first three and the last one."""
    if len(names) <= _MOST:
        return " ".join(names) or "–"
    return f"{' '.join(names[:3])} … {names[-1]}"


def counted(number: int, what: str) -> str:
    """A number of things in a sentence: 1 pose, 2 poses."""
    return f"{number} {what}{'s' * (number != 1)}"


def times(factor: float) -> str:
    """How many times as large, two decimals; three digits of what is far from one, two of what is far below."""
    if factor < 0.1:
        return f"{factor:.2g}"
    return f"{factor:.2f}" if factor < 100 else f"{float(f'{factor:.3g}'):.0f}"


def listing(parts: Sequence[str]) -> str:
    """Parts of a sentence: with commas, and with "and" before the last."""
    *before, last = parts
    return f"{', '.join(before)} and {last}" if before else last


def of_poses(names: Sequence[str]) -> str:
    """Poses by their names, in a sentence."""
    return f"pose{'s' * (len(names) > 1)} {listing(names)}"


def few(names: Sequence[str], most: int = 8) -> str:
    """Names in a sentence, the first of them where they are many."""
    more = len(names) - most
    return ", ".join(names) if more <= 1 else f"{', '.join(names[:most])} and {more} more"


def sentence_case(text: str) -> str:
    """A text as the first of its sentence."""
    return text[:1].upper() + text[1:]
