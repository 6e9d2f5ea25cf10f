"""StiffnessModel: robot, reduced compliances, effects and their values; what is saved, shown, emitted and fitted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from symstiff.arguments import A_ROBOT, require, several
from symstiff.effects.base import EffectParameter, Realisation
from symstiff.effects.instance import EffectInstance, realise_all
from symstiff.errors import UserError, did_you_mean, printable
from symstiff.reduction.complete import known_values
from symstiff.reduction.physical import Parameter, terms_of
from symstiff.reduction.reduce import Reduction, reduce
from symstiff.reduction.structural import Experiment
from symstiff.robot.frozen import FrozenDict, frozen_numbers
from symstiff.robot.loading import from_table
from symstiff.robot.schema import Robot
from symstiff.robot.table import to_table
from symstiff.slopes import derivative
from symstiff.states import Context, moment, point, poses, ranges
from symstiff.symbolic.algebras import evaluate_numpy
from symstiff.symbolic.chain import ElasticChain
from symstiff.symbolic.compliance import compliance_program
from symstiff.symbolic.program import Program
from symstiff.symbolic.programs import deflection_program, observation_program
from symstiff.symbolic.terms import Term

if TYPE_CHECKING:
    from symstiff.codegen.runtime import Evaluator

_COMPLIANCES = "the parameters of a reduction's stage"
_AN_EFFECT = "[EffectInstance('backlash', {'joint': 2})]"
_USUAL = 1e-7
"""Size from which a parameter's step is found, where no unit and no effect tells one."""
_WITHOUT_VALUES = {
    "realisations", "units", "terms", "linear_parameters", "steps", "deflection_program", "observation_program",
    "linear_program", "compliance_program", "structure_hash",
}  # fmt: skip


