"""Transparency of an aperture from white sheets, spoiled by noise, vignetting and paper grain."""

import numpy as np
import pytest

from chromaperture.color.transparency import transparency
from chromaperture.errors import InputError


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
