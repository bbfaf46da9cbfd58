"""Likelihood of all channels: against scipy's optimiser, against windows of simulated textures, on planes."""

import numpy as np
import pytest
import scipy.fft
import scipy.optimize

from chromaperture.matching.evidence.blur import BlurEvidence
from chromaperture.matching.evidence.spectral import SpectralEvidence, _tempered, over_slopes
from chromaperture.matching.evidence.spectral_model import BAND, SpectralModel, Windows
from chromaperture.matching.execution import execution_named
from chromaperture.matching.labels import IDENTITY
from chromaperture.matching.result import ESTIMATED_NOISE, NoiseModel
from chromaperture.optics.lens_blur import BlurModel
from chromaperture.settings.stages import CrossFilterConfig, SpectralConfig
from worlds import at_block_middles, lens_blur, spectral_example

W, H = 160, 120
FAST, SLOW = execution_named("numba"), execution_named("numpy")
LENS = BlurModel(6.0, 12000.0, axial_red_px=-0.2, axial_blue_px=0.3, spherical_px=-0.8)


def texture(rng, slope, colours, shape=(256, 256)):
    """A Gaussian texture of power f^(-2 slope) with covariance ``colours`` of its three colours; unit power in BAND."""
    fy, fx = scipy.fft.fftfreq(shape[0])[:, None], scipy.fft.rfftfreq(shape[1])[None]
    radius = np.hypot(fy, fx)
    amplitude = np.where(radius > 0, np.maximum(radius, 1e-3) ** -slope, 0)
    amplitude /= np.sqrt((amplitude[(radius > BAND[0]) & (radius < BAND[1])] ** 2).mean())
    white = scipy.fft.rfft2(rng.standard_normal((3, *shape)))
    return np.einsum("ij,jyx->iyx", np.linalg.cholesky(colours), white * amplitude)  # spectra


def seen(spectra, blur, layer_px, shape):
    """A texture behind the blur of the frame's middle, everywhere; (H, W, 3)."""
    at_infinity, scale = blur.reference
    size = 256
    middle = (blur.width_px - 1) / 2, (blur.height_px - 1) / 2
    transfer = blur.transfer(*middle, (at_infinity - layer_px) / scale, size)
    return scipy.fft.irfft2(spectra * transfer).transpose(1, 2, 0)[: shape[0], : shape[1]]


def test_colours_are_those_of_highest_likelihood(rng):
    """The rounds against scipy's optimiser, which is given the density alone, of one layer."""
    spectra, powers, node, noise = spectral_example(rng, windows=3, layers=1)
    found = FAST.spectral_likelihood(spectra, powers, node, noise, channel_error=0.01, rounds=300)[:, 0]
    g = np.zeros((2, powers.shape[3], 3, 3), complex)
    for k in range(3):
        g[..., k, k] = powers[:, 0, k] * (1 + 0.01)
    for n, (i, j) in enumerate(((0, 1), (0, 2), (1, 2))):
        g[..., i, j] = powers[:, 0, 3 + 2 * n] + 1j * powers[:, 0, 4 + 2 * n]
        g[..., j, i] = g[..., i, j].conj()

    def loss(root, y, passed):
        lower = np.zeros((3, 3))
        lower[np.tril_indices(3)] = root
        covariance = (lower @ lower.T) * passed + 0.1 * np.eye(3)
        explained = np.einsum("if,fij,jf->f", y.conj(), np.linalg.inv(covariance), y).real
        return (np.log(np.linalg.det(covariance).real) + explained).sum()

    for y, k, value in zip(spectra.astype(complex), node, found, strict=True):
        best = scipy.optimize.minimize(loss, np.eye(3)[np.tril_indices(3)], args=(y, g[k]), method="BFGS")
        assert value == pytest.approx(-best.fun, abs=0.05)  # nats of some hundred: the rounds converge slowly


