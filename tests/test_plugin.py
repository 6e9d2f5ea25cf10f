"""An effect from outside the package, from data that contain it to the report, by the program alone."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy as sp

import symstiff
from symstiff.calibration.identify import identify
from symstiff.calibration.tables.measurements import Measurements, measurements
from symstiff.calibration.tables.table import read_table
from symstiff.codegen.compiler import find_compiler
from symstiff.discrepancy.apart.distinguish import distinction
from symstiff.discrepancy.bridge.assemble import assemble
from symstiff.discrepancy.findings.finding import Task
from symstiff.discrepancy.workflow import diagnose
from symstiff.effects import EffectInstance, catalogue
from symstiff.effects.base import Scales
from symstiff.errors import UserError
from symstiff.model import StiffnessModel, load_model
from symstiff.reduction import reduce
from symstiff.robot import load
from symstiff.symbolic.latex import letter
from tests.diagnosis_data import ROBOT, design, saved

SIZE, PHASE = 6e-7, 0.4
"""Of what is hidden: joint 1 gives way by SIZE·cos(3·q2 + PHASE)·τ1 more than it should."""
WHERE = {"joints": [1, 2]}
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
TRUTH = f"""
format = 1
robot = "{ROBOT}"
noise = {{ sigma_mm = 0.02 }}
[[effect]]
effect = "angle_dependent_compliance"
where = {{ joints = [1, 2] }}
shape = "cosine"
c = {SIZE}
order = 3.0
phase = {PHASE}
"""


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


def command(*arguments: object, plugin: Path | None = None) -> None:
    """Run the program in a process of its own, with or without the plugin on its path."""
    paths = [str(Path(symstiff.__file__).parents[1]), *([str(plugin)] if plugin else [])]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}
    done = subprocess.run(
        [sys.executable, "-m", "symstiff", *map(str, arguments)], env=environment, capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The plugin, data of an arm with hoses, and the folder of its diagnosis with the plugin installed."""
    place = tmp_path_factory.mktemp("plugin")
    install(place)
    (place / "truth.toml").write_text(TRUTH)
    saved(design(), place / "poses.csv")
    command("simulate", place / "truth.toml", "--poses", place / "poses.csv", "-o", place / "data.csv")
    command("diagnose", ROBOT, place / "data.csv", "-o", place / "with", plugin=place)
    return place


