"""What a user describes: DH rows, base, tool, markers, elastic links. Frozen values, validated on entry."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, field_validator, model_validator

from symstiff.errors import UserError
from symstiff.robot.exact import Exact, parse_exact

MAX_JOINTS = 64
_LONGEST = 100.0  # m; anything beyond is a length in millimetres
_WIDEST = 8 * math.pi  # rad; joint limits beyond four turns are degrees


def _length(value: Any) -> Exact:
    number = parse_exact(value)
    if abs(float(number)) > _LONGEST:
        raise UserError(
            f"{float(number):g} m is longer than any robot: lengths are in metres, not millimetres"
        )
    return number


def _angle(value: Any) -> Exact:
    number = parse_exact(value)
    if abs(float(number)) > 2 * math.pi + 1e-9:
        raise UserError(f'{float(number):g} looks like degrees: angles are in radians, e.g. "-pi/2"')
    return number


def _finite(value: Any) -> float:
    number = float(parse_exact(value))
    if not math.isfinite(number):
        raise UserError("expected a finite number")
    return number


def _compliance(value: Any) -> float:
    number = _finite(value)
    if number < 0:
        raise UserError(f"a compliance is not negative, found {number:g}")
    return number


Length = Annotated[Exact, BeforeValidator(_length)]
Angle = Annotated[Exact, BeforeValidator(_angle)]
Number = Annotated[float, BeforeValidator(_finite)]
Compliance = Annotated[float, BeforeValidator(_compliance)]
Identifier = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,62}$")]
Triple = tuple[Exact, Exact, Exact]
ZERO = Exact()


class _Frozen(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", arbitrary_types_allowed=True)


class Placement(_Frozen):
    """A fixed transform: translation [m], then roll-pitch-yaw [rad], R = Rz(yaw)·Ry(pitch)·Rx(roll)."""

    xyz: tuple[Length, Length, Length] = (ZERO, ZERO, ZERO)
    rpy: tuple[Angle, Angle, Angle] = (ZERO, ZERO, ZERO)


class Link(_Frozen):
    """The elastic body after a joint: its elastic frame, compliance template, mass and known compliances."""

    beam_axis: Literal["x", "y", "z"] | tuple[Length, Length, Length] | None = None
    template: str = "beam"
    mass: Number = 0.0  # kg
    com: tuple[Number, Number, Number] = (0.0, 0.0, 0.0)  # m, in DH frame i
    compliance: dict[str, Number] = {}  # known values by "11" … "66", SI units

    @field_validator("beam_axis")
    @classmethod
    def _direction(cls, value: Any) -> Any:
        if isinstance(value, tuple) and not any(value):
            raise UserError(
                'a beam\'s direction cannot be the zero vector: give "x", "y", "z" or a direction'
            )
        return value

    @field_validator("mass")
    @classmethod
    def _mass(cls, value: float) -> float:
        if value < 0:
            raise UserError(f"a mass is not negative, found {value:g} kg")
        return value

    @field_validator("compliance")
    @classmethod
    def _entries(cls, value: dict[str, float]) -> dict[str, float]:
        for key in value:
            if len(key) != 2 or not set(key) <= set("123456") or key[0] > key[1]:
                raise UserError(
                    f'compliance entry {key!r}: name it by row and column, "11" to "66", row ≤ column'
                )
        return value


class Joint(_Frozen):
    """One DH row with its elastic link: a, d [m], alpha, theta [rad]; limits in rad or m."""

    type: Literal["revolute", "prismatic"] = "revolute"
    a: Length
    alpha: Angle
    d: Length
    theta: Angle = ZERO
    limits: tuple[Number, Number] | None = None
    compliance: Compliance = 0.0  # known value, rad/(N·m) or m/N
    link: Link = Link()

    @property
    def prismatic(self) -> bool:
        """Whether the joint variable is a length."""
        return self.type == "prismatic"

    @property
    def range(self) -> tuple[float, float]:
        """The joint's limits; where the file gives none, a full turn, or 0 to 0.5 m if prismatic."""
        if self.limits is not None:
            return self.limits
        return (0.0, 0.5) if self.prismatic else (-math.pi, math.pi)

    @model_validator(mode="after")
    def _limits(self) -> Joint:
        if self.limits is None:
            return self
        low, high = self.limits
        if not low < high:
            raise UserError(f"limits [{low:g}, {high:g}]: the lower one comes first")
        if not self.prismatic and max(abs(low), abs(high)) > _WIDEST:
            raise UserError(f"limits [{low:g}, {high:g}] look like degrees: angles are in radians")
        if self.prismatic and max(abs(low), abs(high)) > _LONGEST:
            raise UserError(f"limits [{low:g}, {high:g}] look like millimetres: lengths are in metres")
        return self


