"""Other languages over the C functions: a C++17 header, a Python module."""

from __future__ import annotations

import keyword
import sys
from typing import TYPE_CHECKING

from symstiff.codegen.emit import base_context, environment
from symstiff.errors import UserError

if TYPE_CHECKING:
    from symstiff.codegen.functions import Functions
    from symstiff.codegen.options import Options

_TAKEN = sys.stdlib_module_names | {"numpy"}


def emit_cpp(functions: Functions, options: Options) -> dict[str, bytes]:
    """A C++17 header: std::array, noexcept, no copies."""
    return {f"{functions.model.robot.name}.hpp": _rendered("cpp/wrapper.hpp.j2", functions, options)}


def emit_python(functions: Functions, options: Options) -> dict[str, bytes]:
    """A Python module that loads or compiles the library; it needs NumPy, not symstiff. Raises UserError."""
    name = functions.model.robot.name
    if name in _TAKEN or keyword.iskeyword(name):
        raise UserError(f"target python: {name}.py would hide Python's own {name}: rename the robot")
    return {f"{name}.py": _rendered("python/module.py.j2", functions, options)}


def _rendered(template: str, functions: Functions, options: Options) -> bytes:
    text: str = environment().get_template(template).render(base_context(functions, options))
    return text.encode()
