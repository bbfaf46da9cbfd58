"""Change of colour over the frame, which shows a filter outside the plane of the stop.

In the stop, every image position sees the whole filter. At a distance from it, off-axis positions see the filter
displaced, so that one colour dominates on one side of the frame and the other colour on the other side.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from chromaperture.color.image import SATURATION
from chromaperture.system.robust import robust_sigma

_CELLS = (8, 12)  # rows, columns
_LEAST = 0.004  # mean of a channel, of white level, below which a cell is too dark to have a colour; chosen by hand
_LEAST_PIXELS = 16  # usable ones of a cell; chosen by hand
_ROUNDS = 5  # of reweighting; chosen by hand
_LINEAR_FROM = 1.5  # robust standard deviations at which the loss turns linear, as Huber's at 1.345; chosen by hand


@dataclass(frozen=True)
class Tint:
    """Change of the colour ratios over the frame."""

    ramp: float  # largest relative change of a channel ratio from the middle of the frame to its edge
    scatter: float  # robust relative standard deviation of the cells about the ramp: large in coloured scenes


def measure_tint(image: np.ndarray) -> Tint | None:
    """Fit a plane to the logarithms of the channel ratios over a grid of cells.

    ``image`` (H, W, 3) float, linear RGB. Returns Tint, or None where fewer than half of the cells can be used.
    """
    height, width = image.shape[:2]
    rows = np.array_split(np.arange(height), _CELLS[0])
    columns = np.array_split(np.arange(width), _CELLS[1])
    with np.errstate(invalid="ignore"):
        usable = (image.max(axis=2) < SATURATION) & np.isfinite(image).all(axis=2)
    values, positions = [], []
    for r in rows:
        for c in columns:
            cell = image[r[0] : r[-1] + 1, c[0] : c[-1] + 1][usable[r[0] : r[-1] + 1, c[0] : c[-1] + 1]]
            if len(cell) < _LEAST_PIXELS:
                continue
            mean = cell.mean(axis=0)
            if mean.min() > _LEAST:
                values.append(np.log(mean))
                positions.append((2 * c.mean() / (width - 1) - 1, 2 * r.mean() / (height - 1) - 1))
    if len(values) < _CELLS[0] * _CELLS[1] / 2:
        return None
    logs = np.array(values)
    basis = np.column_stack([np.ones(len(positions)), np.array(positions)])
    tints = []
    for a, b in ((0, 1), (1, 2), (0, 2)):
        slope, scatter = _robust_plane(basis, logs[:, a] - logs[:, b])
        tints.append(Tint(float(np.expm1(np.hypot(*slope))), scatter))
    return max(tints, key=lambda tint: tint.ramp - tint.scatter)


def _robust_plane(basis: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, float]:
    """Fit a plane by reweighted least squares; return its slopes in x and y and the robust scatter about it."""
    weights: np.ndarray = np.ones(len(values))
    scatter = 0.0
    solution: np.ndarray = np.zeros(3)
    for _ in range(_ROUNDS):
        solution, *_ = np.linalg.lstsq(basis * weights[:, None], values * weights, rcond=None)
        residual = values - basis @ solution
        scatter = robust_sigma(residual)
        weights = 1 / np.sqrt(np.maximum(1.0, np.abs(residual) / max(_LINEAR_FROM * scatter, 1e-6)))
    return solution[1:], scatter
