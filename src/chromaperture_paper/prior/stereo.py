"""The usual first attempt: OpenCV's semi-global block matching on two colour channels."""

from __future__ import annotations

import cv2
import numpy as np

_BLOCK_PX = 7  # chosen by hand


def stereo_sgbm(views: np.ndarray, directions: np.ndarray, layers_px: np.ndarray) -> np.ndarray:
    """Match two views that move along x as a stereo pair.

    ``views`` (H, W, 2) float; ``directions`` (2, 2) float: opposed, along x; ``layers_px`` (D,) float: its ends are the
    range. Returns (H, W) float64, px of half disparity in the centre view; NaN where OpenCV has no match.
    """
    left, right = (1, 0) if directions[1, 0] > directions[0, 0] else (0, 1)
    pair = [_bytes(views[..., k]) for k in (left, right)]
    ratio = float(directions[left, 0] - directions[right, 0])  # px of stereo disparity per px of half disparity
    lowest = int(np.floor(ratio * layers_px[0]))
    count = 16 * int(np.ceil((ratio * layers_px[-1] - lowest + 1) / 16))
    # Padded by the search range, in which OpenCV finds no match.
    rim = count + max(0, -lowest)
    padded = [cv2.copyMakeBorder(p, 0, 0, rim, rim, cv2.BORDER_REFLECT_101) for p in pair]
    raw = semi_global_matching(padded[0], padded[1], lowest, count)[:, rim:-rim]
    half = np.where(raw < lowest, np.nan, raw / ratio).astype(np.float32)
    # Disparities are of the left view, where pixel x of the centre is at x + d u; two rounds find that d.
    x, y = np.meshgrid(np.arange(half.shape[1], dtype=np.float32), np.arange(half.shape[0], dtype=np.float32))
    center = half
    for _ in range(2):
        at = x + np.nan_to_num(center) * np.float32(directions[left, 0])
        center = np.asarray(cv2.remap(half, at, y, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE))
    return center.astype(np.float64)


def semi_global_matching(left: np.ndarray, right: np.ndarray, lowest_px: int, count: int) -> np.ndarray:
    """Match two 8-bit pictures by OpenCV; (H, W) float32, px of ``count`` disparities from the lowest, less unknown."""
    area = _BLOCK_PX**2  # penalties as OpenCV's documentation recommends
    matcher = cv2.StereoSGBM.create(
        lowest_px, count, _BLOCK_PX, P1=8 * area, P2=32 * area, uniquenessRatio=5, mode=cv2.STEREO_SGBM_MODE_HH
    )
    return np.asarray(matcher.compute(left, right), np.float32) / 16


def _bytes(view: np.ndarray) -> np.ndarray:
    """Stretch a view to 8 bits between its first and last percentile; (H, W) uint8."""
    low, high = np.percentile(view, (1, 99))
    return np.asarray(np.clip(255 * (view - low) / max(float(high - low), 1e-6), 0, 255), np.uint8)
