"""Correlation, bilateral filter and best layer, compiled; ``readable/bilateral.py`` explains what is computed."""

from __future__ import annotations

import numpy as np

from chromaperture.matching.compiled import layout, strips
from chromaperture.matching.compiled.correlation import filtered_scores
from chromaperture.matching.compiled.workspace import workspace
from chromaperture.matching.labels import Winner
from chromaperture.matching.readable.bilateral import even_link
from chromaperture.matching.views import Views
from chromaperture.settings.stages import BilateralConfig, CorrelationConfig
from chromaperture.system.threads import in_parallel, thread_count


def bilateral_winner(
    views: Views, layers_px: np.ndarray, *, correlation: CorrelationConfig, bilateral: BilateralConfig
) -> Winner:
    """Take the best layer of the filtered scores, as `readable.bilateral_winner`."""
    height, width = views.mask.shape
    link = even_link(bilateral.sigma_px)
    first, step = np.float32(layers_px[0]), np.float32(layers_px[1] - layers_px[0])
    settings = strips.Columns(len(layers_px), first, step, np.float32(link))
    winner = Winner(*(np.empty((height, width), np.float32) for _ in range(3)))
    with workspace() as memory:
        volume, maps = filtered_scores(
            views, layers_px, memory, config=correlation, even_link=link, texture_weighting=bilateral.texture_weighting
        )
        size = strips.scratch_rows(height) * layout.BLOCK * layout.whole_vectors(len(layers_px))
        scratch = memory.array("strip", (thread_count(), size), np.float32)

        def take_winners(thread: int, first_block: int, last_block: int) -> None:
            strips.take_winners(volume, maps, settings, first_block, last_block, scratch[thread], winner)

        in_parallel(take_winners, -(-width // layout.BLOCK))
    return winner
