"""From the complete model to what measurements identify: M1–M3 physical, M4–M5 algebraic."""

from symstiff.reduction.physical import Parameter, Stage
from symstiff.reduction.reduce import Reduction, reduce
from symstiff.reduction.structural import Experiment, Partition

__all__ = ["Experiment", "Parameter", "Partition", "Reduction", "Stage", "reduce"]
