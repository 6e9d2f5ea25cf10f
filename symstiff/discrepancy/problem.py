"""What the statistics are given: rows of data, columns of the model, and candidates that yield columns."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from symstiff.arrays import Array, Index, Mask, numbered
from symstiff.calibration.experiment.rounding import without_rounding
from symstiff.calibration.residuals import places
from symstiff.effects.base import Move, Shape
from symstiff.errors import UserError


@dataclass(frozen=True)
class Parameter:
    """A coefficient of a candidate: name, unit and the physical range outside which nobody would believe it."""

    name: str
    unit: str = ""
    low: float = -np.inf
    high: float = np.inf
    typical: float = 0.0
    """Usual size, for the relative sizes of one effect's parameters, and beyond which a law without a name that has no
    other is the less likely; 0 where nothing is known of it."""


@dataclass(frozen=True)
class DeviceLaw:
    """What a sensor, the measuring device, a marker or the foot of the base adds by one law."""

    place: str
    title: str
    parameters: tuple[Parameter, ...]
    """One a column; a colon parts the law from the part of it that a column is."""
    values: Array
    """(M, k)"""


@dataclass(frozen=True)
class Problem:
    """Measured rows, the model's columns and the context of every row.

    Rows are scalars: one component of one measured point in one load case of one pose. Optional arrays may be
    None where the data do not hold them. Positions in metres, rotations in radians, loads in N and N·m.
    """

    y: Array
    """(M,) measured deflection or position."""
    A: Array
    """(M, P) columns of the current model; any scale, any rank."""
    pose: Index
    """(M,) number of the pose."""
    case: Index
    """(M,) number of the load case within its pose; rows that agree in pose, case and channel are repeats."""
    channel: Index
    """(M,) number of the measured component: marker and axis together."""
    axis: Index
    """(M,) number of the axis, shared by the markers; 0-2 translations, 3-5 rotations."""
    sigma: Array | None = None
    """(M,) stated standard deviation."""
    load: Array | None = None
    """(M,) load as a factor of the largest load of its pose."""
    J: Array | None = None
    """(M, V) row of the virtual-joint Jacobian."""
    tau: Array | None = None
    """(M, V) load on the virtual joints."""
    weight: Array | None = None
    """(M, V) what the links' weight puts on the virtual joints beside ``tau``, in deflection data."""
    devices: Sequence[DeviceLaw] = ()
    """What sensors and markers may add: an axis that reads too large, a marker that gives way."""
    markers: tuple[str, ...] = ()
    """Names of the measured points, in their order in ``channel``."""
    virtual_joints: tuple[str, ...] = ()
    """V names, such as ``joint 3`` or ``link 2 axis 4``."""
    joint_of: tuple[int, ...] = ()
    """V numbers: 0-based column of ``q`` that the virtual joint turns about, -1 for links."""
    slides: tuple[int, ...] = ()
    """0-based columns of ``q`` that are lengths: prismatic joints."""
    q: Array | None = None
    """(M, n) joint variables."""
    time: Array | None = None
    temperature: Array | None = None
    branch: Array | None = None
    """(M,) +1 loading, -1 unloading."""
    turn: Index | None = None
    """(M,) number of the repeat, for which the robot may have come to its pose anew."""
    file: Index | None = None
    """(M,) where a row came from, among ``files``."""
    files: tuple[str, ...] = ()
    differences: bool = False
    """Whether a row is a reading less the one without load, which all rows of its pose may share."""
    spread: Mapping[str, Array] = field(default_factory=dict)
    """Positive quantities that the noise may grow with, (M,) each: distance, load."""

    def __post_init__(self) -> None:
        rows = len(self.y)
        if self.A.ndim != 2 or len(self.A) != rows:
            raise UserError(f"diagnosis: model columns have shape {self.A.shape}, data have {rows} rows")
        if not np.all(np.isfinite(self.y)) or not np.all(np.isfinite(self.A)):
            raise UserError(
                "diagnosis: data or model columns hold a value that is not finite: remove those rows"
            )
        if self.sigma is not None and not np.all(self.sigma > 0):
            raise UserError("diagnosis: a stated sigma is zero or negative: give positive values or none")

    @property
    def rows(self) -> int:
        """Number of rows M."""
        return len(self.y)

    @property
    def cells(self) -> Index:
        """(M,) a number for pose, load case and channel together, ascending by pose: repeats have the same."""
        return numbered(self.pose, self.case, self.channel)

    @property
    def lines(self) -> Index:
        """(M,) a number for pose and axis together, ascending by pose: what a pose's load cases and markers share."""
        return numbered(self.pose, self.axis)

    @property
    def main(self) -> Mask:
        """(M,) the rows that sizes are told of: translations, rotations where there are none."""
        return self.axis < 3 if np.any(self.axis < 3) else np.ones(self.rows, bool)

    @property
    def points(self) -> Index:
        """(M,) a number for each measured point: what is left of the channel without the axis."""
        return self.channel - self.axis

    def marker(self, point: int) -> str:
        """Name of one of the ``points``."""
        known = np.unique(self.points)
        place = int(np.searchsorted(known, point))
        return self.markers[place] if len(self.markers) == len(known) else f"point {place + 1}"

    @property
    def poses(self) -> int:
        """Number of poses."""
        return len(np.unique(self.pose))

    @property
    def place(self) -> Index:
        """(M,) place of each row's pose by joint variables and data: the same in whatever order the rows stand."""
        return places(self.pose, np.column_stack([self.y, *(() if self.q is None else (self.q,))]))


