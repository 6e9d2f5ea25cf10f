"""The command line: thin; every command imports what it needs when it runs."""

from __future__ import annotations

import errno
import logging
import os
import re
import signal
import sys
import threading
from typing import Any

from symstiff.cli.plain import PlainStream

_INTERRUPTED, _CLOSED = 130, 141
_interrupts: list[int] = []
"""Interrupts of this run."""
_PARSED = re.compile(r"Input should be ([^,]*)(?:, unable to parse .*)?$")
"""How the parser of the options says what it wants."""
_ASKED = {"a valid integer": "a whole number", "a valid number": "a number"}
"""The same in our words; else a number in some range."""
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def main() -> None:
    """Run a command; bad input is one line and exit code 2, a fault of ours 1, an interrupt 130, a closed pipe 141."""
    _prepare()
    try:
        _run()
    except (BrokenPipeError, SystemExit) as error:
        # Rich and typer end with 1 where nobody reads on
        if not isinstance(error, BrokenPipeError) and not isinstance(error.__context__, BrokenPipeError):
            raise
        _discard()
        raise SystemExit(_CLOSED) from None  # as of a program that the signal ends


def _run() -> None:
    from symstiff.errors import UserError

    try:
        from symstiff.cli.app import app

        code = app(prog_name="symstiff", standalone_mode=False) or 0  # typer makes 130 of an interrupt
        if sys.stdout is not None:
            sys.stdout.flush()  # what fails now would fail unseen at exit
        raise KeyboardInterrupt if code == _INTERRUPTED else SystemExit(code)
    except UserError as error:
        print(f"symstiff: {error}", file=sys.stderr)
        raise SystemExit(2) from None
    except KeyboardInterrupt:
        print("symstiff: interrupted", file=sys.stderr)
        raise SystemExit(_INTERRUPTED) from None
    except BrokenPipeError:
        raise
    except Exception as error:
        if hasattr(error, "format_message"):
            raise SystemExit(_usage(error)) from None
        if _interrupts:  # where a library in C is being imported it becomes an ImportError
            print("symstiff: interrupted", file=sys.stderr)
            raise SystemExit(_INTERRUPTED) from None
        import traceback

        if isinstance(error, OSError) and error.errno in _FULL:
            _discard()
            print(f"symstiff: {error.strerror}: make room where the output goes", file=sys.stderr)
            raise SystemExit(2) from None
        if os.environ.get("SYMSTIFF_DEBUG"):
            traceback.print_exc()
        text = " ".join(str(error).split())[:300]
        print(
            f"symstiff: a fault of ours ({type(error).__name__}: {text}); "
            "set SYMSTIFF_DEBUG=1 for the details and report it",
            file=sys.stderr,
        )
        raise SystemExit(1) from None


def _discard() -> None:
    """Let what is left to be written go nowhere: it would fail again at exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _prepare() -> None:
    """Write what the terminal's encoding lacks in plain characters; let SIGTERM and SIGHUP clean up as an error does.

    Where matplotlib keeps its caches is nobody's concern here.
    """
    logging.getLogger("matplotlib").setLevel(logging.ERROR)
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        reconfigure = getattr(stream, "reconfigure", None)
        if reconfigure is not None:
            reconfigure(errors="replace")
        encoding = getattr(stream, "encoding", None) or "utf-8"
        if not (encoding.lower().startswith("utf") or isinstance(stream, PlainStream)):
            setattr(sys, name, PlainStream(stream))
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, _terminated)
        hangup = getattr(signal, "SIGHUP", None)  # nohup ignores it, and goes on
        if hangup is not None and signal.getsignal(hangup) is signal.SIG_DFL:
            signal.signal(hangup, _terminated)
        if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
            signal.signal(signal.SIGINT, _interrupted)


def _interrupted(number: int, frame: Any) -> None:
    _interrupts.append(number)
    signal.default_int_handler(number, frame)


def _terminated(number: int, _: Any) -> None:
    raise SystemExit(128 + number)


def _usage(error: Any) -> int:
    """Say in one line what is wrong with the arguments (typer's own error), and where help is; the exit code."""
    context = getattr(error, "ctx", None)
    if context is not None and "NoArgs" in type(error).__name__:
        print(context.get_help())
        return int(error.exit_code)
    said = " ".join(error.format_message().split()).rstrip(".?").replace(". Did", "; did")
    said = _PARSED.sub(lambda m: f"expected {_ASKED.get(m[1], f'a number {m[1]}')}", said)
    command = context.command_path if context is not None else _command()
    print(f"symstiff: {said[:1].lower()}{said[1:]}: see {command} --help", file=sys.stderr)
    return int(error.exit_code)


def _command() -> str:
    """The command that was asked for, as typed."""
    from symstiff.cli.app import app

    known = {c.name or getattr(c.callback, "__name__", "") for c in app.registered_commands}
    return " ".join(["symstiff", *(a for a in sys.argv[1:2] if a in known)])
