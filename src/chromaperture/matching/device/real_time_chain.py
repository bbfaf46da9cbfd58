"""Quality "real-time" as one chain on the device: ``real_time.py``, stage by stage, in WGSL."""

from __future__ import annotations

from typing import Any

import numpy as np

from chromaperture.matching.device.correlation_stages import (
    LIKELIHOOD,
    Kept,
    add_cell_planes,
    add_cell_scores,
    add_correlation,
    add_enlarged_cells,
    add_label_likelihood,
)
from chromaperture.matching.device.device import Array, Chain, groups_for
from chromaperture.matching.device.view_stages import GUIDE_SCALE, Planes, add_halved_views, add_two_views
from chromaperture.matching.error_bar import CONFIDENCE_SCALE_PX, MAX_SIGMA_PX, sigma_of_range
from chromaperture.matching.readable.bilateral import even_link
from chromaperture.matching.readable.correlation import SCORE_PARTS
from chromaperture.matching.readable.enlarge import JUMP_PX
from chromaperture.matching.readable.four_paths import path_parts
from chromaperture.matching.readable.place import (
    BESIDE_NEARER,
    BIAS,
    EDGE_REACH_PX,
    EDGE_SHARE,
    FARTHEST_OF_FIVE,
    LEAST_INFORMATION,
    LEAST_UNEXPLAINED,
    LEAST_UNEXPLAINED_OF_THREE,
    NEARER_REACH,
    SCATTER,
    SEEN_REACH,
    WIDEST_SHARE,
)
from chromaperture.matching.real_time import RealTimeMethod
from chromaperture.settings.methods import RealTimeConfig

_LANES = 4  # invocations that share a path
# Steps of a path that are read before they are needed. On an H200 a step took 0.7 us without.
_AHEAD = 4


