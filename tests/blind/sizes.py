"""How large a hidden effect is: what of it the model, and what else is hidden, cannot absorb, in units of the noise."""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from symstiff.calibration.fits.decomposition import column_space
from symstiff.calibration.simulation import Effect, Truth, clean_response
from symstiff.calibration.simulation.phenomena import shape_of

if TYPE_CHECKING:
    from tests.blind.generate import Scene

SMALL = 0.02
"""Share of the size that anyone would believe at which an effect is first looked at."""


class Unfit(Exception):  # noqa: N818
    """The story cannot be seen, or not at a believable size, in this design."""


def noise_free(scene: Scene, values: dict[str, float], effects: Sequence[Effect]) -> np.ndarray:
    """Noise-free values (rows, 6), positions only."""
    table = scene.table
    fields = ("points", "point", "labels", "pose", "time", "temperature", "branch")
    truth = Truth(scene.body, values, tuple(effects))
    found = clean_response(
        truth, table.q, table.w, {"kind": table.kind, **{name: getattr(table, name) for name in fields}}
    )
    found[:, 3:] = np.nan
    return found


def noncentrality(scene: Scene, signal: np.ndarray, further: np.ndarray | None = None) -> float:
    """λ: what is left of a signal (rows, 6) outside the model and further columns, over the noise."""
    white = scene.whitened(signal[:, :3]).ravel()
    basis = scene.basis if further is None else np.column_stack([scene.basis, further])
    if further is not None:
        basis = column_space(basis, 1e-7)
    left = white - basis @ (basis.T @ white)
    return float(left @ left)


def span(scene: Scene, base: dict[str, float], effect: Effect, clean: np.ndarray) -> np.ndarray:
    """Whitened signals (3·rows, k) of an effect's parameters, each alone: what it may be, whatever its direction."""
    sizes = {n: effect.values[n] for n in shape_of(effect).amplitudes if n in effect.values}
    none = effect.scaled(0.0).values
    parts = [effect]
    for name, value in sizes.items():
        if not isinstance(value, dict | list):
            parts.append(replace(effect, values={**none, name: value}))
            continue
        for key in value if isinstance(value, dict) else range(len(value)):
            alone = deepcopy(none[name])
            alone[key] = value[key]
            parts.append(replace(effect, values={**none, name: alone}))
    signals = [noise_free(scene, base, (part,)) - clean for part in parts]
    return column_space(np.column_stack([scene.whitened(x[:, :3]).ravel() for x in signals]), 1e-4)


def scaled(
    scene: Scene, base: dict[str, float], effects: Sequence[Effect], wanted: float, kind: str
) -> tuple[tuple[Effect, ...], tuple[float, ...]]:
    """Scale every effect to its λ beside what the others may be; raise where it would be larger than believable."""
    clean = noise_free(scene, base, ())
    if kind == "untestable":
        for effect in effects:
            signal = noise_free(scene, base, (effect,)) - clean
            if noncentrality(scene, signal) > 2.0:
                raise Unfit
        return tuple(effects), (0.0,) * len(effects)
    trial = [e.scaled(SMALL) for e in effects]
    spans = [span(scene, base, e, clean) for e in trial] if len(trial) > 1 else [np.zeros((0, 0))]
    found = [0.0] * len(trial)
    for attempt in range(5):
        signals = [noise_free(scene, base, (e,)) - clean for e in trial]
        for k, signal in enumerate(signals):
            rest = [other for i, other in enumerate(spans) if i != k]
            found[k] = noncentrality(scene, signal, np.column_stack(rest) if rest else None)
            factor = np.sqrt(wanted / found[k]) if found[k] > 0 else np.inf
            if attempt == 0 and factor * SMALL > 1.0:
                raise Unfit
            trial[k] = trial[k].scaled(float(factor))
        if all(abs(f / wanted - 1) < 0.03 for f in found):
            break
    return tuple(trial), tuple(found)
