"""The virtual experiment: an elastic robot in full nonlinear equilibrium, with whatever a truth puts into it.

Stages: ``load_truth`` (TRUTH.toml) → ``prepare`` (a ``Mechanism``) → ``equilibrium`` (virtual coordinates) →
``simulate`` (a measurement table with noise). It reads robot files and tables and shares no mechanics with
the package, so that it can serve as the outside world in tests.
"""

from symstiff.calibration.simulation import (  # noqa: F401  (imported to register their shapes)
    phenomena_body,
    phenomena_device,
    phenomena_joint,
)
from symstiff.calibration.simulation.experiment import clean_response, prepare, simulate
from symstiff.calibration.simulation.nominal import nominal_truth
from symstiff.calibration.simulation.phenomena import SHAPES, Effect, describe_effects
from symstiff.calibration.simulation.truth import (
    Device,
    Environment,
    Noise,
    Truth,
    load_truth,
    truth_from_table,
)

__all__ = [
    "SHAPES",
    "Device",
    "Effect",
    "Environment",
    "Noise",
    "Truth",
    "clean_response",
    "describe_effects",
    "load_truth",
    "nominal_truth",
    "prepare",
    "simulate",
    "truth_from_table",
]
