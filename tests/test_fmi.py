"""FMUs are valid, and simulate to the model's numbers in FMPy."""

from __future__ import annotations

import subprocess
import zipfile
from io import BytesIO

import numpy as np
import pytest

from symstiff.codegen import fmi
from symstiff.codegen.fmi import emit_fmi2, emit_fmi3
from symstiff.codegen.functions import Functions
from symstiff.codegen.options import Options
from symstiff.symbolic.algebras import evaluate_numpy
from tests.generated_c import compiler, emitted, grown, model, needs, poses, written

fmpy = pytest.importorskip("fmpy", reason="FMPy is missing")

CASES = [
    ("kuka_kr270", 2, "double"),
    ("kuka_kr270", 3, "double"),
    ("scara", 2, "float"),
    ("scara", 3, "float"),
]


@pytest.fixture(params=CASES, ids=lambda c: f"{c[0]}-fmi{c[1]}-{c[2]}")
def fmu(request, tmp_path):
    robot, version, precision = request.param
    compiler()
    folder = written(tmp_path, robot, precision, (f"fmi{version}",))
    return folder / f"{robot}_fmi{version}.fmu", robot, precision


def test_fmpy_finds_nothing_wrong(fmu):
    from fmpy.validation import validate_fmu

    assert validate_fmu(str(fmu[0])) == []


def test_a_simulation_gives_deflection_and_command(fmu):
    path, robot, precision = fmu
    m = model(robot)
    n = m.robot.dof
    q, w = poses(robot, 11)
    w /= 10  # small enough for a correction at every pose
    times = np.arange(11) * 0.1
    columns = [f"q[{k}]" for k in range(1, n + 1)] + [f"wrench[{k}]" for k in range(1, 7)]
    signals = np.zeros(11, dtype=[("time", float)] + [(c, float) for c in columns])
    signals["time"] = times
    for k, c in enumerate(columns):
        signals[c] = np.column_stack([q, w])[:, k]
    outputs = (
        [f"deflection[{k}]" for k in range(1, 7)] + [f"q_cmd[{k}]" for k in range(1, n + 1)] + ["status"]
    )
    values = {name: 2 * v for name, v in m.values.items()}
    result = fmpy.simulate_fmu(
        str(path),
        stop_time=1.0,
        step_size=0.1,
        output_interval=0.1,
        input=signals,
        output=outputs,
        start_values=values,
    )
    # the inputs of a step are those at its beginning, its outputs stand at its end
    found = np.column_stack([result[f"deflection[{k}]"] for k in range(1, 7)])
    wanted = m.deflection(q, w, values=values)
    tolerance = 1e-12 if precision == "double" else 1e-4
    size = np.abs(wanted).max()
    steps = [np.abs(found - row).max(axis=1).argmin() for row in wanted[:-1]]
    assert len(set(steps)) == 10
    np.testing.assert_allclose(found[steps], wanted[:-1], rtol=0, atol=tolerance * size)
    command = np.column_stack([result[f"q_cmd[{k}]"] for k in range(1, n + 1)])[steps]
    moved = q[:-1] - command
    J = evaluate_numpy(Functions(m).jacobian, q=q[:-1])["J"]
    assert np.abs(moved).max() > 0
    if n == 6:
        np.testing.assert_allclose(np.einsum("nrj,nj->nr", J, moved), wanted[:-1], rtol=0, atol=1e-9 * size)
    assert not result["status"].any()


def test_units_causalities_and_defaults_are_declared(fmu):
    path, robot, _ = fmu
    m = model(robot)
    description = fmpy.read_model_description(str(path))
    by_name = {v.name: v for v in description.modelVariables}
    for name in m.parameters:
        v = by_name[name]
        assert (v.causality, v.unit, float(v.start)) == ("parameter", m.units[name], m.values[name])
    assert {p.name: by_name[p.name].description for p in m.compliances} == {
        p.name: p.meaning for p in m.compliances
    }
    assert {by_name[f"wrench[{k}]"].unit for k in (4, 5, 6)} == {"N*m"}
    assert by_name["q[3]"].unit == ("m" if m.robot.joint[2].prismatic else "rad")
    assert by_name["deflection[1]"].causality == by_name["q_cmd[1]"].causality == "output"
    units = {u.name: u.baseUnit for u in description.unitDefinitions}
    unit = units["rad/(N*m)"]
    assert (unit.kg, unit.m, unit.s, unit.rad) == (-1, -2, 2, 1)


