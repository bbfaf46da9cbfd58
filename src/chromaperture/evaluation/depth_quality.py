"""Depth quality by the usual figures of depth cameras: flat walls at known distances, whole and zone by zone."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from chromaperture.system.robust import robust_sigma

ZONES = ("top left", "top", "top right", "left", "middle", "right", "bottom left", "bottom", "bottom right")
_OUTLIER_SIGMAS = 4.0  # from the plane: matching errors, counted separately; a Gaussian has 0.006 % beyond
_ROUNDS = 5  # fits, each without the outliers of the one before; chosen by hand
_LEAST_PIXELS = 12  # for a fit of three parameters; chosen by hand


@dataclass(frozen=True)
class PlaneQuality:
    """Quality of the measured depth of a piece of a flat wall."""

    fill: float  # fraction of the pixels with a depth
    accuracy: float  # Z accuracy: median of (measured - true) / true; signed
    plane_rms: float  # root mean square distance from the best plane, relative to the distance; without outliers
    subpixel_rms_px: float  # the same in px of half disparity, which does not grow with distance
    outliers: float  # fraction of the pixels with a depth more than four robust standard deviations off the plane


def plane_quality(
    depth_mm: np.ndarray, truth_mm: float, *, sensor_to_pupil_mm: float, scale_px_mm: np.ndarray | float
) -> PlaneQuality:
    """Measure the quality of the depth of a flat wall perpendicular to the axis.

    ``depth_mm`` (H, W) float: from the sensor plane; NaN unknown; ``truth_mm``: its distance from the sensor plane;
    ``sensor_to_pupil_mm``: delta; ``scale_px_mm`` float or (H, W): B of ``d = A - B / (depth - delta)``. Returns NaN
    where fewer than 12 pixels are known.
    """
    known = np.isfinite(depth_mm)
    fill = float(known.mean())
    if known.sum() < _LEAST_PIXELS:
        return PlaneQuality(fill, np.nan, np.nan, np.nan, np.nan)
    depth = np.asarray(depth_mm, float)[known]
    inverse = 1 / (depth - sensor_to_pupil_mm)
    y, x = np.mgrid[-1 : 1 : depth_mm.shape[0] * 1j, -1 : 1 : depth_mm.shape[1] * 1j]
    # A plane in space, of any tilt, is a plane in inverse depth over the picture of a pinhole.
    basis = np.stack([np.ones(len(inverse)), x[known], y[known]], axis=1)
    keep: np.ndarray = np.ones(len(inverse), bool)
    residual = np.zeros(len(inverse))
    for _ in range(_ROUNDS):
        solution, *_ = np.linalg.lstsq(basis[keep], inverse[keep], rcond=None)
        residual = inverse - basis @ solution
        centred = residual - np.median(residual[keep])  # outliers pull the first fit away from an exact plane
        keep = np.abs(centred) <= _OUTLIER_SIGMAS * robust_sigma(centred) + 1e-12  # 1/mm; keeps all of an exact plane
    scale = np.broadcast_to(np.asarray(scale_px_mm, float), depth_mm.shape)[known]
    z = truth_mm - sensor_to_pupil_mm
    return PlaneQuality(
        fill,
        float(np.median(depth) / truth_mm - 1),
        float(np.sqrt(np.mean(residual[keep] ** 2)) * z**2 / truth_mm),  # |d depth| = z^2 |d (1 / z)|
        float(np.sqrt(np.mean((scale * residual)[keep] ** 2))),
        float(1 - keep.mean()),
    )


def cells(height: int, width: int, rows: int, columns: int) -> list[tuple[slice, slice]]:
    """Divide a frame into cells; returns their (rows, columns), row by row."""
    down, across = (np.linspace(0, n, count + 1).round().astype(int) for n, count in ((height, rows), (width, columns)))
    return [(slice(int(a), int(b)), slice(int(c), int(d))) for a, b in pairwise(down) for c, d in pairwise(across)]


def by_cell(
    depth_mm: np.ndarray, truth_mm: float, sensor_to_pupil_mm: float, scale_px_mm: np.ndarray, rows: int, columns: int
) -> list[PlaneQuality]:
    """Apply `plane_quality` to every cell of the frame, each with its own plane; row by row."""
    scale = np.broadcast_to(scale_px_mm, depth_mm.shape)
    return [
        plane_quality(depth_mm[cell], truth_mm, sensor_to_pupil_mm=sensor_to_pupil_mm, scale_px_mm=scale[cell])
        for cell in cells(depth_mm.shape[0], depth_mm.shape[1], rows, columns)
    ]
