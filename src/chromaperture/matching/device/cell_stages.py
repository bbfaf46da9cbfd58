"""Scores of cells of 2 x 2 px on the device: `stages.correlate` where ``cell_px`` is 2, in WGSL.

A view is sampled once at every sub-pixel phase that the layers use; a layer of a cell reads its window of 5 x 5 px.
Layers come in chunks whose samples fit the memory.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from chromaperture.matching.device.correlation_stages import add_samples, add_samples_y, chunks_of
from chromaperture.matching.device.device import Array, Chain
from chromaperture.matching.device.view_stages import GUIDE_SCALE, Planes
from chromaperture.matching.device.workgroups import groups_for
from chromaperture.matching.logarithm import LOGARITHM
from chromaperture.matching.readable.correlation import (
    CELL_EPSILON,
    CELL_TAPS,
    CONTRARY,
    LEAST_FLOOR,
    SCORE_PARTS,
    padding,
)
from chromaperture.matching.readable.enlarge import JUMP_PX
from chromaperture.matching.readable.four_paths import LEAST_DETERMINANT, NAT_PARTS
from chromaperture.settings.stages import CorrelationConfig

_CHUNK_BYTES = 128e6  # of the samples of a chunk: WebGPU's default limit of a binding
WINDOW_REACH_PX = 2  # of a cell's window
# What `nats.wgsl` needs.
LIKELIHOOD: dict[str, Any] = {
    "least_determinant": LEAST_DETERMINANT,
    "nat_parts": NAT_PARTS,
    "logarithm_terms": LOGARITHM,
    "logarithm_count": len(LOGARITHM),
}
_CELLS = 8  # that an invocation takes, one below the other: they share the sums of 3 of their 5 rows


def add_cell_planes(chain: Chain, planes: Planes) -> Planes:
    """Add views, guide and mask of the cells of a halved picture."""
    tall, wide, count = -(-planes.height // 2), -(-planes.width // 2), planes.view_count + 2
    cells = chain.array("cell_planes", count * tall * wide)
    chain.add(
        "cell_planes", [planes.planes, cells], groups=groups_for(cells.size),
        plane_count=count, width=planes.width, height=planes.height, cells_wide=wide, cells_tall=tall,
    )  # fmt: skip
    return Planes(cells, planes.stats, None, wide, tall, planes.view_count)


def add_cell_scores(
    chain: Chain,
    planes: Planes,
    cells: Planes,
    layers_px: np.ndarray,
    directions: np.ndarray,
    config: CorrelationConfig,
) -> Array:
    """Add the scores of all layers; (cells, D)."""
    pad_x, pad_y = (pad + WINDOW_REACH_PX for pad in padding(layers_px, directions, config.sampling))
    # A second column of cells at the border reaches 2 px further, the taps that three views read with it another one.
    pad_x += 2 * WINDOW_REACH_PX
    tall, wide = planes.height + 2 * pad_y, planes.width + 2 * pad_x
    three = planes.view_count == 3
    most = int(min(_CHUNK_BYTES, chain.device.largest_bytes) // (4 * tall * wide))
    chunks = chunks_of(layers_px, directions, config.sampling, most, len(layers_px), whole=True)
    margin = pad_x if three else 0
    most_phases = max(len(chunk.phases_y) for chunk in chunks)
    samples = samples_y = chain.array("samples_y", tall * (planes.width + 2 * margin) * most_phases)
    if not three:
        samples = chain.array("samples", tall * wide * max(len(chunk.phases_x) for chunk in chunks))
    score = chain.array("score", cells.pixels * len(layers_px))
    for number, chunk in enumerate(chunks):
        if three:
            add_samples_y(chain, planes, chunk, number, samples_y, margin=margin, pad_y=pad_y, whole=True)
            further = [chain.constant(f"taps_x{number}", chunk.phases_x)]
        else:
            add_samples(chain, planes, chunk, number, samples_y, samples, pad_x=pad_x, pad_y=pad_y, whole=True)
            further = []
        chain.add(
            "cell_scores", [samples, chain.constant(f"places{number}", chunk.places), planes.stats, score, *further],
            groups=groups_for(-(-cells.height // _CELLS) * -(-cells.width // 2) * chunk.size),
            uses=("cells_three" if three else "cells_two",), views=planes.view_count,
            cells_each=_CELLS, cells_wide=cells.width, cells_tall=cells.height,
            entry_count=len(chunk.phases_x), phase_count=len(chunk.phases_y), layer_count=chunk.size,
            first_layer=chunk.first, all_layers=len(layers_px), reach=WINDOW_REACH_PX,
            score_parts=SCORE_PARTS, relative_epsilon=sum(CELL_TAPS) ** 4 * CELL_EPSILON,
            least_floor=sum(CELL_TAPS) ** 4 * LEAST_FLOOR, width=planes.width, pad_x=pad_x, pad_y=pad_y,
        )  # fmt: skip
    if not three:
        chain.add(
            "own_sign", [score], groups=groups_for(cells.pixels),
            cell_count=cells.pixels, all_layers=len(layers_px), contrary=float(SCORE_PARTS * CONTRARY),
        )  # fmt: skip
    return score


def add_label_likelihood(
    chain: Chain,
    cells: Planes,
    score: Array,
    labels: Array,
    layers_px: np.ndarray,
    labels_px: np.ndarray,
    *,
    pitch: int,
    score_parts: int,
    of_labels: dict[str, Any],
) -> Array:
    """Add the log-likelihoods of all labels; (cells, pitch)."""
    likelihood = chain.array("likelihood", cells.pixels * pitch)
    chain.add(
        "label_likelihood", [score, labels, cells.planes, likelihood], groups=groups_for(likelihood.size // 4),
        width=cells.width, height=cells.height, view_count=cells.view_count,
        all_layers=len(layers_px), label_count=len(labels_px), pitch=pitch,
        parts=(len(labels_px) - 1) // (len(layers_px) - 1), first_px=float(layers_px[0]),
        layer_step_px=float(layers_px[1] - layers_px[0]), **LIKELIHOOD,
        score_parts=score_parts, **of_labels,
    )  # fmt: skip
    return likelihood


def add_enlarged_cells(chain: Chain, planes: Planes, cells: Planes, surface: Array) -> Array:
    """Add the surface at the pixels of the halved picture; (h, w, 4)."""
    enlarged = chain.array("surface_enlarged", 4 * planes.pixels)
    chain.add(
        "cells_enlarged", [surface, planes.planes, planes.stats, enlarged], groups=groups_for(planes.pixels),
        width=planes.width, height=planes.height, half_width=cells.width, jump_px=JUMP_PX,
        guide_start=planes.view_count * planes.pixels, guide_scale=GUIDE_SCALE,
    )  # fmt: skip
    return enlarged
