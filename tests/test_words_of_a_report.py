"""Numbers, quantities and places as a person writes them."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from symstiff.calibration.simulation import Effect, Truth
from symstiff.calibration.tables.measurements import Measurements
from symstiff.discrepancy.bridge.assemble import assemble
from symstiff.discrepancy.findings.finding import Finding
from symstiff.discrepancy.findings.numbers import decimals_between, milli, number, p_equals, quantity
from symstiff.discrepancy.findings.result import Found, Quantity
from symstiff.discrepancy.search.localise import FittedDevice, FittedLaw
from symstiff.effects import EffectInstance
from symstiff.report.naming import magnitude, main_parameters, places
from symstiff.report.unnamed import device_text, law_text
from symstiff.robot import load
from tests.test_assemble import complete, design, measured, readings, truth_of


@pytest.mark.parametrize(
    ("wheres", "text"),
    [
        ([{"joint": 3}], "at joint 3"),
        ([{"joint": j} for j in (1, 2, 3, 5, 6)], "at joints 1–3, 5, 6"),
        ([{"link": 0}, {"link": 4}], "at links 0, 4"),
        ([{"joints": [4, 5]}, {"joint": 1}], "at joint 1, between joints 4, 5"),
        ([{"joint": 2, "harmonics": [17]}], "at joint 2 (17 a turn)"),
        (
            [{"joint": j, "harmonics": [n]} for j in (1, 2) for n in (1, 2, 4)],
            "at joints 1, 2 (1, 2, 4 a turn)",
        ),
    ],
)
def test_places_of_one_effect_are_told_in_one_breath(wheres: list[dict[str, Any]], text: str) -> None:
    assert places(wheres) == text


@pytest.mark.parametrize(
    ("value", "std", "unit", "text"),
    [
        (1.4432e-7, 1.03e-8, "rad/(N*m)", "(1.44 ± 0.10)·10⁻⁷ rad/(N·m)"),
        (-2.5e-4, 1e-5, "rad", "−0.250 ± 0.010 mrad"),
        (1.2e-3, 3e-5, "m", "1.200 ± 0.030 mm"),
        (4.0, float("inf"), "m/N", "4 m/N (not determined apart from others)"),
    ],
)
def test_quantities_read_as_a_person_writes_them(value: float, std: float, unit: str, text: str) -> None:
    assert quantity(Quantity(value, std, unit)) == text


def test_a_number_above_its_digits_is_rounded_and_written_out() -> None:
    assert [number(x) for x in (2500.0, 12345.0, 99999.0, -1234.5, 999.4)] == [
        "2500", "12300", "1.00·10⁵", "−1230", "999",
    ]  # fmt: skip


def test_a_residual_below_a_thousandth_is_not_shown_as_none() -> None:
    assert [milli(x) for x in (0.0, 1.234e-2, 2.6e-5, 4.18e-7, -3e-9)] == [
        "0.000", "12.340", "0.026", "0.00042", "-3e-06",
    ]  # fmt: skip


def test_numbers_far_from_one_have_powers_of_ten() -> None:
    assert number(3.02e-7) == "3.02·10⁻⁷"
    assert number(0.25) == "0.25"
    assert p_equals(3e-9) == "p < 10⁻⁸"
    assert p_equals(0.03) == "p = 0.03"


def test_a_block_of_compliances_is_as_large_as_what_it_moves() -> None:
    """Entries beside a beam's have no size that one knows: the largest shift that they make in the simulator has."""
    block, table = {"14": 3e-7, "25": 4e-7}, design("ur10", "deflection")
    hidden = truth_of("ur10", Effect("link_asymmetry", {"link": 3}, "entries", {"entries": block}))
    moved = np.abs(readings(hidden, table) - readings(truth_of("ur10"), table))[:, :3].max()
    names = [
        p.name for p in EffectInstance("link_asymmetry", {"link": 3}, {}).realise(load("ur10")).parameters
    ]
    sizes = {n: Quantity(block.get(n.removeprefix("k3_"), 0.0), 1e-9, "rad/N") for n in names}
    effect = Found("link_asymmetry", {"link": 3}, {}, sizes, 0.0, 0.9, ())
    finding = _finding(hidden, table)
    assert moved > 5e-6
    assert magnitude(finding, effect) == f"13 compliances that move a reading by up to {milli(moved)} mm"


def test_a_size_is_told_with_what_it_moves() -> None:
    """A compliance in rad/(N m), or a loop that no load opens wholly, says little without; a shift says all."""
    table, joint, device = design("ur10", "deflection"), {"joint": 2}, {"measurement": "frame"}
    hidden = truth_of("ur10", Effect("joint_compliance", joint, "linear", {"c": 4e-7}))
    moved = np.abs(readings(hidden, table) - readings(truth_of("ur10"), table))[:, :3].max()
    size = {"c2": Quantity(4e-7, 2e-9, "rad/(N*m)")}
    finding = _finding(hidden, table)
    said = magnitude(finding, Found("joint_compliance", joint, {}, size, 0.0, 0.9, ()))
    assert moved > 5e-6
    assert said == (f"c2 = (4.000 ± 0.020)·10⁻⁷ rad/(N·m), by which readings move by up to {milli(moved)} mm")
    shift = {"thermal_drift_frame_x": Quantity(6e-5, 5e-6, "m")}
    drift = Found("thermal_drift", device, {"time": 3600.0}, shift, 0.0, 0.9, ())
    assert magnitude(finding, drift) == main_parameters(drift)


def _finding(hidden: Truth, table: Measurements) -> Finding:
    """What of a finding tells how large an effect is."""
    finding = SimpleNamespace(
        assembly=assemble(complete("ur10"), measured(hidden, table), effects=()),
        added=lambda effect: Finding.added(cast(Finding, finding), effect),
    )
    return cast(Finding, finding)


