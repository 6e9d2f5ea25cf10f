"""Other languages over the C functions: a C++17 header, a Python module."""

from __future__ import annotations

from typing import TYPE_CHECKING

from symstiff.codegen.emit import base_context, environment

if TYPE_CHECKING:
    from symstiff.codegen.functions import Functions
    from symstiff.codegen.options import Options


def emit_cpp(functions: Functions, options: Options) -> dict[str, bytes]:
    """A C++17 header: std::array, noexcept, no copies."""
    return {f"{functions.model.robot.name}.hpp": _rendered("cpp/wrapper.hpp.j2", functions, options)}


def emit_python(functions: Functions, options: Options) -> dict[str, bytes]:
    """A Python module that loads the compiled library, or compiles it; it needs NumPy, not symstiff."""
    return {f"{functions.model.robot.name}.py": _rendered("python/module.py.j2", functions, options)}


def _rendered(template: str, functions: Functions, options: Options) -> bytes:
    text: str = environment().get_template(template).render(base_context(functions, options))
    return text.encode()
