"""Colour alignment in WGSL against the CPU's, on whatever device there is."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from chromaperture.camera.alignment import ChannelAlignment
from chromaperture.camera.camera import CodedApertureCamera
from chromaperture.camera.method import default_config
from chromaperture.color.alignment import align_channels, fill_unknown, white_balance
from chromaperture.color.row_alignment import visible_from
from chromaperture.matching.device.device import Chain, open_device
from chromaperture.matching.device.measured import add_alignment, add_extras
from chromaperture.matching.result import Alignment, Extras
from chromaperture.system.errors import InputError
from devices import camera_on, needs_device, small_sample
from worlds import wavy_capture

pytestmark = [pytest.mark.extra("gpu", "wgpu"), needs_device]

SHAPE = (45, 61)
WHITE = np.array([0.5, 0.8, 0.7])  # of a sheet behind the aperture
DIRECTIONS = {
    "halves": np.array([[1.0, 0.0], [0.0, 0.0], [-1.0, 0.0]]),
    "circles": np.array([[0.87, 0.5], [-0.87, 0.5], [0.0, -1.0]]),
}
# Sums of 16 products of order 1 in 32 bits, at places that differ by rounding: 2e-6 by a rasteriser in software, up to
# 3e-6 before the white balance by an H200. A colour line is the difference of two such sums over a ridge of 1e-4.
SHIFTED, PREDICTED = 4e-6, 2e-3
ROUNDED = 0.002  # of the pixels fall half-way between two of a channel's view, and in 32 bits into either


@cache
def chain_of(design: str, shape: tuple[int, int] = SHAPE) -> Chain:
    chain = Chain(open_device("gpu"))
    image = chain.array("image", 3 * shape[0] * shape[1])
    disparity = chain.array("disparity", shape[0] * shape[1])
    add_alignment(chain, image, disparity, shape, Alignment(DIRECTIONS[design], WHITE.max() / WHITE))
    return chain


@st.composite
def measurements(draw, shape=SHAPE):
    """A picture of noise, and near discs before a wave, unknown in rectangles and single pixels."""
    rng = np.random.default_rng(draw(st.integers(0, 10_000)))
    y, x = np.mgrid[: shape[0], : shape[1]]
    image = rng.uniform(0.1, 0.9, (*shape, 3)).astype(np.float32)
    disparity = 2 * np.sin(x / 9 + rng.uniform(0, 6))
    for _ in range(draw(st.integers(0, 3))):
        middle, radius = rng.uniform((0, 0), shape), rng.uniform(3, 15)
        disparity = np.where(np.hypot(y - middle[0], x - middle[1]) < radius, rng.uniform(-6, 0), disparity)
    disparity[rng.uniform(size=shape) < draw(st.sampled_from([0.0, 0.3]))] = np.nan
    for _ in range(draw(st.integers(0, 2))):
        top, left = rng.integers(0, shape[0] - 9), rng.integers(0, shape[1] - 9)
        disparity[top : top + rng.integers(5, 40), left : left + rng.integers(5, 40)] = np.nan
    return image, disparity.astype(np.float32)


@settings(max_examples=25, deadline=None)
@given(measurements(), st.sampled_from(sorted(DIRECTIONS)))
def test_aligned_channels_are_those_of_the_cpu(case, design):
    image, disparity = case
    found = chain_of(design).run({"image": image, "disparity": disparity}, ["filled", "visible", "color"])
    filled, directions = fill_unknown(disparity), DIRECTIONS[design]
    np.testing.assert_array_equal(found["filled"].reshape(SHAPE), filled)
    seen = (found["visible"].reshape(SHAPE)[..., None] >> np.arange(3) & 1).astype(bool)
    expected_seen = np.stack([visible_from(filled, u) for u in directions], axis=2)
    assert (seen != expected_seen).mean() < ROUNDED

    expected = white_balance(align_channels(image, filled, directions), WHITE)
    error = np.abs(found["color"].reshape(*SHAPE, 3) - expected)
    assert error[seen & expected_seen].max() < SHIFTED * WHITE.max() / WHITE.min()
    if not (seen != expected_seen).any():  # else a prediction has another neighbour
        assert error.max() < PREDICTED


def test_unknown_light_and_a_map_without_any_disparity():
    image = np.random.default_rng(0).uniform(0.1, 0.9, (*SHAPE, 3)).astype(np.float32)
    image[20, 30, 1] = np.nan
    unknown = np.full(SHAPE, np.nan, np.float32)
    found = chain_of("halves").run({"image": image, "disparity": unknown}, ["color"])["color"].reshape(*SHAPE, 3)
    expected = white_balance(image, WHITE)
    np.testing.assert_array_equal(np.isnan(found[..., [0, 2]]), False)
    assert np.isnan(found[20, 30, 1])  # and beside it, what a cubic would have read at a fraction of a px
    away = np.isfinite(found) & np.isfinite(expected)
    assert away.mean() > 0.999
    np.testing.assert_allclose(found[away], expected[away], atol=1e-6)


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (9, 1)])
def test_pictures_one_pixel_wide(shape):
    rng = np.random.default_rng(1)
    image, disparity = rng.uniform(0.1, 0.9, (*shape, 3)).astype(np.float32), rng.uniform(-2, 2, shape)
    chain = chain_of("halves", shape)
    found = chain.run({"image": image, "disparity": disparity.astype(np.float32)}, ["color"])["color"]
    expected = white_balance(align_channels(image, disparity.astype(np.float32), DIRECTIONS["halves"]), WHITE)
    np.testing.assert_allclose(found.reshape(*shape, 3), expected, atol=1e-5)


@cache
def sample_on_device(scale: int, name: str) -> tuple[CodedApertureCamera, np.ndarray]:
    camera, image = small_sample(name, 132, 88, quality="accurate")
    return camera_on("gpu", camera.calibration, replace(camera.config, scale=scale)), image


def chain_behind_disparity(size: tuple[int, int], extras: Extras) -> Chain:
    """From ``disparity``, ``sigma`` and ``image`` of (H, W) to what is asked for."""
    chain, pixels = Chain(open_device("gpu")), size[0] * size[1]
    image, *_ = (chain.array(name, n * pixels) for name, n in (("image", 3), ("disparity", 1), ("sigma", 1)))
    add_extras(chain, image, size, extras)
    return chain


# Lanczos' filter at the photograph's own pixels; cubics at a working scale, and unknown pixels take the nearest of few.
@pytest.mark.parametrize(
    ("name", "scale"), [("still_life_cy_halves", 1), ("still_life_cy_halves", 3), ("still_life_cy_open", 1)]
)
def test_channels_displaced_by_the_lens_are_aligned_as_by_the_cpu(name, scale, rng):
    camera, image = sample_on_device(scale, name)
    assert camera.alignment.numbers.lens.exact == (scale == 1)
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    disparity = (0.6 * np.sin(x / 9) + rng.uniform(-2, 1) - (np.hypot(y - 40, x - 60) < 20)).astype(np.float32)
    disparity[rng.uniform(size=disparity.shape) < 0.1] = np.nan
    disparity[5:30, 90:120] = np.nan
    expected = camera.alignment.align(image, disparity)
    chain = chain_behind_disparity(disparity.shape, Extras(None, camera.alignment.numbers))
    found = chain.run({"image": image, "disparity": disparity}, ["color"])["color"].reshape(image.shape)
    error = np.abs(found - expected)
    # Lanczos' places are rounded to 1 / 32 px, and 32 bits round a few in a thousand to the next one.
    assert (error < 1e-4).mean() > 0.995
    assert error.max() < 0.1


@pytest.mark.parametrize(("quality", "scale"), [("paper", 1), ("real-time", 1), ("real-time", 2)])
def test_a_camera_measures_on_the_device(quality, scale, monkeypatch):
    """Depth, error bar and colours, at the photograph's own pixels and at a working scale."""
    width = 150 * scale
    made, image = small_sample("still_life_cy_halves", width, width * 2 // 3, quality=quality)
    if quality == "paper":  # whose peaks are flat in so few pixels of the sample
        image = wavy_capture("cy_halves", shape=image.shape[:2])
    config = default_config(made.calibration, quality, scale=scale)
    expected = CodedApertureCamera(made.calibration, config, execution="numpy").measure(image)
    on_gpu = camera_on("gpu", made.calibration, config)
    assert (on_gpu.method.on_gpu.reduction is None) == (scale == 1)
    monkeypatch.delattr(ChannelAlignment, "align")
    monkeypatch.delattr(CodedApertureCamera, "millimetres")
    found = on_gpu.measure(image)
    with pytest.raises(InputError, match="the image is constant"):
        on_gpu.measure(np.full_like(image, 0.4))
    assert (np.isnan(expected.depth_mm) == np.isnan(found.depth_mm)).mean() > 0.995
    known = np.isfinite(expected.depth_mm) & np.isfinite(found.depth_mm)
    assert known.mean() > 0.4
    assert (np.abs(found.depth_mm / expected.depth_mm - 1) < 1e-3)[known].mean() > 0.995
    assert np.quantile(np.abs(found.sigma_mm / expected.sigma_mm - 1)[known], 0.99) < 0.05
    assert np.quantile(np.abs(found.color - expected.color), 0.99) < 1e-3
