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

from chromaperture.matching.execution import Execution
from chromaperture.matching.planes.depth_edges import BLOCK_PX, edge_log_odds
from chromaperture.matching.planes.fit import blocks_of_pixels, plane_proposals
from chromaperture.matching.planes.regions import Regions, planes_of_regions
from chromaperture.matching.planes.thin_plate import thin_plate
from chromaperture.settings.stages import PlanesConfig, PlateConfig
from chromaperture.system.threads import BAND_ROWS, each_band

APART_LABELS = 2.0  # of the four blocks about a pixel: farther apart nothing lies between them
# Depth edges come from blocks, so that they have teeth. Two medians take away those of one and two lines.
MEDIAN_PX, MEDIAN_PASSES = 5, 2
NO_EDGE = -6.0  # log odds where a picture is too small for the network


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

    ``nats`` (h, w, N) float32: as `block_sums`; ``first``, ``sigma`` (H, W) float, labels: a first surface, without
    NaN, and the standard deviation of its posterior; ``log_odds`` (2, h, w) float32: as `depth_edges_of`.
    """
    found = planes_of_regions(
        nats, plane_proposals(first, sigma, planes.tiles_px, run=run), log_odds, config=planes, run=run
    )
    own = block_means(first)
    start = np.where(speaks_against(nats, own, found.label, plate), own, found.label)
    return BlockSurface(thin_plate(nats, start, log_odds, config=plate), nats, log_odds, start, found)


def speaks_against(nats: np.ndarray, own: np.ndarray, label: np.ndarray, config: PlateConfig) -> np.ndarray:
    """Return where blocks and their neighbours earn more on their own surface than on another; (h, w) bool."""
    apart = read_along(nats, own) - read_along(nats, label)
    around = cv2.GaussianBlur(apart, (0, 0), 1.0, borderType=cv2.BORDER_REFLECT_101)
    return np.asarray(around > config.own_evidence_nats)


def depth_edges_of(image: np.ndarray) -> np.ndarray:
    """Return the log odds of depth edges between the blocks of an image, linear light; (2, H // 4, W // 4) float32."""
    if min(image.shape[:2]) < 2 * BLOCK_PX:
        return np.full((2, *(n // BLOCK_PX for n in image.shape[:2])), NO_EDGE, np.float32)
    return edge_log_odds(image)


def block_sums(volume: np.ndarray) -> np.ndarray:
    """Sum a volume over squares of 4 px; what is left over at the right and below is left out; (h, w, N) float32."""
    size = BLOCK_PX
    height, width, count = (n // size for n in (*volume.shape[:2], volume.shape[2] * size))
    out = np.empty((height, width, count), np.float32)

    def add(rows: slice) -> None:
        whole = volume[rows.start * size : rows.stop * size, : width * size]
        np.sum(whole.reshape(-1, size, width, size, count), axis=(1, 3), out=out[rows])

    each_band(add, height, rows_a_band=max(1, BAND_ROWS // size))
    return out


def block_means(values: np.ndarray) -> np.ndarray:
    """Return the means of squares of 4 px, without what is left over at the right and below; (h, w) float32."""
    height, width = (n // BLOCK_PX for n in values.shape)
    whole = np.asarray(values[: height * BLOCK_PX, : width * BLOCK_PX], np.float32)
    return whole.reshape(height, BLOCK_PX, width, BLOCK_PX).mean(axis=(1, 3))


def read_along(nats: np.ndarray, label: np.ndarray) -> np.ndarray:
    """Read a volume (h, w, N) at labels (h, w), linearly between them; (h, w) float32."""
    place = np.clip(label, 0, nats.shape[2] - 1)
    below = np.minimum(place.astype(np.intp), nats.shape[2] - 2)[..., None]
    part = (place[..., None] - below).astype(np.float32)
    low, high = (np.take_along_axis(nats, at, axis=2) for at in (below, below + 1))
    return np.asarray((low + part * (high - low))[..., 0])


def at_pixels(label: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Bring labels of blocks to pixels: between blocks where neighbours lie close, else those of the nearest block.

    ``label`` (h, w) float; ``shape`` (int, int): height and width of the picture. Returns (H, W) float32.
    """
    values = np.ascontiguousarray(label, np.float32)
    y, x = ((np.arange(n, dtype=np.float32) - (BLOCK_PX - 1) / 2) / BLOCK_PX for n in shape)
    between = cv2.remap(values, *np.meshgrid(x, y), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    # The range of the four blocks about every pixel.
    wide, square = np.pad(values, 1, mode="edge"), np.ones((2, 2), np.uint8)
    extent = cv2.dilate(wide, square, anchor=(0, 0)) - cv2.erode(wide, square, anchor=(0, 0))
    rows, columns = (np.clip(np.floor(p).astype(int) + 1, 0, n) for p, n in zip((y, x), values.shape, strict=True))
    out = np.where(extent[:, columns][rows] > APART_LABELS, of_pixels(values, shape), between)
    for _ in range(MEDIAN_PASSES):
        out = np.asarray(cv2.medianBlur(out, MEDIAN_PX))
    return out


def of_pixels(of_blocks: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Give pixels what their block has, (h, w) to (H, W)."""
    rows, columns = blocks_of_pixels(shape, of_blocks.shape, BLOCK_PX)
    return np.asarray(of_blocks[:, columns][rows])  # whole rows: .28 ms in place of .81 at 720x480
