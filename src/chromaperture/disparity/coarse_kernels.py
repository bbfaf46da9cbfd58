"""``coarse.py`` compiled: bands of rows, then strips of columns, as in ``kernels.py``.

The volume of scores is made by `bands.py` and turned into likelihoods where it lies; a second one of the same size
takes the sum of the messages. Memory: 4 bytes a score of the halved picture.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from chromaperture.config import CoarseConfig, MatcherConfig
from chromaperture.disparity import messages
from chromaperture.disparity.coarse import Answers, assemble, at_pixels, finish, halved_field, information, parts
from chromaperture.disparity.enlarge import fill_columns, fill_rows, smooth_surface
from chromaperture.disparity.kernels import _filtered_scores, _in_parallel, _workspace
from chromaperture.disparity.semiglobal import LayerField
from chromaperture.disparity.views import MatchInputs
from chromaperture.disparity.winner import Winner

_EVEN = np.zeros((1, 1), np.float32)


def match(inputs: MatchInputs, config: MatcherConfig, *, field: LayerField | None = None) -> Winner:
    """Match halved views; the fast twin of `coarse.match`."""
    coarse, fine_guide = parts(inputs, config)
    height, width = inputs.mask.shape
    layers_px = (2 * inputs.layers_px).astype(np.float32)
    layer, low, middle, high, spread = (np.empty((height, width), np.float32) for _ in range(5))
    small = None if field is None else halved_field(field)
    offset, scale = (_EVEN, _EVEN) if small is None else small
    links_x, links_y = (_links(inputs.guide, axis, coarse) for axis in (1, 0))
    penalties = messages.Penalties(
        slope=np.float32(coarse.slope_penalty),
        jump=np.float32(coarse.jump_penalty),
        temperature=np.float32(coarse.temperature),
        first=layers_px[0],
        step=layers_px[1] - layers_px[0],
        layers=len(layers_px),
    )
    mask = np.ascontiguousarray(inputs.mask, np.float32)
    two_views = inputs.views.shape[2] == 2
    with _workspace() as workspace:
        volume, _ = _filtered_scores(inputs, config, np.float32(0), workspace)
        sums = workspace.array("sums", volume.shape, np.int16)

        def along_rows(_: int, top: int, bottom: int) -> None:
            messages.pool_rows(volume, sums, mask, links_x, offset, scale, penalties, two_views, top, bottom)

        def along_columns(_: int, first: int, last: int) -> None:
            messages.pool_columns(volume, sums, links_y, penalties, first, last, layer, low, middle, high, spread)

        _in_parallel(along_rows, height)
        _in_parallel(along_columns, -(-width // messages.BLOCK))
    inside = np.clip(layer, 1, len(layers_px) - 2)
    place, weight = information(inside, low, middle, high, view_count=inputs.views.shape[2])
    place *= weight
    near = np.float32(math.exp(-math.sqrt(2) / config.bilateral_sigma_px) if config.bilateral_sigma_px > 0 else 0)
    guide = np.ascontiguousarray(inputs.guide, np.float32)

    def smooth_one(_: int, first: int, last: int) -> None:
        for maps in (weight, place)[first:last]:
            smooth_surface(maps, guide, layer, near)

    _in_parallel(smooth_one, 2)
    answers = assemble(layer, place / weight, weight, spread, inputs, middle)
    return finish(_enlarged(at_pixels(answers, small), fine_guide))


def _links(guide: np.ndarray, axis: int, coarse: CoarseConfig) -> np.ndarray:
    """Weight of the penalty between each pixel and the one before it along an axis; 0 for the first; (H, W)."""
    links = np.zeros(guide.shape, np.float32)
    here, before = (guide[:, 1:], guide[:, :-1]) if axis == 1 else (guide[1:], guide[:-1])
    if here.size:
        fading = cv2.exp(cv2.absdiff(here, before) * np.float32(-1 / coarse.edge_range)).reshape(here.shape)
        part = links[:, 1:] if axis == 1 else links[1:]
        np.multiply(fading, np.float32(1 - coarse.edge_floor), out=part)
        part += np.float32(coarse.edge_floor)
    return links


def _enlarged(answers: Answers, guide: np.ndarray) -> Answers:
    """Bring answers to full resolution, as `coarse.enlarge`."""
    guide = np.ascontiguousarray(guide, np.float32)
    out = Answers(*(np.empty(guide.shape, np.float32) for _ in range(4)))
    small = Answers(*(np.ascontiguousarray(a, np.float32) for a in answers))
    _in_parallel(lambda _, top, bottom: fill_columns(*small, guide, top, bottom, *out), len(small.peak))
    _in_parallel(lambda _, top, bottom: fill_rows(guide, top, bottom, *out), len(guide) // 2)
    return out
