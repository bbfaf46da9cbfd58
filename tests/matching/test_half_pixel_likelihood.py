"""Windows' spectra of half pixels, whose noise is partly shared: the likelihood, and what noise alone says."""

from dataclasses import replace

import numpy as np
import pytest

from chromaperture.matching.accurate import AccurateMethod
from chromaperture.matching.device.gpu_method import on_device
from chromaperture.matching.evidence.blur import BlurEvidence
from chromaperture.matching.evidence.half_pixels import (
    half_pixel_likelihood,
    noise_of_frequencies,
    of_equal_light,
    sum_and_difference,
)
from chromaperture.matching.evidence.spectral import SpectralEvidence
from chromaperture.matching.execution import execution_named
from chromaperture.matching.labels import IDENTITY
from chromaperture.matching.result import NoiseModel
from chromaperture.matching.views import view_spaces
from chromaperture.optics.aperture import design_named
from chromaperture.optics.lens_blur import BlurModel
from chromaperture.settings.methods import AccurateConfig
from chromaperture.settings.stages import SpectralConfig
from worlds import lens_blur

W, H = 144, 96
RADIUS = np.linspace(0.04, 0.25, 60)
LAYERS = np.linspace(-1.5, 1.5, 7)
ERROR = 0.002
NOISE = 1e-4


def powers():
    """G of one node: a texture 1 / f^2 behind halves that lie a layer's shift apart; (1, D, 9, F)."""
    phase = 2 * np.pi * RADIUS * LAYERS[:, None] / 2
    both, apart = np.cos(phase), 1j * np.sin(phase)
    out = np.zeros((1, len(LAYERS), 9, len(RADIUS)), np.float32)
    texture = 1e-2 / RADIUS**2
    cross = both * apart.conj()
    out[0, :, 0], out[0, :, 1] = texture * both**2, texture * np.abs(apart) ** 2
    out[0, :, 3], out[0, :, 4] = texture * cross.real, texture * cross.imag
    return out


def complex_noise(rng, *shape):
    return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2)


def measured(spectra, noise=NOISE):
    count = len(spectra)
    return half_pixel_likelihood(
        spectra, powers(), np.zeros(count, int), np.full(count, noise), noise_of_frequencies(RADIUS),
        channel_error=ERROR,
    )  # fmt: skip


def drawn(rng, layer, windows=40, strength=0.1):
    """Textures at a layer, and noise as it is expected."""
    phase = 2 * np.pi * RADIUS * LAYERS[layer] / 2
    texture = np.sqrt(strength * 1e-2) / RADIUS * complex_noise(rng, windows, len(RADIUS))
    noise = np.sqrt(NOISE * noise_of_frequencies(RADIUS)) * complex_noise(rng, windows, 2, len(RADIUS))
    return np.stack([np.cos(phase) * texture, 1j * np.sin(phase) * texture], axis=1) + noise


def test_it_is_the_likelihood_of_the_most_likely_power(rng):
    spectra = drawn(rng, 5, windows=3)
    found = measured(spectra)
    g, noise = powers()[0].astype(float), NOISE * noise_of_frequencies(RADIUS)
    expected = np.full(found.shape, -np.inf)
    for power in np.geomspace(1e-8, 1e3, 2000):
        a = power * (1 + ERROR) * g[:, 0] + noise[0]
        b = power * (g[:, 1] + ERROR * g[:, 0]) + noise[1]
        c = power * (g[:, 3] + 1j * g[:, 4])
        determinant = a * b - np.abs(c) ** 2
        for m, (y, z) in enumerate(spectra):
            explained = (b * np.abs(y) ** 2 + a * np.abs(z) ** 2 - 2 * (c * z * y.conj()).real) / determinant
            level = np.log(determinant / noise.prod(axis=0))
            expected[m] = np.maximum(expected[m], -(level + explained).sum(axis=1))
    np.testing.assert_allclose(found, expected, atol=0.02)


