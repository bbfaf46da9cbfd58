"""Quality "real-time" in plain NumPy: the halved picture, pooled along rows and columns; `coarse_kernels`' oracle.

Correlations of the halved views become log-likelihoods, semi-global matching (`semiglobal`) pools them along the four
axis-parallel paths and name the layer; what the correlations around it say between the layers is averaged where the
guide is even; and the guide says at full resolution to which
of the neighbouring answers a pixel belongs.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from chromaperture.config import CoarseConfig, MatcherConfig, OptimiserConfig
from chromaperture.disparity import reference, semiglobal
from chromaperture.disparity.semiglobal import LayerField
from chromaperture.disparity.views import MatchInputs
from chromaperture.disparity.winner import Winner
from chromaperture.errors import InputError

JUMP_PX = 1.0  # neighbours farther apart lie on two surfaces: a pixel between them belongs to one
LEAST_INFORMATION = 1e-4  # where windows know nothing the layer stands
LEAST_UNEXPLAINED = 3e-3  # by the best correlation
LEAST_LEFT = 1e-5  # of the determinant of the correlations, whose logarithm is the likelihood
SPREAD_POWER = 8  # (1 - x / 8)^8 stands for exp(-x)


class Answers(NamedTuple):
    """What is known of every pixel of the halved picture; (h, w) float32 each, `Winner` says what they are."""

    disparity_px: np.ndarray
    peak: np.ndarray
    curvature: np.ndarray
    spread_px: np.ndarray


def match(inputs: MatchInputs, config: MatcherConfig, *, field: LayerField | None = None) -> Winner:
    """Match halved views; disparities, in px of the full picture, for every pixel of it.

    Parameters
    ----------
    inputs : MatchInputs
        From `prepare_views` with ``config.coarse``.
    config : MatcherConfig
    field : LayerField, optional
        Of the full picture: what equal depth means at every pixel.

    Returns
    -------
    Winner
    """
    coarse, fine_guide = parts(inputs, config)
    score = reference.score_volume(inputs, config)
    layers_px = 2 * inputs.layers_px
    field = None if field is None else halved_field(field)
    if field is not None:
        score = scores_at_labels(score, layers_px, field)
    left = 1 - np.clip(score, 0, 1) ** 2 if inputs.views.shape[2] == 2 else (1 - np.clip(score, 0, 1)) ** 2
    likelihood = -0.5 * np.log(np.maximum(left, LEAST_LEFT)) * inputs.mask[..., None]
    step = float(layers_px[1] - layers_px[0])
    paths = OptimiserConfig(
        paths=4,
        slope_penalty=coarse.slope_penalty / step,
        jump_penalty=coarse.jump_penalty,
        edge_range=coarse.edge_range,
        edge_floor=coarse.edge_floor,
    )
    cost = semiglobal.aggregate(likelihood, inputs.guide, step, config=paths)
    layer = cost.argmin(axis=2)
    inside = np.clip(layer, 1, len(layers_px) - 2)
    low, middle, high = (np.take_along_axis(likelihood, (inside + o)[..., None], axis=2)[..., 0] for o in (-1, 0, 1))
    place, weight = information(inside, low, middle, high, view_count=inputs.views.shape[2])
    links = [smoothing_links(inputs.guide, layer, axis, config) for axis in (1, 0)]
    information_there = two_way(two_way(weight, links[0], axis=1), links[1], axis=0)
    label = two_way(two_way(place * weight, links[0], axis=1), links[1], axis=0) / information_there
    answers = assemble(layer, label, information_there, spread(cost, layer, layers_px, coarse), inputs, middle)
    return finish(enlarge(at_pixels(answers, field), fine_guide))


def scores_at_labels(score: np.ndarray, layers_px: np.ndarray, field: LayerField) -> np.ndarray:
    """Read scores at the labels of a field, by Catmull and Rom's cubics through four layers.

    Straight lines would cut off the peaks between the layers, by more the farther from them, and a frame of even depth
    would be drawn towards the layers as a whole.

    Parameters
    ----------
    score : (H, W, D) float
    layers_px : (D,) float, px
    field : LayerField

    Returns
    -------
    (H, W, D) float32; 0, no evidence, beyond the layers
    """
    count = len(layers_px)
    disparity = field.offset_px[..., None] + field.scale[..., None] * layers_px
    place = (disparity - layers_px[0]) / (layers_px[1] - layers_px[0])
    low = np.clip(np.floor(place).astype(np.intp), 0, count - 2)
    t = place - low
    taps = [np.take_along_axis(score, np.clip(low + i, 0, count - 1), axis=2) for i in (-1, 0, 1, 2)]
    third = 3 * (taps[1] - taps[2]) + taps[3] - taps[0]
    second = 2 * taps[0] - 5 * taps[1] + 4 * taps[2] - taps[3]
    value = taps[1] + t / 2 * (taps[2] - taps[0] + t * (second + t * third))
    return np.where((t >= 0) & (t <= 1), value, 0).astype(np.float32)


def information(
    inside: np.ndarray, low: np.ndarray, middle: np.ndarray, high: np.ndarray, *, view_count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Give what a pixel's own correlations say near its layer: a place, and its information.

    The correlations, not the costs: summed costs have been cut off at the penalties and know little between the
    layers. At its peak a correlation rho earns information rho rho'' / (1 - rho^2) a sample; taken at the layer instead
    it would be least for peaks between the layers, and averages over neighbours would be drawn to the layers.

    Parameters
    ----------
    inside : (H, W)
        Layers, none of them the first or the last.
    low, middle, high : (H, W) float, nats
        Likelihood of the layer before, the layer, the layer after.
    view_count : {2, 3}

    Returns
    -------
    place, weight : two (H, W) float32; the place in layers
    """
    left = [np.exp(np.float32(-view_count if view_count == 2 else -1) * part) for part in (low, middle, high)]
    low, middle, high = (np.sqrt(np.maximum(1 - part, 0)) if view_count == 2 else 1 - part for part in left)
    bend = np.maximum(2 * middle - low - high, 0)
    offset = np.clip((high - low) / (2 * bend + 1e-9), -1, 1)
    peak = np.minimum(middle + offset * (high - low) / 4, 1)
    unexplained = 1 - peak**2 if view_count == 2 else 1 - peak
    weight = bend * peak / (unexplained + LEAST_UNEXPLAINED) + LEAST_INFORMATION
    return (inside + offset).astype(np.float32), weight.astype(np.float32)


