"""What a scene of planes costs on a volume of log-likelihoods, in plain NumPy: the oracle of ``compiled/planes.py``.

A plane in the world is a plane in labels of equal depth: ``label(x, y) = a x + b y + c``, because 1 / depth is linear
in the image. A set of planes is a (K, 3) array of a, b (px per px) and c (px).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

NEAR = 1.5  # tolerances, within which points are fitted
LEAST_POINTS = 8  # of a plane; chosen by hand
LEAST_AREA = 4  # twice that of a triangle: no sliver


class PlaneCosts(NamedTuple):
    """What a plane costs besides its log-likelihood; nats a pixel."""

    slope: float  # of a slope of one label per px; it grows with the square
    outside: float  # where the plane leaves the range of the labels


def plane_costs(likelihood: np.ndarray, planes: np.ndarray, labels_px: np.ndarray, costs: PlaneCosts) -> np.ndarray:
    """Cost of every plane at every pixel: minus the log-likelihood, linear between two labels.

    Parameters
    ----------
    likelihood : (H, W, N) float, nats a pixel
    planes : (K, 3) float
    labels_px : (N,) float, px
    costs : PlaneCosts

    Returns
    -------
    (H, W, K) float32, nats a pixel
    """
    height, width, count = likelihood.shape
    step = float(labels_px[1] - labels_px[0])
    out = np.empty((height, width, len(planes)), np.float32)
    for k, (a, b, c) in enumerate(planes):
        place = (a * np.arange(width) + b * np.arange(height)[:, None] + c - labels_px[0]) / step
        below = np.clip(np.floor(place).astype(np.intp), 0, count - 2)
        t = place - below
        low, high = (np.take_along_axis(likelihood, (below + i)[..., None], axis=2)[..., 0] for i in (0, 1))
        inside = (place >= 0) & (place <= count - 1)
        out[..., k] = np.where(inside, -(1 - t) * low - t * high, costs.outside)
        out[..., k] += costs.slope / 2 * (a * a + b * b) / step**2
    return out


def agreed_plane(
    corners: np.ndarray,
    x: np.ndarray,
    y: np.ndarray,
    label: np.ndarray,
    weight: np.ndarray,
    *,
    tolerance_px: float,
    rounds: int,
) -> np.ndarray:
    """Find the plane through three points that most points agree with, and fit it to these by least squares.

    Parameters
    ----------
    corners : (K, 3) int
        Three points each, of which triangles of at most half `LEAST_AREA` are left out.
    x, y : (P,) int
    label : (P,) float, px
    weight : (P,) float
    tolerance_px : float
        Distance at which a point agrees no more.
    rounds : int
        Of fitting to the points within `NEAR` of it.

    Returns
    -------
    (3,) float64
        NaN where fewer than `LEAST_POINTS` agree, or no triangle is left.
    """
    terms = np.stack([x, y, np.ones(len(x))]).astype(float)
    triangles = terms.T[corners]
    wide = np.abs(np.linalg.det(triangles)) > LEAST_AREA
    if not wide.any():
        return np.full(3, np.nan)
    planes = np.linalg.solve(triangles[wide], label[corners[wide]][..., None].astype(float))[..., 0]
    votes = np.maximum(0, 1 - ((planes @ terms - label) / tolerance_px) ** 2) @ weight
    plane = planes[votes.argmax()]
    for _ in range(rounds):
        near = np.abs(plane @ terms - label) < NEAR * tolerance_px
        if near.sum() < LEAST_POINTS:
            return np.full(3, np.nan)
        weighted = terms[:, near] * weight[near]
        try:
            plane = np.linalg.solve(weighted @ terms[:, near].T, weighted @ label[near])
        except np.linalg.LinAlgError:
            return np.full(3, np.nan)
    return np.asarray(plane)
