"""The singular value decomposition holds where LAPACK's fast algorithm gives up."""

from __future__ import annotations

import numpy as np
import pytest

from symstiff.reduction.svd import svd


@pytest.mark.parametrize("converges", [True, False])
def test_columns_that_depend_on_each_other_are_decomposed_whether_the_fast_way_converges_or_not(
    converges: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A base's block beside a tool's failed so, with entries that were finite."""
    rng = np.random.default_rng(1)
    A = rng.normal(size=(40, 5)) @ rng.normal(size=(5, 9))
    A[:, 3] = 1e-12 * rng.normal(size=40)

    def fails(*_: object, **__: object) -> None:
        raise np.linalg.LinAlgError("SVD did not converge")

    if not converges:
        monkeypatch.setattr(np.linalg, "svd", fails)
    U, s, Vt = svd(A)
    assert U.shape == (40, 9)
    np.testing.assert_allclose(U * s @ Vt, A, atol=1e-12)
    assert np.sum(s > 1e-9 * s[0]) == 5
