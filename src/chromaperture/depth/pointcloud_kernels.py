"""Back-projection of pixels along rays that are known on a grid, and the records of their points, compiled."""

from __future__ import annotations

import numpy as np

from chromaperture.system.compilation import compiled


@compiled(error_model="numpy")
def back_project(depth, first_row, rays, pitch, sensor_to_pupil, srgb, before, points, colors):  # type: ignore[no-untyped-def]
    """Fill in the points of rows from ``first_row`` on: Z = depth - delta, X and Y = Z times the ray.

    ``rays`` is (h, w, 2) float64, x and y at Z = 1 of every ``pitch``-th pixel of the picture, between which rays are
    linear; ``before`` counts the points of the rows above.
    """
    width, columns = depth.shape[1], rays.shape[1]
    across = np.empty((2, columns))  # x and y of the row at Z = 1, at the columns of the grid
    for y in range(len(depth)):
        n, row = before[y], (first_row + y) // pitch
        down = (first_row + y - row * pitch) / pitch
        for column in range(columns):
            for k in range(2):
                across[k, column] = rays[row, column, k] * (1 - down) + rays[row + 1, column, k] * down
        for column in range(columns - 1):
            x0, y0 = across[0, column], across[1, column]
            step_x, step_y = (across[0, column + 1] - x0) / pitch, (across[1, column + 1] - y0) / pitch
            left = column * pitch
            for x in range(left, min(left + pitch, width)):
                z = np.float64(depth[y, x]) - sensor_to_pupil
                if not np.isfinite(z):
                    continue
                right = x - left
                points[n, 0], points[n, 1], points[n, 2] = (x0 + right * step_x) * z, (y0 + right * step_y) * z, z
                colors[n, 0], colors[n, 1], colors[n, 2] = srgb[y, x, 0], srgb[y, x, 1], srgb[y, x, 2]
                n += 1


@compiled(error_model="numpy")
def interleave(places, colors, vertices):  # type: ignore[no-untyped-def]
    """Put the 12 bytes of each place and the 3 of its colour behind each other: (N, 12), (N, 3) and (N, 15) uint8."""
    for n in range(len(vertices)):
        for k in range(12):
            vertices[n, k] = places[n, k]
        for k in range(3):
            vertices[n, 12 + k] = colors[n, k]
