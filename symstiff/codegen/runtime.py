"""A model compiled for this machine and called on arrays: the same Programs as loops that the C compiler vectorises.

``compiled(model)`` builds a shared library once (kept in a cache folder) and returns an ``Evaluator`` with the methods
``deflection`` and ``observation`` of the model. Arrays are read and written in place by their strides; ctypes releases
the interpreter's lock. Without a compiler, the same methods run in NumPy and a warning says so.
"""

from __future__ import annotations

import ctypes
import math
import warnings
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from symstiff.arguments import whole
from symstiff.codegen.compiler import find_compiler, why_none
from symstiff.codegen.library import is_built, library
from symstiff.codegen.names import moments
from symstiff.errors import UserError
from symstiff.slopes import derivative
from symstiff.states import Context, moment, number_of_poses, rows
from symstiff.symbolic.algebras import evaluate_numpy
from symstiff.symbolic.program import Program

if TYPE_CHECKING:
    from symstiff.model import StiffnessModel

_SLICE = 2048  # poses worth a thread
_LOADING = 25_000  # poses at which a library that is there is quicker than NumPy, loading included
_BUILDING = 100_000  # poses for which one is built: its second use repays it


class NotCompiled(UserWarning):
    """No compiler serves this machine: the model is evaluated with NumPy."""


