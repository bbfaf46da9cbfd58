"""Matching at a fraction of the pixels on a device: nothing but the photograph goes up, nothing but maps come down."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from chromaperture.matching import readable as stages
from chromaperture.matching.device.device import Chain, open_device
from chromaperture.matching.device.gpu_method import DeviceMethod, on_device
from chromaperture.matching.device.view_stages import Reduction, add_reduced, add_upsampled
from chromaperture.matching.estimate import method_for
from chromaperture.matching.readable.upsample import Coarse
from chromaperture.matching.result import Disparity
from chromaperture.matching.working_scale import ScaledMethod, coarse_maps, reduced
from chromaperture.optics.aperture import design_named
from chromaperture.settings.methods import RealTimeConfig
from devices import needs_device

pytestmark = [pytest.mark.extra("gpu", "wgpu"), needs_device]

GUIDE_RGB, GUIDE_RANGE = np.array([0.2, 0.5, 0.3]), 0.1
# (full, reduced) width and height: whole fractions, others, narrow, and one pixel.
SIZES = [
    ((60, 45), (20, 15)),
    ((83, 61), (28, 20)),
    ((83, 61), (41, 61)),
    ((1, 9), (1, 3)),
    ((7, 1), (3, 1)),
    ((5, 4), (1, 1)),
]


@cache
def chain_of(full: tuple[int, int], small: tuple[int, int]) -> Chain:
    """Reduction, then enlarging of maps that are sent up."""
    chain = Chain(open_device("gpu"))
    image = chain.array("image", 3 * full[0] * full[1])
    reduction = Reduction(small, GUIDE_RGB)
    picture = add_reduced(chain, image, full[::-1], reduction)
    chain.array("stats", 16)
    for name in ("disparity", "sigma", "confidence"):
        chain.arrays[f"coarse_{name}"] = chain.array(name, small[0] * small[1])
    add_upsampled(chain, image, picture, full[::-1], reduction, GUIDE_RANGE)
    return chain


@st.composite
def photographs(draw):
    """A photograph with or without clipped and unknown pixels, and maps of its working scale with unknown parts."""
    full, small = draw(st.sampled_from(SIZES))
    rng = np.random.default_rng(draw(st.integers(0, 10_000)))
    image = rng.uniform(0, 0.9, (*full[::-1], 3)).astype(np.float32)
    share = draw(st.sampled_from([0.0, 0.02, 0.3]))
    image[rng.uniform(size=full[::-1]) < share] = np.nan
    image[rng.uniform(size=full[::-1]) < share] = 1.0
    shape = small[::-1]
    disparity = rng.choice([-1.0, 0.05, 0.1, 1.5], shape).astype(np.float32)
    unknown = rng.uniform(size=shape) < draw(st.sampled_from([0.0, 0.2, 1.0]))
    sigma, confidence = (rng.uniform(0.1, 1, shape).astype(np.float32) for _ in range(2))
    nan = np.float32(np.nan)
    maps = Disparity(np.where(unknown, nan, disparity), np.where(unknown, nan, sigma), np.where(unknown, 0, confidence))
    return full, small, image, maps


def run(full, small, image, maps: Disparity) -> dict[str, np.ndarray]:
    chain = chain_of(full, small)
    inputs = {"image": image, "coarse_disparity": maps.value_px, "coarse_sigma": maps.sigma_px}
    inputs["coarse_confidence"] = maps.confidence
    return chain.run(inputs, ["reduced", "disparity", "sigma", "confidence"])


@settings(max_examples=40, deadline=None)
@given(photographs())
def test_area_averages(photograph):
    full, small, image, maps = photograph
    found = run(full, small, image, maps)["reduced"].reshape(*small[::-1], 3)
    expected = reduced(image, small).reshape(found.shape)
    np.testing.assert_array_equal(np.isnan(found), np.isnan(expected))
    np.testing.assert_allclose(found, expected, atol=2e-6)  # sums of 12 products of order 1 in 32 bits


def filled(maps: Disparity, guide: np.ndarray) -> Coarse:
    """`coarse_maps` whose choice among several nearest known pixels is the device's: above, left, right, below."""
    unknown = np.isnan(maps.value_px)
    parts = [np.nan_to_num(part) for part in (maps.value_px, maps.sigma_px, maps.confidence)]
    height, width = unknown.shape
    for y, x in np.argwhere(unknown):
        for dy, dx in ((-1, 0), (0, -1), (0, 1), (1, 0), (-1, -1), (-1, 1), (1, -1), (1, 1)):
            if 0 <= y + dy < height and 0 <= x + dx < width and not unknown[y + dy, x + dx]:
                for part in parts:
                    part[y, x] = part[y + dy, x + dx]
                break
    return Coarse(*parts, unknown, guide)


def test_unknown_parts_are_filled_as_on_the_cpu_where_one_known_pixel_is_nearest():
    values = np.arange(12, dtype=np.float32).reshape(3, 4)
    values[:, 3] = np.nan
    maps, guide = Disparity(values, 0.1 * values, np.nan_to_num(0.05 * values)), np.zeros((3, 4), np.float32)
    for one, other in zip(filled(maps, guide), coarse_maps(maps, guide), strict=True):
        np.testing.assert_array_equal(one, other)


@settings(max_examples=40, deadline=None)
@given(photographs())
def test_maps_of_the_working_scale_at_all_pixels(photograph):
    full, small, image, maps = photograph
    guide = np.nan_to_num(reduced(image, small).reshape(*small[::-1], 3) @ GUIDE_RGB.astype(np.float32))
    low, high = np.percentile(guide, (1, 99))
    unit = 1 / (max(float(high - low), 1e-6) * GUIDE_RANGE)
    expected = stages.upsample(filled(maps, guide * np.float32(unit)), image, GUIDE_RGB * unit)
    found = run(full, small, image, maps)
    for name, one in zip(("disparity", "sigma", "confidence"), expected, strict=True):
        here = found[name].reshape(one.shape)
        np.testing.assert_array_equal(np.isnan(here), np.isnan(one))
        # Sums in another order; where both sides of an edge weigh the same to rounding either may be taken: up to
        # 1e-3 of the pixels by a rasteriser in software, 1.4e-3 by an H200, whose exponentials are less exact.
        differs = ~np.isclose(here, one, rtol=1e-5, atol=1e-5, equal_nan=True)
        assert differs.sum() <= 2e-3 * differs.size + 1


def test_what_has_no_room_on_the_device_is_reduced_by_the_cpu():
    matching = method_for(RealTimeConfig().with_range(-2, 2), aperture="cy_halves", execution="numpy")
    method = ScaledMethod(matching, matching.config, (82, 60), design_named("cy_halves"), stages)
    found = on_device(method, "gpu", lambda note: None, pixels=open_device("gpu").largest_bytes)
    assert isinstance(found, ScaledMethod)
    assert isinstance(found.method, DeviceMethod)
    assert replace(found, method=method.method) == method
