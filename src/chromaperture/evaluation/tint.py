"""Does white keep its colour over the frame? It does not where the filter is off the stop.

Behind a stop every point of the frame sees the whole pupil; at a distance from it, points beside the axis see the
filter displaced, so that one colour gains on one side of the frame and the other on the other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from chromaperture.color.image import SATURATION

_CELLS = (8, 12)
_LEAST = 0.004  # linear light below which a cell says nothing of its colour
_ROUNDS = 5


@dataclass(frozen=True)
class Tint:
    """Change of the colour ratios over the frame.

    Attributes
    ----------
    ramp : float
        Largest change of a channel ratio from the middle of the frame to its edge, as a share.
    scatter : float
        Robust standard deviation of the cells about the ramp, as a share: large in coloured scenes.
    direction : (2,) float64
        Gradient of the ratio that changes most; x right, y down, log ratio from middle to edge.
    """

    ramp: float
    scatter: float
    direction: np.ndarray


def measure_tint(image: np.ndarray) -> Tint | None:
    """Fit a plane to the logarithms of the channel ratios over a grid of cells.

    Parameters
    ----------
    image : (H, W, 3) float, linear RGB

    Returns
    -------
    Tint, or None where fewer than half of the cells can be used
    """
    height, width = image.shape[:2]
    rows = np.array_split(np.arange(height), _CELLS[0])
    columns = np.array_split(np.arange(width), _CELLS[1])
    with np.errstate(invalid="ignore"):
        usable = (image.max(axis=2) < SATURATION) & np.isfinite(image).all(axis=2)
    values, places = [], []
    for r in rows:
        for c in columns:
            cell = image[r[0] : r[-1] + 1, c[0] : c[-1] + 1][usable[r[0] : r[-1] + 1, c[0] : c[-1] + 1]]
            if len(cell) < 16:
                continue
            mean = cell.mean(axis=0)
            if mean.min() > _LEAST:
                values.append(np.log(mean))
                places.append((2 * c.mean() / (width - 1) - 1, 2 * r.mean() / (height - 1) - 1))
    if len(values) < _CELLS[0] * _CELLS[1] / 2:
        return None
    logs = np.array(values)
    basis = np.column_stack([np.ones(len(places)), np.array(places)])
    tints = []
    for a, b in ((0, 1), (1, 2), (0, 2)):
        slope, scatter = _robust_plane(basis, logs[:, a] - logs[:, b])
        tints.append(Tint(float(np.expm1(np.hypot(*slope))), scatter, slope))
    return max(tints, key=lambda tint: tint.ramp - tint.scatter)


def _robust_plane(basis: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, float]:
    """Slopes in x and y and the robust scatter about the plane."""
    weights: np.ndarray = np.ones(len(values))
    scatter = 0.0
    solution: np.ndarray = np.zeros(3)
    for _ in range(_ROUNDS):
        solution, *_ = np.linalg.lstsq(basis * weights[:, None], values * weights, rcond=None)
        residual = values - basis @ solution
        scatter = 1.4826 * float(np.median(np.abs(residual)))
        weights = 1 / np.sqrt(np.maximum(1.0, np.abs(residual) / max(1.5 * scatter, 1e-6)))
    return solution[1:], scatter
