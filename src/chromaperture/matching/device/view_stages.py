"""Views, guide and mask on the device: the stages of ``views.py``, in WGSL."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import cv2
import numpy as np

from chromaperture.color.image import DARK, SATURATION
from chromaperture.matching.device.device import Array, Chain
from chromaperture.matching.error_bar import LIGHT_WINDOW_PX
from chromaperture.matching.integer_light import LEAST_EXPONENT, LIGHT_BITS, MOVE_PARTS, halved_moves, smoothing_taps
from chromaperture.matching.readable.upsample import JUMP_PX, LEAST_WEIGHT
from chromaperture.matching.views import (
    CONSTANT,
    FILL_SIGMA_PX,
    FILL_UNITS,
    GUIDE_SIGMA_PX,
    USABLE,
    ViewSpace,
    constant_view,
    no_usable_pixel,
    percentile_spacing,
)
from chromaperture.settings.stages import ViewsConfig

_PARTS = 256  # most workgroups that sum a picture up; one workgroup sums their sums
_MOST_CONSTANTS = 24  # pixels of a Gaussian whose weights the shader names; more would be long to compile
SAMPLES_AT_ONCE = 8  # that `guide_scale` reads before it counts them; by hand
STATS = 16  # numbers of `shared`'s `stats`
_USABLE_AT, _VARIANCE_AT = 4, 8
GUIDE_SCALE = 12  # place of the unit of the matched guide; that of the full one follows, and that of a reduced picture
_SLOT = 2  # of the last


class Planes(NamedTuple):
    """What is matched, on the device."""

    planes: Array  # (K + 2, h, w): views, guide, mask
    stats: Array  # see `shared` in ``common.wgsl``
    full_guide: Array | None  # (H, W), of a halved picture
    width: int  # of the planes
    height: int
    view_count: int

    @property
    def pixels(self) -> int:
        """Of a plane."""
        return self.width * self.height


def add_views(chain: Chain, image: Array, size: tuple[int, int], space: ViewSpace, config: ViewsConfig) -> Planes:
    """Add the views at full resolution, as `views.filtered_views`; ``size`` is (height, width)."""
    height, width = size
    stats = _add_light(chain, image, height * width, space)
    count = len(space.rows)
    raw, smoothed = (chain.array(name, (count + 2) * height * width) for name in ("planes_raw", "planes"))
    mixing = _mixing(space, width, height) | {"whole": False}
    chain.add("views", [image, stats, raw, smoothed], width * height, **mixing)
    planes = Planes(smoothed, stats, None, width, height, count)
    _add_smoothing(chain, raw, planes, config, whole=False)
    return planes


def add_halved_views(
    chain: Chain, image: Array, size: tuple[int, int], space: ViewSpace, config: ViewsConfig
) -> Planes:
    """Add the views of the halved picture, as `views.halved_views`; ``size`` is (height, width) of the full one."""
    height, width = size
    half_height, half_width = -(-height // 2), -(-width // 2)
    stats = _add_light(chain, image, height * width, space)
    count = len(space.rows)
    plane = half_height * half_width
    tall = chain.array("planes_tall", (count + 2) * height * half_width)
    full_guide = chain.array("full_guide", height * width)
    raw, smoothed = (chain.array(name, (count + 2) * plane) for name in ("planes_raw", "planes"))
    mixing = _mixing(space, width, height) | {"half_width": half_width, "whole": True}
    chain.add(
        "halve_rows", [image, stats, tall, full_guide], -(-half_width // 4) * height, **mixing,
    )  # fmt: skip
    chain.add(
        "halve_columns", [tall, stats, raw], (count + 2) * half_width * -(-half_height // 4), width=half_width,
        height=half_height, tall_height=height, plane_count=count + 2, view_count=count,
    )  # fmt: skip
    planes = Planes(smoothed, stats, full_guide, half_width, half_height, count)
    # Of all planes, though only views and usable share are read: the guide between them is as cheap.
    taps = _gaussian(FILL_SIGMA_PX, 2 * round(4 * FILL_SIGMA_PX) + 1)
    bands: dict[str, Any] = {"band_height": len(taps) // 2, "band_count": -(-half_height // (len(taps) // 2))}
    unusable = chain.array("unusable", bands["band_count"] * half_width, np.uint32)
    chain.add(
        "unusable", [raw, unusable], unusable.size, width=half_width, height=half_height, view_count=count,
        usable_share=USABLE, **bands,
    )  # fmt: skip
    around = _add_blur(chain, raw, planes, taps, first=0, count=count + 2, sparse=(unusable, bands))
    chain.add(
        "fill", [around, stats, raw, smoothed], plane, plane=plane, view_count=count, usable_share=USABLE,
        fill_units=FILL_UNITS,
    )  # fmt: skip
    views = raw if space.moves_px is None else _add_moves(chain, raw, planes, space.moves_px, size)
    _add_smoothing(chain, raw, planes, config, whole=True, views=views)
    _add_guide_scale(chain, full_guide, stats, (height, width), config, first=0, slot=1)
    return planes


def add_two_views(chain: Chain, image: Array, size: tuple[int, int], rows: np.ndarray) -> tuple[Array, dict[str, Any]]:
    """Add `error_bar.without_two_views`; return the map of its squares and their numbers along x and y."""
    height, width = size
    side = LIGHT_WINDOW_PX
    spacing, first_y, first_x = side // 2, min(side // 4, height - 1), min(side // 4, width - 1)
    samples_x, samples_y = math.ceil((width - first_x) / spacing), math.ceil((height - first_y) / spacing)
    cells: dict[str, Any] = {"cells_x": max(1, width // side), "cells_y": max(1, height // side)}
    lacking = chain.array("lacking", cells["cells_x"] * cells["cells_y"])
    red, green, blue = (float(matched) for matched in np.any(rows, axis=0))
    chain.add(
        "two_views", [image, lacking], lacking.size, width=width, spacing=spacing, first_x=first_x, first_y=first_y,
        samples_x=samples_x, samples_y=samples_y, per_cell_x=samples_x / cells["cells_x"],
        per_cell_y=samples_y / cells["cells_y"], dark=DARK, matched_red=red, matched_green=green, matched_blue=blue,
        **cells,
    )  # fmt: skip
    return lacking, cells


def check_stats(stats: np.ndarray, view_count: int) -> None:
    """Raise InputError where the picture had nothing to match, as `views.mixed` and `views.smoothed_views`."""
    if stats[_USABLE_AT] == 0:
        raise no_usable_pixel()
    if min(stats[_VARIANCE_AT : _VARIANCE_AT + view_count]) < CONSTANT**2:
        raise constant_view()


def _parts(pixels: int) -> int:
    return min(_PARTS, -(-pixels // 256))


def _add_light(chain: Chain, image: Array, pixels: int, space: ViewSpace) -> Array:
    parts = _parts(pixels)
    stats, sums = chain.array("stats", STATS), chain.array("light_parts", 4 * parts)
    numbers: dict[str, Any] = {"pixels": pixels, "part_count": parts, "saturation": SATURATION}
    chain.add("light", [image, sums], groups=(parts,), **numbers)
    chain.add(
        "light_sum", [sums, stats], groups=(1,), guide_rgb=np.ravel(space.guide_rgb), light_bits=LIGHT_BITS,
        least_exponent=LEAST_EXPONENT, **numbers,
    )  # fmt: skip
    return stats


def _mixing(space: ViewSpace, width: int, height: int) -> dict[str, Any]:
    return {
        "width": width, "height": height, "view_count": len(space.rows), "saturation": SATURATION,
        "rows": np.ravel(space.rows), "guide_rgb": np.ravel(space.guide_rgb),
    }  # fmt: skip


def _add_moves(chain: Chain, raw: Array, planes: Planes, moves_px: np.ndarray, size: tuple[int, int]) -> Array:
    """Add what takes the displacement by the lens off the views; return them, in an array of their own."""
    moves = halved_moves(moves_px, size)
    packed = moves[..., 0].astype(np.uint16) | (moves[..., 1].astype(np.uint16).astype(np.uint32) << 16)
    views = chain.array("planes_moved", planes.view_count * planes.pixels)
    chain.add(
        "moved_views", [raw, chain.constant("moves", packed.astype(np.uint32)), planes.stats, views], views.size,
        width=planes.width, height=planes.height, view_count=planes.view_count, move_parts=MOVE_PARTS,
    )  # fmt: skip
    return views


def _add_smoothing(
    chain: Chain, raw: Array, planes: Planes, config: ViewsConfig, *, whole: bool, views: Array | None = None
) -> None:
    """Smooth views, in ``whole`` units of light or not, and guide; then the views' variance and the guide's unit."""
    count = planes.view_count
    sigma_px = config.presmooth_sigma_px
    taps = smoothing_taps(sigma_px).tolist() if whole else _smoothing_taps(sigma_px)
    _add_blur(chain, views or raw, planes, taps, first=0, count=count, whole=whole)
    taps = _smoothing_taps(GUIDE_SIGMA_PX)
    _add_blur(chain, raw, planes, taps, first=count, count=1)
    parts = _parts(planes.pixels)
    sums = chain.array("variance_parts", 6 * parts)
    numbers: dict[str, Any] = {"pixels": planes.pixels, "part_count": parts, "view_count": count}
    chain.add("variance", [planes.planes, sums], groups=(parts,), **numbers)
    numbers["whole"] = whole
    chain.add("variance_sum", [sums, planes.stats], groups=(1,), **numbers)
    _add_guide_scale(
        chain, planes.planes, planes.stats, (planes.height, planes.width), config, first=count * planes.pixels, slot=0
    )


def _add_guide_scale(
    chain: Chain, guide: Array, stats: Array, size: tuple[int, int], config: ViewsConfig, *, first: int, slot: int
) -> None:
    height, width = size
    sparse = percentile_spacing(height * width)
    across, down = -(-width // sparse), -(-height // sparse)
    low, high = (share * (across * down - 1) for share in (0.01, 0.99))  # places among the sorted, as NumPy's
    chain.add(
        "guide_scale", [guide, stats], groups=(1,), first=first, width=width, sparse=sparse, sparse_width=across,
        sparse_count=across * down, low_place=low, high_place=high, slot=slot, at_once=SAMPLES_AT_ONCE,
        guide_range=config.guide_range,
    )  # fmt: skip


def _add_blur(
    chain: Chain,
    raw: Array,
    planes: Planes,
    taps: list[float],
    *,
    first: int,
    count: int,
    sparse: tuple[Array, dict[str, Any]] | None = None,
    whole: bool = False,
) -> Array:
    """Add a Gaussian of some planes, into `planes`; ``sparse``: at unusable pixels only, into an array of its own."""
    between = chain.arrays.get("planes_between") or chain.array("planes_between", raw.size)
    after = planes.planes if sparse is None else chain.array("planes_blurred", raw.size)
    for along_x, source, target in ((True, raw, between), (False, between, after)):
        _add_pass(
            chain, source, target, planes, taps, first=first, count=count, along_x=along_x, sparse=sparse, whole=whole
        )
    return after


def _add_pass(
    chain: Chain,
    source: Array,
    target: Array,
    planes: Planes,
    taps: list[float],
    *,
    first: int,
    count: int,
    along_x: bool,
    whole: bool,
    sparse: tuple[Array, dict[str, Any]] | None = None,
) -> None:
    """Add one direction of a Gaussian; its border is that of the CPU's."""
    nowhere = chain.arrays.get("no_unusable") or chain.array("no_unusable", 1, np.uint32)
    along, across = (planes.width, planes.height) if along_x else (planes.height, planes.width)
    unusable, bands = sparse or (nowhere, {"band_height": 1, "band_count": 1})
    arrays, uses, weights = [source, unusable, planes.stats, target], "blur_short", _shifted(taps)
    constants: dict[str, Any] = {"taps": weights.ravel()}
    if len(weights) > _MOST_CONSTANTS:
        name = f"taps{len(taps)}_{first}"
        arrays.append(chain.arrays.get(name) or chain.constant(name, weights))
        uses, constants = "blur_long", {}
    chain.add(
        "blur", arrays, -(-along // 4) * across, uses=(uses,), width=planes.width, height=planes.height,
        first_plane=first, plane_count=count, along_x=along_x, replicate=sparse is None, sparse=sparse is not None,
        whole=whole, **bands, reach=len(taps) // 2, span=len(weights), **constants,
    )  # fmt: skip


def _shifted(taps: list[float]) -> np.ndarray:
    """Weights of each pixel in the sums of four neighbours; (taps + 3, 4) float32."""
    return np.stack([np.pad(np.array(taps, np.float32), (j, 3 - j)) for j in range(4)], axis=1)


def _smoothing_taps(sigma_px: float) -> list[float]:
    """Weights of `views.smooth`."""
    return [1.0] if sigma_px == 0 else _gaussian(sigma_px, 2 * math.ceil(4 * sigma_px) + 1)


def _gaussian(sigma_px: float, size: int) -> list[float]:
    return [float(tap) for tap in cv2.getGaussianKernel(size, sigma_px, cv2.CV_64F)[:, 0]]


class Reduction(NamedTuple):
    """The working scale of a method."""

    size_px: tuple[int, int]  # width and height of the reduced picture
    guide_rgb: np.ndarray  # (3,) float64: weights of R, G, B in the guide


def add_reduced(chain: Chain, image: Array, size: tuple[int, int], reduction: Reduction) -> Array:
    """Add `working_scale.reduced` of an image of ``size`` (H, W); return the picture, (h, w, 3)."""
    small = chain.array("reduced", 3 * reduction.size_px[0] * reduction.size_px[1])
    chain.add(
        "reduce", [image, small], small.size // 3, saturation=SATURATION, **_sides(size, reduction),
    )  # fmt: skip
    return small


def add_upsampled(
    chain: Chain, image: Array, small: Array, size: tuple[int, int], reduction: Reduction, guide_range: float
) -> None:
    """Add `readable.upsample`; the chain's ``disparity``, ``sigma``, ``confidence`` become those of ``size`` (H, W)."""
    pixels = small.size // 3
    names = ("disparity", "sigma", "confidence")
    coarse, stats = chain.array("coarse", 4 * pixels), chain.arrays["stats"]
    rgb = np.ravel(reduction.guide_rgb)
    chain.add(
        "coarse_maps", [small, *(chain.arrays[name] for name in names), coarse], pixels, pixels=pixels, guide_rgb=rgb,
    )  # fmt: skip
    width = reduction.size_px[0]
    low, high = (share * (pixels - 1) for share in (0.01, 0.99))  # places among the sorted, as NumPy's
    chain.add(
        "guide_scale", [coarse, stats], groups=(1,), first=3 * pixels, width=width, sparse=1, sparse_width=width,
        sparse_count=pixels, low_place=low, high_place=high, slot=_SLOT, at_once=SAMPLES_AT_ONCE,
        guide_range=guide_range,
    )  # fmt: skip
    outputs = [chain.array(name, size[0] * size[1]) for name in names]
    chain.add(
        "upsample", [image, coarse, stats, *outputs], size[0] * size[1], guide_rgb=rgb, jump_px=JUMP_PX,
        least_weight=LEAST_WEIGHT, **_sides(size, reduction),
    )  # fmt: skip


def _sides(size: tuple[int, int], reduction: Reduction) -> dict[str, Any]:
    width, height = reduction.size_px
    return {"width": width, "height": height, "full_width": size[1], "full_height": size[0]}
