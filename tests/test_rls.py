"""On-line identification converges to the batch estimate and stays bounded."""

from __future__ import annotations

import ctypes
import re

import numpy as np
import pytest

from symstiff.codegen.footprint_parse import CallGraph, call_graph
from symstiff.codegen.functions import Functions
from symstiff.codegen.options import Options
from symstiff.codegen.rls import column_scales
from symstiff.codegen.targets import TARGETS
from symstiff.files import write_tree
from symstiff.model import StiffnessModel
from symstiff.reduction.reduce import reduce
from symstiff.robot import parse
from tests.generated_c import STRICT, compiler, grown, model, poses, run, shared_library, written

ROBOT = "kuka_kr270"
SIGMA = np.array([5e-5, 5e-5, 5e-5, 1e-4, 1e-4, 1e-4])


class Estimator:
    """The generated functions on one state."""

    def __init__(self, library, real):
        self.library, self.real, self.size = library, real, len(model(ROBOT).parameters)
        self.state = np.zeros(2 * self.size + self.size * (self.size - 1) // 2 + 2, real)
        self.c = ctypes.c_double if real is np.float64 else ctypes.c_float
        for name in ("rls_trace", "rls_deviation"):
            getattr(library, f"{ROBOT}_{name}").restype = self.c

    def call(self, name, *arguments):
        kept = [np.ascontiguousarray(a, self.real) if isinstance(a, np.ndarray) else a for a in arguments]
        raw = [a.ctypes.data_as(ctypes.c_void_p) if isinstance(a, np.ndarray) else a for a in kept]
        return getattr(self.library, f"{ROBOT}_{name}")(self.state.ctypes.data_as(ctypes.c_void_p), *raw)

    def init(self, start, deviation, forgetting, bound):
        return self.call("rls_init", start, self.c(deviation), self.c(forgetting), self.c(bound))

    def update(self, q, w, dt, sigma=SIGMA):
        return self.call("rls_update", q, w, dt, sigma)

    def surprise(self, q, w, dt, sigma=SIGMA):
        """Status and value."""
        found = np.full(1, np.nan, self.real)
        status = self.call("rls_surprise", q, w, dt, sigma, found)
        return status, float(found[0])

    @property
    def estimate(self):
        return self.state[: self.size].astype(float)

    @property
    def covariance(self):
        n = self.size
        U = np.eye(n)
        flat = self.state[n : n + n * (n - 1) // 2].astype(float)
        for j in range(1, n):
            U[:j, j] = flat[j * (j - 1) // 2 :][:j]
        D = self.state[n + n * (n - 1) // 2 :][:n].astype(float)
        return U @ np.diag(D) @ U.T

    @property
    def trace(self):
        return self.call("rls_trace")


@pytest.fixture(scope="module")
def libraries(tmp_path_factory):
    found = {}
    for precision in ("double", "float"):
        folder = written(tmp_path_factory.mktemp(precision), ROBOT, precision, ("c", "rls"))
        found[precision] = shared_library(folder, [f"{ROBOT}.c", f"{ROBOT}_rls.c"])
    return found


@pytest.fixture
def estimator(libraries):
    return Estimator(libraries["double"], np.float64)


def emit(m, folder, precision="double"):
    """Write the C code of a model with its estimator."""
    options = Options(precision=precision, targets=("c", "rls"))
    for target in options.targets:
        write_tree(folder, TARGETS[target].emitter()(Functions(m), options))


def data(n, seed=1, noise=True):
    q, w = poses(ROBOT, n, seed)
    rng = np.random.default_rng(seed)
    return q, w, model(ROBOT).deflection(q, w) + noise * rng.normal(size=(n, 6)) * SIGMA


def batch_estimate(q, w, dt, start, deviation, weights=None, sigma=SIGMA):
    """Weighted least squares of all data with the prior, by numpy's lstsq; scaled covariance beside it."""
    scale = np.array(column_scales(model(ROBOT)))
    weights = np.ones(len(q)) if weights is None else weights
    use = sigma > 0
    A = model(ROBOT).observation(q, w)[:, use, :] / scale
    factor = np.sqrt(weights)[:, None] / sigma[use]
    rows = np.vstack([(A * factor[:, :, None]).reshape(-1, len(scale)), np.eye(len(scale)) / deviation])
    right = np.concatenate([(dt[:, use] * factor).ravel(), start * scale / deviation])
    x = np.linalg.lstsq(rows, right, rcond=None)[0]
    return x / scale, np.linalg.inv(rows.T @ rows)


def test_it_starts_anew_from_the_parameters_that_it_has(estimator):
    start = np.linspace(1e-8, 1e-6, estimator.size)
    assert estimator.init(start, 1.0, 0.99, 1e6) == 0
    address = estimator.state.ctypes.data_as(ctypes.c_void_p)
    again = estimator.library[f"{ROBOT}_rls_init"]
    assert again(address, address, estimator.c(2.0), estimator.c(0.99), estimator.c(1e6)) == 0
    np.testing.assert_array_equal(estimator.estimate, start)


def test_without_forgetting_it_is_the_batch_estimate(estimator):
    q, w, dt = data(150)
    start = np.zeros(estimator.size)
    assert estimator.init(start, 0.1, 1.0, 10.0) == 0
    for k in range(len(q)):
        assert estimator.update(q[k], w[k], dt[k]) == 0
    wanted, covariance = batch_estimate(q, w, dt, start, 0.1)
    scale = np.array(column_scales(model(ROBOT)))
    deviations = np.sqrt(np.diag(covariance))
    assert np.abs((estimator.estimate - wanted) * scale / deviations).max() < 1e-6
    np.testing.assert_allclose(estimator.covariance, covariance, rtol=0, atol=1e-8 * np.abs(covariance).max())
    found = [estimator.call("rls_deviation", k) for k in range(estimator.size)]
    np.testing.assert_allclose(found, deviations / scale, rtol=1e-6)


def test_the_estimate_is_within_its_deviations_of_the_truth(estimator):
    q, w, dt = data(300, seed=3)
    estimator.init(np.zeros(estimator.size), 0.1, 1.0, 10.0)
    for k in range(len(q)):
        estimator.update(q[k], w[k], dt[k])
    z = (estimator.estimate - model(ROBOT).vector()) / [
        estimator.call("rls_deviation", k) for k in range(estimator.size)
    ]
    assert 0.3 < np.mean(z**2) < 2.5


def test_forgetting_weights_poses_by_their_age(estimator):
    q, w, dt = data(120, seed=2)
    start, forgetting = np.zeros(estimator.size), 0.98
    assert estimator.init(start, 0.1, forgetting, 100.0) == 0
    for k in range(len(q)):
        estimator.update(q[k], w[k], dt[k])
    ages = np.arange(len(q))[::-1]
    wanted, covariance = batch_estimate(
        q, w, dt, start, 0.1 / np.sqrt(forgetting ** len(q)), forgetting**ages
    )
    scale = np.array(column_scales(model(ROBOT)))
    assert np.abs((estimator.estimate - wanted) * scale / np.sqrt(np.diag(covariance))).max() < 1e-5


def test_it_follows_a_change_only_when_it_forgets(estimator):
    q, w, _ = data(600, seed=5)
    m = model(ROBOT)
    changed = {n: v * 1.5 for n, v in m.values.items()}
    dt = np.vstack([m.deflection(q[:300], w[:300]), m.deflection(q[300:], w[300:], values=changed)])
    errors = {}
    for forgetting in (1.0, 0.97):
        estimator.init(np.zeros(estimator.size), 0.1, forgetting, 100.0)
        for k in range(len(q)):
            estimator.update(q[k], w[k], dt[k])
        left = m.observation(q[-50:], w[-50:]) @ (estimator.estimate - m.vector(changed))
        errors[forgetting] = np.sqrt(np.mean(left**2))
    assert errors[0.97] < 0.01 * errors[1.0]


@pytest.mark.parametrize("precision", ["double", "float"])
@pytest.mark.parametrize("wrench", [0.0, 1.0])
def test_without_excitation_the_covariance_stays_bounded_and_positive(libraries, precision, wrench):
    real = np.float64 if precision == "double" else np.float32
    estimator = Estimator(libraries[precision], real)
    q, w, dt = data(40)
    estimator.init(np.zeros(estimator.size), 0.01, 0.9, 0.02)
    for k in range(40):
        estimator.update(q[k], w[k], dt[k])
    for _ in range(20_000):  # one pose for ever, loaded or not
        assert estimator.update(q[0], w[0] * wrench, dt[0] * wrench) == 0
    assert np.isfinite(estimator.state).all()
    assert estimator.trace <= 0.02 * (1 + 1e-3)
    size = estimator.size
    assert (estimator.state[size + size * (size - 1) // 2 :][:size] >= 0).all()
    after = estimator.estimate
    for k in range(40):
        estimator.update(q[k], w[k], dt[k])
    left = model(ROBOT).deflection(q, w) - np.einsum(
        "nrp,p->nr", model(ROBOT).observation(q, w), estimator.estimate
    )
    assert np.sqrt(np.mean(left**2)) < 3e-4  # it still learns
    assert not np.array_equal(after, estimator.estimate)


@pytest.mark.parametrize("precision", ["double", "float"])
@pytest.mark.parametrize(("looser", "share"), [(10, 0.05), (1000, 0.3)])
def test_a_robot_that_stands_still_does_not_unlearn_what_its_pose_does_not_show(
    libraries, precision, looser, share
):
    """Right values, noise alone, one loaded pose: elsewhere the predictions stay those of the truth."""
    estimator = Estimator(libraries[precision], np.float64 if precision == "double" else np.float32)
    m, rng = model(ROBOT), np.random.default_rng(3)
    q, w = poses(ROBOT, 50, 6)
    dt = m.deflection(q, w)
    assert estimator.init(m.vector(), 1e-3, 0.99, 1.001 * estimator.size * 1e-6 * looser) == 0
    for _ in range(10_000):
        assert estimator.update(q[0], w[0], dt[0] + rng.normal(size=6) * SIGMA) == 0
    error = m.observation(q, w) @ (estimator.estimate - m.vector())
    assert np.sqrt(np.mean(error[:, :3] ** 2)) < share * np.sqrt(np.mean(dt[:, :3] ** 2))
    assert np.sqrt(np.mean(error[0] ** 2)) < SIGMA[0]


@pytest.mark.parametrize("precision", ["double", "float"])
def test_a_robot_that_stands_still_goes_on_following_what_its_pose_shows(libraries, precision):
    estimator = Estimator(libraries[precision], np.float64 if precision == "double" else np.float32)
    m = model(ROBOT)
    q, w, dt = data(1)
    estimator.init(m.vector(), 1e-3, 0.97, 1.001 * estimator.size * 1e-6)
    for _ in range(5000):
        estimator.update(q[0], w[0], dt[0])
    changed = m.deflection(q, w, values={n: 1.5 * v for n, v in m.values.items()})[0]
    for _ in range(600):
        assert estimator.update(q[0], w[0], changed) == 0
    assert np.abs(m.observation(q, w)[0] @ estimator.estimate - changed).max() < 0.1 * SIGMA[0]


def test_single_precision_comes_to_the_same_predictions(libraries):
    single = Estimator(libraries["float"], np.float32)
    q, w, dt = data(200, seed=8)
    single.init(np.zeros(single.size), 0.03, 1.0, 1.0)
    for k in range(len(q)):
        assert single.update(q[k], w[k], dt[k]) == 0
    m = model(ROBOT)
    error = m.observation(q, w) @ (single.estimate - m.vector())
    assert np.sqrt(np.mean((error / SIGMA) ** 2)) < 0.6


def test_components_that_were_not_measured_do_not_count(estimator):
    q, w, dt = data(60)
    sigma = SIGMA * [1, 1, 1, 0, 0, 0]
    dt[:, 3:] = np.nan
    start = model(ROBOT).vector() * 0.5
    estimator.init(start, 0.01, 1.0, 1.0)
    for k in range(len(q)):
        assert estimator.update(q[k], w[k], dt[k], sigma) == 0
    wanted, covariance = batch_estimate(q, w, np.nan_to_num(dt), start, 0.01, sigma=sigma)
    scale = np.array(column_scales(model(ROBOT)))
    assert np.abs((estimator.estimate - wanted) * scale / np.sqrt(np.diag(covariance))).max() < 1e-6


def test_a_pose_of_which_nothing_was_measured_changes_nothing(estimator):
    q, w, dt = data(3)
    estimator.init(model(ROBOT).vector(), 0.01, 0.99, 1.0)
    estimator.update(q[0], w[0], dt[0])
    before = estimator.state.copy()
    for none in (np.zeros(6), -SIGMA):
        assert estimator.update(q[1], w[1], dt[1] * np.nan, none) == 0
        np.testing.assert_array_equal(estimator.state, before)
    assert estimator.update(q[1] * np.nan, w[1], dt[1], np.zeros(6)) == -2


@pytest.mark.parametrize("sigma", [SIGMA, SIGMA * [1, 1, 1, 0, 0, 0]], ids=["pose", "position"])
def test_surprise_is_the_distance_from_what_is_expected_and_learns_nothing(estimator, sigma):
    q, w, dt = data(40, seed=4)
    estimator.init(model(ROBOT).vector() * 0.7, 3e-4, 0.98, 1.0)
    use, scale = sigma > 0, np.array(column_scales(model(ROBOT)))
    for k in range(len(q)):
        A = model(ROBOT).observation(q[k : k + 1], w[k : k + 1])[0]
        innovation = (dt[k] - A @ estimator.estimate)[use]
        scaled = (A / scale)[use]
        spread = scaled @ (estimator.covariance / 0.98) @ scaled.T + np.diag(sigma[use] ** 2)
        wanted = np.sqrt(innovation @ np.linalg.solve(spread, innovation))
        before = estimator.state.copy()
        status, found = estimator.surprise(q[k], w[k], dt[k], sigma)
        assert status == 0
        assert found == pytest.approx(wanted, rel=1e-6)
        np.testing.assert_array_equal(estimator.state, before)
        estimator.update(q[k], w[k], dt[k], sigma)


@pytest.mark.parametrize("precision", ["double", "float"])
def test_a_gate_on_the_surprise_keeps_absurd_measurements_out(libraries, precision):
    """Every tenth reading is of a lost target: the gate lets pass the others, and the estimate is that without them."""
    q, w, dt = data(200, seed=11)
    read = dt.copy()
    read[::10] += [0.02, 0, 0, 0, 0.01, 0]
    errors, passed = {}, np.zeros(len(q), bool)
    for gated in (False, True):
        estimator = Estimator(libraries[precision], np.float64 if precision == "double" else np.float32)
        estimator.init(model(ROBOT).vector() * 0.8, 1e-4, 1.0, 10.0)
        for k in range(len(q)):
            status, surprise = estimator.surprise(q[k], w[k], read[k])
            assert status == 0
            passed[k] = surprise < 6.0
            if passed[k] or not gated:
                assert estimator.update(q[k], w[k], read[k]) == 0
        left = model(ROBOT).observation(q, w) @ estimator.estimate - model(ROBOT).deflection(q, w)
        errors[gated] = np.sqrt(np.mean((left / SIGMA) ** 2))
    assert not passed[::10].any()
    assert np.delete(passed, np.s_[::10]).all()
    assert errors[True] < 0.6
    assert errors[True] < 0.1 * errors[False]


def test_no_gate_lets_pass_what_cannot_be_judged(estimator):
    q, w, dt = data(1)
    estimator.init(model(ROBOT).vector(), 0.01, 1.0, 1.0)
    largest = np.finfo(np.float64).max
    assert estimator.surprise(q[0], w[0], dt[0] * np.nan) == (-2, largest)
    assert estimator.surprise(q[0], w[0], np.full(6, 1e200)) == (
        -2,
        largest,
    )  # finite, which an update would take
    assert estimator.surprise(q[0], w[0], dt[0], SIGMA * 1e-200) == (-20, largest)
    assert estimator.surprise(q[0], w[0], dt[0] * np.nan, np.zeros(6)) == (0, 0.0)
    assert estimator.call("rls_surprise", q[0], w[0], dt[0], SIGMA, None) == -1
    found = np.ones(1)
    assert estimator.call("rls_surprise", None, None, None, None, found) == -1
    assert found == largest


SETTINGS = [
    (0.0, 1.0, 1.0), (-1.0, 1.0, 1.0), (0.1, 0.3, 1.0), (0.1, 1.01, 1.0), (0.1, 0.99, 0.1), (np.nan, 1.0, 1.0),
    (0.1, np.nan, 1.0), (0.1, 1.0, np.inf),
]  # fmt: skip


@pytest.mark.parametrize("settings", SETTINGS)
def test_settings_out_of_range_are_errors_and_leave_zeros(estimator, settings):
    assert estimator.init(np.ones(estimator.size), *settings) == -20
    assert not estimator.state.any()


def test_a_measurement_in_error_leaves_the_state_as_it_was(estimator):
    q, w, dt = data(3)
    estimator.init(model(ROBOT).vector(), 0.01, 0.99, 1.0)
    estimator.update(q[0], w[0], dt[0])
    before = estimator.state.copy()
    broken = [dt[1] * np.nan, dt[1]], [dt[1], SIGMA * np.inf], [dt[1], SIGMA * np.nan]
    for measured, sigma in [
        (broken[0][0], SIGMA),
        (broken[1][0], broken[1][1]),
        (broken[2][0], broken[2][1]),
    ]:
        assert estimator.update(q[1], w[1], measured, sigma) == -2
    assert estimator.update(q[1] * np.nan, w[1], dt[1]) == -2
    assert estimator.update(q[1], w[1], dt[1], SIGMA * 1e-200) == -20
    assert estimator.update(q[1], w[1], dt[1], SIGMA * 1e165) == -20
    assert estimator.update(q[1], w[1], np.full(6, 1e300) * np.array([1, -1, 1, -1, 1, 1])) in (0, -2)
    if not np.isfinite(estimator.state).all():
        pytest.fail("an update left what is not finite")
    estimator.init(model(ROBOT).vector(), 0.01, 0.99, 1.0)
    estimator.update(q[0], w[0], dt[0])
    assert estimator.call("rls_update", None, None, None, None) == -1
    np.testing.assert_array_equal(estimator.state, before)


def test_scales_are_powers_of_two_near_the_columns_sizes():
    scales = np.array(column_scales(model(ROBOT)))
    assert (np.log2(scales) == np.round(np.log2(scales))).all()
    q, w = poses(ROBOT, 300, 9)
    sizes = np.sqrt((model(ROBOT).observation(q, w) ** 2).mean(axis=(0, 1)))
    assert (np.abs(np.log2(sizes / scales)) < 1.2).all()


ONE_JOINT = b"""
format = 1
name = "lever"
base = {link = {template = "rigid"}}
joint = [{a = 0.5, alpha = "-pi/2", d = 0.1, compliance = 1e-6, link = {template = "rigid"}}]
tool = {xyz = [0.1, 0.2, 0.3]}
"""


def small(robot):
    """One compliance, or some with an effect that needs the time."""
    return StiffnessModel.of(reduce(parse(ONE_JOINT))) if robot == "lever" else grown(robot, "thermal_drift")


@pytest.mark.parametrize("precision", ["double", "float"])
@pytest.mark.parametrize("robot", ["lever", "scara"])
def test_the_header_tells_the_size_that_the_compiler_gives_the_state(tmp_path, robot, precision):
    assert (len(small(robot).stiffness_parameters) == 1) == (robot == "lever")
    emit(small(robot), tmp_path, precision)
    (told,) = re.findall(r"struct \((\d+) bytes\)", (tmp_path / f"{robot}_rls.h").read_text())
    size = f"typedef char size[sizeof({robot}_rls_t) == {told} ? 1 : -1];"
    (tmp_path / "size.c").write_text(f'#include "{robot}_rls.h"\n{size}\n')
    run(compiler(), *STRICT, "-O2", "-c", "-I.", "size.c", f"{robot}_rls.c", cwd=tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("level", ["-O0", "-O2"])
@pytest.mark.parametrize("precision", ["double", "float"])
@pytest.mark.parametrize(
    ("robot", "effect"), [("ur10", None), ("kuka_kr270", None), ("ur10", "payload_error")]
)
def test_the_header_tells_the_stack_of_an_update(tmp_path, robot, effect, precision, level):
    emit(model(robot) if effect is None else grown(robot, effect), tmp_path, precision)
    header = (tmp_path / f"{robot}_rls.h").read_text()
    (told,) = map(int, re.findall(r"An update needs about (\d+) bytes of stack", header))
    both = CallGraph()
    for name in (robot, f"{robot}_rls"):
        run(compiler(), level, "-fcallgraph-info=su", "-c", "-I.", f"{name}.c", cwd=tmp_path)
        one = call_graph((tmp_path / f"{name}.ci").read_text())
        both.stack.update(one.stack)
        both.calls.update(one.calls)
    beside = max(both.depth(f"{robot}_{f}") for f in ("deflection", "observation"))
    assert 0.7 * told < both.depth(f"{robot}_rls_update") - beside <= told


def test_it_compiles_strictly_in_single_precision_without_heap(tmp_path):
    folder = written(tmp_path, ROBOT, "float", ("c", "rls"))
    assert "double" not in (folder / f"{ROBOT}_rls.c").read_text()
    run(compiler(), *STRICT, "-O2", "-c", "-I.", f"{ROBOT}_rls.c", "-o", "r.o", cwd=folder)
    needed = run("nm", "-u", "r.o", cwd=folder)
    assert "malloc" not in needed


@pytest.mark.parametrize(("effect", "size"), [("payload_error", 40.0), ("link_weight", 80.0)])
def test_it_converges_where_an_effect_adds_more_load_than_the_experiment(tmp_path, effect, size):
    """The compliances give way under the added load as well: columns of the bare load are far from theirs."""
    m = grown("ur10", effect)
    m = m.with_values(dict(m.values) | {m.effect_parameters[0].name: size})
    emit(m, tmp_path)
    library = shared_library(tmp_path, ["ur10.c", "ur10_rls.c"])
    library.ur10_rls_deviation.restype = ctypes.c_double
    n, p = len(m.stiffness_parameters), len(m.parameters)
    state, start = np.zeros(p + n * (n - 1) // 2 + n + 2), m.vector()
    start[:n] *= 0.7

    def call(name, *arguments):
        raw = [
            a.ctypes.data_as(ctypes.c_void_p) if isinstance(a, np.ndarray) else a for a in (state, *arguments)
        ]
        return getattr(library, f"ur10_{name}")(*raw)

    assert call("rls_init", start, ctypes.c_double(1e-2), ctypes.c_double(1.0), ctypes.c_double(1e3)) == 0
    rng = np.random.default_rng(0)
    q, _ = poses("ur10", 400, 5)
    w = rng.uniform(-100, 100, (400, 6)) * [1, 1, 1, 0.2, 0.2, 0.2]
    dt = m.deflection(q, w) + rng.normal(size=(400, 6)) * SIGMA
    for k in range(400):
        assert call("rls_update", q[k], w[k], dt[k], SIGMA) == 0
    deviation = np.array([call("rls_deviation", ctypes.c_int(k)) for k in range(n)])
    z = (state[:n] - m.vector()[:n]) / deviation
    assert np.sqrt(np.mean(z**2)) < 1.6
    found = dict(zip(m.stiffness_parameters, state[:n].tolist(), strict=True))
    fresh, load = poses("ur10", 50, 6)
    wrong = m.deflection(fresh, 0.1 * load, values=dict(m.values) | found) - m.deflection(fresh, 0.1 * load)
    assert np.sqrt(np.mean(wrong[:, :3] ** 2)) < SIGMA[0]
