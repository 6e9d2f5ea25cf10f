"""Parameters at run time: the text that the generated reader takes, and that reader."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

from symstiff.codegen.emit import base_context, environment
from symstiff.errors import UserError

if TYPE_CHECKING:
    from symstiff.codegen.functions import Functions
    from symstiff.codegen.options import Options
    from symstiff.model import StiffnessModel

DIGITS = 40  # significant digits that the reader takes
_RANGE = {"double": 330, "float": 60}  # powers of ten beyond which no number of the type lies


def params_text(model: StiffnessModel, values: Mapping[str, float] | None = None) -> str:
    """Text for the generated reader, also valid TOML: the structure's hash and every value. Raises UserError.

    values: by parameter name [SI units], the model's own by default; a missing one is zero, and that of a compliance
    which an effect replaced is left out.
    """
    lines = [f"# Parameters of {model.robot.name}, SI units.", f'parameter_hash = "{model.structure_hash}"']
    for name, value in zip(model.parameters, map(float, model.vector(values)), strict=True):
        if not math.isfinite(value):
            raise UserError(f"values: {name} is {value}: give a finite number")
        lines.append(f"{name} = {value!r} # {model.units[name]}")
    return "\n".join(lines) + "\n"


def emit_params(functions: Functions, options: Options) -> dict[str, bytes]:
    """Reader (C, no heap) and the text of the default values."""
    name = functions.model.robot.name
    limit = _RANGE[options.precision]
    limbs = _limbs(limit)
    context = base_context(functions, options) | {
        "digits_read": DIGITS,
        "range": limit,
        "limbs": limbs,
        "ldexp": "ldexpf" if options.single else "ldexp",
        "stack": 4 * limbs + 4 * len(functions.model.parameters) + 300,
    }
    jinja = environment()
    files = {
        f"{name}_params.{end}": jinja.get_template(f"c/params.{end}.j2").render(context).encode()
        for end in "hc"
    }
    return files | {f"{name}.params": params_text(functions.model).encode()}


def _limbs(limit: int) -> int:
    """Limbs for MOST_DIGITS digits times 2^(32·shift), where the power of ten is as small as it gets."""
    power = limit + DIGITS
    shift = (96 + 10 * power // 3) // 32
    return shift + math.ceil(DIGITS * math.log2(10) / 32) + 1
