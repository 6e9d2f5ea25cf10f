"""Options of a generation; every one of them is echoed in the output and part of the model hash."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass

from symstiff.arguments import words
from symstiff.codegen.targets import TARGETS
from symstiff.errors import UserError

CHOICES = {"precision": ("double", "float"), "layout": ("unrolled", "compact")}


@dataclass(frozen=True)
class Options:
    """precision: ``double`` or ``float``; targets: what is emitted; layout: ``unrolled`` or ``compact`` C.

    compact: loops over the parameters, about half the code of ``observation`` for 1.8 times its instructions.
    binaries: whether an FMU gets one for this machine; the sources are the same.
    """

    precision: str = "double"
    layout: str = "unrolled"
    targets: tuple[str, ...] = ("c", "casadi")
    binaries: bool = True

    def __post_init__(self) -> None:
        for key, allowed in CHOICES.items():
            if getattr(self, key) not in allowed:
                raise UserError(f"{key}: unknown {getattr(self, key)!r}: use {' or '.join(allowed)}")
        object.__setattr__(self, "targets", words(self.targets, "targets", "('c', 'casadi')"))
        if not self.targets:
            raise UserError(f"targets: none is given: use {', '.join(TARGETS)}")
        for target in self.targets:
            if target not in TARGETS:
                raise UserError(f"targets: unknown {target!r}: use {', '.join(TARGETS)}")
        if "c" not in self.targets and any(TARGETS[t].needs_c for t in self.targets):
            raise UserError("targets: these build on the C sources: add c")

    @property
    def single(self) -> bool:
        """Whether the real type is ``float``."""
        return self.precision == "float"

    def sources(self, name: str) -> list[str]:
        """The C files of the library with its self-test; test, example and fuzzing programs are others."""
        own = [f"{name}{end}.c" for end in ("", "_batch", "_selftest")]
        return [*own, *(c for t in self.targets for c in TARGETS[t].files(name, ".c"))]

    def table(self) -> dict[str, str]:
        """Options that change the sources as text, in order."""
        told = {k: v for k, v in asdict(self).items() if k != "binaries"}
        return {k: ",".join(v) if isinstance(v, tuple) else str(v) for k, v in told.items()}

    def model_hash(self, structure_hash: str, values: dict[str, float]) -> str:
        """SHA-256 of the model, its default values and these options."""
        text = json.dumps([structure_hash, values, self.table()], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()