@pytest.fixture
def installed(place: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The plugin in this process too."""
    monkeypatch.syspath_prepend(str(place))
    catalogue.cache_clear()
    yield place
    sys.modules.pop("hose_plugin", None)
    monkeypatch.undo()
    catalogue.cache_clear()


def verdict_of(folder: Path) -> Any:
    return json.loads((folder / "verdict.json").read_text())


def test_the_package_does_not_know_the_effect() -> None:
    sources = Path(symstiff.__file__).parent.rglob("*")
    text = "".join(p.read_text(errors="ignore") for p in sources if p.suffix in (".py", ".toml", ".j2"))
    assert "nonlinear_stiffness" in text
    assert "hose_package" not in text
    assert "hose_package" not in catalogue()


@pytest.mark.slow
def test_without_the_plugin_its_effect_gets_no_name_of_the_catalogue(place: Path) -> None:
    found = diagnose(Task(load(ROBOT), read_table(place / "data.csv")))
    assert found.verdict in ("unexplained", "named_insufficient")


def test_diagnose_names_it_at_its_place(place: Path) -> None:
    verdict = verdict_of(place / "with")
    assert verdict["verdict"] == "named"
    (effect,) = verdict["effects"]
    assert (effect["effect"], effect["where"]) == ("hose_package", WHERE)
    assert effect["confidence"] > 0.8
    assert verdict["rms_mm"]["held_out_after"] < 1.2 * verdict["rms_mm"]["noise"]
    a, b = (effect["parameters"][f"hose_package_1_2_{w}"] for w in "ab")
    assert a["value"] == pytest.approx(SIZE * np.cos(PHASE), abs=4 * a["std"])
    assert b["value"] == pytest.approx(-SIZE * np.sin(PHASE), abs=4 * b["std"])


def test_exact_reduction_tells_which_of_its_effects_stand_out(installed: Path) -> None:
    model = StiffnessModel.of(reduce(load(ROBOT), "force", "pose"))
    hoses = distinction(model, "hose_package", WHERE)
    assert (hoses.distinguishable, hoses.gained, hoses.inside) == (True, 2, ())
    belt = distinction(model, "soft_belt", {"joint": 1})
    assert (belt.distinguishable, belt.inside) == (False, ("soft_belt_1_c",))
    listed = [c for c in verdict_of(installed / "with")["candidates"] if c["effect"] == "soft_belt"]
    assert [c["testable"] for c in listed] == [False, False]
    assert all("combinations of the model" in c["reason"] for c in listed)


def test_the_grown_model_loads_and_is_identified_again(installed: Path) -> None:
    grown = load_model(installed / "with" / "model.toml")
    assert [(e.effect, dict(e.where)) for e in grown.effects] == [("hose_package", WHERE)]
    table = read_table(installed / "data.csv")
    again = identify(load(ROBOT), table, str(installed / "with" / "model.toml")).model
    for name in ("hose_package_1_2_a", "hose_package_1_2_b"):
        assert again.values[name] == pytest.approx(grown.values[name], abs=again.deviations[name])
        assert 0 < again.deviations[name] < 0.1 * SIZE


def test_its_law_stands_in_the_latex_of_the_model(installed: Path) -> None:
    text = load_model(installed / "with" / "model.toml")._repr_latex_()
    assert letter(sp.Symbol("hose_package_1_2_a")) in text
    assert r"\cos{\left(3 q_{2} \right)}" in text


def test_c_and_casadi_evaluate_it_and_the_self_test_passed(installed: Path) -> None:
    import casadi as ca

    code, model = installed / "with" / "code", load_model(installed / "with" / "model.toml")
    manifest = json.loads((code / "manifest.json").read_text())
    assert list(manifest["effect_parameters"]) == ["hose_package_1_2_a", "hose_package_1_2_b"]
    assert manifest["verified"]["compiled"] == (find_compiler() is not None)
    assert manifest["verified"]["max_relative_error"] < 1e-9
    assert "p->hose_package_1_2_a" in (code / f"{ROBOT}.c").read_text()
    table = read_table(installed / "data.csv")
    function = ca.Function.load(str(code / f"{ROBOT}_deflection.casadi"))
    columns = [
        np.array(function(model.vector(), q, w)).ravel() for q, w in zip(table.q, table.w, strict=True)
    ]
    np.testing.assert_allclose(columns, model.deflection(table.q, table.w), atol=1e-15)


def test_the_report_shows_its_term_and_what_it_changed_in_the_code(place: Path) -> None:
    page = (place / "with" / "report.html").read_text()
    assert "What is missing: hose package between joints 1, 2" in page
    assert "Hoses along the arm pull the joint back" in page
    laws = page[page.index('id="laws"') : page.index('id="candidates"')]
    assert "joint1 += hose_package_1_2_a*(tau_joint1*cos(3*q_2)) + hose_package_1_2_b*" in laws
    assert "<svg" in laws
    code = page[page.index('id="code"') :]
    assert '<span class="add">' in code
    assert "p-&gt;hose_package_1_2_a" in code


# --- the example of the documents, and plugins with mistakes ---------------------------------------------


@pytest.fixture
def path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder whose distributions are installed in this process."""
    known = set(sys.modules)
    monkeypatch.syspath_prepend(str(tmp_path))
    catalogue.cache_clear()
    yield tmp_path
    for module in set(sys.modules) - known:
        if (tmp_path / f"{module}.py").exists():
            del sys.modules[module]
    monkeypatch.undo()
    catalogue.cache_clear()


@pytest.mark.slow
def test_the_documents_example_is_a_whole_plugin(path: Path) -> None:
    page = (Path(__file__).parent.parent / "docs" / "plugins.md").read_text(encoding="utf-8")
    (project,), (module,) = (
        re.findall(rf"```{kind}\n(.*?)```", page, re.DOTALL) for kind in ("toml", "python")
    )
    points = tomllib.loads(project)["project"]["entry-points"]["symstiff.effects"]
    install(path, "angle_dependent_gear", module, "".join(f"{n} = {at}\n" for n, at in points.items()))
    command("effects", ROBOT, "--json", path / "effects.json", plugin=path)
    (listed,) = (
        e
        for e in json.loads((path / "effects.json").read_text())["effects"]
        if e["effect"] == "angle_dependent_gear"
    )
    assert [p["told"] for p in listed["places"]] == [2, 2]
    gear = EffectInstance("angle_dependent_gear", {"joint": 2}, {"order": 3.0})
    plain = StiffnessModel.of(reduce(load(ROBOT)))
    grown = plain.with_effect(gear).with_values(
        dict(plain.values) | {"angle_dependent_gear_2_c": 4e-6, "angle_dependent_gear_2_s": -2e-6}
    )
    grown.save(path / "model.toml")
    q, force = np.array([0.3, 0.8]), np.array([20.0, 50.0, 0.0])
    added = load_model(path / "model.toml").deflection(q, [*force, 0, 0, 0]) - plain.deflection(
        q, [*force, 0, 0, 0]
    )
    # by hand: the lever from joint 2 to the tool of a planar arm, and the turn about z that its torque makes
    length = float(load(ROBOT).joint[1].a)
    lever = length * np.array([np.cos(q.sum()), np.sin(q.sum())])
    torque = lever[0] * force[1] - lever[1] * force[0]
    turn = (4e-6 * np.cos(3 * q[1]) - 2e-6 * np.sin(3 * q[1])) * torque
    by_hand = [-lever[1] * turn, lever[0] * turn, 0, 0, 0, turn]
    np.testing.assert_allclose(added[0], by_hand, rtol=1e-9, atol=1e-12)


BELT = PLUGIN.replace("HOSES = ", "_HOSES = ")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("import no_such_module", r"cannot load faulty:BELT \(ModuleNotFoundError"),
        ("BELT = 1 / 0", "ZeroDivisionError"),
        ("HOSES = 1", "AttributeError"),
        ("BELT = 3", "is no Effect"),
        (BELT.replace('"soft_belt"', '"backlash"'), "an effect 'backlash' already"),
        (BELT.replace('"soft_belt"', '"soft-belt"'), "cannot be called 'soft-belt'"),
    ],
)
def test_a_plugin_that_cannot_be_used_is_named_with_its_package(path: Path, text: str, says: str) -> None:
    install(path, "faulty", text, "belt = faulty:BELT\n")
    with pytest.raises(UserError, match=f"^plugin belt of package faulty: .*{says}"):
        catalogue()
    install(path, "sound", BELT, "belt = sound:BELT\n")
    with pytest.raises(UserError, match="of package faulty"):
        catalogue()


