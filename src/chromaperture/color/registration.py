"""What alignment by disparity leaves: the lens's own lateral colour, and centroids that vignetting has moved.

Both are smooth over the frame. So one smooth displacement a channel,

    delta_k(x, y, d) = a + b x + c y + e d,

is fitted to the aligned picture itself by Gauss-Newton on locally normalised channels, robustly: eight numbers from
all pixels, which no single wrong depth can sway. Not for two halves of a pupil: their blurs are mirror images, and
registration reads that as displacement.
"""

from __future__ import annotations

import cv2
import numpy as np

_SMOOTH_PX, _WINDOW_PX = 1.2, 25
_ROUNDS = 4
_LARGEST_PX = 2.5  # a larger correction is no lens's
_LEAST_TEXTURE = 0.01  # of the square root of light
_LEAST_NCC = 0.7
_RIDGE = 1e-3


def residual_displacement(aligned: np.ndarray, disparity_px: np.ndarray, *, reference: int = 1) -> np.ndarray:
    """Measure the smooth displacement that is left between the channels.

    Parameters
    ----------
    aligned : (H, W, 3) float32, linear RGB
        From `align_channels`.
    disparity_px : (H, W) float32, px, no NaN
    reference : int
        The channel that stays; the others move.

    Returns
    -------
    (3, 2, H, W) float32, px, x before y: sample channel k further by this; zero where the texture does not tell
    """
    height, width = disparity_px.shape
    tone = np.sqrt(np.maximum(np.asarray(aligned, np.float32), 0))
    tone = np.asarray(cv2.GaussianBlur(tone, (0, 0), _SMOOTH_PX))
    basis = _basis(np.asarray(disparity_px, np.float32))
    fixed, spread = _normalised(tone[..., reference])
    out = np.zeros((3, 2, height, width), np.float32)
    grid_x, grid_y = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    for k in {0, 1, 2} - {reference}:
        for _ in range(_ROUNDS):
            moved = cv2.remap(tone[..., k], grid_x + out[k, 0], grid_y + out[k, 1], cv2.INTER_LINEAR,
                              borderMode=cv2.BORDER_REPLICATE)  # fmt: skip
            step = _step(np.asarray(moved), fixed, spread, basis)
            if step is None:
                break
            out[k] += np.tensordot(step, basis, (0, 0)).astype(np.float32)
        if not np.isfinite(out[k]).all() or np.abs(out[k]).max() > _LARGEST_PX:
            out[k] = 0
    return out


def _basis(disparity: np.ndarray) -> np.ndarray:
    height, width = disparity.shape
    y, x = np.meshgrid(np.linspace(-1, 1, height), np.linspace(-1, 1, width), indexing="ij")
    return np.stack([np.ones_like(x), x, y, disparity]).astype(np.float32)


def _normalised(plane: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Local mean removed, local standard deviation one; and that deviation."""
    size = (_WINDOW_PX, _WINDOW_PX)
    mean = cv2.boxFilter(plane, -1, size)
    spread = np.sqrt(np.maximum(cv2.boxFilter(plane * plane, -1, size) - mean * mean, 1e-8))
    return (plane - mean) / spread, spread


def _step(moved: np.ndarray, fixed: np.ndarray, spread: np.ndarray, basis: np.ndarray) -> np.ndarray | None:
    """One Gauss-Newton step; (4, 2), or None where there is too little texture."""
    mine, own = _normalised(moved)
    alike = cv2.boxFilter(mine * fixed, -1, (_WINDOW_PX, _WINDOW_PX))  # local correlation
    usable = (alike > _LEAST_NCC) & (spread > _LEAST_TEXTURE) & (own > _LEAST_TEXTURE)
    usable[:8] = usable[-8:] = usable[:, :8] = usable[:, -8:] = False
    if usable.sum() < 2000:
        return None
    # The slope of both pictures, averaged: a step that is as long one way as the other.
    gy, gx = (0.5 * (a + b) for a, b in zip(np.gradient(mine), np.gradient(fixed), strict=True))
    error = (fixed - mine)[usable]
    scale = 1.48 * float(np.median(np.abs(error))) + 1e-6
    weight = np.maximum(1 - (error / (4.7 * scale)) ** 2, 0) ** 2  # Tukey's
    at = basis[:, usable]
    rows = np.concatenate([at * gx[usable], at * gy[usable]])
    normal = (rows * weight) @ rows.T
    normal += _RIDGE * np.trace(normal) / len(normal) * np.eye(len(normal))
    return np.asarray(np.linalg.solve(normal, rows @ (weight * error)).reshape(2, -1).T)
