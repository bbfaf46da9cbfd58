"""Which pixels are known, and their error bar, on a device: `accurate.judged`; and what labels are in pixels."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from chromaperture.disparity import evidence_signs
from chromaperture.disparity.accurate import BIAS_OF_PLANES, MEDIAN_PASSES, MEDIAN_PX
from chromaperture.disparity.error_bar import CONFIDENCE_SCALE_PX, LIGHT_WINDOW_PX, MAX_SIGMA_PX, sigma_of_range
from chromaperture.disparity.gpu.device import Array, Chain
from chromaperture.disparity.gpu.measured import MAPS
from chromaperture.disparity.gpu.surface_stages import Grid, SurfaceArrays, add_gaussian, gaussian_taps, per_pixel
from chromaperture.disparity.gpu.view_stages import SHARED
from chromaperture.disparity.gpu.workgroups import groups_for
from chromaperture.disparity.labels import LabelMap
from chromaperture.disparity.learned_error_bar import (
    APART,
    LEAST_DISTANCE,
    POOLED_PX,
    REACHES_PX,
    SMOOTHED_PX,
    Weights,
    weights,
)

_PARTS = 32  # of the picture that are summed on their own: so many workgroups a plane


class OfPlanes(NamedTuple):
    """Planes on a device: how many at most, how many, every pixel's, its layer there, the surface's layer before.

    ``blocks`` are sums of the volume over squares of ``block`` px; ``fits`` and ``skipped`` are as `Voted` has them.
    """

    most: int
    number: Array
    choice: Array
    there: Array
    first: Array
    blocks: Array
    block: int
    fits: Array | None = None
    skipped: int = 0


def add_judged(
    chain: Chain,
    a: SurfaceArrays,
    grid: Grid,
    *,
    planes: OfPlanes | None,
    learned: bool,
    known_within: float,
    known_from_nats: float,
    edge_share: float,
) -> Array:
    """Append `accurate.judged`; return (h, w, 4): layer, error bar in layers, peak, whether known.

    Parameters
    ----------
    chain : Chain
    a : SurfaceArrays
    grid : Grid
    planes : OfPlanes or None
    learned : bool
    known_within : float, layers
    known_from_nats, edge_share : float
        See `judged`.
    """
    pooled, room = (chain.array(name, grid.pixels) for name in ("pooled", "pooling"))
    bar, known = (chain.array(name, grid.pixels, np.uint32) for name in ("bar", "known"))
    # The bar that is not learned has the same reaches: `accurate.POOLED_PX`, `accurate.EDGE_REACH_PX`.
    shape, taps = (grid.height, grid.width), gaussian_taps(POOLED_PX)
    if planes is None:
        per_pixel(
            chain, "known_surface", [a.surface, a.sigma, known, pooled], grid, known_within=known_within,
            count=grid.layers,
        )  # fmt: skip
    else:
        spreads, evidence_of = _add_signs_of_blocks(chain, a, planes, grid)
        per_pixel(
            chain, "known_pixels", [planes.choice, a.surface, a.sigma, planes.there, evidence_of, known, bar, pooled],
            grid, known_within=known_within, count=grid.layers, known_from=known_from_nats,
        )  # fmt: skip
    add_gaussian(chain, pooled, room, shape, taps, parts=1)
    if planes is not None and learned:
        rejected = _add_signs_of_planes(chain, planes, grid)
        of_blocks = _add_block_maps(chain, a, planes, spreads, grid)
        of_frame = chain.array("posterior_of_frame", 1)
        chain.add(
            "frame_posterior", [pooled, of_frame], groups=(1,), uses=("weighed_signs",), height=grid.height,
            width=grid.width, block=planes.block,
        )  # fmt: skip
        chain.add(
            "learned_bar", [pooled, rejected, evidence_of, of_blocks, of_frame, bar], groups=groups_for(grid.pixels),
            uses=("indexing", "weighed_signs"), height=grid.height, width=grid.width, **_numbers(weights()["planes"]),
        )  # fmt: skip
    else:
        _add_surface_bar(
            chain, [pooled, *_add_ranges(chain, a, grid), bar], grid, learned=learned, edge_share=edge_share
        )
    if learned:
        add_gaussian(chain, bar, room, shape, gaussian_taps(SMOOTHED_PX), parts=1)
    results = chain.array("judged", 4 * grid.pixels)
    per_pixel(
        chain, "judged_results", [a.surface, bar, known, a.likelihood, results], grid, count=grid.layers,
        bias=0.0 if planes is None else BIAS_OF_PLANES,
    )  # fmt: skip
    return results


def add_median(chain: Chain, judged: Array, grid: Grid) -> Array:
    """Append `accurate.median_filtered`; return what `add_judged` returns, with other layers."""
    room = chain.array("judged_median", judged.size)
    before, after = judged, room
    for _ in range(MEDIAN_PASSES):
        per_pixel(chain, "median_of_window", [before, after], grid, reach=MEDIAN_PX // 2)
        before, after = after, before
    return before


class Light(NamedTuple):
    """Where the photograph is usable, (h, w), and where it lacks two views, as `add_two_views` has it."""

    usable: Array
    lacking: Array
    cells: dict[str, Any]


def add_label_maps(
    chain: Chain, judged: Array, light: Light, grid: Grid, label_map: LabelMap, labels_px: np.ndarray
) -> None:
    """Append `AccurateMethod.of_labels`: the chain's ``disparity``, ``sigma`` and ``confidence``, (h, w) each.

    Parameters
    ----------
    chain : Chain
    judged : Array
        Of `add_judged`.
    light : Light
        Of the picture that `clipped_filled` has made.
    grid : Grid
    label_map : LabelMap
    labels_px : (N,) float, px
    """
    labels = chain.constant("labels", np.stack([np.asarray(part, np.float32) for part in label_map]))
    outputs = [chain.array(name, grid.pixels) for name in MAPS]
    chain.add(
        "label_maps", [judged, labels, light.lacking, light.usable, *outputs], groups=groups_for(grid.pixels),
        uses=(*SHARED, "finishing"), height=grid.height, width=grid.width, labelled=not label_map.is_identity,
        reach=LIGHT_WINDOW_PX // 2, first_px=float(labels_px[0]), step_px=float(labels_px[1] - labels_px[0]),
        range_sigma_px=sigma_of_range(labels_px), max_sigma_px=MAX_SIGMA_PX, confidence_scale_px=CONFIDENCE_SCALE_PX,
        **light.cells,
    )  # fmt: skip


def _add_surface_bar(chain: Chain, arrays: list[Array], grid: Grid, *, learned: bool, edge_share: float) -> None:
    chain.add(
        "surface_bar", arrays, groups=groups_for(grid.pixels), uses=("indexing", "weighed_signs"), height=grid.height,
        width=grid.width, learned=learned, edge_share=edge_share, **_numbers(weights()["surface"]),
    )  # fmt: skip


def _numbers(model: Weights) -> dict[str, Any]:
    """Return the constants of a bar's shader: of every sign its weight, and the least and the most that it counts."""
    signs = zip(model.names, model.weights, model.least, model.most, strict=True)
    return {"constant": float(model.constant), **{name: np.array(three) for name, *three in signs}}


