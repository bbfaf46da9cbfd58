"""Colour alignment in WGSL against the CPU's, on whatever device there is."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from chromaperture.color.alignment import align_channels, fill_unknown, white_balance
from chromaperture.color.visibility import visible_from
from chromaperture.disparity.gpu.alignment_stage import Alignment, add_alignment
from chromaperture.disparity.gpu.device import Chain, open_device
from devices import needs_device

pytestmark = [pytest.mark.extra("gpu", "wgpu"), needs_device]

SHAPE = (45, 61)
WHITE = np.array([0.5, 0.8, 0.7])  # of a sheet behind the aperture
DIRECTIONS = {
    "halves": np.array([[1.0, 0.0], [0.0, 0.0], [-1.0, 0.0]]),
    "circles": np.array([[0.87, 0.5], [-0.87, 0.5], [0.0, -1.0]]),
}
# Sums of 16 products of order 1 in 32 bits; a colour line is the difference of two such sums over a ridge of 1e-4.
SHIFTED, PREDICTED = 2e-6, 2e-3
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