class Base(Placement):
    """World to frame 0, and link 0, the elastic pedestal."""

    link: Link = Link(beam_axis="x")


class Marker(_Frozen):
    """A measured point, in frame n [m]."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]*$")]
    xyz: tuple[Length, Length, Length]


class GravityCompensator(_Frozen):
    """A spring between two links that acts on one joint; its geometry [m] and rate [N/m] where known."""

    joint: Annotated[int, Field(ge=1)]
    L: Number | None = None
    ax: Number | None = None
    ay: Number | None = None
    s0: Number | None = None
    rate: Number | None = None


class Template(_Frozen):
    """A user's compliance template: six rows of six characters, ``*`` a term, ``0`` or ``.`` none."""

    name: Identifier
    pattern: tuple[str, str, str, str, str, str]

    @field_validator("pattern")
    @classmethod
    def _symmetric(cls, rows: tuple[str, ...]) -> tuple[str, ...]:
        if any(len(row) != 6 or not set(row) <= set("*0.") for row in rows):
            raise UserError("a template has six rows of six characters, * for a term and 0 or . for none")
        if any((rows[i][j] == "*") != (rows[j][i] == "*") for i in range(6) for j in range(6)):
            raise UserError("a template is symmetric, as compliance matrices are")
        return rows


class Robot(_Frozen):
    """A serial robot as its file describes it (format 1): metres, radians, exact numbers."""

    format: Literal[1]
    name: Identifier
    title: str = ""
    convention: Literal["standard", "modified"] = "standard"
    source: str = ""
    base: Base = Base()
    joint: Annotated[tuple[Joint, ...], Field(min_length=1, max_length=MAX_JOINTS)]
    tool: Placement = Placement()
    marker: tuple[Marker, ...] = ()
    gravity_compensator: GravityCompensator | None = None
    template: tuple[Template, ...] = ()

    @property
    def dof(self) -> int:
        """Number of joints n."""
        return len(self.joint)

    @property
    def links(self) -> tuple[Link, ...]:
        """Links 0 (the pedestal) to n."""
        return (self.base.link, *(joint.link for joint in self.joint))

    @property
    def reach(self) -> float:
        """An upper bound of the distance from axis 1 to the tool centre point [m]."""
        offsets = [math.hypot(float(j.a), 0.0 if k == 0 else float(j.d)) for k, j in enumerate(self.joint)]
        strokes = [max(map(abs, j.range)) for j in self.joint if j.prismatic]
        return sum(offsets) + sum(strokes) + math.hypot(*map(float, self.tool.xyz))

    def marker_position(self, name: str) -> Triple:
        """Return a marker's position in frame n [m]; ``tcp`` is the tool centre point."""
        if name == "tcp":
            return self.tool.xyz
        for marker in self.marker:
            if marker.name == name:
                return marker.xyz
        known = ", ".join(["tcp", *(m.name for m in self.marker)])
        raise UserError(f"robot {self.name} has no marker {name!r}: known are {known}")

    @model_validator(mode="after")
    def _consistent(self) -> Robot:
        known = {"beam", "full", "rigid", *(t.name for t in self.template)}
        for index, link in enumerate(self.links):
            if link.template not in known:
                raise UserError(
                    f"link {index}: unknown template {link.template!r}: "
                    "use beam, full, rigid or a [[template]] of the file"
                )
        names = [m.name for m in self.marker]
        if len(set(names)) != len(names) or "tcp" in names:
            raise UserError("marker names must differ, and tcp is the tool centre point")
        compensator = self.gravity_compensator
        if compensator is not None and compensator.joint > self.dof:
            raise UserError(
                f"gravity_compensator.joint = {compensator.joint}: the robot has {self.dof} joints"
            )
        return self
