"""Evidence of all channels together on a GPU agrees with the CPU's, stage by stage."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from chromaperture.matching.device.device import Chain
from chromaperture.matching.device.label_stages import WindowGrid, add_spectra, add_windows
from chromaperture.matching.evidence.blur import BlurEvidence
from chromaperture.matching.evidence.spectral import SpectralEvidence
from chromaperture.matching.evidence.spectral_model import Windows
from chromaperture.matching.labels import IDENTITY
from chromaperture.matching.readable.tiles import without_shading
from chromaperture.matching.result import NoiseModel
from chromaperture.settings.stages import CrossFilterConfig, SpectralConfig
from devices import any_device
from executions import READABLE
from test_gpu_evidence import LENS, bent
from worlds import lens_blur, plane_behind

pytestmark = pytest.mark.extra("gpu", "wgpu")

SHAPE = (70, 97)


def source_for(label_map, config=None):
    """Evidence of an open aperture whose noise is known."""
    blur = lens_blur(LENS, SHAPE[1], SHAPE[0], "cy_open")
    noise = NoiseModel(lambda image: np.full(image.shape, 0.004**2, np.float32), is_known=True)
    pairs = BlurEvidence(CrossFilterConfig(), blur, label_map, noise, READABLE)
    return SpectralEvidence(config or SpectralConfig(), pairs)


def picture(source, seed):
    """A noisy texture behind the blur of one depth, with a bright even part."""
    rng, blur = np.random.default_rng(seed), source.pairs.blur
    image = plane_behind(blur, 1.2 * blur.reach, rng, noise=0.0)
    image[:30, :30] = 0.8
    return (image + rng.normal(0, 0.004, image.shape)).astype(np.float32)


@settings(max_examples=4, deadline=None)
@given(st.sampled_from([(8.0, 10), (11.0, 7)]), st.integers(0, 2**32 - 1))
def test_spectra_agree(window, seed):
    source = source_for(IDENTITY, SpectralConfig(taper_px=window[0], stride_px=window[1]))
    image = picture(source, seed)
    chain = Chain(any_device())
    windows, grid = Windows(source.config), WindowGrid(*SHAPE, window[1])
    arrays = [chain.array(name, image.size) for name in ("image", "shading")]
    spectra = add_spectra(chain, windows, grid, *arrays)
    detail = without_shading(image)
    found = chain.run({"image": image, "shading": image - detail}, [spectra.name])[spectra.name]
    expected = windows.spectra(detail, grid.rows, grid.columns)
    found = found.reshape(*expected.shape[:2], 2, -1)
    # Sums of a few thousand products in single precision.
    np.testing.assert_allclose(found[:, :, 0] + 1j * found[:, :, 1], expected, atol=1e-5 * np.abs(expected).max())


@pytest.mark.parametrize("label_map", [IDENTITY, bent(SHAPE)])
def test_what_labels_earn_agrees(label_map):
    source = source_for(label_map)
    layers = np.arange(-9, 10) * 0.9 * source.pairs.blur.reach
    labels = np.linspace(layers[0], layers[-1], 71)
    image = picture(source, 3)
    grid = WindowGrid(*SHAPE, source.config.stride_px)
    chain = Chain(any_device())
    arrays = [chain.array(name, n) for name, n in (("i", image.size), ("s", image.size), ("n", 3 * grid.count))]
    earned = add_windows(chain, source, grid, arrays, layers, labels)
    noise = source.noise_of_windows(source.noise.variance(image), grid.rows, grid.columns)
    found = chain.run({"i": image, "s": image - without_shading(image), "n": noise}, [earned.name])[earned.name]
    expected = source.of_windows(image, layers, labels)
    away = np.abs(found.reshape(expected.shape) - expected)
    assert expected.max() > 0.4
    # Nats a pixel, at most `cap_nats` = 0.5.
    assert np.quantile(away, 0.99) < 1e-3
    assert away.max() < 0.01
