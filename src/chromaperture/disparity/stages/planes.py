"""What a scene of planes costs on a volume of log-likelihoods, in plain NumPy: the oracle of ``cpu/planes.py``.

A plane in the world is a plane in labels of equal depth: ``label(x, y) = a x + b y + c``, because 1 / depth is linear
in the image. A set of planes is a (K, 3) array of a, b (px per px) and c (px).

References
----------
P. Felzenszwalb, D. Huttenlocher: Efficient belief propagation for early vision. IJCV 70, 2006.
doi:10.1007/s11263-006-7899-4 (messages under a Potts penalty)
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

NEAR = 1.5  # tolerances, within which points are fitted
LEAST_POINTS = 30  # of a plane; chosen by hand
LEAST_AREA = 50  # px^2, twice that of a triangle: no sliver


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


def potts_beliefs(cost: np.ndarray, links: np.ndarray, *, sweeps: int) -> np.ndarray:
    """Min-sum belief propagation on the pixel grid: what every choice at a pixel costs, with the best of all others.

    Neighbours that choose differently pay the penalty of their link. Each sweep sends messages right, left, down and
    up, each using those before it; exact on a single row or column, approximate on a grid.

    Parameters
    ----------
    cost : (H, W, K) float, nats
    links : (2, H, W) float, nats
        Penalties of the links to the right and downwards; the last column and the last row are not read.
    sweeps : int

    Returns
    -------
    (H, W, K) float32
        The choice at a pixel is the smallest.
    """
    cost = np.asarray(cost, np.float32)
    messages = np.zeros((4, *cost.shape), np.float32)  # from the left, right, above, below
    for _ in range(sweeps):
        for axis, (forward, backward) in enumerate(((0, 1), (2, 3))):
            lines, sent = np.moveaxis(cost, 1 - axis, 0), np.moveaxis(messages, 2 - axis, 1)
            penalty = np.moveaxis(links[axis], 1 - axis, 0)[..., None].astype(np.float32)
            count = len(lines)
            for to, back, places in (
                (forward, backward, range(count - 1)),
                (backward, forward, range(count - 1, 0, -1)),
            ):
                ahead = 1 if to == forward else -1
                for i in places:
                    value = lines[i] + sent[:, i].sum(axis=0) - sent[back, i]
                    value -= value.min(axis=-1, keepdims=True)
                    sent[to, i + ahead] = np.minimum(value, penalty[min(i, i + ahead)])
    return np.asarray(cost + messages.sum(axis=0), np.float32)
