"""How blurred a chessboard is, along x and along y, from the edges between its squares."""

from __future__ import annotations

import cv2
import numpy as np
from scipy.optimize import least_squares
from scipy.special import erf

from chromaperture.optics.aperture import Aperture
from chromaperture.optics.psf import pupil_samples

_REACH = 0.42  # of a square, to either side of an edge: beyond lies the blur of the next edge; chosen by hand
_SAMPLES = 61  # of a profile, more than the px it covers; chosen by hand
_FEWEST = 4  # edges of one direction; chosen by hand
_CELLS = 32  # across the pupil; chosen by hand
GREEN = 1  # the channel in which corners are found


def edge_blur(plane: np.ndarray, corners: np.ndarray, inner_corners: tuple[int, int]) -> tuple[float, float]:
    """Measure the standard deviation of the blur across the edges of a chessboard, along x and y; px, NaN unknown.

    Every stretch between two neighbouring corners is an edge. Profiles across all edges of one direction are averaged,
    dark to bright, and the integral of a Gaussian is fitted. Of a disc of radius r it finds about 0.5 r.
    """
    columns, rows = inner_corners
    grid = corners.reshape(rows, columns, 2).astype(float)
    found = {0: [], 1: []}  # type: dict[int, list[np.ndarray]]
    lengths: dict[int, list[float]] = {0: [], 1: []}
    for axis in (0, 1):
        first, second = (grid[:-1], grid[1:]) if axis == 0 else (grid[:, :-1], grid[:, 1:])
        for a, b in zip(first.reshape(-1, 2), second.reshape(-1, 2), strict=True):
            length = float(np.linalg.norm(b - a))
            across = np.array([-(b - a)[1], (b - a)[0]]) / max(length, 1e-6)
            upright = int(abs(across[0]) < abs(across[1]))  # 0: the edge is upright, and is crossed along x
            found[upright].append(_profile(plane, (a + b) / 2, across, (b - a) / length, _REACH * length))
            lengths[upright].append(length)
    return _spread(found[0], lengths[0]), _spread(found[1], lengths[1])


def _profile(
    plane: np.ndarray, middle: np.ndarray, across: np.ndarray, along: np.ndarray, reach_px: float
) -> np.ndarray:
    """Sample across an edge, averaged over a third of its length."""
    steps = np.linspace(-reach_px, reach_px, _SAMPLES)[None, :, None] * across
    places = middle + steps + np.linspace(-0.4, 0.4, 5)[:, None, None] * reach_px * along
    maps = places.astype(np.float32)
    sampled = cv2.remap(plane, maps[..., 0], maps[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    profile = np.asarray(sampled.mean(axis=0), float)
    return profile if profile[-_SAMPLES // 4 :].mean() > profile[: _SAMPLES // 4].mean() else profile[::-1]


def _spread(profiles: list[np.ndarray], lengths: list[float]) -> float:
    if len(profiles) < _FEWEST:
        return float("nan")
    mean, reach = np.mean(profiles, axis=0), _REACH * float(np.mean(lengths))
    t = np.linspace(-reach, reach, _SAMPLES)
    low, high = float(mean.min()), float(mean.max())
    if not high > low:
        return float("nan")

    def residual(p: np.ndarray) -> np.ndarray:
        level = p[0] + p[1] * erf((t - p[2]) / (np.sqrt(2) * np.exp(p[3])))
        return np.asarray((level - mean) / (high - low))

    start = np.array([(low + high) / 2, (high - low) / 2, 0.0, np.log(reach / 4)])
    fit = least_squares(residual, start)
    sigma = float(np.exp(fit.x[3]))
    return sigma if 0 < sigma < 2 * reach else float("nan")


def pupil_spread(aperture: Aperture) -> tuple[float, float]:
    """Return the standard deviation of the pupil's light in green, along x and y; pupil radii."""
    points, light = pupil_samples(aperture, _CELLS)
    weight = light[:, GREEN] / light[:, GREEN].sum()
    mean = weight @ points
    x, y = np.sqrt(np.maximum(weight @ (points - mean) ** 2, 0))
    return float(x), float(y)
