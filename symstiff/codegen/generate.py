"""The main job: derive, reduce, emit, compile, verify, report; a folder that stands alone."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from symstiff import __version__
from symstiff.arguments import A_MODEL, listener, require
from symstiff.codegen.compiler import find_compiler, why_none
from symstiff.codegen.emit import operations
from symstiff.codegen.functions import Functions
from symstiff.codegen.options import Options
from symstiff.codegen.targets import TARGETS
from symstiff.codegen.text import context_names
from symstiff.codegen.verify import Verification, verify
from symstiff.effects.instance import EffectInstance
from symstiff.effects.places import named
from symstiff.errors import UserError
from symstiff.files import CODE, new_folder, write_tree
from symstiff.model import StiffnessModel

Progress = Callable[[str], None]


@dataclass(frozen=True)
class Generated:
    """What was written and what was verified."""

    folder: Path
    manifest: dict[str, Any]
    verification: Verification
    left_out: tuple[EffectInstance, ...] = ()
    """Effects of the model that only the measurement has: no law of the robot."""

    def __repr__(self) -> str:
        proof = self.verification
        how = f"compiled by {proof.compiler}" if proof.compiled else "not compiled"
        worst = "" if proof.max_relative_error is None else f", relative error {proof.max_relative_error:.1g}"
        return (
            f"Generated({str(self.folder)!r}: {len(self.manifest['parameters'])} compliances, {how}{worst})"
        )


def generate(
    model: StiffnessModel,
    folder: str | Path,
    options: Options | None = None,
    *,
    compile_c: bool = True,
    footprint: bool = False,
    progress: Progress | None = None,
) -> Generated:
    """Write the folder for a model; nothing appears unless all of it does. Raises UserError.

    Effects of the measurement (a device that drifts, a bad pose) are no laws of the robot and are left out.

    compile_c: compile and verify the C code; without it FMUs have no binary either.
    footprint: measure code, stack and instructions too, on every machine that the tools at hand can show.
    """
    require(model, StiffnessModel, *A_MODEL)
    listener(progress)
    tell = progress or (lambda stage: None)
    require(options or Options(), Options, "options", "symstiff.Options(precision='float') are some")
    options = replace(options or Options(), binaries=compile_c)
    whole, model = model, model.of_robot()
    left_out = tuple(e for e in whole.effects if e not in model.effects)
    if not model.parameters:
        raise UserError(
            "the model holds errors of the measurement alone, which are no laws of the robot: nothing to generate; "
            "identify its compliances"
        )
    functions = Functions(model)
    with new_folder(folder, CODE) as temporary:
        for target in options.targets:
            tell(f"emitting {target}")
            write_tree(temporary, TARGETS[target].emitter()(functions, options))
        model.save(temporary / "model.toml")
        tell("verifying")
        compiler = find_compiler() if compile_c else None
        reason = why_none() if compile_c and compiler is None else ""
        proof = verify(temporary, functions, compiler, options, footprint, reason)
        manifest = {
            **manifest_of(functions, options, proof),
            "left_out": [named(e.effect, e.where) for e in left_out],
        }
        (temporary / CODE).write_bytes((json.dumps(manifest, indent=2) + "\n").encode())
    return Generated(Path(folder), manifest, proof, left_out)


def manifest_of(functions: Functions, options: Options, proof: Verification) -> dict[str, Any]:
    """manifest.json: everything but ``verified`` is the same on every machine."""
    model = functions.model
    values = model.known
    names = model.stiffness_parameters
    return {
        "generator": __version__,
        "robot": model.robot.name,
        "model_hash": options.model_hash(model.structure_hash, values),
        "parameter_hash": model.structure_hash,
        "options": {
            "loads": model.loads, "measure": model.measure, "fixed": model.fixed_by_name, **options.table(),
        },
        "parameters": list(names),
        "default_parameters": [values[n] for n in names],
        "units": [model.units[n] for n in names],
        "effect_parameters": {
            e.name: {"value": values[e.name], "unit": e.unit} for e in model.effect_parameters
        },
        "context": context_names(functions.deflection),
        "operations": operations(functions, options),
        "verified": proof.table(),
    }  # fmt: skip
