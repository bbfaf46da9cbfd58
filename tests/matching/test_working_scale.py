"""Matching at a fraction of the pixels: what comes back at all of them."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from chromaperture.color.image import SATURATION
from chromaperture.matching import compiled as cpu
from chromaperture.matching import readable as stages
from chromaperture.matching.readable.upsample import Coarse
from chromaperture.matching.result import Disparity
from chromaperture.matching.working_scale import coarse_maps, reduced

GREY = np.full(3, 1 / 3)


def coarse(disparity, *, guide=None, unknown=None) -> Coarse:
    disparity = np.asarray(disparity, np.float32)
    even = np.zeros(disparity.shape, np.float32) if guide is None else np.asarray(guide, np.float32)
    none = np.zeros(disparity.shape, bool) if unknown is None else unknown
    return Coarse(disparity, 0.1 + 0 * disparity, 0.5 + 0 * disparity, none, even)


@pytest.mark.parametrize("run", [cpu, stages])
def test_a_plane_comes_back_exactly(run):
    """A slant of 0.04 px a working px; values at full pixels are those of the plane, in full px."""
    image = np.random.default_rng(1).uniform(0, 9, (48, 64, 3)).astype(np.float32)  # texture that must not be copied
    y, x = np.indices((12, 16))
    fine_y, fine_x = (np.indices((48, 64)) + 0.5) / 4 - 0.5  # full pixels in working px
    found, sigma, confidence = run.upsample(coarse(0.04 * x - 0.03 * y), image, GREY)
    inside = np.s_[2:-2, 2:-2]  # half a working pixel of the border lies beyond the outermost centres
    np.testing.assert_allclose(found[inside], 4 * (0.04 * fine_x - 0.03 * fine_y)[inside], atol=1e-5)
    np.testing.assert_allclose(sigma, 0.4, rtol=1e-6)
    np.testing.assert_allclose(confidence, 0.5, rtol=1e-6)


@pytest.mark.parametrize("run", [cpu, stages])
@pytest.mark.parametrize("edge", [21, 22, 23, 24, 25])
def test_a_depth_edge_lies_where_the_photograph_has_it(run, edge):
    """Working pixels are 4 px wide; the edge is at any pixel of the photograph, and no mean is taken over it."""
    image = np.zeros((24, 48, 3), np.float32)
    image[:, edge:] = 10.0
    share = np.clip((np.arange(12) + 1) * 4 - edge, 0, 4) / 4  # of each working pixel beyond the edge
    guide = np.broadcast_to(10 * share, (6, 12))
    disparity = np.where(share >= 0.5, 1.0, -1.0) * np.ones((6, 1))
    found, _, _ = run.upsample(coarse(disparity, guide=guide), image, GREY)
    assert set(np.unique(found)) == {-4.0, 4.0}
    assert abs(np.argmax(found[12] > 0) - edge) <= 1


@pytest.mark.parametrize("run", [cpu, stages])
def test_unknown_stays_unknown(run):
    unknown = np.zeros((6, 8), bool)
    unknown[2, 3] = True
    found, sigma, confidence = run.upsample(
        coarse(np.ones((6, 8)), unknown=unknown), np.zeros((24, 32, 3), np.float32), GREY
    )
    expected = np.zeros((24, 32), bool)
    expected[8:12, 12:16] = True
    np.testing.assert_array_equal(np.isnan(found), expected)
    np.testing.assert_array_equal(np.isnan(sigma), expected)
    np.testing.assert_array_equal(confidence == 0, expected)


def test_unknown_takes_the_nearest_known_values():
    values = np.full((4, 4), np.nan, np.float32)
    values[:, 0], values[0, 3] = 1.0, 2.0
    maps = coarse_maps(Disparity(values, values / 10, np.ones_like(values)), np.zeros_like(values))
    assert maps.disparity_px[3, 1] == 1
    assert maps.disparity_px[1, 3] == 2
    nothing = np.full((4, 4), np.nan, np.float32)
    assert coarse_maps(Disparity(nothing, nothing, nothing), nothing).unknown.all()


def test_reduced_pictures_are_means_and_know_what_was_cut_off():
    image = np.random.default_rng(3).uniform(0, 0.9, (32, 48, 3)).astype(np.float32)
    small = reduced(image, (12, 8))
    np.testing.assert_allclose(small, image.reshape(8, 4, 12, 4, 3).mean(axis=(1, 3)), rtol=1e-5)
    image[5, 6, 1], image[20, 20] = 1.0, np.nan
    small = reduced(image, (12, 8))
    assert np.isnan(small[1, 1]).all()
    assert np.isnan(small[5, 5]).all()
    assert np.isfinite(small).sum() == small.size - 6


@pytest.mark.parametrize("size", [(12, 8), (11, 7), (30, 20), (48, 32)])
def test_cut_off_is_what_has_a_share_in_a_saturated_pixel(size):
    draw = np.random.default_rng(size[0])
    image = draw.uniform(0, 0.9, (32, 48, 3)).astype(np.float32)
    saturated = draw.random((32, 48)) < 0.02
    image[saturated, draw.integers(0, 3, saturated.sum())] = SATURATION
    share = cv2.resize(saturated.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    np.testing.assert_array_equal(np.isnan(reduced(image, size)), np.repeat(share[..., None] > 0, 3, axis=2))
