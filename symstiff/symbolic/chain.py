"""The elastic chain: frames of a robot, its virtual joints, and their columns of the Jacobian.

Geometric construction: a translation's column is an axis, a rotation's is axis × lever arm and axis. Every function
takes a ``Builder`` that binds temporaries, so that the same geometry serves programs, proofs and exact arithmetic.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import sympy as sp

from symstiff.arguments import A_ROBOT, require
from symstiff.robot.chain import Elementary, Row, elementary_chain
from symstiff.robot.exact import Exact
from symstiff.robot.schema import Robot
from symstiff.symbolic.builder import Builder
from symstiff.symbolic.terms import AXES, VirtualJoint, actuated_joint, link_joint, q

Vec = tuple[sp.Expr, sp.Expr, sp.Expr]
Axes = tuple[Vec, Vec, Vec]
ZERO: Vec = (sp.S.Zero, sp.S.Zero, sp.S.Zero)
IDENTITY: Axes = (
    (sp.S.One, sp.S.Zero, sp.S.Zero),
    (sp.S.Zero, sp.S.One, sp.S.Zero),
    (sp.S.Zero, sp.S.Zero, sp.S.One),
)
_CYCLIC = {"x": (0, 1, 2), "y": (1, 2, 0), "z": (2, 0, 1)}


@dataclass(frozen=True)
class ElasticChain:
    """A robot as a chain of exact motions and virtual joints; lengths stay symbols where ``symbolic`` is set.

    Without ``unit_axes`` oblique elastic axes keep the length that makes their components rational.
    """

    robot: Robot
    symbolic: bool = False
    unit_axes: bool = field(default=True, repr=False)

    def __post_init__(self) -> None:
        require(self.robot, Robot, *A_ROBOT)

    @cached_property
    def rows(self) -> tuple[Row, ...]:
        """The standard DH rows."""
        return elementary_chain(self.robot).rows

    @cached_property
    def base(self) -> tuple[Elementary, ...]:
        """World to frame 0."""
        return elementary_chain(self.robot).base

    @cached_property
    def tool(self) -> tuple[Elementary, ...]:
        """Frame n to tool centre point."""
        return elementary_chain(self.robot).tool

    @property
    def dof(self) -> int:
        """Number of joints n."""
        return len(self.rows)

    @cached_property
    def virtual_joints(self) -> tuple[VirtualJoint, ...]:
        """All virtual joints, base to tip: link 0's six, joint 1, link 1's six, …."""
        joints = [link_joint(0, a) for a in AXES]
        for i in range(1, self.dof + 1):
            joints += [actuated_joint(i), *(link_joint(i, a) for a in AXES)]
        return tuple(joints)

    def length(self, value: Exact, name: str) -> sp.Expr:
        """A DH length: its exact number, or a symbol such as a_2 where lengths are symbolic (zeros stay zero)."""
        if self.symbolic and value:
            return sp.Symbol(name, real=True)
        return value.sympy()

    def offset(self, i: int) -> Vec:
        """Frame i−1 to frame i after the rotation by θ_i: (a_i, 0, d_i), the prismatic variable included."""
        row = self.rows[i - 1]
        d = self.length(row.d, f"d_{i}")
        return self.length(row.a, f"a_{i}"), sp.S.Zero, d + q(i) if row.prismatic else d

    def tool_offset(self) -> Vec:
        """Frame n to tool centre point, in the axes of frame n (the tool's rotation turns about its tip)."""
        values = {e.kind: self.length(e.value, f"t_{e.kind[1]}") for e in self.tool if e.kind[0] == "t"}
        return tuple(values.get(k, sp.S.Zero) for k in ("tx", "ty", "tz"))

    def lengths(self) -> tuple[sp.Symbol, ...]:
        """The length symbols of a symbolic chain, base to tip."""
        return tuple(s for s in self._all_lengths() if s.is_Symbol)

    def length_values(self) -> tuple[sp.Expr, ...]:
        """The robot's own values of ``lengths``."""
        return tuple(length for length in replace(self, symbolic=False)._all_lengths() if length != 0)

    def _all_lengths(self) -> list[sp.Expr]:
        found: list[sp.Expr] = []
        for i, row in enumerate(self.rows, start=1):
            found += [self.length(row.a, f"a_{i}"), self.length(row.d, f"d_{i}")]
        return found + list(self.tool_offset())

    def angle(self, i: int) -> sp.Expr:
        """θ_i: the joint variable (revolute) plus its constant offset."""
        row = self.rows[i - 1]
        return row.theta.sympy() + (sp.S.Zero if row.prismatic else q(i))

    def constant_angles(self) -> tuple[sp.Expr, ...]:
        """Every constant angle of the chain: twists, offsets, rotations of the base and of the tool."""
        turns = [e.value.sympy() for e in (*self.base, *self.tool) if e.kind[0] == "r"]
        return (*turns, *(x.sympy() for row in self.rows for x in (row.theta, row.alpha)))

    def elastic_axes(self, b: Builder, i: int) -> Axes:
        """Axes of link i's elastic frame in DH frame i: cyclic for x, y, z; else beam, z × beam, and their product."""
        axis = self._beam_axis(i)
        if isinstance(axis, str):
            return tuple(IDENTITY[k] for k in _CYCLIC[axis])  # type: ignore[return-value]
        bx, by, bz = axis
        if bx == 0 and by == 0:  # z × beam vanishes: the second axis is frame x
            up = sp.sign(bz)
            return (sp.S.Zero, sp.S.Zero, up), IDENTITY[0], (sp.S.Zero, up, sp.S.Zero)
        if not self.unit_axes:
            return (bx, by, bz), (-by, bx, sp.S.Zero), (-bx * bz, -by * bz, bx**2 + by**2)
        norm, radius, _ = self._sizes(axis)
        cf, sf = b.rotation(bx / radius, by / radius)
        cp, sp_ = b.rotation(radius / norm, bz / norm)
        return (
            (cf * cp, sf * cp, sp_),
            (-sf, cf, sp.S.Zero),
            (-cf * sp_, -sf * sp_, cp),
        )

    def exact_axes(self, i: int) -> Axes:
        """``elastic_axes`` as exact numbers."""
        b = Builder("axes", ())
        axes = self.elastic_axes(b, i)
        exact = {c.symbol: c.exact for c in b.constants}
        return tuple(tuple(sp.sympify(x).xreplace(exact) for x in axis) for axis in axes)  # type: ignore[return-value]

    def turns_with_joint(self, i: int) -> tuple[int, ...]:
        """Which of link i's rotations, 4 to 6, are about the axis of the joint behind it; none where that slides."""
        if i >= self.dof or self.rows[i].prismatic:
            return ()
        return tuple(k for k, axis in enumerate(self.exact_axes(i), start=4) if axis[0] == 0 and axis[1] == 0)

    def axis_lengths(self, i: int) -> Vec:
        """Lengths of link i's elastic axes: one, or of oblique axes without ``unit_axes`` a root each."""
        axis = self._beam_axis(i)
        if self.unit_axes or isinstance(axis, str) or (axis[0] == 0 and axis[1] == 0):
            return sp.S.One, sp.S.One, sp.S.One
        return self._sizes(axis)

    def squares(self) -> frozenset[int]:
        """Whole numbers of whose roots, and those of their divisors, the components of unit elastic axes are made."""
        rational = replace(self, unit_axes=False)
        lengths = {x**2 for i in range(self.dof + 1) for x in rational.axis_lengths(i)[:2]}
        return frozenset(int(x.p * x.q) for x in lengths if x.is_Rational and x != 1)

    @staticmethod
    def _sizes(beam: Vec) -> Vec:
        """Lengths of a beam's vector, of z × beam, and of their product."""
        norm, radius = sp.sqrt(dot(beam, beam)), sp.sqrt(beam[0] ** 2 + beam[1] ** 2)
        return norm, radius, norm * radius

    def _beam_axis(self, i: int) -> str | Vec:
        axis = self.robot.links[i].beam_axis or self._default_axis(i)
        return axis if isinstance(axis, str) else tuple(v.sympy() for v in axis)

    def _default_axis(self, i: int) -> str:
        """The DH axis nearest to the link's own offset, seen in frame i; x where the offset vanishes."""
        if i == 0:
            return "x"
        row = self.rows[i - 1]
        alpha = row.alpha.sympy()
        along = (float(row.a), float(row.d) * float(sp.sin(alpha)), float(row.d) * float(sp.cos(alpha)))
        return "xyz"[max(range(3), key=lambda k: (abs(along[k]), -k))]

    def alpha(self, b: Builder, i: int) -> tuple[sp.Expr, sp.Expr]:
        """Cosine and sine of α_i as exact constants."""
        alpha = self.rows[i - 1].alpha.sympy()
        return b.turn(alpha)

    def base_axes(self, b: Builder) -> Axes:
        """Axes of frame 0 in world axes."""
        axes = IDENTITY
        for motion in self.base:
            if motion.kind[0] == "r":
                value = motion.value.sympy()
                axes = _turned(axes, "xyz".index(motion.kind[1]), *b.turn(value))
        return tuple(b.vector(a) for a in axes)  # type: ignore[return-value]

    def _repr_html_(self) -> str:
        from symstiff.symbolic.reading import chain_html

        return chain_html(self)


def _turned(axes: Axes, k: int, c: sp.Expr, s: sp.Expr) -> Axes:
    """Axes after a rotation about their own k-th axis."""
    i, j = (k + 1) % 3, (k + 2) % 3
    new = list(axes)
    new[i] = tuple(c * x + s * y for x, y in zip(axes[i], axes[j], strict=True))
    new[j] = tuple(c * y - s * x for x, y in zip(axes[i], axes[j], strict=True))
    return tuple(new)  # type: ignore[return-value]


def dot(a: Sequence[sp.Expr], b: Sequence[sp.Expr]) -> sp.Expr:
    """Scalar product."""
    return sp.Add(*[x * y for x, y in zip(a, b, strict=True)])


def cross(a: Sequence[sp.Expr], b: Sequence[sp.Expr]) -> Vec:
    """Vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def turn_z(v: Vec, c: sp.Expr, s: sp.Expr) -> Vec:
    """Rz·v."""
    return c * v[0] - s * v[1], s * v[0] + c * v[1], v[2]


def turn_x(v: Vec, c: sp.Expr, s: sp.Expr) -> Vec:
    """Rx·v."""
    return v[0], c * v[1] - s * v[2], s * v[1] + c * v[2]


def plus(a: Vec, b: Vec) -> Vec:
    """Sum of two vectors."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def scaled(v: Vec, factor: sp.Expr) -> Vec:
    """Vector times scalar."""
    return v[0] * factor, v[1] * factor, v[2] * factor


@dataclass(frozen=True)
class Frames:
    """Frames 0…n in world axes: axes (columns of R_i) and levers ρ_i from each origin to the tool centre point."""

    axes: tuple[Axes, ...]
    levers: tuple[Vec, ...]
    moments: tuple[Axes, ...]  # e_k × ρ_i for the three axes of every frame


def frames(chain: ElasticChain, b: Builder) -> Frames:
    """Frames of the chain; consecutive parallel axes turn by one merged angle, e.g. q_2 + q_3."""
    axes, steps = _orientations(chain, b)
    rho = _combined(b, axes[-1], chain.tool_offset())
    levers: list[Vec] = [rho]
    moments: list[Axes] = [tuple(b.vector(cross(e, rho)) for e in axes[-1])]  # type: ignore[list-item]
    for i in range(chain.dof, 0, -1):
        a, _, d = chain.offset(i)
        z = axes[i - 1][2]
        rho = b.vector(plus(plus(rho, b.vector(scaled(axes[i][0], a))), b.vector(scaled(z, d))))
        levers.append(rho)
        joint_moment = _about_joint(chain, b, i, moments[-1], steps[i - 1], a)
        x, y, _ = (b.vector(cross(e, rho)) for e in axes[i - 1])
        moments.append((x, y, joint_moment))
    return Frames(tuple(axes), tuple(levers[::-1]), tuple(moments[::-1]))


def _about_joint(chain: ElasticChain, b: Builder, i: int, moments: Axes, before: Vec, a: sp.Expr) -> Vec:
    """z_{i−1} × ρ_{i−1} from frame i's moments: z = sin α·y_i + cos α·z_i, and a·(z × x_i) for the lever's change."""
    c, s = chain.alpha(b, i)
    moment = b.vector(plus(scaled(moments[1], s), scaled(moments[2], c)))
    return b.vector(plus(moment, b.vector(scaled(before, a))))


def _orientations(chain: ElasticChain, b: Builder) -> tuple[list[Axes], list[Vec]]:
    """Axes of the frames 0…n, and z_{i−1} × x_i (the y axis before the turn by α_i) for every joint."""
    axes: list[Axes] = [chain.base_axes(b)]
    sides: list[Vec] = []
    start, angle, name = axes[0], sp.S.Zero, ""
    for i in range(1, chain.dof + 1):
        angle, name = angle + chain.angle(i), f"{name}_{i}"
        c, s = b.cos_sin(angle, name)
        x, y, z = (b.vector(v) for v in _turned(start, 2, c, s))
        sides.append(y)
        ca, sa = chain.alpha(b, i)
        x, y, z = (b.vector(v) for v in _turned((x, y, z), 0, ca, sa))
        frame: Axes = (x, y, z)
        axes.append(frame)
        if chain.rows[i - 1].alpha:
            start, angle, name = frame, sp.S.Zero, ""
    return axes, sides


def _combined(b: Builder, axes: Axes, components: Vec) -> Vec:
    """Σ component_k · axis_k, bound."""
    total = tuple(sp.Add(*[components[k] * axes[k][r] for k in range(3)]) for r in range(3))
    return b.vector(total)


def point_offset(chain: ElasticChain, b: Builder, f: Frames, point: str) -> Vec:
    """From the tool centre point to a marker, in world axes."""
    x, y, z = (value.sympy() for value in chain.robot.marker_position(point))
    tx, ty, tz = chain.tool_offset()
    return _combined(b, f.axes[-1], (x - tx, y - ty, z - tz))


def jacobian_columns(chain: ElasticChain, b: Builder, f: Frames) -> dict[VirtualJoint, tuple[sp.Expr, ...]]:
    """Columns J_v of the virtual-joint Jacobian J_θ in base axes at the tool centre point (seed eq. 2, 3)."""
    columns: dict[VirtualJoint, tuple[sp.Expr, ...]] = {}
    for i in range(chain.dof + 1):
        if i:
            z, moment = f.axes[i - 1][2], f.moments[i - 1][2]
            row = chain.rows[i - 1]
            columns[actuated_joint(i)] = (*z, *ZERO) if row.prismatic else (*moment, *z)
        for k, direction in enumerate(chain.elastic_axes(b, i), start=1):
            e, moment = _combined(b, f.axes[i], direction), _combined(b, f.moments[i], direction)
            columns[link_joint(i, k)] = (*e, *ZERO)
            columns[link_joint(i, k + 3)] = (*moment, *e)
    return columns