@pytest.mark.parametrize("layer", [0, 2, 5])
def test_a_texture_is_found_at_its_layer(rng, layer):
    assert measured(drawn(rng, layer)).sum(axis=0).argmax() == layer


def test_noise_that_both_halves_share_tells_no_layer_from_another(rng):
    noise = np.sqrt(NOISE * noise_of_frequencies(RADIUS)) * complex_noise(rng, 200, 2, len(RADIUS))
    likelihood = measured(noise)
    assert np.ptp(likelihood.mean(axis=0)) < 0.3  # nats a window; of a texture as strong as the noise some 30
    assert np.ptp(measured(drawn(rng, 6)).mean(axis=0)) > 10


def test_an_even_picture_without_noise_is_no_evidence():
    likelihood = measured(np.zeros((2, 2, len(RADIUS)), complex), noise=0.0)
    assert np.isfinite(likelihood).all()
    assert np.ptp(likelihood) < 1


def test_green_tells_nothing_more(rng):
    spectra = complex_noise(rng, 4, 3, 5)
    half_sum, half_difference = np.moveaxis(sum_and_difference(spectra), 1, 0)
    np.testing.assert_allclose(half_sum + half_difference, spectra[:, 0])
    np.testing.assert_allclose(half_sum - half_difference, spectra[:, 2])


def test_shading_of_the_halves_is_taken_off():
    fall = np.linspace(0.8, 1.2, 200)[None].repeat(60, axis=0)
    image = 0.3 * np.dstack([fall, np.ones_like(fall), 2 - fall]).astype(np.float32)
    inside = np.s_[:, 48:-48]  # two sigmas from the ends, where the mean is not of both sides
    np.testing.assert_allclose(of_equal_light(image)[inside], 0.3, rtol=0.02)


def evidence(config):
    blur = lens_blur(BlurModel(6.0, 12000.0), W, H, "cy_halves")
    noise = NoiseModel(lambda picture: np.full_like(picture, 1e-6), is_known=True)
    pairs = BlurEvidence(AccurateConfig.for_blur(blur.reach).evidence, blur, IDENTITY, noise, execution_named("numba"))
    return SpectralEvidence(config, pairs)


def test_noise_alone_puts_no_wall_at_the_focus(rng):
    """Common noise, low-pass as in photographs: taken for the channels' own it is detail in focus."""
    variance, spectrum = 3e-6, np.hypot(np.fft.fftfreq(H)[:, None], np.fft.rfftfreq(W))
    white = np.fft.rfft2(rng.standard_normal((H, W)))
    common = np.fft.irfft2(white * np.exp(-0.5 * (2 * np.pi * 0.7 * spectrum) ** 2) * np.sqrt(3.2), (H, W))
    halves = 0.4 + np.sqrt(variance / 3) * (common + np.sqrt(2) * rng.standard_normal((2, H, W)))
    image = np.dstack([halves[0], halves.mean(axis=0), halves[1]]).astype(np.float32)
    layers = None

    def earned(config):
        nonlocal layers
        found = evidence(config)
        found = replace(found, pairs=replace(found.pairs, noise=NoiseModel(lambda p: np.full_like(p, variance), True)))
        layers = np.linspace(-2.0, 2.0, 17) * found.pairs.blur.reach
        return found.of_windows(image, layers, layers)[2:-2, 2:-2].mean(axis=(0, 1))

    known, unknown = (earned(SpectralConfig(dual_pixel=known)) for known in (True, False))
    focus = len(layers) // 2
    assert known[focus] - known.min() < 0.3 * (unknown[focus] - unknown.min())


def test_the_gpu_has_no_such_stage():
    config = replace(AccurateConfig(), spectral=SpectralConfig(dual_pixel=True))
    space = view_spaces(design_named("cy_halves"), None, "unmixed")[0]
    method = AccurateMethod(config, space, evidence(config.spectral), IDENTITY, execution_named("numba"))
    assert on_device(method, "auto", lambda note: None) is method