def smoothing_links(guide: np.ndarray, layer: np.ndarray, axis: int, config: MatcherConfig) -> np.ndarray:
    """Weight with which a pixel hears the one before it: none across a step of the surface; 0 for the first; (H, W)."""
    near = math.exp(-math.sqrt(2) / config.bilateral_sigma_px) if config.bilateral_sigma_px > 0 else 0.0
    links = np.zeros(guide.shape, np.float32)
    to = np.s_[:, 1:] if axis == 1 else np.s_[1:]
    links[to] = near * np.exp(-np.abs(np.diff(guide, axis=axis)))
    links[to] *= np.abs(np.diff(layer, axis=axis)) <= 1
    return links


def two_way(maps: np.ndarray, links: np.ndarray, *, axis: int) -> np.ndarray:
    """Sum of what each sample hears from both sides along an axis, itself included once; (H, W) float64."""
    x, link = np.moveaxis(maps, axis, 0).astype(np.float64), np.moveaxis(links, axis, 0)
    forward, backward = x.copy(), x.copy()
    for i in range(1, len(x)):
        forward[i] += link[i] * forward[i - 1]
    for i in range(len(x) - 2, -1, -1):
        backward[i] += link[i + 1] * backward[i + 1]
    return np.moveaxis(forward + backward - x, 0, axis)


