"""One surface for the flat and the curved: planes where evidence is weak, a plate that bends where it is strong.

Windows and paths pool tens of pixels, a wall has tens of thousands. All evidence is summed over blocks of 4 px. Regions
between the depth edges that the photograph shows (`depth_edges.py`) choose planes and join (`regions.py`): that
tells where weakly textured surfaces are. Where the evidence of blocks themselves speaks against their plane, the
surface of the paths stays. From there a thin plate follows the evidence (`thin_plate.py`).
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from chromaperture.matching.blocks import BLOCK_PX
from chromaperture.matching.execution import Execution
from chromaperture.matching.planes.fit import plane_proposals
from chromaperture.matching.planes.regions import Regions, planes_of_regions
from chromaperture.matching.planes.thin_plate import thin_plate
from chromaperture.settings.stages import PlanesConfig, PlateConfig


class BlockSurface(NamedTuple):
    """What blocks of pixels say of a surface; labels count from 0."""

    label: np.ndarray  # (h, w) float
    nats: np.ndarray  # (h, w, N) float32; sums of the evidence of their pixels
    log_odds: np.ndarray  # (2, h, w) float32; of depth edges, as `edge_log_odds`
    start: np.ndarray  # (h, w) float; where the plate began
    regions: Regions


def surface_of_blocks(
    nats: np.ndarray,
    first: np.ndarray,
    sigma: np.ndarray,
    log_odds: np.ndarray,
    *,
    planes: PlanesConfig,
    plate: PlateConfig,
    run: Execution,
) -> BlockSurface:
    """Find the surface that explains the evidence of blocks.

    ``nats`` (h, w, N) float32: sums of log-likelihoods; ``first``, ``sigma`` (h, w) float, labels: a first surface,
    without NaN, and the standard deviation of its posterior; ``log_odds`` (2, h, w) float32: as `edge_log_odds`.
    """
    sizes = tuple(size // BLOCK_PX for size in planes.tiles_px)
    proposals = plane_proposals(first, sigma, sizes, run=run)
    found = planes_of_regions(nats, proposals, log_odds, config=planes, run=run)
    start = np.where(speaks_against(nats, first, found.label, plate), first, found.label)
    return BlockSurface(thin_plate(nats, start, log_odds, config=plate), nats, log_odds, start, found)


def speaks_against(nats: np.ndarray, own: np.ndarray, label: np.ndarray, config: PlateConfig) -> np.ndarray:
    """Return where blocks and their neighbours earn more on their own surface than on another; (h, w) bool."""
    apart = read_along(nats, own) - read_along(nats, label)
    around = cv2.GaussianBlur(apart, (0, 0), 1.0, borderType=cv2.BORDER_REFLECT_101)
    return np.asarray(around > config.own_evidence_nats)


def read_along(nats: np.ndarray, label: np.ndarray) -> np.ndarray:
    """Read a volume (h, w, N) at labels (h, w), linearly between them; (h, w) float32."""
    place = np.clip(label, 0, nats.shape[2] - 1)
    below = np.minimum(place.astype(np.intp), nats.shape[2] - 2)[..., None]
    part = (place[..., None] - below).astype(np.float32)
    low, high = (np.take_along_axis(nats, at, axis=2) for at in (below, below + 1))
    return np.asarray((low + part * (high - low))[..., 0])