def _add_signs_of_planes(chain: Chain, planes: OfPlanes, grid: Grid) -> Array:
    """Append `learned_error_bar.of_planes`."""
    sums, rejected = chain.array("plane_sums", 2 * _PARTS * planes.most), chain.array("rejected", planes.most)
    chain.add(
        "plane_sums", [planes.choice, planes.there, planes.first, planes.number, sums], groups=(planes.most, _PARTS),
        height=grid.height, width=grid.width, parts=_PARTS, apart=APART,
    )  # fmt: skip
    chain.add(
        "plane_signs", [sums, rejected], groups=groups_for(planes.most), uses=("indexing",), planes=planes.most,
        parts=_PARTS,
    )  # fmt: skip
    return rejected


def _add_signs_of_blocks(chain: Chain, a: SurfaceArrays, planes: OfPlanes, grid: Grid) -> tuple[Array, Array]:
    """Append `evidence_signs.signs_of_evidence`: the spread of every block, and the signs of planes."""
    block = planes.block
    shifts = evidence_signs.SHIFTS
    height, width = grid.height // block, grid.width // block
    size = height * width * len(shifts)
    profile, pooled, room = (chain.array(name, size) for name in ("profile", "profile_pooled", "profile_room"))
    each = chain.constant("shifts", np.concatenate([shifts, np.gradient(shifts)]))
    of_picture: dict[str, Any] = dict(height=grid.height, width=grid.width, block=block)
    chain.add(
        "answer_profile", [planes.blocks, a.surface, each, profile, pooled], groups=groups_for(size),
        uses=("indexing",), **of_picture, count=grid.layers, shift_count=len(shifts),
    )  # fmt: skip
    taps = gaussian_taps(evidence_signs.WINDOW_PX / block)
    add_gaussian(chain, pooled, room, (height, width), taps, parts=len(shifts))
    spreads, evidence_of = chain.array("block_spreads", height * width), chain.array("evidence_of", 2 * planes.most)
    chain.add(
        "block_signs", [pooled, each, spreads], groups=groups_for(height * width), uses=("indexing",),
        blocks=height * width, shift_count=len(shifts), least_spread=evidence_signs.LEAST_SPREAD,
        samples=float(2 * np.pi * evidence_signs.WINDOW_PX**2 / evidence_signs.PIXELS_ALIKE),
    )  # fmt: skip
    of_fall = zip(("before", "middle", "behind"), evidence_signs.OF_FALL, strict=True)
    at: dict[str, Any] = {name: int(np.flatnonzero(shifts == shift)[0]) for name, shift in of_fall}
    chain.add(
        "sums_of_blocks", [planes.choice, profile, planes.number, evidence_of], groups=(planes.most,), **of_picture,
        **at, shift_count=len(shifts), least_evidence=evidence_signs.LEAST_EVIDENCE,
    )  # fmt: skip
    return spreads, evidence_of


