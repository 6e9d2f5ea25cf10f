"""The one exception that a user's mistake raises: one line, and exit code 2 of the command line."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from difflib import get_close_matches

_ARGUMENT = re.compile(r"([a-z_]+): ")
"""How a message about an argument begins."""


class UserError(ValueError):
    """Input that cannot be used: the message names place, cause and remedy in one line of printable text."""

    def __init__(self, message: str) -> None:
        line = " ".join(message.split())
        super().__init__(printable(line, len(line)))

    def with_options(self, options: Mapping[str, str]) -> UserError:
        """The mistake as the command line tells it: an argument that the message begins with is its option."""
        found = _ARGUMENT.match(str(self))
        if found is None or found[1] not in options:
            return self
        return UserError(f"{options[found[1]]}: {str(self)[found.end() :]}")


def printable(text: str, longest: int = 120) -> str:
    """The text without control characters, and cut where it is long."""
    clean = "".join(c if c.isprintable() else "?" for c in text)
    return clean if len(clean) <= longest else f"{clean[: longest - 3]}..."


def did_you_mean(name: str, known: Collection[str]) -> str:
    """``did you mean 'x'? `` with the nearest of the known names, nothing where none is near."""
    close = get_close_matches(name[:40].lower(), known, 1)
    return f"did you mean {close[0]!r}? " if close else ""