ANGLE, CLOCK, HISTORY = "angle", "clock", "history"
"""What laws may depend on beside loads: the joints' variables; time, temperature or order; where the load came from."""


@dataclass(frozen=True)
class Candidate:
    """An effect at a place, as columns that would be added to the model."""

    effect: str
    where: Mapping[str, object]
    parameters: tuple[Parameter, ...]
    columns: Callable[[Shape], Array]
    """shape values -> (M, k), one column a parameter."""
    shapes: tuple[Shape, ...] = ({},)
    """Profile grid of the parameters that are not linear."""
    weights: tuple[float, ...] = ()
    """Prior weights of the shapes; all are alike where this is empty."""
    group: str = ""
    """Structural group: the simplest shapes of one group's candidates cannot be told apart by any data of this kind."""
    parameters_of: Callable[[Shape], tuple[Parameter, ...]] | None = None
    """Parameters of a shape, where they differ between shapes; ``parameters`` are then those of the first."""
    at: str | None = None
    """Virtual joint of which it is a law alone, empty for none; where this is None, its columns tell."""
    driven: Callable[[Shape], frozenset[str] | None] = lambda shape: None
    """What a shape's law depends on beside loads, of ``ANGLE``, ``CLOCK``, ``HISTORY``; None if not known."""
    assumed: frozenset[str] = frozenset()
    """Keys of shapes that take for granted what nobody told, such as the arm's mass: it is one thing for all laws."""
    moves: Callable[[Shape], Mapping[str, Move]] = lambda shape: {}
    """How a shape's values, by key, are moved to what lies between those of the profile."""
    between: int = 0
    """How many of the last ``shapes`` are not of the profile: they were moved to what the data ask for."""
    expected: bool = False
    """Whether theory gives its size: it is there, whatever else is."""
    kin: bool = False
    """Whether the model has the same effect at the same place in another form, such as a wave of the same gear."""
    unavailable: str = ""
    """Why these data cannot show the effect (a column is missing, another kind of data); empty if they can."""
    counted: Array | None = None
    """(M,) what it adds all the same, where its size is known and too small to be looked for."""

    @property
    def simplest(self) -> tuple[Shape, ...]:
        """The shapes that have no more parameters than the first: those with more are another law."""
        return tuple(
            s for s in self.shapes if len(self.parameters_at(s)) <= len(self.parameters_at(self.shapes[0]))
        )

    def parameters_at(self, shape: Shape) -> tuple[Parameter, ...]:
        """The parameters that a shape's columns belong to."""
        return self.parameters if self.parameters_of is None else self.parameters_of(shape)

    def block(self, shape: Shape) -> Array:
        """(M, k) a shape's columns; what is nothing but the others' rounding is zero."""
        found = np.asarray(self.columns(shape), dtype=float)
        found = found.reshape(len(found), -1)
        sizes = np.array([p.typical if p.typical > 0 else 1.0 for p in self.parameters_at(shape)])
        sized = len(sizes) == found.shape[1] and bool(np.all(np.isfinite(found)))
        return without_rounding(found, sizes) if sized else found

    @property
    def profiled(self) -> int:
        """Number of the shapes that are of the profile; they come first."""
        return len(self.shapes) - self.between

    @property
    def key(self) -> str:
        """Stable text that identifies effect and place."""
        return key_of(self.effect, self.where)


def key_of(effect: str, where: Mapping[str, object]) -> str:
    """Stable text that identifies an effect at a place."""
    return effect + "@" + ",".join(f"{k}={where[k]}" for k in sorted(where))


@dataclass(frozen=True)
class Options:
    """Settings of a diagnosis; the defaults are those of the benchmark."""

    alpha: float = 0.025
    """Family-wise level of the candidate tests."""
    alpha_pair: float = 0.005
    """Level of the test of two effects that hide each other, where that of single ones does not reject."""
    alpha_strata: float = 0.004
    """Level of the tests that name nothing (strata, smooth laws outside the catalogue)."""
    alpha_sufficient: float = 0.0015
    """Level at which laws without a name in what is left after adding a candidate make it insufficient."""
    alpha_further: float = 0.002
    """The same level for a further effect of the catalogue: beside the real ones many small misfits look for a name."""
    alpha_little: float = 1e-4
    """The same level where less is left than ``little``: no shape of the catalogue is exact."""
    little: float = 0.01
    """Share of the signal up to which that holds: a tenth of its amplitude."""
    alpha_notable: float = 0.015
    """Both levels where more is left than shapes that are only close would leave."""
    notable: float = 0.03
    """Share of the signal from which that holds for a further effect; for unnamed laws it is ``tolerated_shape``."""
    draws: int = 400
    folds: int = 10
    """Folds of the held-out proof; five are made where there are more than twenty poses."""
    max_effects: int = 3
    seed: int = 20260
    tolerated_share: float = 0.04
    """Share of the signal that a set may miss to an unnamed law at another place."""
    tolerated_shape: float = 0.1
    """Share that it may miss to a law at the place of one of its members: the shape is only close."""
    name_at: float = 0.75
    """Share of the admissible evidence from which the leader is named rather than listed."""
    held_out: bool = True
