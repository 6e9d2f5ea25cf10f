"""model.toml as strangers may write it: every mistake is one line that names the file, the key and the remedy."""

from __future__ import annotations

import copy
import tomllib
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
import tomli_w
from definition import samples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from symstiff.effects.instance import EffectInstance
from symstiff.errors import UserError
from symstiff.model import StiffnessModel, load_model
from tests.test_model import small


def table_of(model: StiffnessModel, folder: Path) -> dict[str, Any]:
    model.save(folder / "good.toml")
    return tomllib.loads((folder / "good.toml").read_text())


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    model = small().with_effect(EffectInstance("joint_compliance", {"joint": 2}))
    return table_of(model, tmp_path_factory.mktemp("model"))


def complaint(table: Any, folder: Path) -> str:
    path = folder / "bad.toml"
    path.write_bytes(table if isinstance(table, bytes) else tomli_w.dumps(table).encode())
    with pytest.raises(UserError) as caught:
        load_model(path)
    text = str(caught.value)
    assert text.startswith(str(path))
    assert "\n" not in text
    return text


WRONG = [1, -1, 1.5, True, "text", [], [1], {}, {"a": 1}, float("nan"), float("inf")]
KEYS = ("format", "loads", "measure", "parameters", "values", "deviations", "effect", "robot")
FITS = {"values": ({},), "deviations": ({},), "effect": ([],), "format": (1,)}


@pytest.mark.parametrize("key", KEYS)
def test_every_key_of_a_wrong_type_is_named(key: str, good: dict[str, Any], tmp_path: Path) -> None:
    for wrong in WRONG:
        if type(wrong) is not bool and wrong in FITS.get(key, ()):
            continue
        if key == "parameters" and wrong == []:
            continue
        assert key in complaint({**good, key: wrong}, tmp_path)


@pytest.mark.parametrize("key", ["format", "loads", "measure", "parameters", "robot"])
def test_every_key_that_is_needed_is_missed(key: str, good: dict[str, Any], tmp_path: Path) -> None:
    assert key in complaint({k: v for k, v in good.items() if k != key}, tmp_path)


def test_what_belongs_to_nothing_is_refused(good: dict[str, Any], tmp_path: Path) -> None:
    names = good["parameters"]
    assert "no compliance 'k9_11'" in complaint({**good, "parameters": [*names, "k9_11"]}, tmp_path)
    assert "no compliance 'k1_21'" in complaint({**good, "parameters": [*names, "k1_21"]}, tmp_path)
    assert "stands there twice" in complaint({**good, "parameters": [*names, names[0]]}, tmp_path)
    assert "no parameter 'k9_11'" in complaint({**good, "values": {"k9_11": 1.0}}, tmp_path)
    assert "no parameter 'c9'" in complaint({**good, "deviations": {"c9": 1.0}}, tmp_path)
    assert "not negative" in complaint({**good, "deviations": {names[0]: -1.0}}, tmp_path)
    assert "finite" in complaint({**good, "values": {names[0]: float("nan")}}, tmp_path)
    assert "unknown key" in complaint({**good, "valeus": {}}, tmp_path)
    assert "unknown effect" in complaint({**good, "effect": [{"effect": "magic", "where": {}}]}, tmp_path)
    for where in ({}, {"joint": 9}, {"joint": "2"}, {"links": [1]}):
        bad = [{"effect": "joint_compliance", "where": where}]
        assert "joint_compliance cannot be at" in complaint({**good, "effect": bad}, tmp_path)


@pytest.mark.parametrize(
    "data", [b"", b"\xff\xfe", b"\x00", b"format = 1\n" * 2, b"[" * 5000, b"x = 1e" + b"9" * 300]
)
def test_what_is_no_model_at_all_is_refused(data: bytes, tmp_path: Path) -> None:
    complaint(data, tmp_path)


def test_a_missing_file_and_a_folder_are_refused(tmp_path: Path) -> None:
    for path in (tmp_path / "none.toml", tmp_path, "\0"):
        with pytest.raises(UserError):
            load_model(path)


scalars = st.one_of(
    st.integers(-(2**62), 2**62),
    st.floats(),
    st.booleans(),
    st.text(st.characters(blacklist_categories=["Cs"]), max_size=12),
    st.sampled_from(
        ["c1", "k0_11", "k1_66", "joint", "pi/2", "__import__('os')", "rigid", "full", "modified"]
    ),
    st.datetimes(),
)


def nested(inner: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    return st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3)


anything = st.recursive(scalars, nested, max_leaves=5)


def paths(table: Any, here: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    items = table.items() if isinstance(table, dict) else enumerate(table) if isinstance(table, list) else ()
    return [*([here] if here else []), *(p for key, value in items for p in paths(value, (*here, key)))]


@given(st.data())
@settings(max_examples=150, deadline=None, suppress_health_check=list(HealthCheck))
def test_nothing_but_a_users_mistake_comes_out_of_a_mutated_file(
    good: dict[str, Any], tmp_path: Path, data: st.DataObject
) -> None:
    table = copy.deepcopy(good)
    for _ in range(data.draw(st.integers(1, 3))):
        *route, last = data.draw(st.sampled_from(paths(table)))
        place = table
        for key in route:
            place = place[key]
        match data.draw(st.sampled_from(["replace", "remove", "add"])):
            case "replace":
                place[last] = data.draw(anything)
            case "remove":
                del place[last]
            case "add" if isinstance(place, dict):
                place[data.draw(st.text(st.characters(blacklist_categories=["Cs"]), max_size=8))] = data.draw(
                    anything
                )
        if not paths(table):
            break
    path = tmp_path / "mutated.toml"
    path.write_bytes(tomli_w.dumps(table).encode())
    with suppress(UserError):
        model = load_model(path)
        q, w = samples(model.robot, 1, 1)
        assert model.deflection(q, w).shape == (1, 6)


@given(st.binary(max_size=200))
@settings(max_examples=100, deadline=None, suppress_health_check=list(HealthCheck))
def test_nothing_but_a_users_mistake_comes_out_of_any_bytes(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "bytes.toml"
    path.write_bytes(data)
    with pytest.raises(UserError):
        load_model(path)


# --- joints only, known values ---------------------------------------------------------------------------
