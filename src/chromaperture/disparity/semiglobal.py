"""Semi-global optimisation of a volume of log-likelihoods, and its refinement by coupled total variation.

Weak texture leaves the likelihood of a single window flat; only more pixels help. Semi-global matching
pools them along eight straight paths through every pixel, on each of which the best path is found
exactly::

    L(p, d) = -l(p, d) + min_e [ L(q, e) + V(d - e) ] - min_e L(q, e),      V(x) = e_pq min(slope |x|, jump)

with q the pixel before p on the path and ``e_pq`` the guide's edge weight between the two. Truncated
linear V lets slanted surfaces bend and edges break. Units make the settings independent of window and
layers: likelihoods are in nats a pixel, penalties in nats.

References
----------
H. Hirschmueller: Stereo processing by semiglobal matching and mutual information. TPAMI 30, 2008.
doi:10.1109/TPAMI.2007.1166
R. Newcombe, S. Lovegrove, A. Davison: DTAM: dense tracking and mapping in real-time. ICCV 2011 (coupling of
volume and total variation). doi:10.1109/ICCV.2011.6126513
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from chromaperture.config import OptimiserConfig
from chromaperture.disparity.variational import (
    OPERATOR_NORM_SQUARED,
    Problem,
    State,
    Steps,
    edge_weights,
    iterate,
    step_sizes,
)

# Lines of pixels, as steps (x, y); every line is walked in both directions. The first two are the 4-path set.
LINES = ((1, 0), (0, 1), (1, 1), (-1, 1))
EDGE_LAYERS = 1e-6  # by which rounding may take a label beyond the volume
LEAST_SHARE = 0.25  # of the better neighbour's: a cubic may undershoot next to a steep flank


class LayerField(NamedTuple):
    """What a common label means at every pixel: ``disparity = offset_px + scale * label``.

    Field curvature and vignetting bend the disparity of a flat wall, so smoothness of the disparity itself
    would fight the lens. With labels of equal depth a wall is constant again.

    Attributes
    ----------
    offset_px : (H, W) float32, px
    scale : (H, W) float32
    """

    offset_px: np.ndarray
    scale: np.ndarray


def layer_field(
    infinity_px: np.ndarray, baseline_px_mm: np.ndarray, *, reference: tuple[float, float]
) -> LayerField:
    """Field whose labels are the disparities of a reference pixel at the same depth.

    From ``d = A - B / z`` here and ``label = A0 - B0 / z`` there.

    Parameters
    ----------
    infinity_px : (H, W) float, px
        A, disparity at infinity, of the colour space that is matched.
    baseline_px_mm : (H, W) float, px mm
        B.
    reference : (float, float)
        A0 and B0, the same for all colour spaces of a camera.
    """
    scale = baseline_px_mm / reference[1]
    offset = infinity_px - scale * reference[0]
    return LayerField(offset.astype(np.float32), scale.astype(np.float32))


def even_field(height: int, width: int) -> LayerField:
    """Field of a lens that shows equal depth at equal disparity all over the frame."""
    return LayerField(np.zeros((height, width), np.float32), np.ones((height, width), np.float32))


def at_labels(
    likelihood: np.ndarray, layers_px: np.ndarray, labels_px: np.ndarray, field: LayerField, *, factors: float = 1.0
) -> np.ndarray:
    """Read a volume of log-likelihoods at the labels of a field, by a cubic through four layers.

    The cubic goes through the unexplained share, exp(-2 l / factors): near a match that is a parabola, while l has a
    cusp there, and surfaces would lock to whatever layers l itself is interpolated between.

    Parameters
    ----------
    likelihood : (H, W, D) float, nats a pixel
        At the disparities ``layers_px``.
    layers_px : (D,) float, px
    labels_px : (N,) float, px
    field : LayerField
    factors : float
        How many shares are multiplied in exp(-2 l), such as one for every band of frequencies.

    Returns
    -------
    (H, W, N) float32
        At the disparities ``offset_px + scale * labels_px``; 0, no evidence, beyond the volume.
    """
    share = np.exp(-2 / factors * likelihood)
    ends = 2 * share[..., :1] - share[..., 1:2], 2 * share[..., -1:] - share[..., -2:-1]
    wide = np.concatenate([ends[0], share, ends[1]], axis=2)
    disparity = field.offset_px[..., None] + field.scale[..., None] * labels_px
    place = (disparity - layers_px[0]) / (layers_px[1] - layers_px[0])
    below = np.clip(np.floor(place).astype(np.intp), 0, len(layers_px) - 2)
    weights = cubic_weights(place - below)
    taps = [np.take_along_axis(wide, below + k, axis=2) for k in range(4)]
    value = sum(weight * tap for weight, tap in zip(weights, taps, strict=True))
    value = np.maximum(value, LEAST_SHARE * np.minimum(taps[1], taps[2]))
    inside = (place > -EDGE_LAYERS) & (place < len(layers_px) - 1 + EDGE_LAYERS)
    return np.where(inside, np.maximum(-factors / 2 * np.log(value), 0), 0).astype(np.float32)


def cubic_weights(t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Lagrange's weights of the samples at -1, 0, 1 and 2 for a place ``t`` in [0, 1]."""
    return (
        -t * (t - 1) * (t - 2) / 6,
        (t + 1) * (t - 1) * (t - 2) / 2,
        -(t + 1) * t * (t - 2) / 2,
        (t + 1) * t * (t - 1) / 6,
    )


