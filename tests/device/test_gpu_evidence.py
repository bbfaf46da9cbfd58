"""Evidence from the camera's blur on a GPU agrees with the CPU's, stage by stage."""

import math

import numpy as np
import pytest

from chromaperture.matching.blocks import BLOCK_PX
from chromaperture.matching.device import evidence_stages
from chromaperture.matching.device.device import Chain, DeviceError
from chromaperture.matching.device.evidence_stages import add_evidence, add_transform, plan_evidence
from chromaperture.matching.device.label_stages import add_labels
from chromaperture.matching.evidence.blur import BlurEvidence
from chromaperture.matching.execution import execution_named
from chromaperture.matching.labels import IDENTITY, LabelMap
from chromaperture.matching.result import ESTIMATED_NOISE, NoiseModel
from chromaperture.optics.lens_blur import BlurModel
from chromaperture.settings.stages import CrossFilterConfig
from devices import any_device
from worlds import lens_blur, plane_behind

pytestmark = pytest.mark.extra("gpu", "wgpu")

LENS = BlurModel(6.0, 12000.0, axial_red_px=-0.2, axial_blue_px=0.3, spherical_px=-0.8, coma_px=0.3)


class Case:
    """A picture, its evidence on the CPU, and the chain that computes it on a device.

    The picture is a pattern at one depth, grey or by ``gains`` of R, G, B: of opposite signs in two hues.
    """

    def __init__(self, design, shape, noise, label_map, *, half_range=5, gains=(1, 1, 1), config=None):
        height, width = shape
        self.blur = lens_blur(LENS, width, height, design)
        rng = np.random.default_rng(3)
        self.image = plane_behind(self.blur, 1.2 * self.blur.reach, rng, noise=0.004, gains=gains)
        variance = np.full_like(self.image, 0.004**2)
        model = NoiseModel(lambda _: variance, is_known=True) if noise else ESTIMATED_NOISE
        self.source = BlurEvidence(config or CrossFilterConfig(), self.blur, label_map, model, execution_named("numpy"))
        self.layers = np.arange(-half_range, half_range + 1) * 0.9 * self.blur.reach
        self.labels = np.linspace(self.layers[0], self.layers[-1], 4 * half_range + 1)
        self.plan = plan_evidence(self.source, self.layers)
        self.chain = Chain(any_device())
        size, tiles, blocks = self.image.size, len(self.plan.nodes.places), (height // BLOCK_PX, width // BLOCK_PX)
        arrays = [self.chain.array(name, n) for name, n in (("image", size), ("noise", 3 * tiles))]
        unexplained = add_evidence(self.chain, self.plan, *arrays)
        usable = self.chain.array("usable", math.prod(blocks))
        likelihood = self.chain.array("likelihood", math.prod(blocks) * len(self.labels))
        add_labels(self.chain, self.plan, unexplained, usable, likelihood, self.labels)
        self.powers = self.plan.nodes.noise_powers(variance) if noise else np.zeros((tiles, 3))
        self.usable = rng.random(blocks) > 0.1

    def run(self, *outputs):
        inputs = {"image": self.image, "noise": self.powers, "usable": self.usable}
        return self.chain.run(inputs, list(outputs))


def bent(shape):
    y, x = np.mgrid[: shape[0], : shape[1]]
    return LabelMap((0.002 * x - 0.1).astype(np.float32), (1 + 0.001 * y).astype(np.float32))


# How R, G, B rise from blue to orange: of three pairs two correlate negatively.
ORANGE_AND_BLUE = np.array([0.9, 0.35, -0.7])
PRIMARY_ALONE = CrossFilterConfig(fallback_weight=0.0)


@pytest.mark.parametrize(
    ("design", "shape", "noise", "label_map", "more"),
    [
        ("cy_halves", (70, 97), True, bent((70, 97)), {}),
        ("cmy_circles", (64, 81), False, IDENTITY, {}),
        ("rgb_squares", (53, 41), True, IDENTITY, {}),
        ("cy_halves", (54, 66), True, IDENTITY, {"gains": ORANGE_AND_BLUE}),
        ("cmy_circles", (54, 66), True, IDENTITY, {"gains": ORANGE_AND_BLUE}),
        ("cy_halves", (54, 66), True, IDENTITY, {"gains": ORANGE_AND_BLUE, "config": PRIMARY_ALONE}),
    ],
)
def test_evidence_agrees(design, shape, noise, label_map, more):
    case = Case(design, shape, noise, label_map, **more)
    found = case.run("spectra", "signal", "correlation", "likelihood")
    tiles = case.plan.nodes.spectra(case.image, case.source.noise.variance(case.image) if noise else None)
    spectra = np.stack([tile.channels for tile in tiles])
    # Transforms in single precision: 1e-6 of the largest.
    got = found["spectra"].view(np.complex64).reshape(spectra.shape)
    np.testing.assert_allclose(got, spectra, atol=1e-5 * np.abs(spectra).max())
    if noise:
        signal = np.stack([tile.signal for tile in tiles])
        # Where the power is a millionth of the largest, its own rounding counts: the highest frequencies.
        np.testing.assert_allclose(found["signal"].reshape(signal.shape), signal, atol=1e-3)
    count = len(case.plan.computed_px)
    correlation = np.moveaxis(case.source._correlations(case.image, case.plan.computed_px, count), 0, -1)
    primary = len(case.blur.pairs)  # others have fewer layers
    kept = [correlation[:primary], correlation[primary:, ..., : case.plan.parts[0].end]]
    expected = np.concatenate([part.ravel() for part in kept])
    np.testing.assert_allclose(found["correlation"], expected, atol=1e-4)
    if more:
        assert correlation.mean(axis=(1, 2, 3)).min() < -0.5  # of a pair
    expected = case.source.at(case.image, case.layers, case.labels) * case.usable[..., None]
    off = np.abs(found["likelihood"].reshape(expected.shape) - expected)
    # Near its limit of 0.999 the squared correlation's logarithm enlarges a difference 500 times; at an end of the
    # range rounding decides whether a label is inside.
    assert off[..., 1:-1].max() < 5e-3
    assert off.max() < 0.03
    assert off.mean() < 1e-4


# One to three passes behind the first, every radix of `fourier`; 1024 is the longest line.
@pytest.mark.parametrize("span", [6, 20, 40, 48, 54, 64, 90, 108, 160, 192, 256, 432, 1000, 1024])
def test_transforms_of_every_radix_are_those_of_numpy(span, rng):
    height, kept = 8, span // 2
    image, shading = rng.normal(0, 1, (2, height, span, 3)).astype(np.float32)
    chain = Chain(any_device())
    arrays = [chain.constant("image", image), chain.constant("shading", shading)]
    rows = chain.array("rows", 2 * 3 * span * kept)
    arrays += [chain.constant("corners", np.zeros(2, np.int32)), rows]
    add_transform(
        chain, "tile_rows", arrays, span, 3 * span // 2, backwards=False, beside_lines=False,
        height=height, width=span, kept=kept,
    )  # fmt: skip
    found = chain.run({}, ["rows"])["rows"].view(np.complex64).reshape(3, span, kept)[:, : min(height, span)]
    expected = np.fft.fft((image - shading).astype(float), axis=1)[: min(height, span), :kept].transpose(2, 0, 1)
    # Single precision: some 1e-7 a pass and a power of a factor.
    np.testing.assert_allclose(found, expected, atol=2e-6 * np.abs(expected).max())


def test_layers_in_rounds_are_the_same(monkeypatch):
    """Where memory holds few layers at once, they go through one after the other."""
    whole = Case("cy_halves", (40, 44), True, IDENTITY).run("correlation")["correlation"]
    sizes = []
    for budget in (1 << 24, 1):
        monkeypatch.setattr(evidence_stages, "ROUND_BYTES", budget)
        case = Case("cy_halves", (40, 44), True, IDENTITY)
        sizes.append(len(case.chain.dispatches))
        np.testing.assert_allclose(case.run("correlation")["correlation"], whole, atol=1e-5)
    assert sizes[0] < sizes[1]


def test_tiles_that_are_too_large_are_refused():
    source = BlurEvidence(
        CrossFilterConfig(), lens_blur(LENS, 6000, 4000), IDENTITY, ESTIMATED_NOISE, execution_named("numpy")
    )
    with pytest.raises(DeviceError, match="too large for the GPU"):
        plan_evidence(source, np.linspace(-3, 3, 21))
