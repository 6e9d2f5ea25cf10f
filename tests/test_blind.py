"""The blind benchmark: reduced with ``-m slow``, at full size with ``-m benchmark``."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from symstiff.calibration.simulation import Effect, Noise, Truth, clean_response, simulate
from symstiff.calibration.tables.table import read_table, write_table
from symstiff.discrepancy.bridge.assemble import assemble
from symstiff.errors import UserError
from symstiff.robot import load
from tests.blind import __main__ as command
from tests.blind import generate
from tests.blind.apart import LEVEL, _weight, apart, limit, outside
from tests.blind.generate import Options, _design, case
from tests.blind.left import left
from tests.blind.nuisance import Whitener
from tests.blind.run import benchmark, keep, one, report
from tests.blind.score import bars, calibration, outcome, same, wilson
from tests.blind.sizes import Unfit, noise_free
from tests.blind.stories import BAD_POSE, ONE, OUTSIDE, RARE, Story, waves

SMALL = Options(
    robots=("kuka_kr270", "scara"),
    poses=(15,),
    levels=(3,),
    markers=(1,),
    classes=("nothing", "one"),
    shares=(0.5, 0.5),
    lambdas=(150.0, 600.0),
)


def test_the_same_number_gives_the_same_case() -> None:
    first, again = case(3, SMALL), case(3, SMALL)
    assert asdict(first.label) == asdict(again.label)
    np.testing.assert_array_equal(first.table.values, again.table.values)


def test_the_table_carries_no_trace_of_the_truth(tmp_path: Path) -> None:
    hidden = next(c for c in (case(n, SMALL) for n in range(20)) if c.label.kind == "one")
    write_table(hidden.table, tmp_path / "data.csv")
    text = (tmp_path / "data.csv").read_text(encoding="utf-8")
    for story in hidden.label.story:
        assert story not in text
    for effect, _ in hidden.label.truth:
        assert effect not in text
    assert len(read_table(tmp_path / "data.csv")) == len(hidden.table)


def test_of_two_effects_none_is_what_the_other_one_may_be(monkeypatch: pytest.MonkeyPatch) -> None:
    """A joint's offset is a part of its link's geometric error."""
    offset = Story("offset", "absolute", lambda d: (
        Effect("joint_offset", {"joint": 2}, "constant", {"offset": 5e-3}), {"joint": 2}))  # fmt: skip
    monkeypatch.setattr(generate, "_TRIES", 2)
    options = replace(SMALL, robots=("kuka_kr270",), classes=("two",), shares=(1.0,))
    for joint, fits in ((2, False), (5, True)):
        geometry = Story("geometry", "absolute", lambda d, link=joint: (
            Effect("geometric_error", {"link": link}, "constant", {"shift": [1e-3, 2e-3, 1e-3, 2e-3, 1e-3, 2e-3]}),
            {"link": link}))  # fmt: skip
        monkeypatch.setattr(generate, "_stories", lambda kind, rng, options, other=geometry: (offset, other))
        if fits:
            found = case(0, options).label.noncentrality
            assert found == pytest.approx((found[0], found[0]), rel=0.1)
        else:
            with pytest.raises(RuntimeError, match="no story"):
                case(0, options)


def test_the_hidden_signal_has_the_noncentrality_that_the_label_says() -> None:
    hidden = next(
        c
        for c in (case(n, SMALL) for n in range(20))
        if c.label.kind == "one" and "left" not in c.label.story[0]
    )
    found = assemble(hidden.model, hidden.table, effects=())
    there = outside(hidden, found).signal(hidden.signal)
    assert there @ there == pytest.approx(hidden.label.wanted, rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize(("number", "seed"), [(59, 441), (47, 461), (49, 441)])
def test_what_is_hidden_is_in_the_columns_of_its_own_candidate(number: int, seed: int) -> None:
    """A payload and robots that miss their poses, hysteresis under the weight of a quill, a drift and a compensator."""
    found = list(left(case(number, Options(seed=seed))))
    assert found
    for story, lam, rest, shape in found:
        assert rest < 0.02 * lam, (story, shape)


def test_a_judge_who_knows_the_noise_names_what_is_large_and_only_that() -> None:
    hidden = next(
        c for c in (case(n, SMALL) for n in range(30)) if c.label.kind == "one" and c.label.wanted == 600.0
    )
    found = assemble(hidden.model, hidden.table)
    groups = {c.key: c.group for c in found.candidates if c.group}
    large, small = (
        limit(hidden, found, groups),
        limit(replace(hidden, signal=0.02 * hidden.signal), found, groups),
    )
    assert large is not None
    assert small is not None
    assert large > 0.8
    assert small <= LEVEL + 0.02
    D = apart(hidden, found, groups)
    assert D is not None
    assert 0.0 <= D <= hidden.label.wanted * 1.1


def test_the_judges_weights_are_likelihood_ratios() -> None:
    hidden = case(0, SMALL)
    found = assemble(hidden.model, hidden.table)
    space = outside(hidden, found)
    noise = np.random.default_rng(5).standard_normal((3 * len(hidden.signal), 40000))
    there = [c for c in found.candidates if not c.unavailable]
    for candidate in there[:: max(len(there) // 6, 1)]:
        ratio = np.exp(_weight(candidate, space, 2.0, noise))
        assert np.mean(ratio) == pytest.approx(1.0, abs=5 * np.std(ratio) / 200)  # under noise alone: one


def test_scores_follow_their_definitions() -> None:
    joint = ("backlash", {"joint": 3})
    other = ("backlash", {"joint": 4})
    assert same(("wrist_coupling", {"joints": [5, 4]}), ("wrist_coupling", {"joints": (4, 5)}), {})
    assert not same(joint, other, {})
    assert same(joint, other, {"backlash@joint=3": "a", "backlash@joint=4": "a"})
    assert outcome("named", [[joint]], [joint], {}) == "right"
    assert outcome("named", [[joint, other]], [joint], {}) == "wrong"
    assert outcome("ambiguous", [[other], [joint]], [joint], {}) == "half"
    assert outcome("named_insufficient", [[joint]], [joint], {}) == "half"
    assert outcome("nothing_missing", [], [joint], {}) == "silent"
    low, high = wilson(95, 100)
    assert (round(low, 3), round(high, 3)) == (0.888, 0.978)
    assert calibration([{"confidences": [(0.9, True)] * 9 + [(0.9, False)]}], 1)[0] == pytest.approx(0.0)
    assert calibration([{"confidences": [(0.9, False)] * 10}])[0] == pytest.approx(0.9)


@pytest.mark.slow
def test_a_few_blind_cases_are_diagnosed_as_promised(tmp_path: Path) -> None:
    rows = benchmark(range(8), SMALL, others=False)
    print(report(rows))
    keep(rows, tmp_path / "blind.json")
    assert len(json.loads((tmp_path / "blind.json").read_text())["cases"]) == 8
    table = bars(rows)
    nothing = table["false alarms (nothing missing) <= 0.05"]
    assert nothing["n"] >= 3
    assert nothing["low"] <= 0.05  # a rate of 5 % is not contradicted
    named = [r for r in rows if r["kind"] == "one"]
    right = sum(r["outcome"] in ("right", "half") for r in named)
    assert wilson(right, len(named))[1] >= 0.95  # nor one of 95 %
    assert right >= 0.5 * len(named)


@pytest.mark.slow
def test_others_ways_see_the_same_data() -> None:
    row = one(0, SMALL)
    assert set(row["others"]) == {"BIC", "AIC", "lasso", "cross-validation"}
    assert "BIC" in report([row])


@pytest.mark.benchmark
def test_the_promises_hold_on_two_hundred_blind_cases(tmp_path: Path) -> None:
    rows = benchmark(range(200), Options(), jobs=2)
    print(report(rows))
    keep(rows, tmp_path / "blind.json")
    table = bars(rows)
    assert table["false alarms (nothing missing) <= 0.05"]["low"] <= 0.05
    assert table["right name at lambda 60 >= 0.95"]["high"] >= 0.95
    assert table["right name at lambda 25 >= 0.85"]["high"] >= 0.85
    assert table["wrong name outside the catalogue <= 0.05"]["low"] <= 0.05
    assert table["two right at lambda 60 >= 0.85"]["high"] >= 0.85
    assert table["two right at lambda 150 and more >= 0.93"]["high"] >= 0.93
    assert (table["closure of the oracle's, median >= 0.97"]["share"] or 0.0) >= 0.97


@pytest.mark.parametrize("settling", [(), (0.1, 0.0, 0.03, 0.0)])
@pytest.mark.parametrize("kind", ["deflection", "absolute"])
def test_the_noise_of_a_case_is_white_once_it_is_whitened(kind: str, settling: tuple[float, ...]) -> None:
    robot = load("scara")
    table = _design(robot, kind, 3, set(), np.random.default_rng(1), Options(poses=(15,)))
    noise = Noise((0.02, 0.03, 0.02), growth_ppm=1.0, approach_mm=(0.02,) * 3, approach_mrad=0.05)
    noise = replace(noise, settling_mrad=settling)
    if kind == "deflection":
        noise = replace(noise, unloaded_mm=(0.02, 0.01, 0.02))
    truth = Truth(robot, {}, (), noise)
    design = {
        "kind": kind,
        "points": table.points,
        "point": table.point,
        "pose": table.pose,
        "labels": table.labels,
    }
    clean = clean_response(truth, table.q, table.w, design)
    white = Whitener(robot, table, noise, simulate(truth, table, 0).sigma[:, :3])
    z = np.array([white((simulate(truth, table, s).values - clean)[:, :3]).ravel() for s in range(200)])
    largest = np.linalg.eigvalsh(z.T @ z / len(z)).max()
    assert np.mean(z**2) == pytest.approx(1.0, abs=0.02)
    assert largest == pytest.approx(
        (1 + np.sqrt(z.shape[1] / len(z))) ** 2, rel=0.1
    )  # of a white matrix this large


def test_the_command_draws_from_the_designs_that_it_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []
    monkeypatch.setattr("tests.blind.run.benchmark", lambda numbers, options, *_: seen.append(options) or [])
    words = ("--n", "1", "--robot", "scara", "ur10", "--poses", "15", "--levels", "3", "5", "--markers", "1")
    monkeypatch.setattr("sys.argv", ["blind", *words])
    command.main()
    (asked,) = seen
    assert (asked.robots, asked.poses, asked.levels, asked.markers) == (
        ("scara", "ur10"),
        (15,),
        (3, 5),
        (1,),
    )
    assert asked.lambdas == Options().lambdas


@pytest.mark.slow
def test_a_story_that_asks_for_more_loads_than_the_designs_have_is_left_out() -> None:
    drawn = Options(classes=("one",), shares=(1.0,), levels=(1,), story="hysteresis constant")
    with pytest.raises(RuntimeError, match="no story of kind one fits"):
        case(0, drawn)
    assert case(0, replace(drawn, story="nonlinear tanh")).label.design["levels"] == 1


@pytest.mark.slow
@pytest.mark.parametrize(
    "story",
    [s for s in (*ONE, *RARE, *waves((3, 11), 0.5), *OUTSIDE, BAD_POSE) if s.context != "heavy"],
    ids=lambda story: str(story.name),
)
def test_every_story_can_be_told(story: Story) -> None:
    """A story whose effect the simulator does not take would be passed over for another one, and never be asked."""
    made = 0
    for number in range(12):
        rng = np.random.default_rng(number)
        try:
            scene = generate._scene((story,), rng, Options(poses=(15,), markers=(1,)))
            effect, _ = story.make(generate._draw(scene, rng))
        except (Unfit, UserError):  # no joint of this robot bears a load, or no design has the levels
            continue
        change = noise_free(scene, scene.values, (effect.scaled(0.01),)) - noise_free(scene, scene.values, ())
        assert np.isfinite(change[:, :3]).all()
        made += bool(np.abs(change[:, :3]).max() > 0)
        if made:
            return
    pytest.fail("no design shows it")
