"""The functions that a model emits, as Programs, with their operation counts."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import isclose

from symstiff.model import StiffnessModel
from symstiff.reduction import reduce
from symstiff.reduction.complete import known_values
from symstiff.symbolic.algebras import count
from symstiff.symbolic.program import Emit, Program
from symstiff.symbolic.programs import forward_program, jacobian_program


@dataclass(frozen=True)
class Functions:
    """Programs of one model; derived once, walked by every emitter."""

    model: StiffnessModel

    @property
    def deflection(self) -> Program:
        """Δt(p, q, W)."""
        return self.model.deflection_program

    @property
    def observation(self) -> Program:
        """A(q, W)."""
        return self.model.observation_program

    @property
    def compliance(self) -> Program:
        """K_C⁻¹(p, q)."""
        return self.model.compliance_program

    @cached_property
    def reciprocal(self) -> bool:
        """Whether K_C⁻¹ is symmetric: any two virtual joints follow each other's loads alike."""
        C = {s.index: s.expression for s in self.compliance.statements if isinstance(s, Emit)}
        return all(C[6 * i + j] == C[6 * j + i] for i in range(6) for j in range(i))

    @cached_property
    def jacobian(self) -> Program:
        """J(q) of the actuated joints."""
        return jacobian_program(self.model.chain)

    @cached_property
    def forward(self) -> Program:
        """Pose of the tool centre point."""
        return forward_program(self.model.chain)

    @property
    def all(self) -> tuple[Program, ...]:
        """All programs, in the order of the header; without the observation where effects replaced every compliance."""
        observed = (self.observation,) if self.model.stiffness_parameters else ()
        return (self.deflection, *observed, self.jacobian, self.compliance, self.forward)

    @cached_property
    def operations(self) -> dict[str, dict[str, int]]:
        """Additions, multiplications, sign changes and sines/cosines of every function."""
        return {p.name: count(p) for p in self.all}

    @cached_property
    def defaults_known(self) -> bool:
        """Whether the model's values are those that its robot file states, zero where it states none."""
        model = self.model
        values = {n: model.values[n] for n in model.parameters if model.values.get(n)}
        if not values:
            return True
        known = known_values(reduce(model.robot, model.loads, model.measure, model.fixed))
        stated = {n: known[n] for n in model.parameters if known.get(n)}
        return values.keys() == stated.keys() and all(isclose(x, stated[n]) for n, x in values.items())
