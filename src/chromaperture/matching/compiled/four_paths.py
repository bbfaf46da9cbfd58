"""Semi-global matching along rows and columns, compiled; ``readable/four_paths.py`` explains what is computed.

The volume of scores is made by `bands.py` and turned into log-likelihoods in place; a second one of the same size takes
the sum of the costs along the rows (`path_costs.py`). Memory: 4 bytes a score of the halved picture.
"""

from __future__ import annotations

import cv2
import numpy as np

from chromaperture.matching.compiled import label_scores, path_costs
from chromaperture.matching.compiled.cell_scores import cell_scores
from chromaperture.matching.compiled.correlation import filtered_scores
from chromaperture.matching.compiled.layout import BLOCK, whole_vectors
from chromaperture.matching.compiled.workspace import workspace
from chromaperture.matching.labels import LabelMap, PathWinner
from chromaperture.matching.readable.correlation import cells_of
from chromaperture.matching.views import Views
from chromaperture.settings.stages import CorrelationConfig, FourPathsConfig
from chromaperture.system.threads import in_parallel


def four_path_winner(
    views: Views,
    layers_px: np.ndarray,
    label_map: LabelMap,
    *,
    correlation: CorrelationConfig,
    paths: FourPathsConfig,
    labels_px: np.ndarray | None = None,
) -> PathWinner:
    """Find the best label of every pixel along four paths, as `readable.four_path_winner`."""
    guide, mask = views.guide, views.mask
    if correlation.cell_px == 2:
        guide, mask = cells_of(guide), cells_of(mask)
    height, width = mask.shape
    labels = LabelMap(*(np.ascontiguousarray(part, np.float32) for part in label_map))
    links_x, links_y = (_links(guide, axis, paths) for axis in (1, 0))
    labels_px = layers_px if labels_px is None else labels_px
    first, step = (np.float32(value) for value in (labels_px[0], labels_px[1] - labels_px[0]))
    settings = path_costs.Settings(
        np.float32(paths.jump_penalty), np.float32(paths.row_share), np.float32(paths.temperature),
        first, step, len(labels_px),
    )  # fmt: skip
    between = labels.scale.size > 1 or len(labels_px) > len(layers_px)
    layers = label_scores.Layers(
        np.float32(layers_px[0]), np.float32(layers_px[1] - layers_px[0]), len(layers_px), between
    )
    mask = np.ascontiguousarray(mask, np.float32)
    two_views = views.pictures.shape[2] == 2
    winner = PathWinner(*(np.empty((height, width), np.float32) for _ in PathWinner._fields))
    with workspace() as memory:
        if correlation.cell_px == 2:
            volume = cell_scores(views, layers_px, memory, config=correlation)
        else:
            volume, _ = filtered_scores(views, layers_px, memory, config=correlation)
        size = -(-width // BLOCK) * BLOCK * height * whole_vectors(len(labels_px))
        nats = memory.array("nats", (size,), np.int16) if between else volume
        sums = memory.array("sums", (size,), np.int16)

        def along_rows(_: int, top: int, bottom: int) -> None:
            path_costs.along_rows(volume, nats, sums, mask, links_x, labels, layers, settings, two_views, top, bottom)

        def along_columns(_: int, first_block: int, last_block: int) -> None:
            path_costs.along_columns(nats, sums, links_y, settings, first_block, last_block, winner)

        in_parallel(along_rows, height)
        in_parallel(along_columns, -(-width // BLOCK))
    return winner


def _links(guide: np.ndarray, axis: int, paths: FourPathsConfig) -> np.ndarray:
    """Weight of the penalty between each pixel and the one before it along an axis; 0 for the first; (H, W)."""
    links = np.zeros(guide.shape, np.float32)
    here, before = (guide[:, 1:], guide[:, :-1]) if axis == 1 else (guide[1:], guide[:-1])
    if here.size:
        fading = cv2.exp(cv2.absdiff(here, before) * np.float32(-1 / paths.edge_range)).reshape(here.shape)
        part = links[:, 1:] if axis == 1 else links[1:]
        np.multiply(fading, np.float32(1 - paths.edge_floor), out=part)
        part += np.float32(paths.edge_floor)
    return links
