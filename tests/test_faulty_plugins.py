"""Plugins with mistakes: each is named with its package, and what to write instead."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from symstiff.calibration.tables.measurements import Measurements, measurements
from symstiff.discrepancy.bridge.assemble import assemble
from symstiff.effects import EffectInstance, catalogue
from symstiff.effects.base import Scales
from symstiff.errors import UserError
from symstiff.model import StiffnessModel, load_model
from symstiff.reduction import reduce
from symstiff.robot import load
from tests.diagnosis_data import ROBOT
from tests.plugins import PLUGIN, discovered, install


@pytest.fixture
def path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder whose distributions are installed in this process."""
    with discovered(tmp_path, monkeypatch):
        yield tmp_path


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


def test_where_nobody_knows_what_is_usual_columns_are_numbers(path: Path) -> None:
    faulty_belt(path, ('"rad/(N*m)", 0.0, 1e-4, 1e-6)', '"rad/(N*m)", 0.0, 1e-4, 0.0)'))
    model = StiffnessModel.of(reduce(load(ROBOT), "force", "pose"))
    model = model.with_effect(EffectInstance("soft_belt", {"joint": 1}))
    model = model.with_effect(EffectInstance("force_sensor_bias", {"load": "force_sensor"}))
    assert not model.is_linear
    A = model.observation(np.zeros(model.robot.dof), [100.0, 50.0, -20.0, 0, 0, 0])
    assert np.isfinite(A).all()
    assert A[:, :, model.parameters.index("soft_belt_1_c")].any()


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
