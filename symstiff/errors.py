"""The one exception that a user's mistake raises; the command line turns it into one line and exit code 2."""


class UserError(ValueError):
    """Input that cannot be used: the message names place, cause and remedy in one line of printable text."""

    def __init__(self, message: str) -> None:
        line = " ".join(message.split())
        super().__init__(
            "".join(c if c.isprintable() else "?" for c in line)
        )  # no control codes for a terminal
