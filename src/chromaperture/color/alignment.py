"""Alignment of the sensor channels to the view of the pupil's centre (paper section 5.1)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

import cv2
import numpy as np

from chromaperture.color.row_alignment import (
    align_by_rows,
    fill_hidden,
    row_moves,
    scale_channels,
    shift_along_rows,
    visible_from,
)
from chromaperture.color.unmixing import view_reach
from chromaperture.optics.aperture import Aperture, centroids
from chromaperture.system.compilation import compiled
from chromaperture.system.errors import InputError
from chromaperture.system.threads import in_parallel

_STILL = 1e-3  # displacement per px of disparity that counts as none: the accuracy of the centroids


def channel_directions(aperture: Aperture, film: dict[str, np.ndarray]) -> np.ndarray:
    """Return the displacement (x, y) of R, G, B per that of the views, (3, 2), by the film's leaks."""
    return np.nan_to_num(centroids(aperture.with_film(film))) / view_reach(aperture)


def fill_unknown(values: np.ndarray, *, step: int = 1) -> np.ndarray:
    """Replace every NaN by the nearest known value, on a lattice of ``step``, or by 0 where none is known."""
    if step > 1:
        return rows_filler(values, step=step)(slice(0, len(values)))
    unknown = ~np.isfinite(values)
    if unknown.all():
        return np.zeros_like(values)
    if not unknown.any():
        return values
    return fill_from_nearest(values)


