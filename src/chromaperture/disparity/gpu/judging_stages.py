"""Which pixels are known, and their learned error bar, on a device: `accurate.judged` of a surface of planes."""

from __future__ import annotations

from typing import Any, NamedTuple

import cv2
import numpy as np

from chromaperture.disparity import evidence_signs
from chromaperture.disparity.gpu.device import Array, Chain
from chromaperture.disparity.gpu.surface_stages import Grid, SurfaceArrays, add_gaussian, gaussian_taps, per_pixel
from chromaperture.disparity.gpu.workgroups import groups_for
from chromaperture.disparity.learned_error_bar import MOST_APART, POOLED_PX, REACHES_PX, SMOOTHED_PX, WIDE_PX, weights
from chromaperture.disparity.plane_agreement import BESIDE_PX, KNOWN_SHARE

_ALIKE = 1e-3  # labels: a surface as near to its plane has taken it, as `learned_error_bar.of_planes` has it
_PARTS = 32  # of the picture that are summed on their own: so many workgroups a plane


class OfPlanes(NamedTuple):
    """Planes on a device: how many at most, how many, every pixel's, its layer there, the surface's layer before."""

    most: int
    number: Array
    choice: Array
    there: Array
    first: Array


def add_judged(
    chain: Chain,
    a: SurfaceArrays,
    blocks: Array,
    planes: OfPlanes,
    grid: Grid,
    *,
    block: int,
    apart: float,
    known_within: float,
    bias: float,
) -> Array:
    """Append `accurate.judged` with the learned bar; return (h, w, 4): layer, error bar, peak, whether known.

    Parameters
    ----------
    chain : Chain
    a : SurfaceArrays
    blocks : Array
        Sums of the volume over blocks.
    planes : OfPlanes
    grid : Grid
    block : int
        Side of a block, px.
    apart, known_within, bias : float, layers
        See `judged`.
    """
    beside = _add_beside(chain, planes.there, grid, apart)
    of_planes = _add_signs_of_planes(chain, a, planes, beside, grid, known_within)
    of_blocks, averages = _add_signs_of_blocks(chain, a, blocks, planes, grid, block)
    bar, known = chain.array("bar", grid.pixels), chain.array("known", grid.pixels, np.uint32)
    per_pixel(
        chain, "known_pixels", [planes.choice, beside, a.surface, a.sigma, planes.there, of_planes, known, bar], grid,
        known_within=known_within, count=grid.layers,
    )  # fmt: skip
    pooled, wide, room = (chain.array(n, k * grid.pixels) for n, k in (("pooled", 2), ("wide", 1), ("pooling", 2)))
    per_pixel(chain, "bar_maps", [a.surface, a.sigma, planes.there, pooled, wide], grid, alike=_ALIKE)
    shape = grid.height, grid.width
    add_gaussian(chain, pooled, room, shape, gaussian_taps(POOLED_PX), parts=2)
    add_gaussian(chain, wide, room, shape, gaussian_taps(WIDE_PX), parts=1)
    near, far = _add_ranges(chain, a, grid)
    model = weights()["planes"]
    signs: dict[str, Any] = {
        name: np.array(three)
        for name, *three in zip(model.names, model.weights, model.least, model.most, strict=True)
    }  # fmt: skip
    chain.add(
        "learned_bar", [pooled, wide, near, far, of_planes, of_blocks, averages, bar], groups=groups_for(grid.pixels),
        uses=("indexing", "blocks_of_pixels"), height=grid.height, width=grid.width, block=block,
        number=planes.most, constant=float(model.constant), **signs,
    )  # fmt: skip
    add_gaussian(chain, bar, room, shape, gaussian_taps(SMOOTHED_PX), parts=1)
    results = chain.array("judged", 4 * grid.pixels)
    per_pixel(
        chain, "judged_results", [a.surface, bar, known, a.likelihood, results], grid, count=grid.layers, bias=bias
    )
    return results


def _add_beside(chain: Chain, there: Array, grid: Grid, apart: float) -> Array:
    names = "plane_steps", "step_distance", "beside_steps"
    steps, away, beside = (chain.array(name, grid.pixels, np.uint32) for name in names)
    per_pixel(chain, "plane_steps", [there, steps], grid, apart=apart)
    per_pixel(chain, "step_distance", [steps, away], grid, reach=BESIDE_PX)
    per_pixel(chain, "beside_steps", [away, beside], grid, reach=BESIDE_PX, around=_around(BESIDE_PX))
    return beside


