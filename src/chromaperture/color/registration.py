"""What alignment by disparity leaves: the lens's own lateral colour, centroids that vignetting or leaking film moved.

All are smooth over the frame and linear in inverse depth. So one smooth displacement a channel,

    delta_k(x, y, d) = a + b x + c y + e d,

is fitted to the aligned picture itself: windows are registered by their normalised correlation, and the eight numbers
are those from which they depart least in the sum of distances, which no few wrong windows can sway. What windows of
one surface then still agree on, such as a disparity that is off by a little, is averaged over that surface, in cells
of place and disparity. That only for sub-apertures of one shape: halves of a pupil, and mixed channels, blur each in a
way of its own, which a few windows read as displacement, one way or the other with their texture.
"""

from __future__ import annotations

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

_SMOOTH_PX = 1.0  # against grain
_HALF, _STRIDE = 19, 16  # half side of a window and distance of two, px
_SEARCH = 5  # px
_ENOUGH = 1500  # windows for one smooth model: a large picture is not searched more densely
_ROUNDS = 2  # of the smooth model, and as many of the surfaces' own
_LARGEST_PX = 2.5  # a larger correction is no lens's
_LEAST_GRADIENT = 4e-3  # of the square root of light, a px, in the direction in which it is least
_LEAST_NCC = 0.8
_LEAST_WINDOWS = 25
_PARTS = 3  # along each side of a window, whose agreement tells the window's error
_SOFT_PX = 0.05  # departures below this count as squares
_RIDGE = 1e-2  # windows that say "no displacement"
_CELL_PX, _CELL_DISPARITY = 48.0, 0.7  # px, of place and of disparity, over which a surface is averaged
_DOUBT = 2.0  # windows that say "no displacement" in each cell
_DOUBTFUL_PX = 0.1  # a window of this error counts half
_FAR_PX = 0.5  # a window that departs by this from the model counts half


def residual_displacement(
    aligned: np.ndarray,
    disparity_px: np.ndarray,
    *,
    surfaces: bool = True,
    reference: int = 1,
    valid: np.ndarray | None = None,
) -> np.ndarray:
    """Measure the smooth displacement that is left between the channels.

    Parameters
    ----------
    aligned : (H, W, 3) float32, linear RGB
        From `align_channels`.
    disparity_px : (H, W) float32, px, no NaN
    surfaces : bool
        Average over single surfaces too, not over the whole frame only.
    reference : int
        The channel that stays; the others move.
    valid : (H, W) bool, optional
        Only windows that lie wholly in it are registered.

    Returns
    -------
    (3, 2, H, W) float32, px, x before y: sample channel k further by this; zero where the texture does not tell
    """
    height, width = disparity_px.shape
    tone = np.sqrt(np.maximum(np.asarray(aligned, np.float32), 0))
    tone = np.asarray(cv2.GaussianBlur(tone, (0, 0), _SMOOTH_PX))
    disparity = np.asarray(disparity_px, np.float32)
    basis = _basis(disparity)
    stride = _STRIDE if surfaces else max(_STRIDE, round((height * width / _ENOUGH) ** 0.5))
    out = np.zeros((3, 2, height, width), np.float32)
    grid_x, grid_y = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    for k in {0, 1, 2} - {reference}:
        for turn in range(2 * _ROUNDS if surfaces else _ROUNDS):
            moved = cv2.remap(tone[..., k], grid_x + out[k, 0], grid_y + out[k, 1], cv2.INTER_CUBIC,
                              borderMode=cv2.BORDER_REPLICATE)  # fmt: skip
            places, found, error = registered_windows(
                np.asarray(moved), tone[..., reference], valid=valid, stride=stride
            )
            if len(places) < _LEAST_WINDOWS:
                break
            if turn < _ROUNDS:
                step = _fitted(basis[:, places[:, 1], places[:, 0]].T, found, error)
                out[k] += np.tensordot(step.T, basis, (1, 0)).astype(np.float32)
            else:
                out[k] += by_surface(places, found, error, disparity)
        if np.abs(out[k]).max() > _LARGEST_PX:
            out[k] = 0
    return out


def by_surface(
    places_px: np.ndarray, displacement_px: np.ndarray, error_px: np.ndarray, disparity_px: np.ndarray
) -> np.ndarray:
    """Average windows over cells of place and disparity, smoothly from cell to cell.

    Parameters
    ----------
    places_px : (N, 2) int, (x, y)
    displacement_px : (N, 2) float, (x, y)
    error_px : (N,) float
    disparity_px : (H, W) float32, no NaN

    Returns
    -------
    (2, H, W) float32, px, x before y; near zero where there are no windows
    """
    low, height, width = float(disparity_px.min()), *disparity_px.shape
    depth = (disparity_px - np.float32(low)) / np.float32(_CELL_DISPARITY) + 1
    shape = (int(height / _CELL_PX) + 3, int(width / _CELL_PX) + 3, int(depth.max()) + 3)
    x, y = places_px.T
    cells = np.rint([y / _CELL_PX + 1, x / _CELL_PX + 1, depth[y, x]]).astype(int)
    weight = 1 / (1 + np.square(displacement_px).sum(axis=1) / _FAR_PX**2 + np.square(error_px) / _DOUBTFUL_PX**2)
    sums = np.zeros((3, *shape))
    for total, value in zip(sums, (weight, *(weight * displacement_px.T)), strict=True):
        np.add.at(total, tuple(cells), value)
    sums = gaussian_filter(sums, (0, 1, 1, 1), mode="constant")
    share = 1 / (2 * np.pi) ** 1.5  # of a lone window in its own cell
    mean = sums[1:] / (sums[0] + _DOUBT * share)
    rows, columns = np.arange(height, dtype=np.float32)[:, None], np.arange(width, dtype=np.float32)[None]
    where = np.stack(np.broadcast_arrays(rows / _CELL_PX + 1, columns / _CELL_PX + 1, depth)).astype(np.float32)
    return np.stack([map_coordinates(m, where, order=1, mode="nearest", output=np.float32) for m in mean])