@dataclass(frozen=True)
class Evaluator:
    """A model's deflections and observation matrices, fast.

    threads: how many share the poses of a call; library: the loaded shared library, None for NumPy.
    """

    model: StiffnessModel
    library: ctypes.CDLL | None
    threads: int = 1

    def __reduce__(self) -> tuple[Any, ...]:
        """Another process loads the library again."""
        return (_again, (self.model, self.threads, self.library is not None))

    @property
    def backend(self) -> str:
        """``c`` or ``numpy``."""
        return "numpy" if self.library is None else "c"

    def deflection(
        self,
        q: np.ndarray,
        w: np.ndarray,
        *,
        values: Mapping[str, float] | None = None,
        context: Context | None = None,
        out: np.ndarray | None = None,
    ) -> np.ndarray:
        """Deflections (N, 6) [m, rad] for q (N, n) and W (N, 6) or (6,), as ``StiffnessModel.deflection``.

        Poses that are no finite numbers give NaN; they are not looked for. out: a contiguous array (N, 6) of doubles
        to write to; a new one costs as much as its numbers.
        """
        return self._deflection(q, w, self.model.vector(values), context, out)

    def observation(
        self,
        q: np.ndarray,
        w: np.ndarray,
        *,
        values: Mapping[str, float] | None = None,
        context: Context | None = None,
        out: np.ndarray | None = None,
    ) -> np.ndarray:
        """∂Δt/∂π (N, 6, P), as ``StiffnessModel.observation``.

        out: a contiguous array (N, 6, P) of doubles to write to; a new one costs as much as its numbers.
        """
        model = self.model
        if model.is_linear:
            return self._call("observation", q, w, np.zeros(0), context, out)
        found = derivative(model, lambda x: self._deflection(q, w, x, context), model.vector(values))
        if out is None:
            return found
        _result(out, found.shape).reshape(found.shape)[...] = found
        return out

    def _deflection(
        self,
        q: np.ndarray,
        w: np.ndarray,
        p: np.ndarray,
        context: Context | None,
        out: np.ndarray | None = None,
    ) -> np.ndarray:
        return self._call("deflection", q, w, p, context, out)

    def _call(
        self,
        function: str,
        q: np.ndarray,
        w: np.ndarray,
        p: np.ndarray,
        context: Context | None,
        out: np.ndarray | None = None,
    ) -> np.ndarray:
        return self.evaluate(function, _arrays(programs(self.model)[function], q, w, context), p, out)

    def evaluate(
        self, function: str, inputs: Mapping[str, np.ndarray], p: np.ndarray, into: np.ndarray | None = None
    ) -> np.ndarray:
        """Evaluate a program on (N or 1, size) arrays by input name; poses that the loops refuse go through NumPy."""
        program = programs(self.model)[function]
        n = number_of_poses(inputs)
        name, shape = program.outputs[0]
        out = _result(into, (n, *shape))
        if self.library is None or not program.size(name):
            out.reshape(n, *shape)[:] = _numpy(program, inputs, p, n)
            return out.reshape(n, *shape)
        arrays = {k: np.broadcast_to(a, (n, a.shape[1])) for k, a in inputs.items()}
        refused = np.zeros(n, dtype=np.uint8)
        call = getattr(self.library, function)
        call.restype = ctypes.c_size_t

        def run(part: slice) -> None:
            strided = [x for a in arrays.values() for x in _strided(a[part])]
            poses = pointer(refused[part])
            call(ctypes.c_size_t(part.stop - part.start), pointer(p), *strided, *_strided(out[part]), poses)

        self._share(run, n)
        left = np.flatnonzero(refused)
        if len(left):
            few = {k: a[left] for k, a in arrays.items()}
            out[left] = _numpy(program, few, p, len(left)).reshape(len(left), -1)
        return out.reshape(n, *shape)

    def _share(self, run: Callable[[slice], None], n: int) -> None:
        """Run all poses, in as many threads as are worth it."""
        parts = max(min(self.threads, -(-n // _SLICE)), 1)
        cuts = [n * k // parts for k in range(parts + 1)]
        slices = [slice(a, b) for a, b in pairwise(cuts)]
        if parts == 1:
            run(slices[0])
            return
        with ThreadPoolExecutor(parts) as pool:
            list(pool.map(run, slices))


def compiled(model: StiffnessModel, threads: int = 1) -> Evaluator:
    """The model compiled for this machine, or evaluated with NumPy where that cannot be (a warning says why)."""
    whole(threads, "threads", 1)
    compiler = find_compiler()
    if compiler is None:
        warnings.warn(
            f"{why_none()}: the model is evaluated with NumPy (install gcc, clang or ziglang, or point $CC to one)",
            NotCompiled,
            stacklevel=2,
        )
        return Evaluator(model, None, threads)
    try:
        evaluator = Evaluator(model, library(model, programs(model), compiler), threads)
    except UserError as error:
        warnings.warn(f"{error}: the model is evaluated with NumPy", NotCompiled, stacklevel=2)
        return Evaluator(model, None, threads)
    _prove(evaluator)
    return evaluator


def for_poses(model: StiffnessModel, poses: int) -> Evaluator:
    """The quicker way for so many poses, one call or many: compiled where that is repaid and possible, else NumPy.

    The results differ by rounding only, so that nothing warns of a missing compiler.
    """
    compiler = find_compiler() if poses >= _LOADING else None
    if compiler is None or (poses < _BUILDING and not is_built(model, programs(model), compiler)):
        return Evaluator(model, None)
    return _again(model, 1, True)


def _again(model: StiffnessModel, threads: int, wanted: bool) -> Evaluator:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotCompiled)
        try:
            return compiled(model, threads) if wanted else Evaluator(model, None, threads)
        except RuntimeError:  # the compiler broke the arithmetic
            return Evaluator(model, None, threads)


def _prove(evaluator: Evaluator) -> None:
    """Compare with NumPy at a few poses. Raises RuntimeError where the compiler broke the arithmetic."""
    model = evaluator.model
    rng = np.random.default_rng(5)
    q = np.array([rng.uniform(*joint.range, size=3) for joint in model.robot.joint]).T
    for name, program in programs(model).items():
        sizes = {v.name: len(v.symbols) for v in program.inputs}
        inputs = {"q": q, "w": rng.uniform(-500, 500, (3, 6))}
        now = np.array([m.default for m in moments(model, program)])
        inputs |= {"context": now + rng.uniform(0.5, 1.5, (3, len(now)))} if len(now) else {}
        p = rng.uniform(1e-7, 1e-6, sizes.get("p", 0))
        wanted = _numpy(program, inputs, p, 3)
        found = evaluator.evaluate(name, inputs, p)
        size = np.abs(wanted[np.isfinite(wanted)]).max(initial=0.0)
        if not np.allclose(found, wanted, rtol=1e-9, atol=1e-11 * size, equal_nan=True):
            raise RuntimeError(f"the compiled {name} of {model.robot.name} differs from NumPy's")


def programs(model: StiffnessModel) -> dict[str, Program]:
    """The programs that are compiled: Δt, and the columns of the parameters that it is linear in."""
    return {"deflection": model.deflection_program, "observation": model.linear_program}


def _arrays(program: Program, q: np.ndarray, w: np.ndarray, context: Context | None) -> dict[str, np.ndarray]:
    """The arrays (N or 1, size) of a program's inputs, in its order."""
    sizes = {vector.name: len(vector.symbols) for vector in program.inputs}
    given = {name: rows(name, array, sizes.get(name, 6)) for name, array in (("q", q), ("w", w))}
    found = given | moment(program, context, number_of_poses(given))
    return {name: found[name] for name in sizes if name in found}


def _result(into: np.ndarray | None, shape: tuple[int, ...]) -> np.ndarray:
    """Where results (N, size) are written: ``into`` or a new array."""
    flat = (shape[0], math.prod(shape[1:]))
    if into is None:
        return np.empty(flat)
    usable = into.dtype == np.float64 and into.flags.carray
    if not usable or into.shape != shape:
        raise UserError(f"out: expected a contiguous array of doubles of shape {shape}")
    return into.reshape(flat)


def _numpy(program: Program, arrays: Mapping[str, np.ndarray], p: np.ndarray, n: int) -> np.ndarray:
    name, shape = program.outputs[0]
    if n == 0 or not program.size(name):
        return np.empty((n, *shape))
    extra = {"p": p} if any(v.name == "p" for v in program.inputs) else {}
    return evaluate_numpy(program, **arrays, **extra)[name]


def _strided(array: np.ndarray) -> tuple[Any, Any]:
    """Pointer and strides (component, pose) in elements; an array that these cannot describe is copied."""
    size = array.itemsize
    if any(s < 0 or s % size for s in array.strides) or not array.flags.aligned:
        array = np.require(array, requirements=("C", "A"))
    strides = (ctypes.c_size_t * 2)(array.strides[1] // size, array.strides[0] // size)
    first = pointer(array)
    first.array = array  # keeps a copy alive for the call
    return first, strides


def pointer(array: np.ndarray) -> Any:
    """Where an array's numbers are, as C functions are told."""
    return array.ctypes.data_as(ctypes.c_void_p)
