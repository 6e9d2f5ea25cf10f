"""The seed's Table 2 on a virtual robot: counts by the reduction, the models in the order of the seed."""

import pytest

from symstiff.calibration.seed_tables import SEED, table2


@pytest.fixture(scope="module")
def rows():
    _, found = table2(seed=1)
    return {row.name: row for row in found}


def test_the_numbers_of_parameters_are_those_of_the_seed_and_equal_the_rank(rows) -> None:
    for name, row in rows.items():
        assert row.parameters == SEED[name][0]
        assert row.rank == row.parameters


def test_complete_models_compensate_at_least_95_per_cent_and_joint_models_clearly_less(rows) -> None:
    for name in ("C1", "C2"):
        assert rows[name].fitted.compensated > 0.95
        assert rows[name].fresh.compensated > 0.95
    for name in ("J1", "J2"):
        assert rows[name].fitted.compensated < 0.93
        assert rows[name].fresh.compensated < 0.93


def test_every_refinement_fits_better_in_the_seeds_order(rows) -> None:
    left = {name: row.fitted.after["positional"].rms for name, row in rows.items()}
    assert left["C2"] < left["C1"] < left["J2"] < left["J1"]


def test_the_deflections_have_the_size_of_the_seeds(rows) -> None:
    before = rows["C1"].fitted.before["positional"]
    assert 3e-3 < before.rms < 7e-3
    assert 5e-3 < before.max < 11e-3
