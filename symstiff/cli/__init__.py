"""The command line: thin; every command imports what it needs when it runs."""

from __future__ import annotations

import sys


def main() -> None:
    """Run a command; bad input is one line and exit code 2, a fault of ours exit code 1."""
    from symstiff.cli.app import app
    from symstiff.errors import UserError

    try:
        app()
    except UserError as error:
        print(f"symstiff: {error}", file=sys.stderr)
        raise SystemExit(2) from None
    except KeyboardInterrupt:
        print("symstiff: interrupted, nothing was written", file=sys.stderr)
        raise SystemExit(1) from None
    except BrokenPipeError:
        raise SystemExit(1) from None
    except Exception as error:
        import os
        import traceback

        if os.environ.get("SYMSTIFF_DEBUG"):
            traceback.print_exc()
        text = " ".join(str(error).split())[:300]
        print(
            f"symstiff: a fault of ours ({type(error).__name__}: {text}); "
            "set SYMSTIFF_DEBUG=1 for the details and report it",
            file=sys.stderr,
        )
        raise SystemExit(1) from None
