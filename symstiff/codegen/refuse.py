"""Models that a target cannot express are refused before anything is written."""

from __future__ import annotations

from typing import TYPE_CHECKING

from symstiff.errors import UserError

if TYPE_CHECKING:
    from symstiff.codegen.functions import Functions


def refuse_context(functions: Functions, target: str) -> None:
    """Refuse laws of time, temperature or load history. Raises UserError."""
    for vector in functions.deflection.inputs:
        if vector.name == "context":
            names = ", ".join(s.name for s in vector.symbols)
            raise UserError(
                f"target {target}: the model's effects depend on {names}: remove {target} from --targets"
            )
