"""A plugin of two effects, and how it is installed in this process for a test."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from symstiff.effects import catalogue

PLUGIN = '''
"""Two effects that no catalogue has: hoses that stiffen a joint as the next one turns, and a belt like a gear."""
import sympy as sp
from symstiff.effects.base import Effect, EffectParameter, Realisation
from symstiff.symbolic.terms import Term, actuated_joint, q, tau


def hoses(robot, where, shape):
    j, k = where["joints"]
    at, name = actuated_joint(j), f"hose_package_{j}_{k}"
    waves = {"a": sp.cos(3 * q(k)), "b": sp.sin(3 * q(k))}
    own = {w: EffectParameter(f"{name}_{w}", "rad/(N*m)", -1e-4, 1e-4, 1e-6) for w in waves}
    return Realisation(tuple(own.values()), tuple(Term(own[w].name, at, wave * tau(at)) for w, wave in waves.items()))


def belt(robot, where, shape):
    at = actuated_joint(where["joint"])
    c = EffectParameter(f"soft_belt_{where['joint']}_c", "rad/(N*m)", 0.0, 1e-4, 1e-6)
    return Realisation((c,), (Term(c.name, at, tau(at)),))


HOSES = Effect(
    identifier="hose_package",
    title="Hose package",
    description="Hoses along the arm pull the joint back, the more the further the next joint is bent.",
    seen_in=frozenset({"deflection"}),
    places=lambda robot: tuple(
        {"joints": [j, k]} for j in range(1, robot.dof + 1) for k in range(1, robot.dof + 1) if j != k
    ),
    realise=hoses,
    separated_by="poses that turn the next joint",
)
BELT = Effect(
    identifier="soft_belt",
    title="Soft belt",
    description="A belt between motor and gear.",
    seen_in=frozenset({"deflection"}),
    places=lambda robot: tuple({"joint": j} for j in range(1, robot.dof + 1)),
    realise=belt,
)
'''


def install(
    place: Path,
    module: str = "hose_plugin",
    text: str = PLUGIN,
    points: str = "hose_package = hose_plugin:HOSES\nsoft_belt = hose_plugin:BELT\n",
) -> None:
    """What pip leaves of a distribution: a module, and metadata with the entry points."""
    (place / f"{module}.py").write_text(text, encoding="utf-8")
    info = place / f"{module}-1.0.dist-info"
    info.mkdir()
    name = module.replace("_", "-")
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[symstiff.effects]\n{points}")


@contextmanager
def discovered(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder whose distributions are installed in this process."""
    known = set(sys.modules)
    monkeypatch.syspath_prepend(str(folder))
    catalogue.cache_clear()
    yield folder
    for module in set(sys.modules) - known:
        if (folder / f"{module}.py").exists():
            del sys.modules[module]
    monkeypatch.undo()
    catalogue.cache_clear()
