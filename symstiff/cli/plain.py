"""Text where the encoding of a stream lacks signs: 10⁻⁷ becomes 10^-7, a minus a hyphen, ± becomes +-, τ tau."""

from __future__ import annotations

import re
import unicodedata
from functools import lru_cache
from typing import Any

_RAISED = re.compile("[⁺⁻⁰¹²³⁴⁵⁶⁷⁸⁹ᵀ]+")
_LEVEL = str.maketrans("⁺⁻⁰¹²³⁴⁵⁶⁷⁸⁹ᵀ", "+-0123456789T")
_SIGNS = {
    "−": "-", "–": "-", "—": "-", "·": "*", "×": "x", "±": "+-", "≤": "<=", "≥": ">=", "≈": "~", "→": "->", "…": "...",
    "Σ": "sum", "∂": "d", "√": "sqrt ", "∞": "inf", "°": "deg", "µ": "u", "μ": "u", "′": "'", "″": "''", "½": "1/2",
}  # fmt: skip


def plain(text: str, encoding: str) -> str:
    """The text with what the encoding lacks in characters that it has; a power is written as a whole, one way."""
    if _has(text, encoding):
        return text
    text = _RAISED.sub(lambda m: m[0] if _has(m[0], encoding) else f"^{m[0].translate(_LEVEL)}", text)
    return "".join(c if _has(c, encoding) else _spelt(c) for c in text)


def _has(text: str, encoding: str) -> bool:
    try:
        text.encode(encoding)
    except UnicodeEncodeError:
        return False
    return True


@lru_cache
def _spelt(character: str) -> str:
    """One character in ASCII: a sign, a lowered digit, a Greek letter's name, or a question mark."""
    name = unicodedata.name(character, "")
    if character in _SIGNS:
        return _SIGNS[character]
    if name.startswith("GREEK") and " LETTER " in name:
        word = name.split()[-1]
        return word.capitalize() if " CAPITAL " in name else word.lower()
    digit = unicodedata.digit(character, None)
    return "?" if digit is None else str(digit)


class PlainStream:
    """A text stream that writes what its encoding lacks in plain characters; all else is the stream's own."""

    def __init__(self, stream: Any) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        """Write text; the number of its characters."""
        self._stream.write(plain(text, self._stream.encoding))
        return len(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)
