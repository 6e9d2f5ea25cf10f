"""What looks like a compliance, or like another effect: asymmetries of rigid links, mounts that harden, markers that
sag, gears of the wrist that saturate, weights that turn one joint alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from symstiff.codegen.compiler import find_compiler
from symstiff.codegen.generate import generate
from symstiff.discrepancy.findings.finding import Task
from symstiff.discrepancy.laws.unnamed import laws_at
from symstiff.discrepancy.workflow import diagnose
from symstiff.effects import EffectInstance
from symstiff.model import joints_only
from symstiff.robot import load
from tests.test_assemble import Effect, assemble, complete, design, measured, of, truth_of
from tests.test_linkages_and_hoses import experiment, filled, positions
from tests.test_posture import laws_and_change, left
from tests.test_sensors import read


def test_links_that_the_model_takes_for_rigid_have_no_asymmetry() -> None:
    """Couplings between axes of which none gives way are no compliance."""
    table = measured(truth_of("ur10"), design("ur10", "deflection"))
    rigid, elastic = (
        of(assemble(model, table), "link_asymmetry", {"link": 2}).unavailable
        for model in (joints_only(load("ur10")), complete("ur10"))
    )
    assert rigid == "the model takes all links for rigid: compliances come before asymmetries"
    assert not elastic


def test_a_mount_that_hardens_is_told_by_its_block_and_its_moment() -> None:
    laws, _ = laws_and_change("ur10")
    mounts = {x.place: x for x in laws if x.title == "compliance that grows with the load"}
    assert set(mounts) == {"link 0", "link 6"}
    block = mounts["link 6"]
    assert block.values.shape[1] == 21
    assert [p.unit for p in block.parameters][:4] == ["m/N", "m/N", "m/N", "rad/N"]
    assert block.parameters[-1].unit == "rad/(N*m)"


def test_a_marker_that_sags_moves_by_where_down_is_in_the_tools_axes() -> None:
    """A stem that bends across itself: along x of the tool by gravity along x, along y by gravity along y."""
    table = experiment()
    plain = filled(table, positions(table))
    found = assemble(complete("ur10"), plain, effects=())
    view = found.situation.view
    tool = view.found.R[:, -1]
    down = -tool[:, 2]
    sag = np.einsum("nij,nj->ni", tool, down * [1e-4, 1e-4, 0.0]) * (table.point == 1)[:, None]
    (law,) = (
        x for x in found.problem.devices if x.place == "marker p2" and x.title.startswith("sag by the way of gravity")
    )  # fmt: skip
    assert left(law.values, sag[view.state, view.component]) < 1e-9


def test_bolts_rub_only_where_loads_go_both_ways() -> None:
    """At a link's axis, beside what it does in proportion to the load."""
    table = measured(truth_of("ur10"), design("ur10", "deflection"))
    both = assemble(complete("ur10"), table, effects=()).problem
    one = assemble(complete("ur10"), replace(table, branch=np.ones(len(table))), effects=()).problem
    texts = [{law.text for law in laws_at(problem, 0)} for problem in (both, one)]
    assert texts[0] - texts[1] == {("branch*tau",), ("branch*tau*(1-load)",)}


@pytest.mark.slow
def test_a_coupling_that_saturates_early_is_still_a_coupling() -> None:
    effect = Effect("wrist_coupling", {"joints": [5, 6]}, "saturating", {"c": 6e-5, "tau0": 6.0})
    found = diagnose(
        Task(load("ur10"), read(design("ur10", "deflection", poses=30), truth_of("ur10", effect), 8))
    )
    assert found.verdict == "named"
    assert [(e.effect, dict(e.where)) for e in found.effects] == [("wrist_coupling", {"joints": [5, 6]})]
    assert found.effects[0].shape["saturation"] > 0


@pytest.mark.parametrize(
    ("name", "weights", "seen"), [("ur10", 1.0, True), ("ur10", 0.0, False), ("kuka_kr270", 1.0, False)]
)
def test_a_coupling_that_saturates_counts_the_weight_that_the_file_tells(
    name: str, weights: float, seen: bool
) -> None:
    """The UR10's masses are told, and turn with the joints before the wrist's; those of the KR 270 are not."""
    shape = {"saturation": 20.0, "weights": weights}
    terms = EffectInstance("wrist_coupling", {"joints": [5, 6]}, shape).realise(load(name)).terms
    assert ("q_3" in {str(s) for term in terms for s in term.factor.free_symbols}) == seen


def test_code_of_a_coupling_that_saturates_under_unequal_weights_passes_its_test(tmp_path: Path) -> None:
    """The steepnesses of the two laws differ without a load, so the stiffness matrix is not symmetric."""
    if find_compiler() is None:
        pytest.skip("no C compiler")
    effect = EffectInstance("wrist_coupling", {"joints": [5, 6]}, {"saturation": 2.0})
    model = complete("ur10").with_effect(effect)
    values = {n: 1e-7 * (1 + k % 3) for k, n in enumerate(model.stiffness_parameters)}
    made = generate(model.with_values(values | {"wrist_coupling_5_6_c": 6e-5}), tmp_path / "code")
    assert made.verification.selftest is not None
    assert "K is not symmetric" in (tmp_path / "code" / "ur10.h").read_text()


def test_the_weight_of_a_link_and_a_wave_of_its_joint_are_twins_where_joints_alone_give_way() -> None:
    """What a mass along the joint's axis adds is rounding, and makes no difference between them."""
    table = experiment()
    found = assemble(joints_only(load("ur10")), filled(table, positions(table)))
    weight = of(found, "link_weight", {"link": 2})
    wave = of(found, "transmission_error", {"joint": 2, "harmonics": [1]})
    assert weight.group == wave.group