def test_a_plugin_that_fails_where_it_is_asked_is_named(path: Path) -> None:
    install(
        path,
        "belt",
        BELT.replace("places=lambda robot: ", "places=lambda robot: 1 / 0 or "),
        "belt = belt:BELT\n",
    )
    with pytest.raises(
        UserError, match=r"^plugin belt of package belt: its places fails \(ZeroDivisionError"
    ):
        EffectInstance("soft_belt", {"joint": 1}).realise(load(ROBOT))
    assert catalogue()["backlash"].places(load(ROBOT))


JOINTS = 'tuple({"joint": j} for j in range(1, robot.dof + 1)),\n    realise=belt'
LAW = "return Realisation((c,), (Term(c.name, at, tau(at)),))"


def faulty_belt(path: Path, *changes: tuple[str, str]) -> None:
    """A plugin whose belt is changed."""
    text = BELT
    for old, new in changes:
        assert text.count(old) == 1
        text = text.replace(old, new)
    install(path, "belt", text, "belt = belt:BELT\n")


@pytest.mark.parametrize(
    ("new", "says"),
    [
        ("return 1 / 0", r"its realise fails with the shape \{\} \(ZeroDivisionError"),
        ("return {}['what']", "its realise fails .*KeyError: 'what'"),
        ("return shape.no_such_thing", "its realise fails .*AttributeError"),
        ("return None", "expected a Realisation of realise, found None"),
        (
            LAW.replace("c.name", "'c'"),
            "a law has the parameter 'c', which is none of .'soft_belt_1_c'.: list it",
        ),
        (LAW.replace("(c,), ", "c, "), "its parameters are no EffectParameters: give a tuple of them"),
        (LAW.replace("tau(at)", "sp.gamma(tau(at))"), "the law of soft_belt_1_c uses gamma"),
        (LAW.replace("tau(at)", "sp.nan * tau(at)"), "the law of soft_belt_1_c holds nan"),
        (LAW.replace("tau(at)", "'tau'"), "its realise fails .*SympifyError"),
        (LAW.replace("at,", "actuated_joint(9),"), "soft_belt_1_c acts at joint9"),
    ],
)
def test_a_plugin_whose_law_is_none_is_named_with_its_place(path: Path, new: str, says: str) -> None:
    faulty_belt(path, (LAW, new))
    model, table = StiffnessModel.of(reduce(load(ROBOT), "force", "pose")), small_table()
    for ask in (
        lambda: EffectInstance("soft_belt", {"joint": 1}).realise(load(ROBOT)),
        lambda: assemble(model, table, effects=[catalogue()["soft_belt"]]),
    ):
        with pytest.raises(UserError, match=rf"^soft_belt at \{{'joint': 1\}}: .*{says}") as refused:
            ask()
        assert "plugin belt of package belt" in str(refused.value)
        assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("low", "high", "typical", "says"),
    [
        ("1.0", "0.0", "0.5", "low 1 is above high 0"),
        ("0.0", "1e-4", "None", "soft_belt_1_c: typical: expected a finite number, found None"),
        ("float('nan')", "1e-4", "1e-6", "soft_belt_1_c: low: expected a finite number, found nan"),
        ("0.0", "'a'", "1e-6", "soft_belt_1_c: high: expected a finite number, found 'a'"),
    ],
)
def test_a_parameter_has_a_range_and_a_size(path: Path, low: str, high: str, typical: str, says: str) -> None:
    faulty_belt(path, ('"rad/(N*m)", 0.0, 1e-4, 1e-6)', f'"rad/(N*m)", {low}, {high}, {typical})'))
    with pytest.raises(UserError, match=says):
        EffectInstance("soft_belt", {"joint": 1}).realise(load(ROBOT))