def _add_block_maps(chain: Chain, a: SurfaceArrays, planes: OfPlanes, spreads: Array, grid: Grid) -> Array:
    """Append `learned_error_bar.of_fits`, and what of a block's signs its pixels have."""
    signs = chain.array("block_maps", 2 * grid.pixels)
    fits = planes.fits or chain.array("no_fits", 1)
    blocks = (grid.height // planes.block) * (grid.width // planes.block)
    chain.add(
        "block_maps", [a.surface, fits, spreads, signs], groups=groups_for(grid.pixels),
        uses=("indexing", "blocks_of_pixels"), height=grid.height, width=grid.width, block=planes.block,
        skipped=planes.skipped, fit_count=fits.size // blocks - planes.skipped if planes.fits else 0,
        least=LEAST_DISTANCE,
    )  # fmt: skip
    return signs


def _add_ranges(chain: Chain, a: SurfaceArrays, grid: Grid) -> tuple[Array, Array]:
    """Append `learned_error_bar.ranges`: a square of squares is a square."""
    rows, near, far = (chain.array(name, 4 * grid.pixels) for name in ("range_rows", "range_near", "range_far"))
    steps = REACHES_PX[0], REACHES_PX[1] - REACHES_PX[0]
    for source, target, reach in ((a.surface, near, steps[0]), (near, far, steps[1])):
        per_pixel(chain, "range_line", [source, rows], grid, reach=reach, along_x=True, of_one=source is a.surface)
        per_pixel(chain, "range_line", [rows, target], grid, reach=reach, along_x=False, of_one=False)
    return near, far
