"""Functional mock-up units: co-simulation by FMI 2.0 and 3.0, sources inside, a binary where a compiler is."""

from __future__ import annotations

import platform
import sys
import tempfile
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from symstiff.codegen.compiler import find_compiler, shared_flags
from symstiff.codegen.emit import base_context, environment
from symstiff.codegen.names import Moment, moments
from symstiff.codegen.text import CAlgebra
from symstiff.effects.units import base_units

if TYPE_CHECKING:
    from symstiff.codegen.functions import Functions
    from symstiff.codegen.options import Options

_FIXED_TIME = (1980, 1, 1, 0, 0, 0)
_WRENCH = ("N", "N", "N", "N*m", "N*m", "N*m")
_MOMENT_UNITS = {"temperature": "degC", "branch": "1", "turn": "1"}
_TWIST = ("m", "m", "m", "rad", "rad", "rad")
_SYSTEMS = {
    "linux": ("linux64", "linux", ".so"),
    "win32": ("win64", "windows", ".dll"),
    "darwin": ("darwin64", "darwin", ".dylib"),
}


@dataclass(frozen=True)
class Variable:
    """A scalar variable of the FMU; index counts from 1."""

    index: int
    name: str
    description: str
    causality: str
    unit: str = ""
    start: str | None = None
    integer: bool = False

    @property
    def reference(self) -> int:
        """Value reference."""
        return self.index - 1

    @property
    def variability(self) -> str:
        """As the standard wants it for the causality."""
        return "tunable" if self.causality == "parameter" else "discrete" if self.integer else "continuous"


def emit_fmi2(functions: Functions, options: Options) -> dict[str, bytes]:
    """An FMI 2.0 FMU."""
    return _emit(functions, options, 2)


def emit_fmi3(functions: Functions, options: Options) -> dict[str, bytes]:
    """An FMI 3.0 FMU."""
    return _emit(functions, options, 3)


def _emit(functions: Functions, options: Options, version: int) -> dict[str, bytes]:
    name = functions.model.robot.name
    context = fmu_context(functions, options, version)
    jinja = environment()

    def rendered(template: str) -> bytes:
        text: str = jinja.get_template(template).render(context)
        return text.lstrip("\n").encode()

    sources = {
        f"{name}.h": rendered("c/header.h.j2"),
        f"{name}.c": rendered("c/source.c.j2"),
        f"{name}_fmi{version}.c": rendered(f"fmi/fmi{version}.c.j2"),
    }
    files = {"modelDescription.xml": rendered(f"fmi/fmi{version}.xml.j2")}
    files |= {f"sources/{k}": v for k, v in sources.items()}
    if version == 3:
        files["sources/buildDescription.xml"] = rendered("fmi/build.xml.j2")
    if options.binaries:
        files |= _binary(name, sources, version)
    return {f"{name}_fmi{version}.fmu": zipped(files)}


def fmu_context(functions: Functions, options: Options, version: int) -> dict[str, Any]:
    """What the templates print beside the common names."""
    model = functions.model
    base = base_context(functions, options)
    literal = CAlgebra(False).literal
    meanings = {p["name"]: p["meaning"] for p in (*base["parameters"], *base["effect_parameters"])}
    values = [
        {"name": n, "start": literal(value), "meaning": meanings[n]} for n, value in model.known.items()
    ]
    every = moments(model, functions.deflection)
    moment = [m for m in every if m.name != "time"]
    variables = _variables(functions, values, moment)
    names = dict.fromkeys(v.unit for v in variables if v.unit)
    return base | {
        "token": base["model_hash"],
        "values": values,
        "moment": [m.name for m in moment],
        "clock": next((literal(m.default) for m in every if m.name == "time" and m.default), ""),
        "starts": [*(v["start"] for v in values), *(literal(m.default) for m in moment)],
        "variables": variables,
        "units": [{"name": u, "base": _base(u)} for u in names],
        "sources": [f"{model.robot.name}.c", f"{model.robot.name}_fmi{version}.c"],
    }


def _variables(
    functions: Functions, values: Sequence[Mapping[str, str]], moment: Sequence[Moment]
) -> list[Variable]:
    model = functions.model
    joints = ["m" if j.prismatic else "rad" for j in model.robot.joint]
    found: list[tuple[str, str, str, str, str | None]] = []
    for k, unit in enumerate(joints, 1):
        found.append((f"q[{k}]", f"variable of joint {k}", "input", unit, "0.0"))
    for k, unit in enumerate(_WRENCH, 1):
        found.append(
            (
                f"wrench[{k}]",
                "load that acts on the robot at the tool centre point, base axes",
                "input",
                unit,
                "0.0",
            )
        )
    for v in values:
        found.append((v["name"], v["meaning"], "parameter", model.units[v["name"]], v["start"]))
    for m in moment:
        found.append((m.name, m.meaning, "input", _MOMENT_UNITS[m.name], CAlgebra(False).literal(m.default)))
    for k, unit in enumerate(joints, 1):
        found.append((f"q_cmd[{k}]", f"compensated command of joint {k}", "output", unit, None))
    for k, unit in enumerate(_TWIST, 1):
        found.append(
            (f"deflection[{k}]", "deflection of the tool centre point, base axes", "output", unit, None)
        )
    variables = [Variable(i, *row) for i, row in enumerate(found, 1)]
    status = "0, or the negative error of the C function"
    return [*variables, Variable(len(found) + 1, "status", status, "output", integer=True)]


def _base(unit: str) -> list[tuple[str, float]]:
    """Attributes of a unit's definition by the SI base units."""
    if unit == "degC":
        return [("K", 1), ("offset", 273.15)]
    return sorted(base_units(unit).items())


def _binary(name: str, sources: Mapping[str, bytes], version: int) -> dict[str, bytes]:
    """The shared library for this machine, by its place in the FMU; nothing where no compiler is."""
    compiler, system = find_compiler(), _SYSTEMS.get(sys.platform)
    if compiler is None or system is None:
        return {}
    machine = {"amd64": "x86_64", "arm64": "aarch64"}.get(
        platform.machine().lower(), platform.machine().lower()
    )
    place = f"{machine}-{system[1]}" if version == 3 else system[0]
    flags = ["-std=c99", "-O2", "-fvisibility=hidden", *shared_flags()]
    with tempfile.TemporaryDirectory() as scratch:
        for file, content in sources.items():
            (Path(scratch) / file).write_bytes(content)
        texts = [f for f in sources if f.endswith(".c")]
        built = name + system[2]
        done = compiler.run([*flags, "-I.", *texts, "-o", built, "-lm"], cwd=Path(scratch))
        if done.returncode != 0:
            raise RuntimeError(f"the FMU's sources do not compile:\n{done.stderr[:2000]}")
        return {f"binaries/{place}/{built}": (Path(scratch) / built).read_bytes()}


def zipped(files: Mapping[str, bytes]) -> bytes:
    """A zip archive that depends on nothing but its contents."""
    buffer = BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in sorted(files):
            entry = zipfile.ZipInfo(name, _FIXED_TIME)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.create_system = 3
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, files[name])
    return buffer.getvalue()
