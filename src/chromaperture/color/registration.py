"""Residual displacement after alignment by disparity, from lateral colour and centroids moved by vignetting or leakage.

Both are smooth over the frame and linear in inverse depth. So one smooth displacement per channel,

    delta_k(x, y, d) = a + b x + c y + e d,

is fitted to the aligned picture itself: windows are registered by normalised correlation, and the eight coefficients
minimise the sum of distances (not squared: robust to outliers). The remaining displacement that is consistent within a
surface, such as that of a biased disparity, is averaged over the surface, in cells of image position and disparity.
This only for sub-apertures of equal shape: halves of a pupil, and mixed channels, differ in the shape of their blur,
which single windows misread as displacement, of a sign that depends on their texture.
"""

from __future__ import annotations

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

from chromaperture.system.threads import each_band

# Chosen by hand; the result on test captures is in docs/colour.md, "Alignment".
_SMOOTH_PX = 1.0  # sigma, against noise
_HALF, _STRIDE = 19, 16  # half side of a window and distance between windows, px
_SEARCH = 5  # px
_ENOUGH = 1500  # windows for the smooth model: in large pictures the stride grows
_ROUNDS = 2  # of the smooth model, and of the averages over surfaces
_LARGEST_PX = 2.5  # a larger correction is rejected as not due to a lens
_LEAST_GRADIENT = 4e-3  # square root of light per px, in the direction of least texture
_LEAST_NCC = 0.8
_LEAST_WINDOWS = 25
_PARTS = 3  # along each side of a window, from whose consistency its error is estimated
_SOFT_PX = 0.05  # smaller residuals are weighted as squares
_RIDGE = 1e-2  # prior of no displacement, in windows
_CELL_PX, _CELL_DISPARITY = 48.0, 0.7  # px, of position and of disparity, over which a surface is averaged
_CELL_PRIOR = 2.0  # prior of no displacement in each cell, in windows
_HALF_WEIGHT_ERROR_PX = 0.1  # standard error of a window of half weight: texture allows a figure below it
_HALF_WEIGHT_PX = 0.5  # displacement of a window of half weight
_REWEIGHTINGS = 30


def residual_displacement(aligned: np.ndarray, disparity_px: np.ndarray, *, surfaces: bool = True) -> np.ndarray:
    """Measure the smooth displacement of red and blue from green that remains; (3, 2, H, W) px, 0 for green."""
    height, width = disparity_px.shape
    tone = np.maximum(np.asarray(aligned, np.float32), 0)
    tone = np.asarray(cv2.GaussianBlur(np.sqrt(tone, out=tone), (0, 0), _SMOOTH_PX))
    disparity = np.asarray(disparity_px, np.float32)
    scale = max(float(np.abs(disparity).max()), 1e-3)
    x, y = np.linspace(-1, 1, width), np.linspace(-1, 1, height)
    green = np.ascontiguousarray(tone[..., 1])
    stride = _STRIDE if surfaces else max(_STRIDE, round((height * width / _ENOUGH) ** 0.5))
    out = np.zeros((3, 2, height, width), np.float32)
    for k in (0, 2):
        channel = np.ascontiguousarray(tone[..., k])
        for turn in range(2 * _ROUNDS if surfaces else _ROUNDS):
            places, found, error = registered_windows(_moved(channel, out[k]), green, stride)
            if len(places) < _LEAST_WINDOWS:
                break
            if turn < _ROUNDS:
                columns, rows = places.T
                basis = np.stack([np.ones(len(places)), x[columns], y[rows], disparity[rows, columns] / scale])
                _add_smooth(out[k], _fitted(basis.T, found, error), x, y, disparity / np.float32(scale))
            else:
                out[k] += by_surface(places, found, error, disparity)
        if max(float(out[k].max()), -float(out[k].min())) > _LARGEST_PX:
            out[k] = 0
    return out


def _moved(channel: np.ndarray, displacement_px: np.ndarray) -> np.ndarray:
    """Sample a channel (H, W) at x + displacement, (2, H, W) px, band by band: of many megapixels maps are large."""
    moved = np.empty_like(channel)
    columns = np.arange(channel.shape[1], dtype=np.float32)[None]

    def sample(band: slice) -> None:
        rows = np.arange(band.start, band.stop, dtype=np.float32)[:, None]
        x, y = columns + displacement_px[0, band], rows + displacement_px[1, band]
        cv2.remap(channel, x, y, cv2.INTER_CUBIC, dst=moved[band], borderMode=cv2.BORDER_REPLICATE)

    each_band(sample, len(channel))
    return moved


def _add_smooth(out: np.ndarray, coefficients: np.ndarray, x: np.ndarray, y: np.ndarray, relative: np.ndarray) -> None:
    """Add the smooth model of coefficients (4, 2) to a displacement (2, H, W), band by band."""

    def add(band: slice) -> None:
        for part, (constant, across, down, near) in zip(out, coefficients.T, strict=True):
            part[band] += (constant + across * x)[None] + (down * y[band])[:, None] + near * relative[band]

    each_band(add, len(y))


