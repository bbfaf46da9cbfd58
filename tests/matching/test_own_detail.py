"""How much of a window's evidence is a pixel's own: a printed half beside a blank one, noise, even texture."""

from dataclasses import replace

import numpy as np

from chromaperture.matching.evidence.blur import BlurEvidence
from chromaperture.matching.evidence.spectral import SpectralEvidence, own_detail
from chromaperture.matching.execution import execution_named
from chromaperture.matching.labels import IDENTITY
from chromaperture.matching.result import NoiseModel
from chromaperture.optics.lens_blur import BlurModel
from chromaperture.settings.stages import CrossFilterConfig, SpectralConfig
from worlds import lens_blur

H, W = 96, 128
ON = CrossFilterConfig(own_detail=True)


def half_printed(rng, *, noise):
    """White noise of contrast 0.1 on the left half, the right half blank; noise everywhere."""
    picture = np.full((H, W), 0.4)
    picture[:, : W // 2] += 0.1 * rng.standard_normal((H, W // 2))
    picture = picture[..., None] + noise * rng.standard_normal((H, W, 3))
    return picture.astype(np.float32)


def test_a_blank_wall_beside_a_print_has_no_evidence_of_its_own(rng):
    image = half_printed(rng, noise=1e-3)
    own = own_detail(image, np.full_like(image, 1e-6), (0, 2), ON)
    printed, beside, far = own[:, : W // 2 - 4], own[:, W // 2 + 6 : W // 2 + 12], own[:, -24:]
    assert np.median(printed) > 0.8
    # exp(-36 / 2 / 1.5^2) of the edge's power, and its surroundings' noise, against a quarter of the window's
    assert beside.max() < 0.1
    # Noise alone: a window of 100 px knows its power to a seventh, and a threefold surplus of that leaves .09.
    assert far.max() < 0.1


def test_without_known_noise_even_texture_counts_as_it_is(rng):
    image = (0.4 + 0.1 * rng.standard_normal((H, W, 1)) * np.ones(3)).astype(np.float32)
    own = own_detail(image, None, (0, 2), ON)
    assert np.median(own) > 0.8
    assert own.max() <= 1
    strong = own_detail(100 * image, None, (0, 2), ON)
    np.testing.assert_allclose(strong, own, atol=1e-3)  # a share: it has no unit


def test_what_is_not_a_pixels_own_is_taken_off_the_pairs_alone(rng):
    blur = lens_blur(BlurModel(6.0, 12000.0), W, H, "cy_halves")
    layers = np.linspace(-2.0, 2.0, 9) * blur.reach
    image = half_printed(rng, noise=1e-3)
    image[0, 0] = np.nan
    noise = NoiseModel(lambda picture: np.full_like(picture, 1e-6), is_known=True)
    pairs = BlurEvidence(CrossFilterConfig(), blur, IDENTITY, noise, execution_named("numba"))
    without = SpectralEvidence(SpectralConfig(gain=0.0), pairs)
    counted = SpectralEvidence(SpectralConfig(gain=0.0), replace(pairs, config=ON))
    own = counted.own_detail(image)
    assert np.isfinite(own).all()
    assert without.own_detail(image) is None
    expected = without.at(image, layers, layers) * own[..., None]
    np.testing.assert_allclose(counted.at(image, layers, layers), expected, rtol=1e-6)
