"""Complete stiffness models of serial robots: derived, reduced, identified, emitted.

    from symstiff import StiffnessModel, generate, load, reduce

    robot = load("kuka_kr270")
    reduction = reduce(robot, loads="gravity", measure="pose")
    model = StiffnessModel.of(reduction)
    dt = model.deflection(q=[[0.0, -1.2, 1.4, 0.0, 0.6, 0.0]], w=[[0, 0, -2500, 0, 0, 0]])
    generate(model, "kr270")

With measurements: ``read_table``, or ``measurements`` of arrays, then ``identify``, or ``diagnose(Task(robot, table))``
and ``write_report``. Without a robot: ``plan`` poses for a model, and ``simulate`` the truth that ``load_truth`` reads,
or ``truth_from_table`` builds, at the poses that ``read_poses`` reads. ``model.with_effect(EffectInstance(…))`` grows a
model by an effect. Mistakes in files and arguments raise ``UserError``, a ValueError of one line.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from symstiff.calibration.identify import identify
    from symstiff.calibration.plan import Goal, Load, plan
    from symstiff.calibration.simulation import load_truth, simulate, truth_from_table
    from symstiff.calibration.tables.measurements import measurements
    from symstiff.calibration.tables.table import read_poses, read_table, write_table
    from symstiff.codegen.generate import generate
    from symstiff.codegen.options import Options
    from symstiff.compensation import compensate
    from symstiff.discrepancy.findings.finding import Task
    from symstiff.discrepancy.workflow import diagnose
    from symstiff.effects.instance import EffectInstance
    from symstiff.errors import UserError
    from symstiff.model import StiffnessModel, load_model
    from symstiff.reduction import reduce
    from symstiff.report.folder import write_report
    from symstiff.robot import library, load
    from symstiff.symbolic.chain import ElasticChain
    from symstiff.symbolic.reading import observation_matrix, virtual_jacobian

__version__ = "0.1.0"

__all__ = [
    "EffectInstance",
    "ElasticChain",
    "Goal",
    "Load",
    "Options",
    "StiffnessModel",
    "Task",
    "UserError",
    "compensate",
    "diagnose",
    "generate",
    "identify",
    "library",
    "load",
    "load_model",
    "load_truth",
    "measurements",
    "observation_matrix",
    "plan",
    "read_poses",
    "read_table",
    "reduce",
    "simulate",
    "truth_from_table",
    "virtual_jacobian",
    "write_report",
    "write_table",
]

# Resolved when first asked for: `import symstiff` and `symstiff --help` load no SymPy, CasADi or pandas.
_HOME = {
    "EffectInstance": "symstiff.effects.instance",
    "ElasticChain": "symstiff.symbolic.chain",
    "Goal": "symstiff.calibration.plan",
    "Load": "symstiff.calibration.plan",
    "Options": "symstiff.codegen.options",
    "StiffnessModel": "symstiff.model",
    "Task": "symstiff.discrepancy.findings.finding",
    "UserError": "symstiff.errors",
    "compensate": "symstiff.compensation",
    "diagnose": "symstiff.discrepancy.workflow",
    "generate": "symstiff.codegen.generate",
    "identify": "symstiff.calibration.identify",
    "library": "symstiff.robot",
    "load": "symstiff.robot",
    "load_model": "symstiff.model",
    "load_truth": "symstiff.calibration.simulation",
    "measurements": "symstiff.calibration.tables.measurements",
    "observation_matrix": "symstiff.symbolic.reading",
    "plan": "symstiff.calibration.plan",
    "read_poses": "symstiff.calibration.tables.table",
    "read_table": "symstiff.calibration.tables.table",
    "reduce": "symstiff.reduction",
    "simulate": "symstiff.calibration.simulation",
    "truth_from_table": "symstiff.calibration.simulation",
    "virtual_jacobian": "symstiff.symbolic.reading",
    "write_report": "symstiff.report.folder",
    "write_table": "symstiff.calibration.tables.table",
}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return sorted({*(name for name in globals() if name.startswith("__")), *_HOME})
