"""Nearest admissible set in the Burg divergence, by Newton's method inside the affine set."""

from __future__ import annotations

import numpy as np

from symstiff.arrays import Array
from symstiff.errors import UserError
from symstiff.reduction.admissible import AdmissibleSet, Block
from symstiff.reduction.nearest import Affine, deepest_point

_LEAST_DEPTH = 1e-9


def nearest_logdet(affine: Affine, rules: AdmissibleSet, target: Array) -> tuple[Array, float]:
    """Minimise Σ tr(K·K0⁻¹) − log det(K·K0⁻¹) − order, plus ½(x − target)² outside blocks.

    Returns x (n,) in scaled parameters, every block positive definite, and the value. The divergence does not
    change with units or with the axes of a link. Raises UserError where nominal blocks or the affine set are
    not positive definite.
    """
    blocks = [(block, _inverse_nominal(block, target)) for block in rules.blocks]
    held = {index for block in rules.blocks for _, _, index in block.entries}
    free = np.array([float(index not in held) for index in range(len(target))])
    *start, depth = deepest_point(affine, rules)
    if depth < _LEAST_DEPTH:
        raise UserError(
            "the log-determinant metric needs positive definite link matrices, and the data leave none: "
            'use the metric "relative"'
        )
    x, N = affine.restore(np.array(start)), affine.null
    value, gradient, hessian = _divergence(blocks, x, free, target)
    for _ in range(100):
        reduced = N.T @ gradient
        step = -np.linalg.lstsq(N.T @ hessian @ N, reduced, rcond=None)[0]
        decrement = float(-reduced @ step)
        if decrement < 1e-13 * (1.0 + value):
            break
        length = 1.0
        while True:
            trial = x + length * (N @ step)
            new = _divergence(blocks, trial, free, target)
            if new[0] <= value - 0.1 * length * decrement or length < 1e-12:
                break
            length *= 0.5
        if length < 1e-12:
            break
        x, (value, gradient, hessian) = trial, new
    return x, value


def _inverse_nominal(block: Block, target: Array) -> Array:
    """K0⁻¹ of the scaled nominal block."""
    nominal = block.matrix(target)
    if np.linalg.eigvalsh(nominal)[0] <= 1e-12:
        raise UserError(
            f"{block.label}: the nominal matrix is not positive definite, as the metric logdet needs: "
            'give nominal values for all its terms, or use the metric "relative"'
        )
    return np.asarray(np.linalg.inv(nominal))


def _divergence(
    blocks: list[tuple[Block, Array]], x: Array, free: Array, target: Array
) -> tuple[float, Array, Array]:
    """Value, gradient (n,) and Hessian (n, n); an infinite value outside the positive definite cone."""
    off = free * (x - target)
    value, gradient, hessian = 0.5 * float(off @ off), off.copy(), np.diag(free)
    for block, inverse_nominal in blocks:
        K = block.matrix(x)
        try:
            factor = np.linalg.cholesky(K)
        except np.linalg.LinAlgError:
            return np.inf, gradient, hessian
        inverse, E = np.linalg.inv(K), block.basis()
        logdet = 2.0 * float(np.sum(np.log(np.diag(factor)))) + float(np.linalg.slogdet(inverse_nominal)[1])
        value += float(np.trace(K @ inverse_nominal)) - logdet - block.size
        index = [i for _, _, i in block.entries]
        gradient[index] += np.einsum("eab,ba->e", E, inverse_nominal - inverse)
        bent = inverse @ E
        hessian[np.ix_(index, index)] += np.einsum("eab,fba->ef", bent, bent)
    return value, gradient, hessian