@pytest.mark.parametrize(
    ("places", "says"),
    [
        ("None", "expected a place of places, found None"),
        ("(1, 2)", "expected a place of places, found 1: give a tuple of tables"),
        ("({'joint': robot},)", r"places gives .*: give texts, numbers or lists"),
    ],
)
def test_places_that_are_none_are_refused(path: Path, places: str, says: str) -> None:
    faulty_belt(path, (JOINTS, f"{places},\n    realise=belt"))
    with pytest.raises(UserError, match=f"{says}.*plugin belt of package belt"):
        catalogue()["soft_belt"].places(load(ROBOT))


def test_places_and_shapes_may_come_one_by_one_and_in_any_kind_of_list(path: Path) -> None:
    shapes = "({'order': n} for n in (1, 2))"
    places = "({'joints': (j, np.int64(j + 1))} for j in range(1, robot.dof))"
    faulty_belt(
        path,
        (JOINTS, f"{places},\n    shapes=lambda robot, where, scales: {shapes},\n    realise=belt"),
        ("import sympy as sp", "import numpy as np\nimport sympy as sp"),
        (LAW, LAW.replace("tau(at)", "shape['order'] * tau(at)")),
        ('actuated_joint(where["joint"])', 'actuated_joint(where["joints"][0])'),
        ("""f"soft_belt_{where['joint']}_c\"""", """f"soft_belt_{where['joints'][0]}_c\""""),
    )
    effect = catalogue()["soft_belt"]
    assert effect.places(load(ROBOT)) == ({"joints": [1, 2]},)
    assert effect.shapes(load(ROBOT), {"joints": [1, 2]}, Scales()) == ({"order": 1.0}, {"order": 2.0})
    grown = StiffnessModel.of(reduce(load(ROBOT))).with_effect(
        EffectInstance("soft_belt", {"joints": (1, 2)}, {"order": 1})
    )
    grown.save(path / "model.toml")
    assert load_model(path / "model.toml").effects == grown.effects


@pytest.mark.parametrize(
    ("field", "says"),
    [
        (
            "needs=frozenset({'humidity'})",
            r"needs 'humidity': give some of \['branch', 'temperature', 'time'\]",
        ),
        ("needs='temperature'", "needs: expected a list of texts, found 'temperature'"),
        ("told={'order': '{} and {}'}", "told of order is '{} and {}': give a text with one {}, or none"),
        ("told={'order': '{x}'}", "told of order is '{x}'"),
        ("told={'order': 3}", "told of order is 3"),
        ("shapes=None", "shapes is no function: give one"),
    ],
)
def test_what_an_effect_says_of_itself_is_checked_where_it_is_registered(
    path: Path, field: str, says: str
) -> None:
    faulty_belt(path, (JOINTS, f"{JOINTS},\n    {field}"))
    with pytest.raises(UserError, match=f"^plugin belt of package belt: .*soft_belt: {says}"):
        catalogue()