@dataclass(frozen=True)
class StiffnessModel:
    """A stiffness model: Δt = Σ_v J_v·Δθ_v over the terms of its compliances and effects.

    compliances: the identifiable parameters π″; effects: what was added to them; values, deviations: by parameter name,
    SI units, read-only (a missing value is zero); fixed: joints (from 1) that stood still when the compliances were
    reduced, with values [rad, m]; file_tool: the file's [tool] xyz [m], where ``robot`` has a measured point instead;
    seen: least and greatest ``q1`` …, ``fx`` … ``mz`` [SI], ``time`` [s] and ``temperature`` [°C] of the rows that the
    values were fitted to, as far as known.
    """

    robot: Robot
    compliances: tuple[Parameter, ...]
    loads: str = "wrench"
    measure: str = "pose"
    effects: tuple[EffectInstance, ...] = ()
    values: Mapping[str, float] = field(default_factory=dict)
    deviations: Mapping[str, float] = field(default_factory=dict)
    fixed: Mapping[int, float] = field(default_factory=dict)
    file_tool: tuple[float, float, float] | None = None
    seen: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        require(self.robot, Robot, *A_ROBOT)
        Experiment(self.loads, self.measure)  # refuses unknown classes
        for name, kind, example in (
            ("compliances", Parameter, _COMPLIANCES), ("effects", EffectInstance, _AN_EFFECT),
        ):  # fmt: skip
            object.__setattr__(self, name, several(getattr(self, name), kind, name, example))
        if self.file_tool is not None:
            object.__setattr__(self, "file_tool", point(self.file_tool))
        for name, least in (("values", -np.inf), ("deviations", 0.0), ("fixed", -np.inf)):
            object.__setattr__(self, name, frozen_numbers(getattr(self, name), name, least))
        object.__setattr__(self, "seen", ranges(self.seen, self.robot))

    @classmethod
    def of(cls, reduction: Reduction, values: Mapping[str, float] | None = None) -> StiffnessModel:
        """The model that a reduction leaves; values default to those that the robot file knows. UserError for none."""
        require(reduction, Reduction, "a reduction", "reduce(robot) gives one")
        reduction.check_any()
        values = known_values(reduction) if values is None else values
        experiment = reduction.experiment
        fixed = {j: float(v) for j, v in reduction.standing.items()}
        model = cls(reduction.robot, reduction.kept, experiment.loads, experiment.measure, fixed=fixed)
        return model.with_values(values)

    @property
    def chain(self) -> ElasticChain:
        """The elastic chain of the robot."""
        return ElasticChain(self.robot)

    @cached_property
    def realisations(self) -> tuple[Realisation, ...]:
        """The effects' parameters and terms on this robot.

        Raises UserError for two laws of one parameter, and for a key that no law reads: misspelt, or of another effect.
        """
        found = realise_all(self.effects, self.robot)
        for effect in self.effects:
            if unread := effect.unread(self.robot):
                raise UserError(
                    f"{effect.effect} at {dict(effect.where)} knows no shape key {printable(unread[0], 40)!r}: correct "
                    "or remove it"
                )
        return found

    @property
    def stiffness_parameters(self) -> tuple[str, ...]:
        """Names of the compliances: the C array ``k``, in order."""
        replaced = {n for r in self.realisations for n in r.replaces}
        return tuple(p.name for p in self.compliances if p.name not in replaced)

    @property
    def effect_parameters(self) -> tuple[EffectParameter, ...]:
        """The effects' parameters, in order; each once."""
        found = {p.name: p for r in self.realisations for p in r.parameters}
        return tuple(p for n, p in found.items() if n not in self.stiffness_parameters)

    @property
    def bends(self) -> bool:
        """Whether any compliance has a value; positions may leave all of them zero."""
        return any(self.values.get(name) for name in self.stiffness_parameters)

    @property
    def frame_errors(self) -> frozenset[str]:
        """Parameters of effects that set virtual joints off by constants, which stand for one another in positions."""
        return frozenset(p.name for r in self.realisations if r.is_constant for p in r.parameters)

    @property
    def parameters(self) -> tuple[str, ...]:
        """All parameters: compliances, then effects."""
        return (*self.stiffness_parameters, *(p.name for p in self.effect_parameters))

    @property
    def rest(self) -> dict[str, float]:
        """Time [s] and temperature [°C] at which the model's effects do nothing; of several effects the first's."""
        return {name: value for r in reversed(self.realisations) for name, value in r.rest.items()}

    @cached_property
    def units(self) -> dict[str, str]:
        """SI unit of every parameter."""
        units = {p.name: p.unit for p in self.compliances}
        return FrozenDict(units | {p.name: p.unit for p in self.effect_parameters})

    @cached_property
    def terms(self) -> tuple[Term, ...]:
        """Every term of the model."""
        kept = set(self.stiffness_parameters)
        terms = terms_of(tuple(p for p in self.compliances if p.name in kept))
        # effects that share entries of a link's compliance bring the same terms: each counts once
        return tuple(dict.fromkeys((*terms, *(t for r in self.realisations for t in r.terms))))

    @cached_property
    def linear_parameters(self) -> tuple[str, ...]:
        """Parameters whose column needs no other parameter's value: all or none.

        An error of the load or of the device changes every compliance's column as well as its own.
        """
        return () if any(bilinear(t) for t in self.terms) else self.parameters

    @cached_property
    def steps(self) -> dict[str, float]:
        """A usual size of every parameter, from which the steps of a central difference are found."""
        usual = {"m/N": 1e-8, "rad/N": 1e-8}
        steps = {p.name: usual.get(p.unit, _USUAL) for p in self.compliances}
        return FrozenDict(
            steps | {p.name: p.typical or usual.get(p.unit, _USUAL) for p in self.effect_parameters}
        )

    @property
    def is_linear(self) -> bool:
        """Whether Δt is linear in all parameters."""
        return len(self.linear_parameters) == len(self.parameters)

    @cached_property
    def deflection_program(self) -> Program:
        """Δt(q, W; π) by recursion."""
        return deflection_program(self.chain, self.terms, self.parameters)

    @cached_property
    def observation_program(self) -> Program:
        """A(q, W) of the stiffness parameters."""
        names = self.stiffness_parameters
        return observation_program(self.chain, [t for t in self.terms if t.parameter in names], names)

    @cached_property
    def linear_program(self) -> Program:
        """∂Δt/∂π of the linear parameters, (6, their number)."""
        names = self.linear_parameters
        if names == self.stiffness_parameters:
            return self.observation_program
        return observation_program(self.chain, [t for t in self.terms if t.parameter in names], names)

    @cached_property
    def compliance_program(self) -> Program:
        """K_C⁻¹(q; π) at small load."""
        return compliance_program(self.chain, self.terms, self.parameters)

    @property
    def known(self) -> dict[str, float]:
        """The value of every parameter, in order; what is not known is zero."""
        return {n: float(self.values.get(n, 0.0)) for n in self.parameters}

    def vector(self, values: Mapping[str, float] | None = None) -> np.ndarray:
        """Parameter values in order (missing ones zero). Raises UserError for a name that the model does not have."""
        source = self.values if values is None else self._known(values)
        return np.array([float(source.get(n, 0.0)) for n in self.parameters])

    def _known(self, values: Mapping[str, float], what: str = "values") -> Mapping[str, float]:
        """The values, checked. Raises UserError for a name that is no parameter, nor a compliance one replaced."""
        values = frozen_numbers(values, what)
        unknown = sorted(set(values).difference(self.parameters, (p.name for p in self.compliances)), key=str)
        if unknown:
            name = str(unknown[0])[:40]
            hint = did_you_mean(name, self.parameters) or "see its .parameters"
            raise UserError(f"{self.robot.name}: the model has no parameter {name!r}: {hint}")
        return values

    def deflection(
        self,
        q: npt.ArrayLike,
        w: npt.ArrayLike,
        *,
        values: Mapping[str, float] | None = None,
        context: Context | None = None,
    ) -> np.ndarray:
        """Deflection of the tool centre point (N, 6) [m, rad] for q (N, n), W (N, 6); one row stands for all.

        q [rad, m]; W [N, N·m] acts at the tool centre point, forces first; both it and the deflection, translations
        first, stand in base axes. ``values`` stand for those of the model, and what they leave out for zero.
        ``context``: columns (N,) or numbers that laws need: ``time`` [s], ``temperature`` [°C], ``branch`` (+1 while
        the load grows, −1 while it falls, 0 while nothing is carried) and ``turn`` (the load where it last turned over
        the present one, 1 while it grows). A reduced model holds for its class of ``loads`` and ``measure`` alone, and
        where its ``fixed`` joints stand: what other loads bend is not in it, and nothing here says so.
        Raises UserError for other shapes, what is no finite number, unknown names in ``values`` and a missing column of
        ``context``.
        """
        return self._deflection(*self.poses(q, w), self.vector(values), context)

    def _deflection(self, q: np.ndarray, w: np.ndarray, p: np.ndarray, context: Context | None) -> np.ndarray:
        extra = moment(self.deflection_program, context, len(q))
        return evaluate_numpy(self.deflection_program, p=p, q=q, w=w, **extra)["dt"]

    def observation(
        self,
        q: npt.ArrayLike,
        w: npt.ArrayLike,
        *,
        values: Mapping[str, float] | None = None,
        context: Context | None = None,
    ) -> np.ndarray:
        """∂Δt/∂π (N, 6, P) in the order of ``parameters``, at ``values`` where the model is not linear in them.

        Takes what ``deflection`` takes, holds where that holds, and raises UserError as it does.
        """
        q, w = self.poses(q, w)
        p = self.vector(values)
        if self.is_linear:
            program = self.linear_program
            return evaluate_numpy(program, q=q, w=w, **moment(program, context, len(q)))["A"]
        return derivative(self, lambda x: self._deflection(q, w, x, context), p)

    def poses(self, q: npt.ArrayLike, w: npt.ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """q (N, n) and W (N, 6) with as many rows. Raises UserError for other shapes and what is no finite number."""
        return poses(q, w, self.robot.dof)

    def compile(self, threads: int = 1) -> Evaluator:
        """Compiled ``deflection`` and ``observation`` on arrays; NumPy's, with a warning, where no compiler is."""
        from symstiff.codegen.runtime import compiled

        return compiled(self, threads)

    def of_robot(self) -> StiffnessModel:
        """The model without effects that only the measurement has: what a controller evaluates.

        An error of the device, a bad pose, and what has no law at a virtual joint are no laws of the robot.
        """
        realised = zip(self.effects, self.realisations, strict=True)
        kept = tuple(e for e, r in realised if any(t.at.kind != "measure" for t in r.terms))
        return self.with_effects(kept)

    def with_effects(self, effects: Sequence[EffectInstance]) -> StiffnessModel:
        """The model with these effects alone, and the values that it has of what is in them."""
        kept = several(effects, EffectInstance, "effects", _AN_EFFECT)
        if kept == self.effects:
            return self
        other = replace(self, effects=kept)
        names = set(other.parameters)
        return other.with_values(
            {n: v for n, v in self.values.items() if n in names},
            {n: v for n, v in self.deviations.items() if n in names},
        )

    def with_values(
        self, values: Mapping[str, float], deviations: Mapping[str, float] | None = None
    ) -> StiffnessModel:
        """The same model with other values. Raises UserError for a name that the model does not have."""
        known, spread = dict(self._known(values)), dict(self._known(deviations or {}, "deviations"))
        return self._alike(values=known, deviations=spread)

    def with_seen(self, seen: Mapping[str, tuple[float, float]]) -> StiffnessModel:
        """The same model with other ranges of what its values were fitted to. Raises UserError for what is none."""
        return self._alike(seen=seen)

    def _alike(self, **numbers: Any) -> StiffnessModel:
        other = replace(self, **numbers)  # nothing is derived twice
        other.__dict__.update({n: x for n, x in self.__dict__.items() if n in _WITHOUT_VALUES})
        return other

    def with_effect(self, instance: EffectInstance) -> StiffnessModel:
        """The model grown by an effect; it keeps the values of compliances that this replaces.

        Raises UserError for a place or a shape that do not fit.
        """
        other = replace(self, effects=(*self.effects, instance))
        _ = other.realisations  # a mistake shows here, not where the model is used
        return other

    @cached_property
    def structure_hash(self) -> str:
        """SHA-256 of everything but values, known ones included: a parameter file fits a model with the same hash."""
        from symstiff.model_file import hash_of_structure

        return hash_of_structure(self)

    @property
    def fixed_by_name(self) -> dict[str, float]:
        """The values of the joints that stood still, by ``q1`` … ``qn``."""
        return {f"q{j}": float(v) for j, v in sorted(self.fixed.items())}

    def save(self, path: str | Path) -> None:
        """Write model.toml, whole or not at all."""
        from symstiff.model_file import write_model

        write_model(self, path)

    def __repr__(self) -> str:
        effects = "".join(f" + {e.effect}" for e in self.effects)
        return f"StiffnessModel({self.robot.name}{effects}: {len(self.parameters)} parameters)"

    def _repr_latex_(self) -> str:
        from symstiff.model_reading import model_latex

        return model_latex(self)

    def _repr_html_(self) -> str:
        from symstiff.model_reading import model_html

        return model_html(self)


def bilinear(term: Term) -> bool:
    """Whether other parameters' columns change with a term's: an error of the load, or of the device that reads."""
    if term.at.kind in ("load", "body"):
        return True
    return any(s.name.startswith("dt_") for s in term.factor.free_symbols)


def joints_only(
    robot: Robot,
    loads: str = "wrench",
    measure: str = "pose",
    fixed: Mapping[int, Any] | None = None,
    points: Sequence[str] = (),
) -> StiffnessModel:
    """The conventional model of rigid links: one compliance a joint (the seed's J models), reduced for the class."""
    require(robot, Robot, *A_ROBOT)
    rigid = _without_links(robot)
    reduction = reduce(rigid, loads, measure, fixed, points=points)
    return replace(StiffnessModel.of(reduction), robot=robot)


def _without_links(robot: Robot) -> Robot:
    table = to_table(robot)
    base = table.setdefault("base", {})
    base["link"] = {**base.get("link", {}), "template": "rigid"}
    for joint in table["joint"]:
        joint["link"] = {**joint.get("link", {}), "template": "rigid"}
    return from_table(table, robot.name)


def load_model(path: str | Path) -> StiffnessModel:
    """Read model.toml. Raises UserError."""
    from symstiff.model_file import read_model

    return read_model(path)