def aggregate(
    likelihood: np.ndarray, guide: np.ndarray, step_px: float, *, config: OptimiserConfig
) -> np.ndarray:
    """Sum of the path costs of every pixel and layer, in plain NumPy: the oracle of ``semiglobal_kernels``.

    Every path brings the pixel's own likelihood; all but one are taken off again (Drory et al., GCPR 2014).

    Parameters
    ----------
    likelihood : (H, W, D) float, nats a pixel
    guide : (H, W) float
        In units of the bilateral range, as `MatchInputs.guide`.
    step_px : float
        Distance of two layers.
    config : OptimiserConfig

    Returns
    -------
    (H, W, D) float64
        Lower is better.
    """
    height, width, layers = likelihood.shape
    total = (config.paths - 1) * likelihood.astype(np.float64)
    apart = np.abs(np.arange(layers)[:, None] - np.arange(layers)) * step_px
    penalty = np.minimum(config.slope_penalty * apart, config.jump_penalty)
    for line in LINES[: config.paths // 2]:
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
                        weight = link_weight(guide[y, x], guide[py, px], config)
                        cost[y, x] += (before + weight * penalty).min(axis=1) - before.min()
            total += cost
    return total


def link_weight(here: float, there: float, config: OptimiserConfig) -> float:
    """Weight of the penalty between two neighbours: 1 on an even guide, ``edge_floor`` across its edges."""
    return config.edge_floor + (1 - config.edge_floor) * np.exp(-abs(here - there) / config.edge_range)


def coupled_variation(
    disparity_px: np.ndarray,
    likelihood: np.ndarray,
    guide: np.ndarray,
    layers_px: np.ndarray,
    *,
    config: OptimiserConfig,
) -> np.ndarray:
    """Refine a disparity map by total variation coupled to the volume of log-likelihoods, in plain NumPy.

    Minimises ``slope_penalty * sum e |grad u|_h - l(v) + (u - v)^2 / (2 theta)`` in turns: u by
    primal-dual steps, v by trying every layer; theta falls geometrically until the two are one. Inside,
    disparity counts in layers.

    Parameters
    ----------
    disparity_px : (H, W) float, px
        Start; no NaN.
    likelihood : (H, W, D) float, nats a pixel
    guide : (H, W) float
    layers_px : (D,) float, px
    config : OptimiserConfig

    Returns
    -------
    (H, W) float32, px
    """
    return couple(disparity_px, likelihood, guide, layers_px, config, iterate, nearest_likely)


def couple(
    disparity_px: np.ndarray,
    likelihood: np.ndarray,
    guide: np.ndarray,
    layers_px: np.ndarray,
    config: OptimiserConfig,
    solve: Callable[[Problem, State, Steps], None],
    decouple: Callable[[np.ndarray, np.ndarray, float], np.ndarray],
) -> np.ndarray:
    """Alternate the two steps of `coupled_variation` with a given solver of each; (H, W) float32, px."""
    step = float(layers_px[1] - layers_px[0])
    edges = edge_weights(guide, edge_range=config.edge_range, floor=config.edge_floor)
    state = State.start(((disparity_px - layers_px[0]) / step).astype(np.float32))
    steps = step_sizes(config.variation_iterations, primal_step=OPERATOR_NORM_SQUARED**-0.5)
    fidelity = 1 / (config.slope_penalty * step)  # of a nat, against a total variation of weight 1 a layer
    bounds = (0.0, len(layers_px) - 1.0)
    for theta in np.geomspace(*config.coupling_layers2, config.coupling_rounds):
        target = decouple(state.u, likelihood, float(theta) * fidelity)
        weight = np.full(target.shape, 1 / theta, np.float32)
        state.extrapolated = state.u.copy()
        solve(Problem(target, weight, edges, bounds, config.huber_layers, True), state, steps)
    return (layers_px[0] + step * state.u).astype(np.float32)


def spread(
    disparity_px: np.ndarray, cost: np.ndarray, layers_px: np.ndarray, *, temperature: float
) -> np.ndarray:
    """Root mean square distance of the layers from the answer, each as probable as exp(-cost / temperature).

    A broad minimum spreads, and so does a rival far away: both kinds of error are in one number.

    Parameters
    ----------
    disparity_px : (H, W) float, px
    cost : (H, W, D) float
        From `aggregate`.
    layers_px : (D,) float, px
    temperature : float
        In the unit of ``cost``.

    Returns
    -------
    (H, W) float32, px
    """
    probable = np.exp(-(cost - cost.min(axis=2, keepdims=True)) / temperature)
    away = (layers_px - disparity_px[..., None]) ** 2
    return np.sqrt((probable * away).sum(axis=2) / probable.sum(axis=2)).astype(np.float32)


def nearest_likely(u: np.ndarray, likelihood: np.ndarray, fidelity: float) -> np.ndarray:
    """Give the v that minimises ``(v - u)^2 / 2 - fidelity * l(v)``, between layers by a parabola; (H, W)."""
    layers = np.arange(likelihood.shape[2], dtype=np.float32)
    cost = (layers - u[..., None]) ** 2 / 2 - np.float32(fidelity) * likelihood
    best = cost.argmin(axis=2)
    inner = np.clip(best, 1, len(layers) - 2)
    left, center, right = (np.take_along_axis(cost, (inner + o)[..., None], 2)[..., 0] for o in (-1, 0, 1))
    bend = left - 2 * center + right
    offset = np.clip((left - right) / (2 * np.maximum(bend, 1e-12)), -0.5, 0.5)
    return np.where(best == inner, inner + offset, best).astype(np.float32)
