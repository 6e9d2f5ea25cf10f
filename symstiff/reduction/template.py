"""The compliance template k⁰ of a link (seed M2, eq. 13): derived from a Timoshenko beam, or a user's own."""

from __future__ import annotations

from functools import cache

import sympy as sp

from symstiff.robot.schema import Robot

Pattern = tuple[tuple[bool, ...], ...]


@cache
def beam_compliance() -> sp.Matrix:
    """6 × 6 tip compliance of a cantilever Timoshenko beam along axis 1, in symbols.

    Castigliano: the flexibility is ∫₀ᴸ Sᵀ·F·S dx, with S the section loads (N, V₂, V₃, T, M₂, M₃) at x that a unit
    tip wrench causes, and F the section's compliances 1/EA, κ/GA, 1/GJ, 1/EI. Symbols: E, G, L, A, J, I_2, I_3,
    kappa_2, kappa_3.
    """
    E, G, L, A, J, i2, i3, k2, k3 = sp.symbols("E G L A J I_2 I_3 kappa_2 kappa_3", positive=True)
    x = sp.Symbol("x", positive=True)
    section = sp.diag(1 / (E * A), k2 / (G * A), k3 / (G * A), 1 / (G * J), 1 / (E * i2), 1 / (E * i3))
    loads = sp.eye(6)
    loads[4, 2] = -(L - x)  # a force along 3 at the tip bends about 2
    loads[5, 1] = L - x  # a force along 2 bends about 3
    energy = loads.T * section * loads
    return energy.applyfunc(lambda entry: sp.expand(sp.Poly(entry, x).integrate().eval(L)))


@cache
def beam_pattern() -> Pattern:
    """Where the beam's compliance does not vanish: the diagonal, (2,6) and (3,5) with their mirrors (seed eq. 13)."""
    k = beam_compliance()
    return tuple(tuple(bool(k[i, j] != 0) for j in range(6)) for i in range(6))


def pattern(robot: Robot, template: str) -> Pattern:
    """Non-zero entries of a template: ``beam``, ``full``, ``rigid``, or one that the robot file defines."""
    if template == "beam":
        return beam_pattern()
    for own in robot.template:
        if own.name == template:
            return tuple(tuple(c == "*" for c in row) for row in own.pattern)
    return tuple((template == "full",) * 6 for _ in range(6))