def test_states_are_saved_restored_and_serialised(tmp_path):
    compiler()
    path = written(tmp_path, "scara", "double", ("fmi2",)) / "scara_fmi2.fmu"
    from fmpy.fmi2 import FMU2Slave

    description = fmpy.read_model_description(str(path))
    folder = fmpy.extract(str(path), str(tmp_path / "x"))
    unit = FMU2Slave(
        guid=description.guid, unzipDirectory=folder, modelIdentifier="scara", instanceName="one"
    )
    unit.instantiate()
    unit.setupExperiment(startTime=0.0)
    unit.enterInitializationMode()
    unit.exitInitializationMode()
    q, w = poses("scara", 2)
    references = list(range(10))
    outputs = [v.valueReference for v in description.modelVariables if v.name.startswith("deflection")]

    def deflection(k):
        unit.setReal(references, [*q[k], *w[k]])
        unit.doStep(0.0, 0.1)
        return unit.getReal(outputs)

    first = deflection(0)
    state = unit.getFMUState()
    data = unit.serializeFMUState(state)
    assert deflection(1) != first
    unit.setFMUState(state)
    assert unit.getReal(outputs) == first
    deflection(1)
    again = unit.deserializeFMUState(data)
    unit.setFMUState(again)
    assert unit.getReal(outputs) == first
    unit.setReal(references[:1], [float("nan")])
    unit.doStep(0.0, 0.1)
    assert unit.getInteger([v.valueReference for v in description.modelVariables if v.name == "status"]) == [
        -2
    ]
    assert unit.getReal(outputs) == [0.0] * 6
    with pytest.raises(Exception, match="fmi2SetReal"):
        unit.setReal(outputs[:1], [1.0])
    unit.freeFMUState(state)
    unit.terminate()
    unit.freeInstance()


@pytest.mark.parametrize("version", [2, 3])
def test_the_sources_inside_build_the_same_fmu(tmp_path, version, monkeypatch):
    """Without its binary an FMU is still whole: FMPy compiles it from its sources."""
    compiler("cmake")
    compiler()
    monkeypatch.setattr(fmi, "find_compiler", lambda: None)
    emit = emit_fmi2 if version == 2 else emit_fmi3
    files = emit(Functions(model("scara")), Options(targets=("c", f"fmi{version}")))
    path = tmp_path / f"scara_fmi{version}.fmu"
    path.write_bytes(files[path.name])
    assert not [n for n in zipfile.ZipFile(path).namelist() if n.startswith("binaries")]
    from fmpy.build import build_platform_binary

    folder = tmp_path / "x"
    fmpy.extract(str(path), str(folder))
    try:
        build_platform_binary(str(folder))
    except TypeError:
        build_platform_binary(str(folder), generator="Unix Makefiles")
    result = fmpy.simulate_fmu(str(folder), stop_time=0.1, step_size=0.1, start_values={"wrench[3]": -1000.0})
    wanted = model("scara").deflection(np.zeros(4), np.array([0, 0, -1000.0, 0, 0, 0]))[0]
    found = [result[f"deflection[{k}]"][-1] for k in range(1, 7)]
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-12 * np.abs(wanted).max())


@pytest.mark.parametrize("version", [2, 3])
def test_the_sources_compile_strictly(tmp_path, version):
    archive = zipfile.ZipFile(
        BytesIO(emitted("scara", "double", (f"fmi{version}",))[f"scara_fmi{version}.fmu"])
    )
    archive.extractall(tmp_path)
    flags = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror", "-Wmissing-prototypes"]
    for cc in ("gcc", "clang"):
        command = [compiler(cc), *flags, "-c", f"scara_fmi{version}.c", "-o", "x.o"]
        done = subprocess.run(command, cwd=tmp_path / "sources", capture_output=True, text=True)
        assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize(("effect", "shape"), [("hysteresis", 0), ("thermal_drift", 0), ("thermal_drift", 1)])
def test_laws_of_the_moment_read_time_from_the_simulation_and_the_rest_from_inputs(
    effect, shape, version, tmp_path
):
    compiler()
    m = grown("scara", effect, shape)
    emit = emit_fmi2 if version == 2 else emit_fmi3
    path = tmp_path / f"scara_fmi{version}.fmu"
    path.write_bytes(emit(Functions(m), Options(targets=("c", f"fmi{version}")))[path.name])
    from fmpy.validation import validate_fmu

    assert validate_fmu(str(path)) == []
    q, w = poses("scara", 1)
    start = {f"q[{k}]": x for k, x in enumerate(q[0], 1)} | {f"wrench[{k}]": x for k, x in enumerate(w[0], 1)}
    moment = {"temperature": 31.0, "branch": -1.0}
    start |= {n: moment[n] for n in needs(m) if n != "time"}
    outputs = [f"deflection[{k}]" for k in range(1, 7)]
    result = fmpy.simulate_fmu(
        str(path),
        start_time=100.0,
        stop_time=3700.0,
        step_size=1200.0,
        output_interval=1200.0,
        output=outputs,
        start_values=start,
    )
    found = np.column_stack([result[name] for name in outputs])
    np.testing.assert_allclose(result["time"], [100.0, 1300.0, 2500.0, 3700.0])
    known = {"time": result["time"], **{n: np.full(4, x) for n, x in moment.items()}}
    wanted = m.deflection(np.repeat(q, 4, 0), np.repeat(w, 4, 0), context={n: known[n] for n in needs(m)})
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-12 * np.abs(wanted).max())
    other = dict(known, branch=np.ones(4), temperature=np.full(4, 20.0), time=np.zeros(4))
    unlike = m.deflection(np.repeat(q, 4, 0), np.repeat(w, 4, 0), context={n: other[n] for n in needs(m)})
    assert np.abs(found - unlike).max() > 1e-3 * np.abs(wanted).max()
    units = {v.name: v.unit for v in fmpy.read_model_description(str(path)).modelVariables}
    assert {n: units[n] for n in needs(m) - {"time"}} == {
        n: {"temperature": "degC", "branch": "1"}[n] for n in needs(m) - {"time"}
    }
