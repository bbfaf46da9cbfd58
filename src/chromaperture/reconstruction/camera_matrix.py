"""The camera matrix of a reduced picture."""

from __future__ import annotations

import numpy as np


def scaled(camera_matrix: np.ndarray, scale: int) -> np.ndarray:
    """Return the camera matrix of the reduced picture, whose pixel centres lie at (scale - 1) / 2 of the full one's."""
    matrix = np.array(camera_matrix, float)
    matrix[:2] /= scale
    matrix[:2, 2] -= (scale - 1) / (2 * scale)
    return matrix
