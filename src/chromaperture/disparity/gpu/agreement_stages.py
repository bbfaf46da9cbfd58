"""Planes or the surface that they explain, pixel by pixel, on a device: `plane_agreement.py`, or as fits voted."""

from __future__ import annotations

import cv2
import numpy as np

from chromaperture.disparity.gpu.device import Array, Chain
from chromaperture.disparity.gpu.surface_stages import Grid, SurfaceArrays, per_pixel
from chromaperture.disparity.gpu.voting_stages import Voted
from chromaperture.disparity.gpu.workgroups import groups_for
from chromaperture.disparity.plane_agreement import (
    AGREEMENT_SIGMAS,
    AGREEMENT_WINDOW_PX,
    BESIDE_PX,
    BORDER_PX,
    SURROUNDED_SHARE,
    WHOLE_AREA_SHARE,
)

_PIXELS_COUNTED = 16  # that an invocation of `area_sums.wgsl` counts


def disc(reach_px: int) -> list[float]:
    """Return how far each row of OpenCV's disc reaches to either side; (2 reach + 1,)."""
    side = 2 * reach_px + 1
    widths = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side)).sum(axis=1)
    return [float((width - 1) // 2) for width in widths]


def add_planes_or_surface(
    chain: Chain, a: SurfaceArrays, choice: Array, planes: Array, grid: Grid, *, voted: Voted, block_px: int
) -> tuple[Array, Array]:
    """Append the choice between planes and surface, into ``surface``; return the layers of the planes and those before.

    Parameters
    ----------
    chain : Chain
    a : SurfaceArrays
    choice : Array
        Plane of every pixel, (h, w) uint32.
    planes : Array
        (K, 4); layers, of pixels.
    grid : Grid
    voted : Voted
        Where no fits voted it is `plane_agreement.where_they_agree`, else `plane_voting.planes_or_surface`.
    block_px : int
    """
    pixels = grid.pixels
    there, first = (chain.array(name, pixels) for name in ("plane_layer", "first_layer"))
    apart = chain.array("planes_apart", pixels, np.uint32)
    arrays = [choice, planes, a.surface, a.sigma, there, apart, first]
    per_pixel(chain, "planes_apart", arrays, grid, sigmas=AGREEMENT_SIGMAS)
    sums = chain.array("allowed_sums", planes.size // 2, np.uint32)
    if voted.trusted is not None:
        allowed, before, block, within = voted.trusted, voted.choice, block_px, 1.0
        chain.add("fill_zero", [sums], groups=groups_for(sums.size), uses=("indexing",), size=sums.size)
        _add_area_sums(chain, before, allowed, sums, Grid(grid.height // block, grid.width // block, grid.layers))
    else:  # every pixel has its own answer, and none is too near to ask
        allowed = _add_agreement(chain, choice, planes, apart, (a.sigma, there, first), grid)
        before, block, within = choice, 1, -1.0
    chain.add(
        "planes_taken", [allowed, before, sums, choice, there, a.surface], groups=groups_for(pixels),
        uses=("indexing", "blocks_of_pixels"), height=grid.height, width=grid.width, block=block, within=within,
    )  # fmt: skip
    return there, first


def _add_agreement(
    chain: Chain, choice: Array, planes: Array, apart: Array, labels: tuple[Array, Array, Array], grid: Grid
) -> Array:
    """Append `plane_agreement.where_they_agree`; return where planes are allowed. ``apart`` is changed.

    ``labels`` are the error bar, the layer of the plane, and that of the surface, (h, w) each.
    """
    votes, agreed = (chain.array(name, grid.pixels, np.uint32) for name in ("planes_votes", "planes_agreed"))
    reach = AGREEMENT_WINDOW_PX // 2
    per_pixel(chain, "votes_line", [apart, votes], grid, reach=reach, along_x=True, majority=0)
    per_pixel(
        chain, "votes_line", [votes, apart], grid, reach=reach, along_x=False, majority=AGREEMENT_WINDOW_PX**2 // 2 + 1
    )
    areas, of_areas = _add_areas(chain, choice, apart, grid, of_spots=False)
    _add_area_sums(chain, areas, apart, of_areas, grid)
    spots, of_spots = _add_areas(chain, choice, apart, grid, of_spots=True)
    per_pixel(chain, "spot_sums", [areas, spots, apart, of_spots], grid, reach=BORDER_PX, disc=disc(BORDER_PX))
    per_pixel(
        chain, "apart_kept", [areas, spots, of_areas, of_spots, apart], grid,
        whole_share=WHOLE_AREA_SHARE, surrounded_share=SURROUNDED_SHARE,
    )  # fmt: skip
    tiles = -(-grid.height // BESIDE_PX) * -(-grid.width // BESIDE_PX)
    of_tiles = chain.array("choice_tiles", 2 * tiles, np.uint32)
    chain.add(
        "choice_tiles", [choice, of_tiles], groups=groups_for(tiles), uses=("indexing",),
        height=grid.height, width=grid.width, tile=BESIDE_PX,
    )  # fmt: skip
    per_pixel(
        chain, "planes_allowed", [choice, planes, of_tiles, apart, *labels, agreed], grid,
        tile=BESIDE_PX, reach=BESIDE_PX, disc=disc(BESIDE_PX),
    )  # fmt: skip
    return agreed


def _add_area_sums(chain: Chain, found: Array, apart: Array, sums: Array, grid: Grid) -> None:
    """Append how many pixels have each number of ``found``, and at how many of them planes and surface are apart."""
    chain.add(
        "area_sums", [found, apart, sums], groups=groups_for(-(-grid.pixels // _PIXELS_COUNTED)), uses=("indexing",),
        height=grid.height, width=grid.width,
    )  # fmt: skip


def _add_areas(chain: Chain, choice: Array, apart: Array, grid: Grid, *, of_spots: bool) -> tuple[Array, Array]:
    """Append connected areas of one plane, or of its pixels that differ; their numbers, and room for two sums each."""
    name = "spots" if of_spots else "areas"
    keys, joined, found = (chain.array(f"{name}_{part}", grid.pixels, np.uint32) for part in ("key", "joined", "found"))
    sums = chain.array(f"{name}_sums", 2 * grid.pixels, np.uint32)
    per_pixel(chain, "areas_start", [choice, apart, keys, joined, sums], grid, of_spots=of_spots)
    per_pixel(chain, "areas_joined", [keys, joined], grid)
    per_pixel(chain, "areas_found", [joined, found], grid)
    return found, sums