def rows_filler(values: np.ndarray, *, step: int = 1) -> Callable[[slice], np.ndarray]:
    """Return a function that gives some rows of `fill_unknown`: of many megapixels no second map is kept."""
    if step == 1:
        filled = fill_unknown(values)
        return lambda rows: filled[rows]
    known = fill_unknown(values[step // 2 :: step, step // 2 :: step])
    down, across = (np.minimum(np.arange(n) // step, m - 1) for n, m in zip(values.shape, known.shape, strict=True))

    def fill(rows: slice) -> np.ndarray:
        part = values[rows]
        y, x = np.nonzero(~np.isfinite(part))
        if len(y):
            part = part.copy()
            part[y, x] = known[down[rows][y], across[x]]
        return part

    return fill


def align_channels(
    image: np.ndarray,
    disparity_px: np.ndarray,
    directions: np.ndarray,
    *,
    displacement_px: np.ndarray | None = None,
    exact: bool = True,
) -> np.ndarray:
    """Shift each channel back by its disparity, and predict the samples that were occluded in it.

    ``image`` (H, W, 3) float32, linear RGB; ``disparity_px`` (H, W) float32, px; NaN is filled from the nearest known
    pixel; ``directions`` (3, 2) float: from `channel_directions`; ``displacement_px`` (3, 2, H, W) float32, px:
    displacement, x before y, of each channel from the centre view, from `LensShift` or `residual_displacement`;
    disparity times direction when absent; ``exact``: sample by Lanczos' filter where ``displacement_px`` is given, else
    by cubics, in a third of the time. Returns (H, W, 3) float32, linear RGB, in the view of the pupil's centre. Raises
    InputError: disparity and image differ in size.
    """
    if image.shape[:2] != disparity_px.shape:
        raise InputError(
            f"disparity {disparity_px.shape} and image {image.shape[:2]} differ in size: they are of two photographs"
        )
    filled = fill_unknown(disparity_px).astype(np.float32, copy=False)
    along = row_moves(directions) if displacement_px is None else None
    if along is not None:
        return align_by_rows(image, lambda rows: filled[rows], along)
    moved = linear_displacement(filled, directions) if displacement_px is None else iter(displacement_px)
    # Cubics smooth a channel by its fraction of a px, which registration reads as displacement (docs/colour.md).
    cubic = displacement_px is None or not exact
    color = shift_back(image, moved, interpolation=cv2.INTER_CUBIC if cubic else cv2.INTER_LANCZOS4)
    visible = np.empty(image.shape, bool)
    for k, u in enumerate(np.asarray(directions, float)):
        visible[..., k] = visible_from(filled, u)
    order = np.argsort(np.linalg.norm(directions, axis=1), kind="stable")
    return fill_hidden(color, visible, filled, order, out=color)


def linear_displacement(disparity_px: np.ndarray, directions: np.ndarray) -> Iterator[np.ndarray]:
    """Compute disparity times direction, one channel after the other; (2, H, W) float32 each, px, x before y."""
    u = np.asarray(directions, np.float32)
    u = np.where(np.abs(u) < _STILL, np.float32(0), u)
    disparity = np.asarray(disparity_px, np.float32)
    for along in u:
        moved = np.zeros((2, *disparity.shape), np.float32)
        for part, factor in zip(moved, along, strict=True):
            if factor:
                np.multiply(disparity, factor, out=part)
        yield moved


def shift_back(
    image: np.ndarray, displacement_px: Iterable[np.ndarray], *, interpolation: int = cv2.INTER_CUBIC
) -> np.ndarray:
    """Sample each channel at x + its displacement, (2, H, W) px, by an OpenCV interpolation; (H, W, 3) float32."""
    height, width = image.shape[:2]
    x, y = np.arange(width, dtype=np.float32)[None], np.arange(height, dtype=np.float32)[:, None]
    color = np.empty((height, width, 3), np.float32)
    image = np.ascontiguousarray(image, np.float32)
    for k, (dx, dy) in enumerate(displacement_px):
        if not dx.any() and not dy.any():
            color[..., k] = image[..., k]
            continue
        if interpolation == cv2.INTER_CUBIC and not dy.any():
            shift_along_rows(image, dx, k, color)
            continue
        plane = np.ascontiguousarray(image[..., k])
        color[..., k] = cv2.remap(plane, x + dx, y + dy, interpolation, borderMode=cv2.BORDER_REPLICATE)
    return color


def white_balance(color: np.ndarray, white_rgb: np.ndarray) -> np.ndarray:
    """Scale the channels so that a white sheet seen through the aperture becomes white; (H, W, 3) linear."""
    color, balanced = np.ascontiguousarray(color, np.float32), np.empty(color.shape, np.float32)
    scale_channels(color, white_gains(white_rgb), balanced)
    return balanced


def white_gains(white_rgb: np.ndarray) -> np.ndarray:
    """Return the factors of `white_balance`; (3,) float32."""
    white = np.asarray(white_rgb, np.float32)
    return white.max() / white


def fill_from_nearest(values: np.ndarray) -> np.ndarray:
    """Replace every NaN by a nearest known value, exactly (Felzenszwalb and Huttenlocher 2012), faster than SciPy."""
    values = np.ascontiguousarray(values)
    rows, filled = np.empty(values.shape, np.int32), values.copy()
    _nearest_rows(values, rows)
    in_parallel(lambda _, first, last: _fill_rows(values, rows, filled, first, last), len(values))
    return filled


@compiled()
def _nearest_rows(values, rows):  # type: ignore[no-untyped-def]
    """Find the row of the nearest known pixel in the same column, -1 where there is none."""
    height, width = values.shape
    for y in range(height):
        for x in range(width):
            if np.isfinite(values[y, x]):
                rows[y, x] = y
            else:
                rows[y, x] = rows[y - 1, x] if y > 0 else -1
    for y in range(height - 2, -1, -1):
        for x in range(width):
            above, below = rows[y, x], rows[y + 1, x]
            if below >= 0 and (above < 0 or below - y < y - above):
                rows[y, x] = below


@compiled(error_model="numpy")
def _fill_rows(values, rows, filled, first_row, last_row):  # type: ignore[no-untyped-def]
    width = values.shape[1]
    lowest, begins = np.empty(width, np.int64), np.empty(width)  # parabolas of the envelope, and where each begins
    heights = np.empty(width)
    for y in range(first_row, last_row):
        first = 0
        while first < width:
            if np.isfinite(values[y, first]):
                first += 1
                continue
            last = first  # of a run of unknown pixels; what is known beside it hides all that is beyond
            while last + 1 < width and not np.isfinite(values[y, last + 1]):
                last += 1
            count = 0
            for x in range(max(first - 1, 0), min(last + 2, width)):
                if rows[y, x] < 0:
                    continue
                heights[x] = float(rows[y, x] - y) ** 2 + float(x) ** 2
                begin = -np.inf
                while count > 0:
                    p = lowest[count - 1]
                    begin = (heights[x] - heights[p]) / (2.0 * (x - p))
                    if begin > begins[count - 1]:
                        break
                    count -= 1
                    begin = -np.inf
                lowest[count], begins[count] = x, begin
                count += 1
            at = 0
            for x in range(first, last + 1):
                while at + 1 < count and begins[at + 1] < x:
                    at += 1
                filled[y, x] = values[rows[y, lowest[at]], lowest[at]]
            first = last + 1