def registered_windows(
    moved: np.ndarray, fixed: np.ndarray, *, valid: np.ndarray | None = None, stride: int = _STRIDE
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Displacement between two pictures, window by window where they have texture in both directions.

    Parameters
    ----------
    moved, fixed : (H, W) float32
    valid : (H, W) bool, optional
        Windows that leave it are left out.
    stride : int, px
        From window to window.

    Returns
    -------
    places_px : (N, 2) int, (x, y)
        Middles of the windows.
    displacement_px : (N, 2) float64, (x, y)
        What ``fixed`` shows at x, ``moved`` shows at x + displacement.
    error_px : (N,) float64
        Standard error of each.
    """
    height, width = fixed.shape
    gy, gx = np.gradient(fixed)
    side = (2 * _HALF + 1, 2 * _HALF + 1)
    xx, xy, yy = (cv2.boxFilter(p, -1, side) for p in (gx * gx, gx * gy, gy * gy))
    least = (xx + yy) / 2 - np.sqrt(((xx - yy) / 2) ** 2 + xy**2)
    if valid is not None:
        least = np.where(cv2.erode(valid.astype(np.uint8), np.ones(side, np.uint8)) > 0, least, 0)
    places, found, errors = [], [], []
    rim = _HALF + _SEARCH
    for y in range(rim, height - rim, stride):
        for x in range(rim, width - rim, stride):
            if least[y, x] < _LEAST_GRADIENT**2:
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


def standard_error(moved: np.ndarray, fixed: np.ndarray) -> float:
    """How far a window's displacement can be relied on: from what it leaves, part by part of the window.

    A line in the tone and a small shift are fitted, and their error is that of least squares with errors that hang
    together within a part, whatever they are: grain, a colour that one channel has and the other has not, two depths.

    Parameters
    ----------
    moved, fixed : (h, w) float32
        To a px in place.

    Returns
    -------
    float, px
    """
    gy, gx = np.gradient(fixed.astype(float))
    rows = np.stack([np.ones(fixed.shape), fixed - fixed.mean(), gx, gy])
    normal = np.linalg.inv(np.einsum("ayx,byx->ab", rows, rows) + 1e-12 * np.eye(4))
    coefficients = normal @ np.einsum("ayx,yx->a", rows, moved)
    left = rows * (moved - np.tensordot(coefficients, rows, 1))
    starts = np.linspace(0, fixed.shape[0], _PARTS + 1).astype(int)[:-1]
    scores = np.add.reduceat(np.add.reduceat(left, starts, axis=1), starts, axis=2).reshape(4, -1)
    covariance = normal @ (scores @ scores.T) @ normal * _PARTS**2 / (_PARTS**2 - 1)
    return float(np.sqrt(covariance[2, 2] + covariance[3, 3]) / max(abs(coefficients[1]), 1e-6))


def _peak(scores: np.ndarray) -> float:
    """Vertex of the parabola through three scores."""
    left, middle, right = (float(s) for s in scores)
    curvature = left - 2 * middle + right
    return 0.0 if curvature >= 0 else 0.5 * (left - right) / curvature


def _basis(disparity: np.ndarray) -> np.ndarray:
    height, width = disparity.shape
    y, x = np.meshgrid(np.linspace(-1, 1, height), np.linspace(-1, 1, width), indexing="ij")
    scale = max(float(np.abs(disparity).max()), 1e-3)
    return np.stack([np.ones_like(x), x, y, disparity / scale]).astype(np.float32)


def _fitted(rows: np.ndarray, values: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Coefficients (4, 2) that leave the least sum of distances, by reweighted least squares."""
    sure = 1 / (1 + np.square(error) / _DOUBTFUL_PX**2)  # windows count by their own error
    weight = sure
    coefficients = np.zeros((rows.shape[1], 2))
    for _ in range(30):
        weighted = (rows * weight[:, None]).T
        normal = weighted @ rows + _RIDGE * weight.sum() / len(rows) * np.eye(rows.shape[1])
        coefficients = np.linalg.solve(normal, weighted @ values)
        left = np.linalg.norm(values - rows @ coefficients, axis=1)
        weight = sure / np.sqrt(left**2 + _SOFT_PX**2)
    return coefficients
