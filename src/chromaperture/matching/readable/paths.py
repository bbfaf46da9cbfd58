"""Semi-global matching of a volume of log-likelihoods, in plain NumPy: the oracle of ``compiled/paths.py``.

Weak texture leaves the likelihood of a single window flat; only more pixels help. Semi-global matching aggregates them
along straight paths through every pixel, on each of which the best path is found exactly::

    L(p, d) = -l(p, d) + min_e [ L(q, e) + V(d - e) ] - min_e L(q, e),      V(x) = e_pq min(slope |x|, jump)

with q the pixel before p on the path and ``e_pq`` the guide's edge weight between the two. The truncated linear V lets
slanted surfaces bend and edges break. Log-likelihoods and penalties are in nats, so that the settings do not depend on
the window or the layers.

References
----------
H. Hirschmueller: Stereo processing by semiglobal matching and mutual information. TPAMI 30, 2008.
doi:10.1109/TPAMI.2007.1166
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from chromaperture.matching.blocks import BLOCK_PX
from chromaperture.matching.labels import LabelMap
from chromaperture.settings.stages import SurfaceConfig

# Lines of pixels, as steps (x, y); every line is walked in both directions. The first two are the 4-path set.
LINES = ((1, 0), (0, 1), (1, 1), (-1, 1))
EDGE_LAYERS = 1e-4  # by which rounding may take a label beyond the volume
LEAST_UNEXPLAINED = 0.25  # of the better neighbour's: a polynomial may undershoot next to a steep flank


class PathPenalties(NamedTuple):
    """Penalties of a change of layer between neighbours on a path; nats, and units of ``guide_range``."""

    slope_per_layer: float
    jump: float
    edge_range: float
    edge_floor: float

    def link(self, here: float, there: float) -> float:
        """Weight of the penalties between two neighbours: 1 on an even guide, ``edge_floor`` across its edges."""
        return float(self.edge_floor + (1 - self.edge_floor) * np.exp(-abs(here - there) / self.edge_range))


class Posterior(NamedTuple):
    """Mean and variance of the layers of every pixel by their costs."""

    mean_px: np.ndarray  # (H, W) float32, px
    variance_px2: np.ndarray  # (H, W) float32, px^2

    def sigma_px(self, disparity_px: np.ndarray) -> np.ndarray:
        """Return the root mean square distance of the layers from a map (H, W); (H, W) float32, px.

        A broad minimum widens it, and so does a rival far away: both kinds of error are in one number.
        """
        away = np.asarray(disparity_px, np.float32) - self.mean_px
        return np.sqrt(self.variance_px2 + away * away)


def penalties_of(config: SurfaceConfig, layers_px: np.ndarray) -> PathPenalties:
    """Return the penalties between layers of a distance.

    A step along a path leads from block to block, past `BLOCK_PX` pixels of one log-likelihood; costs are nats over
    that number, so that the volume is in nats a pixel.
    """
    slope, jump = (nats / BLOCK_PX for nats in (config.slope_penalty, config.jump_penalty))
    return PathPenalties(slope * float(layers_px[1] - layers_px[0]), jump, config.edge_range, config.edge_floor)


def path_temperature(config: SurfaceConfig) -> float:
    """Return the temperature of the sum of all paths' costs, in their unit."""
    return config.temperature * config.paths / BLOCK_PX


def aggregate_paths(
    likelihood: np.ndarray, guide: np.ndarray, layers_px: np.ndarray, *, config: SurfaceConfig
) -> np.ndarray:
    """Sum the path costs of every pixel and layer.

    Every path holds the pixel's own log-likelihood; all but one are taken off again (Drory et al., GCPR 2014).

    Parameters
    ----------
    likelihood : (H, W, D) float, nats a pixel
    guide : (H, W) float
        In units of ``guide_range``.
    layers_px : (D,) float, px
    config : SurfaceConfig

    Returns
    -------
    (H, W, D) float64
        Lower is better.
    """
    return path_costs(likelihood, guide, penalties_of(config, layers_px), paths=config.paths)