@pytest.mark.slow
def test_windows_see_the_power_that_the_model_says(rng):
    """Mean power of many windows of a steep texture behind a wide blur: leakage counts at the finest."""
    blur = lens_blur(LENS, 256, 256, "cy_open")
    layer = -4.0 * blur.reach
    config = SpectralConfig()
    windows = Windows(config)
    model = SpectralModel(blur, np.array([layer]), windows, (1.5,), FAST)
    rows = columns = np.arange(24, 232, 16)
    middle = model.counts[0] // 2 * model.counts[1] + model.counts[1] // 2
    expected = model.powers()[0, middle, 0]
    power, cross = 0, 0
    pictures = 24
    for _ in range(pictures):
        image = seen(texture(rng, 1.5, np.eye(3) * 0.9 + 0.1), blur, layer, (256, 256))
        spectra = windows.spectra(image.astype(np.float32), rows, columns).astype(complex)
        power = power + (np.abs(spectra) ** 2).mean(axis=0) / pictures
        cross = cross + (spectra[:, 0] * spectra[:, 2].conj()).mean(axis=0) / pictures
    # 24 pictures of some 60 independent windows: 3 %, and the node is not the frame's exact middle. Where little is
    # left of the texture the model's floor lies above it, on purpose, but never below.
    ratio = power / expected[:3]
    strong = expected[:3] > 0.05 * expected[:3].max()
    assert np.abs(np.log(ratio[strong])).mean() < 0.15
    assert ratio.max() < 1.5
    together = np.hypot(expected[5], expected[6])
    coherence = (cross * (expected[5] - 1j * expected[6]) / together).real / np.sqrt(power[0] * power[2])
    both = strong[0] & strong[2]
    # The colours' covariance over their power; 3 % a frequency, and these are correlated.
    assert coherence[both].mean() == pytest.approx(0.1, abs=0.05)


@pytest.mark.parametrize("design", ["cy_open", "cy_halves"])
@pytest.mark.parametrize("edge_px", [-3.0, 2.0])
def test_a_coloured_plane_is_found_at_its_depth(design, edge_px, rng):
    blur = lens_blur(LENS, W, H, design)
    true = edge_px * blur.reach
    colours = np.array([[1.0, 0.8, 0.6], [0.8, 1.0, 0.7], [0.6, 0.7, 1.0]])
    image = 0.4 + 0.01 * seen(texture(rng, 1.1, colours), blur, true, (H, W))
    image = (image + rng.normal(0, 0.002, image.shape)).astype(np.float32)
    layers = true + np.linspace(-3.0, 3.0, 21) * blur.reach
    noise = NoiseModel(lambda picture: np.full_like(picture, 0.002**2), is_known=True)
    evidence = SpectralEvidence(SpectralConfig(), BlurEvidence(CrossFilterConfig(), blur, IDENTITY, noise, FAST))
    volume = evidence.at_windows(image, layers, np.arange(8, H, 8), np.arange(8, W, 8))
    best = layers[volume.mean(axis=(0, 1)).argmax()]
    assert best == pytest.approx(true, abs=0.31 * blur.reach)  # a layer, 0.3 px of blur


def test_slopes_are_learned_over_the_picture(rng):
    """One window's slope is ambiguous; what the other windows have decides it."""
    clear = np.zeros((2, 50, 6))
    clear[1, :, 3] = 8.0  # slope 1, layer 3
    torn = np.zeros((2, 1, 6))
    torn[0, 0, 1] = torn[1, 0, 4] = 5.0
    layer = over_slopes(np.concatenate([clear, torn], axis=1))[-1]
    assert layer.argmax() == 4
    assert layer[4] > layer[1] + 1


def test_unknown_noise_leaves_the_pairs_alone(rng):
    blur = lens_blur(LENS, W, H, "cy_open")
    layers = np.linspace(-2.0, 2.0, 9) * blur.reach
    image = rng.random((H, W, 3)).astype(np.float32)
    pairs = BlurEvidence(CrossFilterConfig(), blur, IDENTITY, ESTIMATED_NOISE, FAST)
    both = SpectralEvidence(SpectralConfig(), pairs).at(image, layers, layers)
    np.testing.assert_array_equal(both, pairs.at(image, layers, layers))


def test_blocks_have_the_evidence_of_windows_at_their_middles(rng):
    blur = lens_blur(LENS, 62, 45, "cy_open")
    layers = np.linspace(-2.0, 2.0, 9) * blur.reach
    image = rng.random((45, 62, 3)).astype(np.float32)
    noise = NoiseModel(lambda picture: np.full_like(picture, 0.02**2), is_known=True)
    pairs, config = BlurEvidence(CrossFilterConfig(), blur, IDENTITY, noise, FAST), SpectralConfig()
    both = SpectralEvidence(config, pairs)
    expected = at_block_middles(both.of_windows(image, layers, layers, None), image.shape[:2], config.stride_px)
    found = both.at(image, layers, layers) - pairs.at(image, layers, layers)
    np.testing.assert_allclose(found, expected, atol=1e-5)  # float32


def test_what_windows_say_is_limited():
    config = SpectralConfig(gain=2.0, cap_nats=0.5)
    earned = _tempered(np.array([[[0.0, -1e-3, -50.0]]]), config)[0, 0]
    assert earned[0] == pytest.approx(0.5)
    assert earned[0] - earned[1] == pytest.approx(2e-3, rel=0.01)  # the gain near the best
    assert earned[2] == 0