def _around(reach_px: int) -> list[float]:
    """Return how far each row about a pixel is within reach to either side, as `cv2.distanceTransform` counts."""
    picture = np.ones((2 * reach_px + 1, 2 * reach_px + 1), np.uint8)
    picture[reach_px, reach_px] = 0
    within = cv2.distanceTransform(picture, cv2.DIST_L2, cv2.DIST_MASK_5) <= reach_px
    return [float((width - 1) // 2) for width in within.sum(axis=1)]


def _add_signs_of_planes(
    chain: Chain, a: SurfaceArrays, planes: OfPlanes, beside: Array, grid: Grid, known_within: float
) -> Array:
    sums = chain.array("plane_sums", 8 * _PARTS * planes.most)
    chain.add(
        "plane_sums", [planes.choice, beside, a.surface, a.sigma, planes.there, planes.first, planes.number, sums],
        groups=(planes.most, _PARTS), height=grid.height, width=grid.width, parts=_PARTS, known_within=known_within,
        most_apart=MOST_APART, alike=_ALIKE,
    )  # fmt: skip
    signs = chain.array("plane_signs", 4 * planes.most)
    chain.add(
        "plane_signs", [sums, signs], groups=groups_for(planes.most), uses=("indexing",), planes=planes.most,
        parts=_PARTS, known_share=KNOWN_SHARE,
    )  # fmt: skip
    return signs


def _add_signs_of_blocks(
    chain: Chain, a: SurfaceArrays, blocks: Array, planes: OfPlanes, grid: Grid, block: int
) -> tuple[Array, Array]:
    """Append `evidence_signs.signs_of_evidence`: the signs of blocks, behind the planes' averages the frame's."""
    shifts = evidence_signs.SHIFTS
    height, width = grid.height // block, grid.width // block
    size = height * width * len(shifts)
    profile, pooled, room = (chain.array(name, size) for name in ("profile", "profile_pooled", "profile_room"))
    each = chain.constant("shifts", np.concatenate([shifts, np.gradient(shifts)]))
    of_picture: dict[str, Any] = dict(height=grid.height, width=grid.width, block=block)
    chain.add(
        "answer_profile", [blocks, a.surface, each, profile, pooled], groups=groups_for(size), uses=("indexing",),
        **of_picture, count=grid.layers, shift_count=len(shifts),
    )  # fmt: skip
    taps = gaussian_taps(evidence_signs.WINDOW_PX / block)
    add_gaussian(chain, pooled, room, (height, width), taps, parts=len(shifts))
    signs, averages = chain.array("block_signs", 2 * height * width), chain.array("plane_averages", planes.most + 1)
    sharp = evidence_signs.SHARP_STEPS
    of_fall = ("before", -sharp), ("middle", 0), ("behind", sharp)
    at: dict[str, Any] = {name: int(np.flatnonzero(shifts == shift)[0]) for name, shift in of_fall}
    chain.add(
        "block_signs", [profile, pooled, each, signs], groups=groups_for(height * width), uses=("indexing",),
        blocks=height * width, shift_count=len(shifts), least_spread=evidence_signs.LEAST_SPREAD,
        samples=float(2 * np.pi * evidence_signs.WINDOW_PX**2 / evidence_signs.PIXELS_ALIKE), **at,
    )  # fmt: skip
    chain.add(
        "sums_of_blocks", [planes.choice, signs, planes.number, averages], groups=(planes.most + 1,), **of_picture,
        planes=planes.most, least_nats=evidence_signs.LEAST_NATS,
    )  # fmt: skip
    chain.add(
        "sharpness_of_blocks", [planes.choice, averages, signs], groups=groups_for(height * width), uses=("indexing",),
        **of_picture,
    )  # fmt: skip
    return signs, averages


def _add_ranges(chain: Chain, a: SurfaceArrays, grid: Grid) -> tuple[Array, Array]:
    """Append `learned_error_bar.ranges`: a square of squares is a square."""
    rows, near, far = (chain.array(name, 4 * grid.pixels) for name in ("range_rows", "range_near", "range_far"))
    steps = REACHES_PX[0], REACHES_PX[1] - REACHES_PX[0]
    for source, target, reach in ((a.surface, near, steps[0]), (near, far, steps[1])):
        per_pixel(chain, "range_line", [source, rows], grid, reach=reach, along_x=True, of_one=source is a.surface)
        per_pixel(chain, "range_line", [rows, target], grid, reach=reach, along_x=False, of_one=False)
    return near, far
