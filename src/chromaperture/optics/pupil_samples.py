"""An aperture as weighted points of the pupil."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from chromaperture.optics.aperture import Aperture


@lru_cache(maxsize=64)
def pupil_samples(aperture: Aperture, cells: int, supersampling: int = 8) -> tuple[np.ndarray, np.ndarray]:
    """Sample the pupil by the cells of a square grid, each with the light that passes it.

    Every cell averages finer midpoints, so that a cell cut by a rim is weighted by its area; with an even count a
    division along an axis lies between cells.

    ``cells``: cells across the pupil, even; ``supersampling``: midpoints across a cell. Returns ``points`` (S, 2)
    float64: centre of the part of each cell inside the pupil, pupil radii; ``weights`` (S, 3) float64: fraction of the
    open pupil's light in R, G, B; over all cells they sum to the channel transmissions.
    """
    fine = cells * supersampling
    axis = (np.arange(fine) + 0.5) * 2 / fine - 1
    x, y = np.meshgrid(axis, axis)
    inside = (np.hypot(x, y) < 1).astype(float)

    def per_cell(values: np.ndarray) -> np.ndarray:
        blocks = values.reshape(cells, supersampling, cells, supersampling, -1)
        return blocks.sum(axis=(1, 3)).reshape(cells * cells, -1)

    area = per_cell(inside)[:, 0]
    used = area > 0
    light = per_cell(aperture.transmission_map(x, y))[used]
    points = np.hstack([per_cell(x * inside), per_cell(y * inside)])[used] / area[used, None]
    return points, light / area.sum()
