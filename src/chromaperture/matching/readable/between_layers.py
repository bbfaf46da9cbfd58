"""Where between two layers a surface lies, from all that is around a pixel.

Penalties for a change of layer keep the paths of semi-global matching at one layer over a whole wall, so their costs no
longer show where between two layers it lies. The volume does, once it is averaged over neighbours. Without a compiled
twin: OpenCV does the averaging.
"""

from __future__ import annotations

import cv2
import numpy as np

from chromaperture.matching.readable.paths import LEAST_UNEXPLAINED
from chromaperture.system.threads import each_band

TANGENTS = 2  # iterations; chosen by hand


def between_layers(
    disparity_px: np.ndarray, likelihood: np.ndarray, layers_px: np.ndarray, *, sigma: float
) -> np.ndarray:
    """Move a map from its nearest layers to the most likely place about them, half a layer at most.

    The unexplained fraction s = exp(-2 l) of a pixel is a parabola ``s0 + a o + b o^2`` in the offset o from the layer.
    The sum of the log s over a window is bounded from above by its tangents at the last offset, which in turn are least
    at ``o = -sum(a / s) / sum(2 b / s)``.

    ``disparity_px`` (H, W) float, px: no NaN; ``likelihood`` (H, W, D) float, nats a pixel; ``layers_px`` (D,) float,
    px; ``sigma``: of the Gaussian window, samples of the map. Returns (H, W) float32, px.
    """
    step = float(layers_px[1] - layers_px[0])
    nearest = np.clip(np.rint((disparity_px - layers_px[0]) / step).astype(np.intp), 1, len(layers_px) - 2)
    slope, bend = np.empty((2, *nearest.shape), likelihood.dtype)

    def fit(rows: slice) -> None:
        three = np.take_along_axis(likelihood[rows], nearest[rows, :, None] + np.arange(-1, 2), axis=2)
        left, right = (np.exp(2 * (three[..., 1] - three[..., k])) for k in (0, 2))  # as multiples of the layer's own
        slope[rows], bend[rows] = (right - left) / 2, np.maximum((left + right) / 2 - 1, 0)

    each_band(fit, len(nearest))
    offset = np.zeros(slope.shape, np.float32)
    for _ in range(TANGENTS):
        unexplained = np.maximum(1 + offset * (slope + offset * bend), np.float32(LEAST_UNEXPLAINED))
        pull, stiffness = _averaged(slope / unexplained, sigma), _averaged(2 * bend / unexplained, sigma)
        offset = np.clip(-pull / np.maximum(stiffness, np.float32(1e-9)), -0.5, 0.5)
    return np.asarray(layers_px[0] + step * (nearest + offset), np.float32)


def _averaged(picture: np.ndarray, sigma: float) -> np.ndarray:
    return np.asarray(cv2.GaussianBlur(picture, (0, 0), sigma, borderType=cv2.BORDER_REFLECT_101))