@pytest.mark.parametrize(
    ("mass", "my", "text"),
    [
        (
            Quantity(-8.93, 4.04, "kg"), 0.0372,
            "mx = 0.088 ± 0.018 kg·m, mz = 1.38 ± 0.55 kg·m, m = −8.9 ± 4.0 kg and 1 more",
        ),
        (
            Quantity(-0.93, 4.56, "kg"), -0.007,
            "mx = 0.088 ± 0.018 kg·m, mz = 1.38 ± 0.55 kg·m, m = −0.9 ± 4.6 kg (not told from zero) "
            "and 1 not told from zero",
        ),
        (
            Quantity(2.0, 0.1, "kg"), -0.007,
            "m = 2.00 ± 0.10 kg, mx = 0.088 ± 0.018 kg·m, 1 more and 1 not told from zero",
        ),
        (
            Quantity(0.0, float("inf"), "kg"), 0.0372,
            "mx = 0.088 ± 0.018 kg·m, mz = 1.38 ± 0.55 kg·m, m = 0 kg (not determined apart from others) and 1 more",
        ),
    ],
)  # fmt: skip
def test_a_mass_is_told_beside_the_sizes_that_are_told_best(mass: Quantity, my: float, text: str) -> None:
    """A payload that is wrong by −8.9 ± 4.0 kg was one of "3 more", and nobody saw it."""
    moments = {"mx": (0.0884, 0.0184), "my": (my, 0.0166), "mz": (1.38, 0.553)}
    sizes = {"m": mass, **{n: Quantity(*size, "kg*m") for n, size in moments.items()}}
    assert main_parameters(Found("payload_error", {"load": "payload"}, {}, sizes, 0.0, 0.9, ())) == text


def test_what_is_not_determined_is_counted_as_that() -> None:
    sizes = {
        n: Quantity(*size, "m") for n, size in {"x": (6e-5, 5e-6), "y": (7e-7, 3e-6), "z": (0, 4e-6)}.items()
    }
    drift = Found("thermal_drift", {"link": 3}, {}, sizes, 0.0, 0.9, ())
    assert main_parameters(drift) == "x = 0.0600 ± 0.0050 mm and 2 not told from zero"
    faint = {"x": Quantity(1e-6, 4e-6, "m")}
    assert main_parameters(replace(drift, parameters=faint)) == "x = (1.0 ± 4.0)·10⁻³ mm (not told from zero)"
    assert main_parameters(replace(drift, parameters={"x": Quantity(0.0, float("inf"), "m")})) == ""
    weight = {"m": Quantity(1.76, 0.23, "kg"), "mx": Quantity(0.0, float("inf"), "kg*m")}
    assert main_parameters(replace(drift, parameters=weight)) == (
        "m = 1.76 ± 0.23 kg with mx held at zero, which these data do not tell"
    )


@pytest.mark.parametrize(
    ("first", "last", "decimals"),
    [
        (2.62e-5, 2.31e-5, 3),  # 0.026 and 0.023
        (2.59e-5, 2.51e-5, 4),  # 0.026 and 0.025 look like 0.001
        (1.0374e-5, 1.0052e-5, 4),
        (2.046e-5, 2.033e-5, 5),  # four digits
        (2.04601e-5, 2.04599e-5, 5),  # and no more
        (7.5e-6, 5.9e-6, 4),
        (0.012345, 0.011, 2),
        (12.3, 4.0, 0),
        (3e-4, 2e-5, None),
        (2e-5, 0.0, None),
        (2.034e-5, 2.034e-5, None),  # nothing was added
    ],
)
def test_as_many_digits_as_tell_two_sizes_apart(first: float, last: float, decimals: int | None) -> None:
    assert decimals_between(first, last) == decimals_between(last, first) == decimals


def device(sizes: list[tuple[float, float]]) -> FittedDevice:
    terms = tuple(
        (f"compliance that grows: {k}", value, std, "rad/(N*m)") for k, (value, std) in enumerate(sizes)
    )
    return FittedDevice("link 0", terms, 0.4)


@pytest.mark.parametrize(
    ("sizes", "told"),
    [
        ([(3e-8, 1e-8), (1e-9, 1e-8)], "(0 (3.0 ± 1.0)·10⁻⁸ rad/(N·m), 1 (0.1 ± 1.0)·10⁻⁸ rad/(N·m))"),
        ([(3e-8, 1e-8), *[(1e-9, 1e-8)] * 9], "(0 (3.0 ± 1.0)·10⁻⁸ rad/(N·m))"),
        ([(3e-8, float("inf"))] * 21, "(21 sizes, none of which is told by itself)"),
    ],
)
def test_of_many_sizes_of_a_device_only_those_that_are_clear_are_told(
    sizes: list[tuple[float, float]], told: str
) -> None:
    assert device_text(device(sizes)).startswith(f"a compliance that grows {told} explains 40 %")


def test_terms_of_a_law_that_are_tiny_are_written_with_powers_of_ten() -> None:
    """Not as 4e − 05, the minus of an exponent being none of the law."""
    law = FittedLaw("joint 1", "-4.2e-08*tau +2*tau*|tau|", 10.0, 0.5, 0.4, np.zeros(0))
    assembly = assemble(
        complete("ur10"), measured(truth_of("ur10"), design("ur10", "deflection")), effects=()
    )
    finding = cast(Finding, SimpleNamespace(
        task=SimpleNamespace(robot=load("ur10")), assembly=assembly, table=design("ur10", "deflection")
    ))  # fmt: skip
    assert law_text(finding, law).startswith("(−4.20·10⁻⁵·t + 2000·t·|t|) mrad")