def path_costs(likelihood: np.ndarray, guide: np.ndarray, penalties: PathPenalties, *, paths: int) -> np.ndarray:
    """Sum the path costs for given penalties; see `aggregate_paths`."""
    height, width, layers = likelihood.shape
    total = (paths - 1) * likelihood.astype(np.float64)
    apart = np.abs(np.arange(layers)[:, None] - np.arange(layers))
    penalty = np.minimum(penalties.slope_per_layer * apart, penalties.jump)
    for line in LINES[: paths // 2]:
        for sign in (1, -1):
            dx, dy = sign * line[0], sign * line[1]
            cost = np.full(likelihood.shape, np.nan)
            rows = range(height) if dy >= 0 else range(height - 1, -1, -1)
            columns = range(width) if dx >= 0 else range(width - 1, -1, -1)
            for y in rows:
                for x in columns:
                    cost[y, x] = -likelihood[y, x]
                    py, px = y - dy, x - dx
                    if 0 <= py < height and 0 <= px < width:
                        before = cost[py, px]
                        weight = penalties.link(guide[y, x], guide[py, px])
                        cost[y, x] += (before + weight * penalty).min(axis=1) - before.min()
            total += cost
    return total


def posterior(cost: np.ndarray, layers_px: np.ndarray, *, temperature: float) -> Posterior:
    """Return mean and variance of the layers, each as probable as exp(-cost / temperature).

    Parameters
    ----------
    cost : (H, W, D) float
        From `aggregate_paths`.
    layers_px : (D,) float, px
    temperature : float
        In the unit of ``cost``.

    Returns
    -------
    Posterior
    """
    probable = np.exp(-(cost - cost.min(axis=2, keepdims=True)) / temperature)
    probable /= probable.sum(axis=2, keepdims=True)
    mean = probable @ layers_px
    variance = (probable * (layers_px - mean[..., None]) ** 2).sum(axis=2)
    return Posterior(mean.astype(np.float32), variance.astype(np.float32))


def read_at_labels(
    likelihood: np.ndarray,
    layers_px: np.ndarray,
    labels_px: np.ndarray,
    label_map: LabelMap,
    *,
    factors: float = 1.0,
    places: tuple[np.ndarray, np.ndarray] | None = None,
) -> np.ndarray:
    """Interpolate a volume of log-likelihoods at the labels of a map, and between its samples.

    Between layers by a polynomial through six of them, then between samples linearly: a map varies so little from
    sample to sample that the other order gives the same, for fewer polynomials. Both go through the unexplained
    fraction, exp(-2 l / factors): near a match that is a parabola, while l has a cusp there, and surfaces would be
    biased to whatever layers l itself is interpolated between.

    Parameters
    ----------
    likelihood : (h, w, D) float, nats a pixel
        At the disparities ``layers_px``.
    layers_px : (D,) float, px
    labels_px : (N,) float, px
    label_map : LabelMap
        Of the samples.
    factors : float
        How many fractions are multiplied in exp(-2 l), such as one for every band of frequencies.
    places : (H,) float, (W,) float
        Rows and columns that are read, in samples, ascending; the last sample holds beyond it. The samples when absent.

    Returns
    -------
    (H, W, N) float32
        At the disparities ``offset_px + scale * labels_px``; 0, no evidence, beyond the volume.
    """
    unexplained = np.exp(-2 / factors * likelihood)
    before, after = (2 * unexplained[..., end] - unexplained[..., next_] for end, next_ in ((0, 1), (-1, -2)))
    ends = [2 * before - unexplained[..., 0], before, after, 2 * after - unexplained[..., -1]]
    wide = np.concatenate([np.stack(ends[:2], -1), unexplained, np.stack(ends[2:], -1)], axis=2)
    offset, scale = (part[..., None] for part in label_map)
    place = (offset + scale * labels_px - layers_px[0]) / (layers_px[1] - layers_px[0])
    below = np.clip(np.floor(place).astype(np.intp), 0, len(layers_px) - 2)
    weights = lagrange_weights(place - below)
    taps = [np.take_along_axis(wide, below + k, axis=2) for k in range(6)]
    value = sum(weight * tap for weight, tap in zip(weights, taps, strict=True))
    value = np.maximum(value, LEAST_UNEXPLAINED * np.minimum(taps[2], taps[3]))
    inside = (place > -EDGE_LAYERS) & (place < len(layers_px) - 1 + EDGE_LAYERS)
    value = np.where(inside, value, 1)
    for axis, place in enumerate(places or ()):
        value = between_samples(value, place, axis=axis)
    return np.maximum(-factors / 2 * np.log(value), 0).astype(np.float32)


def between_samples(volume: np.ndarray, place: np.ndarray, *, axis: int) -> np.ndarray:
    """Interpolate a volume linearly at places along an axis, in samples; the last sample holds beyond it."""
    place = np.minimum(place, volume.shape[axis] - 1)
    below = place.astype(np.intp)
    above = np.minimum(below + 1, volume.shape[axis] - 1)
    weight = np.expand_dims(place - below, [other for other in range(3) if other != axis]).astype(volume.dtype)
    first = volume.take(below, axis)
    return np.asarray(first + weight * (volume.take(above, axis) - first))


def lagrange_weights(t: np.ndarray) -> list[np.ndarray]:
    """Lagrange's weights of the samples at -2, -1, 0, 1, 2 and 3 for a place ``t`` in [0, 1]."""
    nodes = range(-2, 4)
    return [
        np.prod([(t - other) / (node - other) for other in nodes if other != node], axis=0, dtype=float)
        for node in nodes
    ]
