"""Transparency of an aperture from white sheets, spoiled by noise, vignetting and paper grain."""

import numpy as np
import pytest

from chromaperture.color.transparency_map import compensate_vignetting, flat_field, light_efficiency, transparency
from chromaperture.system.errors import InputError


def sheets(rng, truth, height=120, width=180):
    y, x = np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j]
    light = 0.9 * (1 - 0.3 * (x**2 + y**2))[..., None] * np.ones(3)
    light = light * rng.normal(1, 0.02, (height, width, 1))  # the same paper, the same grain
    pictures = [light * truth, light]
    return [p + rng.normal(0, 0.01, p.shape) for p in pictures]


def test_vignetting_grain_and_noise_cancel(rng):
    truth = np.array([0.51, 0.74, 0.375])
    found = transparency(*sheets(rng, truth))
    # 0.01 noise over a blur of 4.5 px leaves 0.01 / sqrt(4 pi 4.5^2) = 6e-4; in a corner, where the border mirrors,
    # twice that, of a light of 0.36 only, in both sheets: 4e-3 at most, three of those
    np.testing.assert_allclose(found, np.broadcast_to(truth, found.shape), atol=12e-3)
    np.testing.assert_allclose(found.mean(axis=(0, 1)), truth, atol=5e-4)


def test_sheets_that_cannot_be_compared_say_so(rng):
    coded, bare = sheets(rng, np.array([0.5, 0.7, 0.4]))
    with pytest.raises(InputError, match="size"):
        transparency(coded[:-1], bare)
    with pytest.raises(InputError, match="bare white sheet is saturated"):
        transparency(coded, np.ones_like(bare))
    with pytest.raises(InputError, match="coded white sheet is saturated"):
        transparency(np.full_like(bare, np.nan), bare)
    with pytest.raises(InputError, match="dark"):
        transparency(coded, np.zeros_like(bare))


def test_the_summary_is_that_of_the_map(rng):
    share = np.broadcast_to([0.5, 0.7, 0.4], (40, 60, 3)).copy()
    share[3, 5], share[30, 50] = (0.4, 0.6, 0.3), (0.6, 0.8, 0.5)
    light = light_efficiency(share)
    np.testing.assert_allclose(light.minimum, [0.4, 0.6, 0.3])
    np.testing.assert_allclose(light.maximum, [0.6, 0.8, 0.5])
    assert light.efficiency == pytest.approx((0.5 + 0.7 + 0.4) / 3)  # the two pixels cancel
    assert light.mean[1] > light.luminance > light.mean[0]  # the eye sees mostly green


def test_sheets_of_different_exposure_are_detected(rng):
    coded, bare = sheets(rng, np.array([0.9, 0.95, 0.85]))
    with pytest.raises(InputError, match="differ in exposure"):
        transparency(np.clip(coded * 1.3, 0, 0.99), bare)


def test_dust_and_uneven_light_do_not_matter(rng):
    share = np.array([0.5, 0.7, 0.4])
    coded, bare = sheets(rng, share)
    slope = np.linspace(0.6, 1.0, bare.shape[1])[None, :, None]
    coded, bare = coded * slope, bare * slope
    coded[20:32, 40:52] *= 0.3  # a fly
    found = transparency(coded, bare)
    # Next to the fly half the window is missing; without leaving it out the error would be 0.1.
    np.testing.assert_allclose(found[10:45, 25:70].mean(axis=(0, 1)), share, atol=0.01)


def test_each_channel_is_evened_out_by_its_own_shading(rng):
    x = np.linspace(-1, 1, 160)[None, :]
    y = np.linspace(-1, 1, 120)[:, None]
    shading = np.stack([1 - 0.3 * (x - shift) ** 2 - 0.1 * y**2 for shift in (-0.2, 0.0, 0.2)], -1)
    sheet = (0.7 * shading + 0.003 * rng.normal(size=shading.shape)).astype(np.float32)
    picture = 0.4 * shading
    even = compensate_vignetting(picture, flat_field(sheet))
    inner = even[12:-12, 12:-12]
    # Blurred over 4 px a parabola of curvature 0.3 a half width moves by 1e-3; noise adds as much.
    assert np.ptp(inner, axis=(0, 1)).max() < 0.004
    with pytest.raises(InputError, match="differ in size"):
        compensate_vignetting(picture[1:], flat_field(sheet))
    with pytest.raises(InputError, match="dark in places"):
        flat_field(sheet * (x > -0.5)[..., None])
    with pytest.raises(InputError, match="saturated"):
        flat_field(np.ones_like(sheet))
