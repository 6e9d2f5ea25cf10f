"""Complete stiffness models of serial robots: derived, reduced, identified, emitted."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from symstiff.calibration.identify import identify as identify
    from symstiff.codegen.generate import generate as generate
    from symstiff.compensation import compensate as compensate
    from symstiff.model import StiffnessModel as StiffnessModel
    from symstiff.model import load_model as load_model
    from symstiff.reduction import reduce as reduce
    from symstiff.robot import library as library
    from symstiff.robot import load as load
    from symstiff.symbolic.chain import ElasticChain as ElasticChain
    from symstiff.symbolic.reading import observation_matrix as observation_matrix
    from symstiff.symbolic.reading import virtual_jacobian as virtual_jacobian

__version__ = "0.1.0"

# Resolved when first asked for: `import symstiff` and `symstiff --help` load no SymPy, CasADi or pandas.
_HOME = {
    "ElasticChain": "symstiff.symbolic.chain",
    "StiffnessModel": "symstiff.model",
    "compensate": "symstiff.compensation",
    "generate": "symstiff.codegen.generate",
    "identify": "symstiff.calibration.identify",
    "library": "symstiff.robot",
    "load": "symstiff.robot",
    "load_model": "symstiff.model",
    "observation_matrix": "symstiff.symbolic.reading",
    "reduce": "symstiff.reduction",
    "virtual_jacobian": "symstiff.symbolic.reading",
}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOME})
