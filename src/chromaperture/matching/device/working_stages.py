"""Matching at a fraction of the pixels on the device: ``working_scale.py`` and ``readable/upsample.py``, in WGSL."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from chromaperture.color.image import SATURATION
from chromaperture.matching.device.device import Array, Chain
from chromaperture.matching.device.view_stages import SAMPLES_AT_ONCE
from chromaperture.matching.device.workgroups import groups_for
from chromaperture.matching.readable.upsample import JUMP_PX, LEAST_WEIGHT

_SLOT = 2  # of the guide's unit among those of `shared.wgsl`'s `stats`, behind those of the matched and the full guide


class Reduction(NamedTuple):
    """The working scale of a method.

    Attributes
    ----------
    size_px : (int, int)
        Width and height of the reduced picture.
    guide_rgb : (3,) float64
        Weights of R, G, B in the guide.
    """

    size_px: tuple[int, int]
    guide_rgb: np.ndarray


def add_reduced(chain: Chain, image: Array, size: tuple[int, int], reduction: Reduction) -> Array:
    """Add `working_scale.reduced` of an image of ``size`` (H, W); return the picture, (h, w, 3)."""
    small = chain.array("reduced", 3 * reduction.size_px[0] * reduction.size_px[1])
    chain.add(
        "reduce", [image, small], groups=groups_for(small.size // 3),
        saturation=SATURATION, **_sides(size, reduction),
    )  # fmt: skip
    return small


def add_upsampled(
    chain: Chain, image: Array, small: Array, size: tuple[int, int], reduction: Reduction, guide_range: float
) -> None:
    """Add `stages.upsample`; the chain's ``disparity``, ``sigma``, ``confidence`` become those of ``size`` (H, W)."""
    pixels = small.size // 3
    names = ("disparity", "sigma", "confidence")
    coarse, stats = chain.array("coarse", 4 * pixels), chain.arrays["stats"]
    rgb = np.ravel(reduction.guide_rgb)
    chain.add(
        "coarse_maps", [small, *(chain.arrays[name] for name in names), coarse], groups=groups_for(pixels),
        pixels=pixels, guide_rgb=rgb,
    )  # fmt: skip
    width = reduction.size_px[0]
    low, high = (share * (pixels - 1) for share in (0.01, 0.99))  # places among the sorted, as NumPy's
    chain.add(
        "guide_scale", [coarse, stats], groups=(1,),
        first=3 * pixels, width=width, sparse=1, sparse_width=width, sparse_count=pixels,
        low_place=low, high_place=high, slot=_SLOT, at_once=SAMPLES_AT_ONCE, guide_range=guide_range,
    )  # fmt: skip
    outputs = [chain.array(name, size[0] * size[1]) for name in names]
    chain.add(
        "upsample", [image, coarse, stats, *outputs], groups=groups_for(size[0] * size[1]),
        guide_rgb=rgb, jump_px=JUMP_PX, least_weight=LEAST_WEIGHT, **_sides(size, reduction),
    )  # fmt: skip


def _sides(size: tuple[int, int], reduction: Reduction) -> dict[str, Any]:
    width, height = reduction.size_px
    return {"width": width, "height": height, "full_width": size[1], "full_height": size[0]}
