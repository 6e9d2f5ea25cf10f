"""Text from files inside generated code: filters of the templates, one for each language that it may stand in."""

from __future__ import annotations

import re
from collections.abc import Callable


def c_comment(text: str) -> str:
    """Text for a comment of C or C++: it neither ends nor begins one, and has no trigraph."""
    return re.sub(r"\?(?=\?)", "? ", _spaced(_spaced(text, "*/"), "/*"))


def st_comment(text: str) -> str:
    """Text for a comment of Structured Text, where comments nest."""
    return _spaced(_spaced(text, "*)"), "(*")


def markdown(text: str) -> str:
    """Text for a paragraph of Markdown: no emphasis, code, link or HTML."""
    return re.sub(r"[\\`*_\[\]<>|]", r"\\\g<0>", text)


def pkgconfig(text: str) -> str:
    """Text for a line that CMake configures and pkg-config reads: no variable, comment or escape."""
    return re.sub(r"[@$#\\]", " ", text)


FILTERS: dict[str, Callable[[str], str]] = {
    "c_comment": c_comment,
    "st_comment": st_comment,
    "markdown": markdown,
    "pkgconfig": pkgconfig,
    "python": repr,
}


def _spaced(text: str, pair: str) -> str:
    """The text with a space in every such pair of characters."""
    return text.replace(pair, f"{pair[0]} {pair[1]}")
