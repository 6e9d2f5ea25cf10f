"""What a user describes: DH rows, base, tool, markers, elastic links. Frozen values, validated on entry."""

from __future__ import annotations

import math
from itertools import combinations
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, field_validator, model_validator

from symstiff.errors import UserError
from symstiff.robot.exact import shown
from symstiff.robot.frozen import FrozenDict
from symstiff.robot.quantities import (
    LONGEST,
    WIDEST,
    ZERO,
    Angle,
    BeamAxis,
    Compliance,
    Entry,
    Format,
    FreeLength,
    Identifier,
    Length,
    Lever,
    Mass,
    Metres,
    Name,
    Number,
    Text,
    Triple,
)

if TYPE_CHECKING:
    import numpy as np

MAX_JOINTS = 64
_MAX_ROWS = 100  # markers, templates
BUILT_IN_TEMPLATES = frozenset({"beam", "full", "rigid"})


class _Frozen(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", arbitrary_types_allowed=True)


class Placement(_Frozen):
    """A fixed transform: translation [m], then roll-pitch-yaw [rad], R = Rz(yaw)·Ry(pitch)·Rx(roll)."""

    xyz: tuple[Length, Length, Length] = (ZERO, ZERO, ZERO)
    rpy: tuple[Angle, Angle, Angle] = (ZERO, ZERO, ZERO)


class Link(_Frozen):
    """The elastic body after a joint: its elastic frame, compliance template, mass and known compliances.

    The weight hangs behind the link's own springs, which therefore carry it with all that is before them.
    """

    beam_axis: BeamAxis = None
    template: str = "beam"
    mass: Mass = 0.0  # kg
    com: tuple[Metres, Metres, Metres] = (0.0, 0.0, 0.0)  # m, in DH frame i
    compliance: Annotated[dict[str, Entry], AfterValidator(FrozenDict)] = (
        FrozenDict()
    )  # by "11" … "66", SI units

    @field_validator("compliance")
    @classmethod
    def _entries(cls, value: dict[str, float]) -> dict[str, float]:
        for key, entry in value.items():
            if len(key) != 2 or not set(key) <= set("123456") or key[0] > key[1]:
                raise UserError(f'entry {shown(key)}: name it by row and column, "11" to "66", row ≤ column')
            if key[0] == key[1] and entry < 0:
                raise UserError(f"entry {key}: a compliance on the diagonal is not negative, found {entry:g}")
        for key, entry in value.items():
            first, second = (value.get(c * 2, math.inf) for c in key)
            most = (
                first * second if first and second else 0.0
            )  # where one is unknown, the other may still be zero
            if key[0] != key[1] and most < math.inf and entry**2 > most * (1 + 1e-9):
                a, b = ("any" if c == math.inf else f"{c:g}" for c in (first, second))
                raise UserError(
                    f"entry {key}: of an elastic body its square is at most entry {key[0] * 2} times entry "
                    f"{key[1] * 2}, {a} times {b}: correct {entry:g}, or one of these"
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
        if not self.prismatic and max(abs(low), abs(high)) > WIDEST:
            raise UserError(f"limits [{low:g}, {high:g}] look like degrees: angles are in radians")
        if self.prismatic and max(abs(low), abs(high)) > LONGEST:
            raise UserError(f"limits [{low:g}, {high:g}] look like millimetres: lengths are in metres")
        return self


class Base(Placement):
    """World to frame 0, and link 0, the elastic pedestal."""

    link: Link = Link(beam_axis="x")


class Marker(_Frozen):
    """A measured point, in frame n [m]."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,62}$")]
    xyz: tuple[Length, Length, Length]


ANCHORS_MEET = 1e-3
"""Difference of the distances of a spring's ends from the axis, as a share, at which they meet."""


class GravityCompensator(_Frozen):
    """A spring between two links that acts on one joint; its geometry [m] and rate [N/m] where known."""

    joint: Annotated[int, Field(ge=1, strict=True)]
    L: Lever | None = None
    ax: Metres | None = None
    ay: Metres | None = None
    s0: FreeLength | None = None
    rate: Number | None = None

    @model_validator(mode="after")
    def _turns(self) -> GravityCompensator:
        if self.ax is not None and self.ay is not None and float(self.ax) == 0.0 == float(self.ay):
            raise UserError("ax and ay are both 0: a spring that is held in the joint's axis turns nothing")
        if self.ax is not None and self.ay is not None and self.L is not None:
            away = math.hypot(float(self.ax), float(self.ay))
            if abs(away - float(self.L)) < ANCHORS_MEET * away:
                raise UserError(
                    f"L = {self.L} is the anchor's distance from the axis: at one angle both ends meet"
                )
        return self


class Template(_Frozen):
    """A user's compliance template: six rows of six characters, ``*`` a term, ``0`` or ``.`` none."""

    name: Identifier
    pattern: tuple[str, str, str, str, str, str]

    @field_validator("pattern")
    @classmethod
    def _of_a_body(cls, rows: tuple[str, ...]) -> tuple[str, ...]:
        if any(len(row) != 6 or not set(row) <= set("*0.") for row in rows):
            raise UserError("a template has six rows of six characters, * for a term and 0 or . for none")
        if any((rows[i][j] == "*") != (rows[j][i] == "*") for i in range(6) for j in range(6)):
            raise UserError("a template is symmetric, as compliance matrices are")
        for i, j in combinations(range(6), 2):
            lacking = [f"{k + 1}{k + 1}" for k in (i, j) if rows[k][k] != "*"]
            if rows[i][j] == "*" and lacking:
                raise UserError(
                    f"row {i + 1}: entry {i + 1}{j + 1} is a coupling without {' and '.join(lacking)} on the diagonal, "
                    "which no elastic body has: write * there too"
                )
        return rows


class Robot(_Frozen):
    """A serial robot as its file describes it (format 1): metres, radians, exact numbers."""

    format: Format
    name: Name
    title: Text = ""
    convention: Literal["standard", "modified"] = "standard"
    source: Text = ""
    base: Base = Base()
    joint: Annotated[tuple[Joint, ...], Field(min_length=1, max_length=MAX_JOINTS)]
    tool: Placement = Placement()
    marker: Annotated[tuple[Marker, ...], Field(max_length=_MAX_ROWS)] = ()
    gravity_compensator: GravityCompensator | None = None
    template: Annotated[tuple[Template, ...], Field(max_length=_MAX_ROWS)] = ()

    def __hash__(self) -> int:
        return hash((self.name, len(self.joint)))

    @property
    def kinds(self) -> str:
        """R for a joint that turns, P for one that slides, base to tip."""
        return "".join("P" if joint.prismatic else "R" for joint in self.joint)

    def __repr__(self) -> str:
        return f"Robot({self.name}: {self.dof} joints {self.kinds})"

    __str__ = __repr__

    def _repr_html_(self) -> str:
        from symstiff.robot.reading import robot_html

        return robot_html(self)

    @property
    def dof(self) -> int:
        """Number of joints n."""
        return len(self.joint)

    @property
    def links(self) -> tuple[Link, ...]:
        """Links 0 (the pedestal) to n."""
        return (self.base.link, *(joint.link for joint in self.joint))

    @property
    def ranges(self) -> np.ndarray:
        """(n, 2) every joint's least and greatest value [rad, m]."""
        import numpy as np

        return np.array([joint.range for joint in self.joint], dtype=float)

    @property
    def reach(self) -> float:
        """An upper bound of the distance from axis 1 to the tool centre point [m]."""
        offsets = [math.hypot(float(j.a), 0.0 if k == 0 else float(j.d)) for k, j in enumerate(self.joint)]
        strokes = [max(map(abs, j.range)) for j in self.joint if j.prismatic]
        return sum(offsets) + sum(strokes) + math.hypot(*map(float, self.tool.xyz))

    @property
    def has_weights(self) -> bool:
        """Whether the file tells the mass of any link."""
        return any(link.mass for link in self.links)

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
    def _templates_known(self) -> Robot:
        own = [t.name for t in self.template]
        if len(set(own)) != len(own) or not BUILT_IN_TEMPLATES.isdisjoint(own):
            raise UserError("template: the names must differ, from each other and from beam, full, rigid")
        for index, link in enumerate(self.links):
            if link.template not in BUILT_IN_TEMPLATES and link.template not in own:
                place = "base" if index == 0 else f"joint[{index}]"
                raise UserError(
                    f"{place}.link.template: unknown template {shown(link.template)}: "
                    "use beam, full, rigid or a [[template]] of the file"
                )
        return self

    @model_validator(mode="after")
    def _markers_differ(self) -> Robot:
        names = ["tcp", *(m.name for m in self.marker)]
        for name in names:
            if names.count(name) > 1:
                raise UserError(
                    f"marker: {name!r} stands for two points: names differ, tcp is the tool's tip"
                )
        return self

    @model_validator(mode="after")
    def _compensator_fits(self) -> Robot:
        if self.gravity_compensator is None:
            return self
        number = self.gravity_compensator.joint
        if number > self.dof or self.joint[number - 1].prismatic:
            turning = ", ".join(str(k) for k, joint in enumerate(self.joint, start=1) if not joint.prismatic)
            able = f"give one of {turning}" if turning else "it has none, leave [gravity_compensator] out"
            raise UserError(f"gravity_compensator.joint: {number} is no revolute joint of this robot: {able}")
        return self


KEYS = sorted(
    {
        key
        for model in (Robot, Base, Joint, Link, Marker, GravityCompensator, Template)
        for key in model.model_fields
    }
)
