"""Quality "real-time" in plain NumPy: the halved picture, pooled along rows and columns; the oracle of ``coarse_kernels``.

Correlations of the halved views become log-likelihoods, semi-global matching (`semiglobal`) pools them along the four
axis-parallel paths, a parabola finds the disparity between the layers, and the guide says at full resolution to which
of the neighbouring answers a pixel belongs.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from chromaperture.config import CoarseConfig, MatcherConfig, OptimiserConfig
from chromaperture.disparity import reference, semiglobal
from chromaperture.disparity.inputs import MatchInputs
from chromaperture.disparity.optimise import MAX_CORRELATION, log_likelihood
from chromaperture.disparity.semiglobal import LayerField
from chromaperture.disparity.subpixel import Winner, parabola_winner
from chromaperture.errors import InputError

JUMP_PX = 1.0  # neighbours farther apart lie on two surfaces: a pixel between them belongs to one
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
    likelihood = log_likelihood(score, view_count=inputs.views.shape[2]) * inputs.mask[..., None]
    layers_px = 2 * inputs.layers_px
    field = None if field is None else halved_field(field)
    if field is not None:
        likelihood = semiglobal.at_labels(likelihood, layers_px, field)
    step = float(layers_px[1] - layers_px[0])
    paths = OptimiserConfig(
        paths=4,
        slope_penalty=coarse.slope_penalty / step,
        jump_penalty=coarse.jump_penalty,
        edge_range=coarse.edge_range,
        edge_floor=coarse.edge_floor,
    )
    cost = semiglobal.aggregate(likelihood, inputs.guide, step, config=paths)
    winner = parabola_winner(-cost, layers_px)
    best = cost.argmin(axis=2)
    explained = np.take_along_axis(likelihood, best[..., None], axis=2)[..., 0]
    labels = np.where(np.isfinite(winner.disparity_px), winner.disparity_px, layers_px[best])
    answers = Answers(winner.disparity_px, explained, winner.curvature, spread(cost, labels, layers_px, coarse))
    return finish(enlarge(at_pixels(answers, field), fine_guide))


def parts(inputs: MatchInputs, config: MatcherConfig) -> tuple[CoarseConfig, np.ndarray]:
    """Settings and guide of the full picture; InputError where the inputs were not made for this."""
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


def spread(cost: np.ndarray, disparity_px: np.ndarray, layers_px: np.ndarray, coarse: CoarseConfig) -> np.ndarray:
    """Root mean square distance of the layers from the answer, weighted by how little more they cost; (H, W) px."""
    worse = (cost - cost.min(axis=2, keepdims=True)) / (SPREAD_POWER * coarse.temperature)
    weight = np.maximum(1 - worse, 0) ** SPREAD_POWER
    away = (layers_px - disparity_px[..., None]) ** 2
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
    """Turn the likelihood of the best layer into a correlation."""
    least = math.log(1 - MAX_CORRELATION)
    peak = np.sqrt(-np.expm1(np.maximum(-2 * answers.peak, np.float32(least))))
    return Winner(answers.disparity_px, peak, answers.curvature, answers.spread_px)
