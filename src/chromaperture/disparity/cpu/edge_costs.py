# mypy: disallow-untyped-defs=False
"""Likelihood of the places of an edge, compiled; ``stages/edge_costs.py`` explains what is computed.

Libraries factor one such matrix as fast, but need four times as long for the small ones that are composed, factored and
solved here in one go: the lines are further columns of the matrix while it is eliminated.
"""

from __future__ import annotations

import numpy as np

from chromaperture.compilation import compiled, inlined
from chromaperture.disparity.cpu.paths import FAST
from chromaperture.disparity.stages.edge_costs import LEAST_OF_TRACE


def edge_costs(
    lines: np.ndarray, near: np.ndarray, far: np.ndarray, share: np.ndarray, noise: np.ndarray
) -> np.ndarray:
    """Compute negative log-likelihoods of Gaussian lines, as `stages.edge_costs`; (P, T) float64."""
    out = np.empty((len(lines), len(share)))
    # Doubles: the noise may be 1e-9 of the variances.
    _edge_costs(*(np.ascontiguousarray(part, np.float64) for part in (lines.T, near, far, share, noise)), out)
    return out


@compiled(fastmath=FAST, error_model="numpy")
def _edge_costs(lines, near, far, share, noise, out):
    count, total = len(near), len(near) + lines.shape[1]
    rows = np.empty((count, total))  # upper triangle of the covariance, then the lines
    least = 0.0
    for t in range(len(share)):
        for i in range(count):
            row, here = rows[i], share[t, i]
            for j in range(i, count):
                there = share[t, j]
                row[j] = here * there * near[i, j] + (1.0 - here) * (1.0 - there) * far[i, j] + noise[i, j]
            row[count:] = lines[i]
        if t == 0:
            for i in range(count):
                least += LEAST_OF_TRACE / count * rows[i, i]
        for i in range(count):
            rows[i, i] += least
        out[:, t] = 0.0
        for k in range(0, count, 2):  # two rows at a time: what they are taken from is loaded half as often
            pivot, other = rows[k], rows[min(k + 1, count - 1)]
            logs = _scale(pivot, k)
            if k + 1 < count:
                factor = pivot[k + 1]
                for j in range(k + 1, total):
                    other[j] -= factor * pivot[j]
                logs += _scale(other, k + 1)
            for i in range(k + 2, count):
                row, factor, further = rows[i], pivot[i], other[i]
                for j in range(i, total):
                    row[j] -= factor * pivot[j] + further * other[j]
            for p in range(len(out)):
                out[p, t] += 0.5 * (pivot[count + p] ** 2 + logs)
                if k + 1 < count:
                    out[p, t] += 0.5 * other[count + p] ** 2


@inlined(fastmath=FAST, error_model="numpy")
def _scale(row, k):
    """Divide a row by the standard deviation of its first number, whose logarithm of the variance is returned."""
    variance = row[k]
    part = 1.0 / np.sqrt(variance)
    for j in range(k, len(row)):
        row[j] *= part
    return np.log(variance)