def by_surface(
    places_px: np.ndarray, displacement_px: np.ndarray, error_px: np.ndarray, disparity_px: np.ndarray
) -> np.ndarray:
    """Average windows over cells of image position and disparity, smoothly; (2, H, W) float32, px."""
    low, height, width = float(disparity_px.min()), *disparity_px.shape
    depth = (disparity_px - np.float32(low)) / np.float32(_CELL_DISPARITY) + 1
    shape = (int(height / _CELL_PX) + 3, int(width / _CELL_PX) + 3, int(depth.max()) + 3)
    x, y = places_px.T
    cells = np.rint([y / _CELL_PX + 1, x / _CELL_PX + 1, depth[y, x]]).astype(int)
    weight = 1 / (
        1 + np.square(displacement_px).sum(axis=1) / _HALF_WEIGHT_PX**2 + np.square(error_px) / _HALF_WEIGHT_ERROR_PX**2
    )
    sums = np.zeros((3, *shape))
    for total, value in zip(sums, (weight, *(weight * displacement_px.T)), strict=True):
        np.add.at(total, tuple(cells), value)
    sums = gaussian_filter(sums, (0, 1, 1, 1), mode="constant")
    peak = 1 / (2 * np.pi) ** 1.5  # of the smoothing kernel: weight of a single window in its own cell
    mean = sums[1:] / (sums[0] + _CELL_PRIOR * peak)
    rows, columns = np.arange(height, dtype=np.float32)[:, None], np.arange(width, dtype=np.float32)[None]
    where = np.stack(np.broadcast_arrays(rows / _CELL_PX + 1, columns / _CELL_PX + 1, depth)).astype(np.float32)
    return np.stack([map_coordinates(m, where, order=1, mode="nearest", output=np.float32) for m in mean])


def registered_windows(moved: np.ndarray, fixed: np.ndarray, stride: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Register textured windows: centres (N, 2), displacement (N, 2) of ``moved`` and its error (N,), px."""
    height, width = fixed.shape
    side = (2 * _HALF + 1, 2 * _HALF + 1)
    places, found, errors = [], [], []
    rim = _HALF + _SEARCH
    for y in range(rim, height - rim, stride):
        for x in range(rim, width - rim, stride):
            wide = fixed[y - _HALF - 1 : y + _HALF + 2, x - _HALF - 1 : x + _HALF + 2]
            if _least_gradient2(wide) < _LEAST_GRADIENT**2:
                continue
            patch = fixed[y - _HALF : y + _HALF + 1, x - _HALF : x + _HALF + 1]
            around = moved[y - rim : y + rim + 1, x - rim : x + rim + 1]
            score = cv2.matchTemplate(around, patch, cv2.TM_CCOEFF_NORMED)
            _, best, _, (i, j) = cv2.minMaxLoc(score)
            if best < _LEAST_NCC or not (0 < i < 2 * _SEARCH and 0 < j < 2 * _SEARCH):
                continue
            places.append((x, y))
            found.append((i - _SEARCH + _peak(score[j, i - 1 : i + 2]), j - _SEARCH + _peak(score[j - 1 : j + 2, i])))
            errors.append(standard_error(around[j : j + side[1], i : i + side[0]], patch))
    return np.array(places, int).reshape(-1, 2), np.array(found, float).reshape(-1, 2), np.array(errors, float)


def _least_gradient2(wide: np.ndarray) -> float:
    """Return the mean square of the gradient in the direction of least texture, of a window with a px around it."""
    gx, gy = (wide[1:-1, 2:] - wide[1:-1, :-2]) / 2, (wide[2:, 1:-1] - wide[:-2, 1:-1]) / 2
    xx, xy, yy = (float(np.vdot(a, b)) / gx.size for a, b in ((gx, gx), (gx, gy), (gy, gy)))
    return (xx + yy) / 2 - float(np.hypot((xx - yy) / 2, xy))


def standard_error(moved: np.ndarray, fixed: np.ndarray) -> float:
    """Estimate a window's displacement error, px, with residuals correlated within each of 3 x 3 parts."""
    gy, gx = np.gradient(fixed.astype(float))
    rows = np.stack([np.ones(fixed.shape), fixed - fixed.mean(), gx, gy])
    normal = np.linalg.inv(np.einsum("ayx,byx->ab", rows, rows) + 1e-12 * np.eye(4))
    coefficients = normal @ np.einsum("ayx,yx->a", rows, moved)
    residual_rows = rows * (moved - np.tensordot(coefficients, rows, 1))
    starts = np.linspace(0, fixed.shape[0], _PARTS + 1).astype(int)[:-1]
    scores = np.add.reduceat(np.add.reduceat(residual_rows, starts, axis=1), starts, axis=2).reshape(4, -1)
    covariance = normal @ (scores @ scores.T) @ normal * _PARTS**2 / (_PARTS**2 - 1)
    return float(np.sqrt(covariance[2, 2] + covariance[3, 3]) / max(abs(coefficients[1]), 1e-6))


def _peak(scores: np.ndarray) -> float:
    """Compute the vertex of the parabola through three scores, px from the middle one."""
    left, middle, right = (float(s) for s in scores)
    curvature = left - 2 * middle + right
    return 0.0 if curvature >= 0 else 0.5 * (left - right) / curvature


def _fitted(rows: np.ndarray, values: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Fit coefficients (4, 2) with the least sum of distances, by iteratively reweighted least squares."""
    prior = 1 / (1 + np.square(error) / _HALF_WEIGHT_ERROR_PX**2)
    weight = prior
    coefficients = np.zeros((rows.shape[1], 2))
    for _ in range(_REWEIGHTINGS):
        weighted = (rows * weight[:, None]).T
        normal = weighted @ rows + _RIDGE * weight.sum() / len(rows) * np.eye(rows.shape[1])
        coefficients = np.linalg.solve(normal, weighted @ values)
        residual = np.linalg.norm(values - rows @ coefficients, axis=1)
        weight = prior / np.sqrt(residual**2 + _SOFT_PX**2)
    return coefficients