def small_table() -> Measurements:
    """Some poses of the arm under a load."""
    rng = np.random.default_rng(1)
    q = rng.uniform(-1, 1, (8, 2))
    w = np.tile([20.0, 50.0, 0, 0, 0, 0], (8, 1))
    return measurements(q, w, kind="deflection", values=rng.normal(size=(8, 6)) * 1e-4)


def test_the_law_of_every_shape_is_checked(path: Path) -> None:
    faulty_belt(
        path,
        (JOINTS, f"{JOINTS},\n    shapes=lambda robot, where, scales: ({{'n': 0.0}}, {{'n': 1.0}})"),
        (LAW, LAW.replace("tau(at)", "sp.Max(tau(at), 0) if shape['n'] else tau(at)")),
    )
    model = StiffnessModel.of(reduce(load(ROBOT), "force", "pose"))
    with pytest.raises(UserError, match=r"^soft_belt at .*the law of soft_belt_1_c uses Max"):
        assemble(model, small_table(), effects=[catalogue()["soft_belt"]])


def test_a_law_that_is_no_number_in_the_data_says_so(path: Path) -> None:
    faulty_belt(path, (LAW, LAW.replace("tau(at)", "sp.asin(tau(at))")))
    model = StiffnessModel.of(reduce(load(ROBOT), "force", "pose"))
    found = assemble(model, small_table(), effects=[catalogue()["soft_belt"]])
    assert {c.unavailable for c in found.candidates} == {"its law gives no finite number in these data"}


def test_an_effect_is_seen_in_data_that_there_are(path: Path) -> None:
    install(path, "belt", BELT.replace('{"deflection"}', '{"photographs"}'), "belt = belt:BELT\n")
    with pytest.raises(
        UserError, match=r"seen_in is \['photographs'\]: give some of \['absolute', 'deflection'\]"
    ):
        catalogue()


def test_a_parameter_has_an_si_unit(path: Path) -> None:
    install(path, "belt", BELT.replace('"rad/(N*m)"', '"furlong"'), "belt = belt:BELT\n")
    with pytest.raises(UserError, match="the unit of soft_belt_1_c cannot be 'furlong': give SI units"):
        EffectInstance("soft_belt", {"joint": 1}).realise(load(ROBOT))


@pytest.mark.parametrize("unit", ["mm/N", "rad/Nm", "Nm", "rad/", "(rad", "m//N", "deg", ""])
def test_a_unit_that_is_not_made_of_si_units_is_refused(path: Path, unit: str) -> None:
    faulty_belt(path, ('"rad/(N*m)", 0.0', f'"{unit}", 0.0'))
    with pytest.raises(UserError, match="the unit of soft_belt_1_c cannot be "):
        EffectInstance("soft_belt", {"joint": 1}).realise(load(ROBOT))


@pytest.mark.parametrize(
    "unit",
    ["1", "rad", "rad/(N*m)", "m/N", "1/K", "kg*m^2", "rad/(N*m*degC)", "m/s^2", "rad/(N*m)^2", "s^-1"],
)
def test_units_are_products_of_si_units(path: Path, unit: str) -> None:
    faulty_belt(path, ('"rad/(N*m)", 0.0', f'"{unit}", 0.0'))
    (parameter,) = EffectInstance("soft_belt", {"joint": 1}).realise(load(ROBOT)).parameters
    assert parameter.unit == unit


def test_two_packages_that_bring_one_effect_are_told(path: Path) -> None:
    for module in ("belt_a", "belt_b"):
        install(path, module, BELT, f"{module} = {module}:BELT\n")
    with pytest.raises(
        UserError, match="plugin belt_b of package belt-b: there is an effect 'soft_belt' already"
    ):
        catalogue()


@pytest.mark.parametrize("name", ["soft-belt 1_c", "1_c", "double", "k", "time", "naïve", ""])
def test_a_parameter_that_c_cannot_hold_is_refused_before_any_code(path: Path, name: str) -> None:
    install(
        path, "belt", BELT.replace("""f"soft_belt_{where['joint']}_c\"""", repr(name)), "belt = belt:BELT\n"
    )
    with pytest.raises(
        UserError, match=r"soft_belt at \{'joint': 1\}: an effect's parameter cannot be called"
    ):
        EffectInstance("soft_belt", {"joint": 1}).realise(load(ROBOT))
