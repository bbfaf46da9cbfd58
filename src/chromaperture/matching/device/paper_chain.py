"""Quality "paper" as one chain on the device: ``paper.py``, stage by stage, in WGSL.

Layers go through the filter in the chunks that ``correlation_stages.py`` makes of them, and only the best so far is
kept: the volume never exists as a whole.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from chromaperture.matching.device.correlation_stages import Kept, add_correlation
from chromaperture.matching.device.device import Array, Chain
from chromaperture.matching.device.real_time_chain import add_links, add_recursions
from chromaperture.matching.device.view_stages import Planes, add_views
from chromaperture.matching.error_bar import CONFIDENCE_SCALE_PX, MAX_SIGMA_PX, independent_samples, sigma_of_range
from chromaperture.matching.paper import CELL_PX, EDGE_REACH_PX, LEAST_VARIANCE, WINDOW_CELLS, PaperMethod
from chromaperture.matching.readable.bilateral import even_link
from chromaperture.matching.readable.correlation import MIN_WEIGHT
from chromaperture.settings.methods import PaperConfig


def runs_on_device(config: PaperConfig) -> bool:
    """Whether the device has what the settings ask for: neither debiasing nor weights by texture."""
    return not (config.correlation.noise_debiasing or config.bilateral.texture_weighting)


def add_paper(chain: Chain, image: Array, size: tuple[int, int], method: PaperMethod) -> None:
    """Add all stages from the image (H, W, 3) to ``disparity``, ``sigma`` and ``confidence``, (H, W) each."""
    config, space = method.config, method.space
    planes = add_views(chain, image, size, space, config.views)
    layers_px = config.layers.values_px
    first, step = float(layers_px[0]), float(layers_px[1] - layers_px[0])
    even = even_link(config.bilateral.sigma_px)
    best = chain.array("best", 5 * planes.pixels)
    links = add_links(chain, planes, best, even=even, edge_range=1.0, by_layer=False)
    kept = Kept("weighted", ("scores_weighted",), {"least_weight": MIN_WEIGHT}, more=1, together=4)
    directions = space.directions
    for maps, chunk in add_correlation(
        chain, planes, layers_px, directions, config.correlation, chunked=True, kept=kept
    ):
        pitch = kept.pitch_of(chunk.size)
        # Up to the map of the weights: behind the layers by four, or in their last place where that is free.
        filtered = 4 * chunk.quads + (chunk.size == 4 * chunk.quads)
        add_recursions(chain, planes, maps, links, map_count=filtered, gain=1 - even, own=0.0, pitch=pitch)
        chain.add(
            "running_winner", [maps, best], planes.pixels, quads=chunk.quads, pixels=planes.pixels, pitch=pitch,
            layer_count=chunk.size, first_layer=chunk.first,
        )  # fmt: skip
    peaks, ranges = (chain.array(name, count * planes.pixels) for name, count in (("peaks", 3), ("ranges", 2)))
    chain.add(
        "peak", [best, peaks], planes.pixels, pixels=planes.pixels, view_count=planes.view_count,
        total_layers=len(layers_px), first_px=first, step_px=step, samples=independent_samples(config),
        sigma_scale=config.sigma_scale, range_sigma_px=sigma_of_range(layers_px), max_sigma_px=MAX_SIGMA_PX,
    )  # fmt: skip
    of_square: dict[str, Any] = dict(width=size[1], height=size[0], reach=EDGE_REACH_PX, side=2 * EDGE_REACH_PX + 1)
    chain.add("peak_range_x", [peaks, ranges], planes.pixels, **of_square)
    if method.hue_share > 0:
        unlike, cells = _add_unlike_share(chain, planes, peaks, space.directions)
    else:
        unlike, cells = chain.constant("unlike_share", np.zeros(1, np.float32)), {"columns": 1, "rows": 1}
    outputs = [chain.array(name, planes.pixels) for name in ("disparity", "sigma", "confidence")]
    widest = sigma_of_range(layers_px)
    chain.add(
        "peak_range", [peaks, ranges, unlike, *outputs], planes.pixels, edge_share=config.edge_share,
        floor_px=method.floor_px, hue_px=method.hue_share * widest, range_sigma_px=widest,
        max_sigma_px=MAX_SIGMA_PX, confidence_scale_px=CONFIDENCE_SCALE_PX, **cells, **of_square,
    )  # fmt: skip


def _add_unlike_share(
    chain: Chain, planes: Planes, peaks: Array, directions: np.ndarray
) -> tuple[Array, dict[str, Any]]:
    """Add `paper.unlike_share`, in cells; return its map and their numbers along x and y."""
    cells: dict[str, Any] = {"columns": max(1, planes.width // CELL_PX), "rows": max(1, planes.height // CELL_PX)}
    count = cells["columns"] * cells["rows"]
    moments, share = chain.array("unlike_moments", 8 * count), chain.array("unlike_share", count)
    chain.add(
        "unlike_moments", [planes.planes, peaks, moments], count, width=planes.width, height=planes.height,
        view_count=planes.view_count, directions=np.ravel(directions), cell=CELL_PX, **cells,
    )  # fmt: skip
    chain.add(
        "unlike_share", [moments, share], count, view_count=planes.view_count, side=WINDOW_CELLS,
        least_variance=LEAST_VARIANCE, **cells,
    )  # fmt: skip
    return share, cells