def add_real_time(chain: Chain, image: Array, size: tuple[int, int], method: RealTimeMethod) -> None:
    """Add all stages from the image (H, W, 3) to ``disparity``, ``sigma`` and ``confidence``, (H, W) each."""
    config, space, label_map = method.config, method.space, method.label_map
    height, width = size
    whole = add_halved_views(chain, image, size, space, config.views)
    cell_px = config.correlation.cell_px
    planes = whole if cell_px == 1 else add_cell_planes(chain, whole)
    layers_px, labels_px = method.layers_px, method.labels_px
    pitch = 4 * -(-len(labels_px) // 4)  # whole vectors of four labels
    labels = chain.constant("labels", np.stack([np.asarray(part, np.float32) for part in label_map]))
    of_labels: dict[str, Any] = {
        "labelled": not label_map.is_identity, "full_width": width, "full_height": height, "label_spacing": 2 * cell_px
    }  # fmt: skip
    of_layers: dict[str, Any] = {"layer_count": len(labels_px), "pitch": pitch}
    first, step = float(labels_px[0]), float(labels_px[1] - labels_px[0])
    frame: dict[str, Any] = {"width": planes.width, "height": planes.height}
    at_once = cell_px == 1 and label_map.is_identity and len(labels_px) == len(layers_px)
    if cell_px == 1:
        kept = Kept("likelihood", ("nats", "scores_nats"), LIKELIHOOD)
        correlated = add_correlation(
            chain, planes, layers_px, space.directions, config.correlation,
            pitch=pitch if at_once else len(layers_px), kept=kept if at_once else None,
        )  # fmt: skip
        score = list(correlated)[-1][0]
    else:
        score = add_cell_scores(chain, whole, planes, layers_px, space.directions, config.correlation)
    likelihood = score
    if not at_once:
        parts = 1 if cell_px == 1 else SCORE_PARTS
        likelihood = add_label_likelihood(
            chain, planes, score, labels, layers_px, labels_px, pitch=pitch, score_parts=parts, of_labels=of_labels
        )
    winner, places = _add_paths(chain, planes, likelihood, config, of_layers)
    smoothed = _add_smoothing_along_surface(chain, planes, winner, places, config)

    ranges, surface = chain.array("ranges", 2 * planes.pixels), chain.array("surface", 4 * planes.pixels)
    reach = -(-EDGE_REACH_PX // cell_px)
    between: dict[str, Any] = {"first_px": first, "step_px": step, "reach": reach, **frame, **of_labels}
    quads = -(-planes.width // 4) * planes.height
    chain.add("surface", [smoothed, labels, ranges], quads, **between)
    chain.add(
        "surface_range", [ranges, smoothed, winner, labels, planes.planes, surface],
        planes.width * -(-planes.height // 4), layer_count=len(labels_px), widest_px=sigma_of_range(labels_px),
        scatter=SCATTER, bias=BIAS, widest_share=WIDEST_SHARE, seen_reach=SEEN_REACH,
        mask_plane=(planes.view_count + 1) * planes.pixels, edge_share=EDGE_SHARE, **between,
    )  # fmt: skip

    if cell_px > 1:
        surface = add_enlarged_cells(chain, whole, planes, surface)
    lacking, cells = add_two_views(chain, image, size, space.rows)
    assert whole.full_guide is not None
    outputs = [chain.array(name, height * width, np.float32) for name in ("disparity", "sigma", "confidence")]
    chain.add(
        "enlarge", [surface, whole.full_guide, whole.stats, labels, lacking, *outputs], height * width, guide_start=0,
        guide_scale=GUIDE_SCALE + 1, width=width, height=height, half_width=whole.width, jump_px=JUMP_PX,
        labelled=not label_map.is_identity, range_sigma_px=sigma_of_range(config.layers.values_px),
        floor_px=method.floor_px, max_sigma_px=MAX_SIGMA_PX, confidence_scale_px=CONFIDENCE_SCALE_PX, **cells,
    )  # fmt: skip


def _add_paths(
    chain: Chain, planes: Planes, likelihood: Array, config: RealTimeConfig, of_layers: dict[str, Any]
) -> tuple[Array, Array]:
    """Add the four paths and the best layer; return it, and the places between the layers."""
    paths = config.paths
    size: dict[str, Any] = {"width": planes.width, "height": planes.height}
    pitch = of_layers["pitch"]
    # Costs of two layers share 32 bits.
    costs = [
        chain.array(name, planes.pixels * pitch // 2, np.uint32)
        for name in ("rightward", "leftward", "downward", "upward")
    ]
    exchange = "lanes_quad" if chain.device.subgroups else "lanes_shared"
    parts = path_parts(paths.jump_penalty)
    last_parts = 65535 / paths.jump_penalty  # what comes up the columns is not rounded on the CPU
    for direction, cost in enumerate(costs):
        along_row = direction < 2
        lines, rows = (planes.height, []) if along_row else (planes.width, costs[:2])
        chain.add(
            "four_paths", [likelihood, planes.planes, planes.stats, cost, *rows], groups=(-(-lines // (64 // _LANES)),),
            uses=(exchange, "packed_costs", "own_of_rows" if along_row else "own_of_columns"), direction=direction,
            row_share=paths.row_share, guide_plane=planes.view_count * planes.pixels, pitch=pitch,
            jump=paths.jump_penalty, row_parts=parts, cost_parts=parts if direction < 3 else last_parts,
            edge_range=paths.edge_range, edge_floor=paths.edge_floor, ahead=_AHEAD, vectors=-(-pitch // (4 * _LANES)),
            **size,
        )  # fmt: skip
    winner, places = chain.array("winner", 3 * planes.pixels), chain.array("places", 2 * planes.pixels)
    chain.add(
        "path_winner", [likelihood, *costs, winner, places], planes.pixels, row_parts=parts, cost_parts=last_parts,
        view_count=planes.view_count, temperature=paths.temperature, farthest_of_five=FARTHEST_OF_FIVE,
        least_unexplained=LEAST_UNEXPLAINED, least_unexplained_of_three=LEAST_UNEXPLAINED_OF_THREE,
        least_information=LEAST_INFORMATION, **size, **of_layers,
    )  # fmt: skip
    chain.add(
        "beside_nearer", [winner, places], planes.pixels, nearer_reach=NEARER_REACH, weight=BESIDE_NEARER, **size,
    )  # fmt: skip
    return winner, places


def _add_smoothing_along_surface(
    chain: Chain, planes: Planes, winner: Array, places: Array, config: RealTimeConfig
) -> Array:
    even = even_link(config.smoothing_sigma_px / config.correlation.cell_px)
    links = add_links(chain, planes, winner, even=even, edge_range=config.smoothing_edge_range, by_layer=True)
    return add_recursions(chain, planes, places, links, map_count=2, gain=1.0, own=1.0)


def add_links(chain: Chain, planes: Planes, layers: Array, *, even: float, edge_range: float, by_layer: bool) -> Array:
    """Add the weights of the links between neighbours, (2, h, w); ``layers`` is read only where ``by_layer``."""
    links = chain.array("links", 2 * planes.pixels)
    chain.add(
        "links", [planes.planes, planes.stats, layers, links], planes.pixels, width=planes.width, height=planes.height,
        guide_plane=planes.view_count * planes.pixels, even_link=even, edge_range=edge_range, by_layer=by_layer,
    )  # fmt: skip
    return links


def add_recursions(
    chain: Chain,
    planes: Planes,
    maps: Array,
    links: Array,
    *,
    map_count: int,
    gain: float,
    own: float,
    pitch: int | None = None,
) -> Array:
    """Add the recursions of `smoothing` along x, then along y; return the sums, in place of the maps.

    ``pitch`` is the distance of two pixels' maps where it is not their number.
    """
    pitch = pitch or map_count
    frame: dict[str, Any] = {"width": planes.width, "height": planes.height, "gain": gain, "own": own}
    between = chain.arrays.get(f"{maps.name}_x") or chain.array(f"{maps.name}_x", maps.size)
    for along_x, source, target in ((True, maps, between), (False, between, maps)):
        lines = planes.height if along_x else planes.width
        chain.add(
            "smoothing", [source, links, target], groups=groups_for(lines * map_count, 8), along_x=along_x,
            map_count=map_count, pitch=pitch, **frame,
        )  # fmt: skip
    return maps
