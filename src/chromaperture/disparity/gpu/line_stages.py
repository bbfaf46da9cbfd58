"""Lines across borders on a device: which are heard, which share their covariances, what places of an edge cost them.

The stages of `plane_edges.border_lines` and `EdgeLikelihood.costs`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from chromaperture.disparity.edge_likelihood import (
    AMPLITUDE_OCTAVES,
    HALF,
    LEAST_TEXTURE,
    NODES,
    OUTER,
    OWN_COLOUR,
    SHADES_EVERY,
    SHADES_PX,
    SHIFTS,
    UNKNOWN_LEVEL,
    Photograph,
    noise_covariance,
    noise_of_end,
)
from chromaperture.disparity.gpu.device import Array, Chain
from chromaperture.disparity.gpu.line_textures import DIFFERENCES, SAMPLES, LineTextures
from chromaperture.disparity.gpu.surface_stages import add_gaussian, gaussian_taps
from chromaperture.disparity.gpu.workgroups import groups_for
from chromaperture.disparity.plane_edges import LEAST_ACROSS, LEAST_OF_PAIR, LINE_WEIGHT, NORMAL_SIGMA
from chromaperture.disparity.stages.edge_costs import LEAST_OF_TRACE

PLACES = 2 * SHIFTS + 1
MOST_LINES = 16  # eliminated at once: with the matrix 15 of the 16 KB that a workgroup shares
LANES, LANES_IN_SOFTWARE = 64, 8  # invocations of a matrix; in software one vector, whose barriers cost nothing
_SIDE_BY_SIDE = 512  # parts of lines; a photograph of 720x480 px has some 200
_LINE, _PART = 8, 28  # numbers of a `Line` and a `Part` in the shaders
_SHADE_PARTS = 64  # workgroups that sum the shades
_PICTURES = "line_light", "line_noise_at"  # what `inputs_of` gives


class LineArrays(NamedTuple):
    """What lines across the borders of one camera's photographs need on a device.

    Attributes
    ----------
    textures : LineTextures
        Sizes.
    maps, covariances, shares, facts : Array
        As in `LineTextures`.
    light, noise : Array
        (h, w, 3): `Photograph.smooth` and `noise_variance`.
    shared : Array
        Covariance of the colours (3, 3), and of a line's differences of white noise.
    """

    textures: LineTextures
    maps: Array
    covariances: Array
    shares: Array
    facts: Array
    light: Array
    noise: Array
    shared: Array


class Listed(NamedTuple):
    """Lines on a device, P at most.

    Attributes
    ----------
    at : Array
        (2, h, w) uint32: 1 + the line behind a grid point, along rows and along columns, 0 for none.
    about : Array
        (P, 4) uint32: near and far plane, the points of the pair (bits) and whether near comes first (bit 31), weight.
    lines : Array
        (P, 2) uint32: grid point, and a key of both sides.
    numbers : Array
        How many lines, and how many parts of their groups.
    most : int
        P.
    """

    at: Array
    about: Array
    lines: Array
    numbers: Array
    most: int


def line_arrays(chain: Chain, textures: LineTextures) -> LineArrays:
    """Send what a camera's lines have in common, and make room for what a photograph's have."""
    noise = DIFFERENCES @ noise_covariance() @ DIFFERENCES.T
    size = 3 * textures.maps.shape[0] * textures.maps.shape[1]
    names = "maps", "covariances", "shares", "facts"
    maps, covariances, shares, facts = (chain.constant(f"line_{name}", getattr(textures, name)) for name in names)
    light, of_noise = (chain.array(name, size) for name in _PICTURES)
    shared = chain.constant("line_shared", np.concatenate([np.zeros(9), noise.ravel()]))
    return LineArrays(textures, maps, covariances, shares, facts, light, of_noise, shared)


def inputs_of(photograph: Photograph) -> dict[str, np.ndarray]:
    """Return what goes up for the lines of a photograph."""
    return dict(zip(_PICTURES, (photograph.smooth, photograph.noise_variance), strict=True))


def add_colours(chain: Chain, image: Array, shape: tuple[int, int], shared: Array) -> None:
    """Append `Photograph.colours` of an image (h, w, 3), into ``shared``."""
    height, width = (-(-side // SHADES_EVERY) for side in shape)
    fine, coarse = (chain.array(f"shades_{name}", 3 * height * width) for name in ("fine", "coarse"))
    room = chain.array("shades_room", 3 * shape[0] * width)
    for blurred, sigma in zip((fine, coarse), SHADES_PX, strict=True):
        add_gaussian(chain, blurred, room, shape, gaussian_taps(sigma), parts=3, source=image, every=SHADES_EVERY)
    products = chain.array("shade_products", 8 * _SHADE_PARTS)
    chain.add(
        "shade_products", [fine, coarse, products], groups=(_SHADE_PARTS,),
        height=height, width=width, parts=_SHADE_PARTS,
    )  # fmt: skip
    chain.add("line_colours", [products, shared], groups=(1,), parts=_SHADE_PARTS, own_colour=OWN_COLOUR)


def add_listed(
    chain: Chain, choice: Array, planes: Array, arrays: LineArrays, unfinished: Array, *, apart: float, most: int
) -> Listed:
    """Append the lines that cross borders of near planes within the picture.

    Parameters
    ----------
    chain : Chain
    choice : Array
        (h, w), of the grid.
    planes : Array
        (K, 4), of grid points, in layers.
    arrays : LineArrays
    unfinished : Array
        Grows where there are more lines than ``most``.
    apart : float
        Layers.
    most : int
    """
    height, width = arrays.textures.maps.shape[:2]
    groups = groups_for(2 * height * width)
    listed = Listed(
        chain.array("line_at", 2 * height * width, np.uint32), chain.array("line_about", 4 * most, np.uint32),
        chain.array("line_keys", 2 * most, np.uint32), chain.array("line_numbers", 2, np.uint32), most,
    )  # fmt: skip
    counts = chain.array("line_counts", groups[0] * groups[1], np.uint32)
    uses = "indexing", "border_lines"
    of_borders: dict[str, Any] = dict(
        height=height, width=width, half=HALF, shifts=SHIFTS, apart=float(apart), least_of_pair=LEAST_OF_PAIR
    )
    chain.add("border_points", [choice, planes, listed.at, counts], groups=groups, uses=uses, **of_borders)
    chain.add("line_offsets", [counts, listed.numbers, unfinished], groups=(1,), parts=counts.size, most=most)
    chain.add(
        "lines_listed", [choice, planes, counts, arrays.maps, listed.at, listed.about, listed.lines], groups=groups,
        uses=uses, **of_borders, **_of_textures(arrays.textures), first_layer=float(arrays.textures.first_layer),
        most=most,
    )  # fmt: skip
    return listed


def add_line_costs(chain: Chain, choice: Array, listed: Listed, arrays: LineArrays) -> Array:
    """Append `stages.edge_costs` of all lines, (P, PLACES); those along their border lose their points.

    Parameters
    ----------
    chain : Chain
    choice : Array
        (h, w), of the grid.
    listed : Listed
    arrays : LineArrays
    """
    height, width = arrays.textures.maps.shape[:2]
    groups, uses = groups_for(listed.most), ("indexing", "line_group")
    sizes: dict[str, Any] = _of_textures(arrays.textures)
    facts, kinds = (chain.array(f"line_{name}", _LINE * listed.most) for name in ("own", "kinds"))
    parts = chain.array("line_parts", _PART * listed.most)
    taps = _across_taps()
    chain.add(
        "line_sides",
        [
            choice, listed.lines, listed.numbers, arrays.light, arrays.noise, chain.constant("line_taps", taps),
            listed.about, facts,
        ],
        groups=groups, uses=uses, **sizes, height=height, width=width, half=HALF, outer=OUTER, reach=len(taps) // 2,
        least_across=LEAST_ACROSS, line_weight=LINE_WEIGHT,
    )  # fmt: skip
    chain.add(
        "line_powers", [facts, listed.numbers, arrays.facts, arrays.shared, kinds], groups=groups, uses=uses, **sizes,
        least_texture=LEAST_TEXTURE, octaves=AMPLITUDE_OCTAVES, noise_of_end=noise_of_end(),
    )  # fmt: skip
    chain.add(
        "line_parts", [kinds, arrays.facts, arrays.shared, listed.numbers, parts], groups=groups,
        uses=(*uses, "line_part"), **sizes, samples=SAMPLES, most_lines=MOST_LINES, octaves=AMPLITUDE_OCTAVES,
        unknown_level=UNKNOWN_LEVEL, least_of_trace=LEAST_OF_TRACE,
    )  # fmt: skip
    costs = chain.array("line_costs", PLACES * listed.most)
    chain.add(
        "line_costs",
        [
            arrays.covariances, arrays.shares, parts, listed.numbers, arrays.shared, arrays.light, listed.lines, costs,
        ],
        groups=(_SIDE_BY_SIDE, PLACES), uses=("line_part",), height=height, width=width, samples=SAMPLES, places=PLACES,
        most_lines=MOST_LINES, side_by_side=_SIDE_BY_SIDE,
        lanes=LANES_IN_SOFTWARE if chain.device.info.is_software else LANES,
    )  # fmt: skip
    return costs


def _of_textures(textures: LineTextures) -> dict[str, Any]:
    return dict(nodes=NODES**2, layers=textures.layers)


def _across_taps() -> np.ndarray:
    """Return what `plane_edges._across` filters by: a Gaussian, then OpenCV's Sobel; (n, 2), its slope and along it."""
    gaussian = gaussian_taps(NORMAL_SIGMA)
    return np.stack([np.convolve(gaussian, part) for part in ([-1, 0, 1], [1, 2, 1])], axis=1)