def assemble(
    layer: np.ndarray,
    label: np.ndarray,
    information: np.ndarray,
    spread_px: np.ndarray,
    inputs: MatchInputs,
    likelihood: np.ndarray,
) -> Answers:
    """Put together what is known of the halved picture; ends of the range are unknown; peaks are correlations."""
    first, step = (np.float32(2 * a) for a in (inputs.layers_px[0], inputs.layers_px[1] - inputs.layers_px[0]))
    known = (layer > 0) & (layer < len(inputs.layers_px) - 1)
    disparity = np.where(known, first + step * label, np.nan).astype(np.float32)
    peak = np.sqrt(np.maximum(1 - np.exp(-2 * likelihood), 0)).astype(np.float32)
    return Answers(disparity, peak, (information / step**2).astype(np.float32), spread_px)


def parts(inputs: MatchInputs, config: MatcherConfig) -> tuple[CoarseConfig, np.ndarray]:
    """Give settings and guide of the full picture; InputError where the inputs were not made for this."""
    if config.coarse is None or inputs.fine_guide is None:
        raise InputError("inputs and settings do not belong together: prepare the views with the same MatcherConfig")
    return config.coarse, inputs.fine_guide


def halved_field(field: LayerField) -> LayerField:
    """Give the field at the pixels of the halved picture."""
    return LayerField(*(np.ascontiguousarray(part[::2, ::2], np.float32) for part in field))


def at_pixels(answers: Answers, field: LayerField | None) -> Answers:
    """Turn answers among labels into disparities of every pixel."""
    if field is None:
        return answers
    disparity = field.offset_px + field.scale * answers.disparity_px
    return Answers(disparity, answers.peak, answers.curvature / field.scale**2, field.scale * answers.spread_px)


def spread(cost: np.ndarray, layer: np.ndarray, layers_px: np.ndarray, coarse: CoarseConfig) -> np.ndarray:
    """Root mean square distance of the layers from the best, weighted by how little more they cost; (H, W) px."""
    worse = (cost - cost.min(axis=2, keepdims=True)) / (SPREAD_POWER * coarse.temperature)
    weight = np.maximum(1 - worse, 0) ** SPREAD_POWER
    away = (layers_px - layers_px[layer][..., None]) ** 2
    return np.sqrt((weight * away).sum(axis=2) / weight.sum(axis=2)).astype(np.float32)


def enlarge(answers: Answers, guide: np.ndarray) -> Answers:
    """Bring answers to full resolution; pixels in between lean to the neighbour whose guide is more like theirs.

    Parameters
    ----------
    answers : Answers, (h, w)
    guide : (H, W) float32, in units of the bilateral range; h = ceil(H / 2), w = ceil(W / 2)
    """
    maps = np.stack(answers)
    wide = _between(maps, guide[::2], axis=1)
    return Answers(*_between(wide, guide, axis=0).astype(np.float32))


def _between(maps: np.ndarray, guide: np.ndarray, *, axis: int) -> np.ndarray:
    """Fill in every second sample along an axis of (4, h, w) maps; the guide (h, w) is already enlarged there."""
    maps, guide = np.moveaxis(maps, axis + 1, 0), np.moveaxis(guide, axis, 0)
    before = maps[: len(guide) // 2]
    after = np.concatenate([maps[1:], maps[-1:]])[: len(before)]
    here, at_before = guide[1::2], guide[0::2][: len(before)]
    at_after = np.concatenate([guide[2::2], guide[-1:]])[: len(before)]
    to_before, to_after = (here - at_before) ** 2, (here - at_after) ** 2
    share = (1 + to_before) / (2 + to_before + to_after)
    with np.errstate(invalid="ignore"):
        apart = np.abs(after[:, 0] - before[:, 0]) > JUMP_PX
    share = np.where(apart, share > 0.5, share)
    share = np.where(np.isnan(before[:, 0]), 1, np.where(np.isnan(after[:, 0]), 0, share))[:, None]
    mixed = np.where(share <= 0, before, np.where(share >= 1, after, before + share * (after - before)))
    out = np.empty((len(guide), *maps.shape[1:]), np.float32)
    out[::2], out[1::2] = maps, mixed
    return np.moveaxis(out, 0, axis + 1)


def finish(answers: Answers) -> Winner:
    """Give the answers as every matcher does."""
    return Winner(*answers)
