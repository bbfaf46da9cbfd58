"""Back-projection of pixels along rays that are known on a grid, compiled."""

from __future__ import annotations

import numpy as np

from chromaperture.compilation import compiled


@compiled(error_model="numpy")
def back_project(depth, rays, pitch, sensor_to_pupil, srgb, before, points, colors, first_row, last_row):  # type: ignore[no-untyped-def]
    """Fill in the points of some rows: Z = depth - delta, X and Y = Z times the ray between four of the grid.

    ``rays`` is (h, w, 2) float64, x and y at Z = 1 of every ``pitch``-th pixel; ``before`` counts the points of the
    rows above.
    """
    width = depth.shape[1]
    for y in range(first_row, last_row):
        n, row = before[y], y // pitch
        down = (y - row * pitch) / pitch
        for x in range(width):
            z = np.float64(depth[y, x]) - sensor_to_pupil
            if not np.isfinite(z):
                continue
            column = x // pitch
            right = (x - column * pitch) / pitch
            for k in range(2):
                above = rays[row, column, k] * (1 - right) + rays[row, column + 1, k] * right
                below = rays[row + 1, column, k] * (1 - right) + rays[row + 1, column + 1, k] * right
                points[n, k] = (above * (1 - down) + below * down) * z
            points[n, 2] = z
            for k in range(3):
                colors[n, k] = srgb[y, x, k]
            n += 1
