"""Noise of photographs by dual-pixel sensors, of which both halves of a pixel share a part."""

from __future__ import annotations

from itertools import pairwise

import cv2
import numpy as np

# Chosen by hand: squares small enough to lie between edges, and enough of them in a range of light for a percentile
_SQUARE_PX = 16
_PERCENTILE = 10  # of the squares' power in a range of light: the others hold detail
_RANGES_OF_LIGHT = np.linspace(0, 1, 9) ** 2
_LEAST_SQUARES = 30
_NOISIEST = 3  # ranges of light whose mean counts: where rounding leaves none of the noise the measure is too small
_TEXTURED = 2.0  # times the median of all ranges of light: such a range has no flat squares
# Red and blue share half of their noise, and green is their mean: as a pattern of all three channels, noise has 3 times
# the power that green has. The likelihood takes channels' noise to be independent, so that each gets as much.
_SHARED = 3.0
_LAPLACIAN = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32) / 6  # of unit power for white noise


def shared_noise_ratio(image: np.ndarray, variance: np.ndarray) -> float:
    """Measure how many times a photograph's noise variance is that which is expected of its sensor, at least 1.

    Both halves of a pixel share noise: on walls without detail, at all frequencies, the power of their sum is 2 to 3
    times that of their difference. Against a model of noise of their own, what they share is sharp detail without
    parallax, and blank walls stand at the focus.

    ``image`` (H, W, 3) float, linear: red and blue are the halves, green is their mean; ``variance`` of its shape.
    """
    power, light = (_squares(part) for part in (cv2.filter2D(image[..., 1], -1, _LAPLACIAN) ** 2 / variance[..., 1],
                                                image[..., 1]))  # fmt: skip
    found = []
    for low, high in pairwise(_RANGES_OF_LIGHT):
        inside = (light >= low) & (light < high) & np.isfinite(power)
        if inside.sum() >= _LEAST_SQUARES:
            found.append(float(np.percentile(power[inside], _PERCENTILE)))
    flat = [power for power in found if power <= _TEXTURED * np.median(found)]
    return max(1.0, _SHARED * float(np.mean(sorted(flat)[-_NOISIEST:]))) if flat else 1.0


def _squares(picture: np.ndarray) -> np.ndarray:
    """Mean of every square; flat."""
    rows, columns = (n // _SQUARE_PX for n in picture.shape)
    whole = picture[: rows * _SQUARE_PX, : columns * _SQUARE_PX]
    return np.asarray(whole.reshape(rows, _SQUARE_PX, columns, _SQUARE_PX).mean(axis=(1, 3)).ravel())
