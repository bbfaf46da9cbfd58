"""Alignment of the sensor channels to the view of the pupil's centre (paper section 5.1)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import cv2
import numpy as np

from chromaperture.color.nearest_known import fill_from_nearest
from chromaperture.color.row_alignment import align_rows, balance
from chromaperture.color.shift_kernels import shift_along_rows
from chromaperture.color.unmixing import view_reach
from chromaperture.color.visibility import STILL, fill_hidden, visible_from
from chromaperture.errors import InputError
from chromaperture.optics.aperture import Aperture, centroids
from chromaperture.threads import each_band

_STILL = 1e-3  # displacement per px of disparity that counts as none: the accuracy of the centroids


def channel_directions(aperture: Aperture, film: dict[str, np.ndarray]) -> np.ndarray:
    """Compute the displacement (x, y) of the sensor's R, G, B in units of the views' displacement; (3, 2) float64.

    Film leaks: red sees a little of the cyan half too, and moves less than the unmixed yellow view. ``film`` holds the
    measured R, G, B transmission of each filter; missing ones keep the design's ideal film.
    """
    return np.nan_to_num(centroids(aperture.with_film(film))) / view_reach(aperture)


def fill_unknown(values: np.ndarray, *, step: int = 1) -> np.ndarray:
    """Replace every NaN by the nearest known value, or all by zero when none is known; (H, W).

    With a ``step`` the nearest is looked for among every so many rows and columns: for maps of many megapixels that
    were interpolated between pixels so far apart.
    """
    unknown = ~np.isfinite(values)
    if step > 1 and unknown.any():
        known = fill_unknown(values[step // 2 :: step, step // 2 :: step])
        rows, columns = (
            np.minimum(np.arange(n) // step, m - 1) for n, m in zip(values.shape, known.shape, strict=True)
        )
        out = values.copy()

        def fill(band: slice) -> None:
            y, x = np.nonzero(unknown[band])
            out[band][y, x] = known[rows[band][y], columns[x]]

        each_band(fill, len(values))
        return out
    if unknown.all():
        return np.zeros_like(values)
    if not unknown.any():
        return values
    return fill_from_nearest(values)


def align_channels(
    image: np.ndarray,
    disparity_px: np.ndarray,
    directions: np.ndarray,
    *,
    displacement_px: np.ndarray | None = None,
    exact: bool = True,
) -> np.ndarray:
    """Shift each channel back by its disparity, and predict the samples that were occluded in it.

    Parameters
    ----------
    image : (H, W, 3) float32, linear RGB
    disparity_px : (H, W) float32, px; NaN is filled from the nearest known pixel
    directions : (3, 2) float
        From `channel_directions`.
    displacement_px : (3, 2, H, W) float32, px, optional
        Displacement, x before y, of each channel from the centre view, from `LensShift` or `residual_displacement`;
        disparity times direction when absent.
    exact : bool
        Sample by Lanczos' filter where ``displacement_px`` is given, else by cubics, in a third of the time.

    Returns
    -------
    (H, W, 3) float32, linear RGB, in the view of the pupil's centre

    Raises
    ------
    InputError
        Disparity and image differ in size.
    """
    if image.shape[:2] != disparity_px.shape:
        raise InputError(
            f"disparity {disparity_px.shape} and image {image.shape[:2]} differ in size: they are of two photographs"
        )
    filled = fill_unknown(disparity_px).astype(np.float32, copy=False)
    lengths = np.linalg.norm(directions, axis=1)
    order = np.argsort(lengths, kind="stable")
    if displacement_px is None and moves_along_rows(directions):
        across = np.asarray(directions, float)[:, 0]
        moves, views = np.where(np.abs(across) < _STILL, 0, across), np.where(lengths < STILL, 0, across)
        color, visible = align_rows(image, filled, moves, views)
        return fill_hidden(color, visible, filled, order, out=color)
    moved = linear_displacement(filled, directions) if displacement_px is None else iter(displacement_px)
    # Cubics smooth a channel by its fraction of a px, which registration reads as displacement (docs/colour.md).
    cubic = displacement_px is None or not exact
    color = shift_back(image, moved, interpolation=cv2.INTER_CUBIC if cubic else cv2.INTER_LANCZOS4)
    visible = np.empty(image.shape, bool)
    for k, u in enumerate(np.asarray(directions, float)):
        visible[..., k] = visible_from(filled, u)
    return fill_hidden(color, visible, filled, order, out=color)


def moves_along_rows(directions: np.ndarray) -> bool:
    """Whether every channel, (3, 2) x before y, is displaced horizontally."""
    return bool((np.abs(np.asarray(directions, float)[:, 1]) < _STILL).all())


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


def white_balance(color: np.ndarray, white_rgb: np.ndarray, *, out: np.ndarray | None = None) -> np.ndarray:
    """Scale the channels so that a white sheet seen through the aperture becomes white; (H, W, 3) linear.

    ``out`` takes the result; it may be ``color``.
    """
    white = np.asarray(white_rgb, np.float32)
    if out is None:
        out = np.empty(color.shape, np.float32)
    balance(np.ascontiguousarray(color, np.float32), white.max() / white, out)
    return out
