"""What others would do with the same data: information criteria, lasso, pose-wise cross-validation.

Each takes the scan of the starting model and returns the candidates that it selects; for comparison only.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from symstiff.arrays import Array
from symstiff.discrepancy.problem import Problem
from symstiff.discrepancy.statistics.scan import Scan, basis_of, explained, extend, outside


def information_criterion(scan: Scan, penalty: float, most: int = 3) -> tuple[int, ...]:
    """Forward selection by n·log(RSS) + penalty·k; penalty 2 is AIC, log n is BIC."""
    scan = _flat(scan)
    chosen: list[int] = []
    while len(chosen) < most:
        n = len(scan.best.y)
        squares = explained(scan)[0]
        left = np.maximum(scan.best.rss - squares, 1e-300)
        gain = n * np.log(scan.best.rss / left) - penalty * scan.best.bases.rank
        gain[_barred(scan, chosen)] = -np.inf
        best = int(np.argmax(gain))
        if gain[best] <= 0:
            break
        chosen.append(int(scan.bank.owner[best]))
        scan = extend(scan, (best,))
    return tuple(chosen)


def aic(scan: Scan) -> tuple[int, ...]:
    """Akaike's criterion."""
    return information_criterion(scan, 2.0)


def bic(scan: Scan) -> tuple[int, ...]:
    """Schwarz's criterion."""
    return information_criterion(scan, float(np.log(len(scan.best.y))))


def cross_validation(scan: Scan, problem: Problem, folds: int = 5, most: int = 3) -> tuple[int, ...]:
    """Forward selection by pose-wise cross-validation with the one-standard-error rule."""
    scan = _flat(scan)
    fold = np.unique(problem.pose, return_inverse=True)[1].reshape(-1) % folds
    chosen: list[int] = []
    entries: list[int] = []
    while len(chosen) < most:
        squares = np.where(_barred(scan, chosen), -np.inf, explained(scan)[0] - scan.best.bases.rank)
        before = _fold_errors(scan, [], fold)
        trial = {int(e): before - _fold_errors(scan, [int(e)], fold) for e in np.argsort(squares)[::-1][:12]}
        best = max(trial, key=lambda e: float(np.mean(trial[e])))
        gain = trial[best]
        if np.mean(gain) <= np.std(gain, ddof=1) / np.sqrt(len(gain)):
            break
        chosen.append(int(scan.bank.owner[best]))
        entries.append(best)
        scan = extend(scan, (best,))
    return tuple(chosen)


def lasso(scan: Scan, problem: Problem, folds: int = 5, most: int = 3) -> tuple[int, ...]:
    """Lasso on all columns after projection, penalty by pose-wise cross-validation (one standard error)."""
    scan = _flat(scan)
    layer, bank = scan.best, scan.bank
    named = np.flatnonzero(~bank.generic[bank.owner])
    cols = np.concatenate([np.arange(bank.start[e], bank.start[e] + bank.width[e]) for e in named])
    owner = np.concatenate([np.full(bank.width[e], bank.owner[e]) for e in named])
    X = outside(scan, layer, named.tolist())
    length = np.linalg.norm(X, axis=0)
    keep = length > 1e-6 * np.sqrt(layer.length2[cols])
    X, owner = X[:, keep] / length[keep], owner[keep]
    fold = np.unique(problem.pose, return_inverse=True)[1].reshape(-1) % folds
    top = float(np.max(np.abs(X.T @ layer.y)))
    grid = top * np.geomspace(1.0, 0.03, 20)
    error = np.zeros((folds, len(grid)))
    for k in range(folds):
        train = fold != k
        for g, beta in enumerate(_path(X[train], layer.y[train], grid)):
            error[k, g] = np.mean((layer.y[~train] - X[~train] @ beta) ** 2)
    mean, se = error.mean(axis=0), error.std(axis=0, ddof=1) / np.sqrt(folds)
    best = int(np.argmin(mean))
    pick = int(np.flatnonzero(mean <= mean[best] + se[best])[0])
    beta = _path(X, layer.y, grid[: pick + 1])[-1]
    strength = {int(o): float(np.sum(beta[owner == o] ** 2)) for o in np.unique(owner)}
    ranked = sorted((o for o in strength if strength[o] > 0), key=lambda o: -strength[o])
    return tuple(ranked[:most])


def _path(X: Array, y: Array, grid: Array, sweeps: int = 60) -> list[Array]:
    """Coordinate descent, warm started along a falling penalty."""
    gram, inner = X.T @ X, X.T @ y
    diagonal = np.maximum(np.diag(gram), 1e-12)
    beta = np.zeros(X.shape[1])
    out = []
    for penalty in grid:
        for _ in range(sweeps):
            before = beta.copy()
            gradient = inner - gram @ beta
            active = np.flatnonzero((np.abs(gradient) > penalty) | (beta != 0))
            for j in active:
                rho = inner[j] - gram[j] @ beta + diagonal[j] * beta[j]
                beta[j] = np.sign(rho) * max(abs(rho) - penalty, 0.0) / diagonal[j]
            if np.max(np.abs(beta - before)) < 1e-4 * max(np.max(np.abs(beta)), 1e-300):
                break
        out.append(beta.copy())
    return out


def _flat(scan: Scan) -> Scan:
    """The scan without an approach error: what these methods assume."""
    return replace(scan, layers=(scan.layers[0],))


def _barred(scan: Scan, chosen: list[int]) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    owner = scan.bank.owner
    return np.asarray(scan.bank.generic[owner] | np.isin(owner, chosen) | (scan.best.bases.rank == 0))


def _fold_errors(
    scan: Scan, entries: list[int], fold: np.ndarray[tuple[int, ...], np.dtype[np.intp]]
) -> Array:
    layer = scan.best
    X = np.hstack([layer.basis[:, :0], *(basis_of(scan, layer, e) for e in entries)])
    out = []
    for k in np.unique(fold):
        train = fold != k
        beta = np.linalg.lstsq(X[train], layer.y[train], rcond=1e-9)[0] if X.shape[1] else np.zeros(0)
        out.append(float(np.mean((layer.y[~train] - X[~train] @ beta) ** 2)))
    return np.array(out)
