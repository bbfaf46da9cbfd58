"""Quality "accurate" with shifted views, its labels and its error bar, on surfaces that are known."""

import numpy as np
import pytest

from chromaperture.matching import compiled as cpu
from chromaperture.matching import readable as stages
from chromaperture.matching.accurate import AccurateMethod, explained_surface, path_surface
from chromaperture.matching.blocks import block_means
from chromaperture.matching.error_bar import surface_sigma
from chromaperture.matching.evidence.correlation import CorrelationEvidence, log_likelihood
from chromaperture.matching.execution import execution_named
from chromaperture.matching.labels import IDENTITY, LabelMap, Surface, label_map
from chromaperture.matching.readable.correlation import three_view_score
from chromaperture.matching.result import ESTIMATED_NOISE
from chromaperture.matching.views import ViewSpace
from chromaperture.settings.methods import AccurateConfig
from chromaperture.settings.stages import (
    CorrelationConfig,
    CorrelationEvidenceConfig,
    LayersConfig,
    SurfaceConfig,
    ViewsConfig,
)
from chromaperture.system.errors import InputError

LAYERS_PX = np.arange(-3.0, 3.01, 0.5)


def correlation_volume(rng, truth, *, peak=0.6, noise=0.15):
    """Correlations that fall off with the distance from the truth, with noise common to 3 x 3 px."""
    error = rng.normal(0, noise, (truth.shape[0] // 3 + 1, truth.shape[1] // 3 + 1, len(LAYERS_PX)))
    error = error.repeat(3, 0).repeat(3, 1)[: truth.shape[0], : truth.shape[1]]
    return np.clip(peak * np.exp(-((LAYERS_PX - truth[..., None]) ** 2)) + error, -1, 1)


def wall(shape=(45, 60)):
    return -0.3 + 0.015 * np.mgrid[: shape[0], : shape[1]][1]


def test_likelihood_is_that_of_gaussian_views():
    """The mean log density ratio of correlated against independent Gaussian pairs, over drawn samples."""
    rng = np.random.default_rng(1)
    for rho in (0.3, 0.8):
        x, y = rng.multivariate_normal([0, 0], [[1, rho], [rho, 1]], 200_000).T
        together = (x**2 - 2 * rho * x * y + y**2) / (1 - rho**2) + np.log(1 - rho**2)
        alone = x**2 + y**2
        gain = (alone - together).mean() / 2
        assert log_likelihood(np.array(rho), view_count=2) == pytest.approx(gain, abs=0.01)  # sampling error
    # Three views of which only two are related are the evidence of those two: det R = 1 - rho^2 for both.
    pair = log_likelihood(np.array(0.5), view_count=2)
    score = three_view_score(np.array(0.5), np.array(0.0), np.array(0.0))
    # What counts of a perfect score, .999, counts in either view count, but not alike.
    assert log_likelihood(score, view_count=3) == pytest.approx(pair, rel=1e-3)


def test_anticorrelation_is_no_evidence_and_certainty_is_finite():
    values = log_likelihood(np.array([-1.0, -0.2, 0.0, 1.0]), view_count=2)
    np.testing.assert_array_equal(values[:3], 0)
    assert np.isfinite(values[3])


def surface_of(likelihood, *, config, execution="numba"):
    """The surface of a volume of pixels, from its blocks."""
    nats, run = block_means(likelihood), execution_named(execution)
    found = path_surface(nats, np.zeros(nats.shape[:2]), LAYERS_PX, config=config, run=run)
    odds = np.full((2, *nats.shape[:2]), -6.0, np.float32)
    return explained_surface(found, odds, LAYERS_PX, likelihood.shape[:2], config=config, run=run)


def config_of(**surface):
    return AccurateConfig(surface=SurfaceConfig(**surface))


@pytest.mark.slow
@pytest.mark.parametrize(("execution", "kind"), [("numba", "views"), ("numpy", "views"), ("numba", "none")])
def test_a_surface_is_found_with_an_error_bar(execution, kind):
    rng = np.random.default_rng(2)
    truth = wall((20, 24)) if execution == "numpy" else wall()
    likelihood = log_likelihood(correlation_volume(rng, truth), view_count=2)
    config = config_of(slope_penalty=1.5, jump_penalty=3, learned_error_bar=kind)
    surface = surface_of(likelihood, config=config, execution=execution)
    alone = np.abs(LAYERS_PX[likelihood.argmax(axis=2)] - truth).mean()
    assert np.isfinite(surface.disparity_px).all()
    # A twentieth of a layer is found, a ninth with the few pixels of NumPy; of single pixels half a layer.
    assert np.abs(surface.disparity_px - truth).mean() < 0.06 < alone
    assert (surface.sigma_px > 0).all()
    assert np.median(surface.peak) == pytest.approx(0.6, abs=0.15)  # the correlation put in; noise is 0.15


def test_a_surface_at_the_end_of_the_range_is_unknown():
    truth = np.full((20, 20), LAYERS_PX[-1] + 0.3)
    likelihood = log_likelihood(correlation_volume(np.random.default_rng(4), truth, noise=0.02), view_count=2)
    surface = surface_of(likelihood, config=AccurateConfig())
    assert np.isnan(surface.disparity_px).all()
    assert np.isnan(surface_sigma(surface)).all()


@pytest.mark.parametrize("run", [stages, cpu])
def test_the_posterior_of_a_quadratic_cost_is_that_of_a_gaussian(run):
    """exp(-(d - m)^2 / 2 s^2) on fine layers has the standard deviation s; the map's own error adds."""
    layers = np.arange(-4, 4.01, 0.1)
    middle, sigma = 0.03, 0.6
    cost = np.tile((layers - middle) ** 2 / (2 * sigma**2) * 7.0, (3, 4, 1)).astype(np.float32)
    posterior = run.posterior(cost, layers, temperature=7.0)
    np.testing.assert_allclose(posterior.mean_px, middle, atol=1e-6)  # float32 layers of up to 4 px
    sigma_px = posterior.sigma_px(np.full((3, 4), middle))
    # Sum over layers for the integral; beyond the last, at 6 sigma, nothing is left.
    np.testing.assert_allclose(sigma_px, sigma, rtol=1e-4)
    moved = posterior.sigma_px(np.full((3, 4), middle + 0.8))
    np.testing.assert_allclose(moved, np.hypot(sigma, 0.8), rtol=1e-4)  # as above


@pytest.mark.parametrize("run", [stages, cpu])
def test_a_rival_far_away_widens_the_posterior(run):
    layers = np.arange(-3, 3.01, 0.25)
    alone = np.minimum(8 * (layers - 1) ** 2, 20.0)
    rival = np.minimum(alone, 8 * (layers + 1.5) ** 2 + 1)
    cost = np.stack([alone, rival])[None].astype(np.float32)
    without, with_rival = run.posterior(cost, layers, temperature=2.0).sigma_px(np.ones((1, 2)))[0]
    assert without < 0.4  # 0.36 is found; one parabola has sqrt(2 / 16)
    assert with_rival > 1.0  # 1.6 is found: the rival lies 2.5 px off


def test_surface_sigma_adds_the_floor_and_is_capped():
    one = np.ones((2, 2), np.float32)
    surface = Surface(np.array([[0, 1], [np.nan, 2]], np.float32), np.array([[0.2, 0.3], [0.1, 99]], np.float32), one)
    sigma = surface_sigma(surface)
    np.testing.assert_allclose(sigma[0], [0.2, 0.3], rtol=1e-6)  # float32
    assert np.isnan(sigma[1, 0])
    assert 2 < sigma[1, 1] < 99
    np.testing.assert_allclose(surface_sigma(surface, floor_px=0.4)[0], [np.hypot(0.2, 0.4), 0.5], rtol=1e-6)


def test_mismatched_shapes_are_named():
    with pytest.raises(InputError, match="does not fit"):
        surface_of(np.zeros((4, 5, 6)), config=AccurateConfig())


def half_pupil_image(rng, disparity_px, *, noise):
    """Left and right half views of a random texture on a wall, in R and G, exact by Fourier shifts; (40, 48, 3)."""
    shape = (40, 48)
    spectrum = np.fft.fft2(rng.normal(size=shape))
    frequency = np.fft.fftfreq(shape[1])
    spectrum *= np.exp(-8 * (frequency**2 + np.fft.fftfreq(shape[0])[:, None] ** 2))
    views = [np.fft.ifft2(spectrum * np.exp(2j * np.pi * frequency * -disparity_px * u)).real for u in (-1, 1)]
    image = np.zeros((*shape, 3), np.float32)
    image[..., :2] = 0.5 + 0.1 * (np.stack(views, -1) + rng.normal(0, noise, (*shape, 2)))
    return image


CONFIG = AccurateConfig(
    layers=LayersConfig(min_px=-2.5, max_px=2.5, step_px=0.5),
    views=ViewsConfig(presmooth_sigma_px=0.0),
    evidence=CorrelationEvidenceConfig(correlation=CorrelationConfig(window_decay=0.8)),
)


def halves(scale=1.0):
    """Views R and G, which a px of disparity displaces by ``scale`` px; the guide is even."""
    return ViewSpace(np.array([[-scale, 0], [scale, 0]]), np.eye(3)[:2], np.zeros(3))


def measured(image, spaces, label_maps=(IDENTITY,)):
    run = execution_named("numba")
    evidence = CorrelationEvidence(CONFIG.evidence, CONFIG.views, spaces, label_maps, ESTIMATED_NOISE, run)
    return AccurateMethod(CONFIG, spaces[0], evidence, label_maps[0], run).match(image)


def test_two_view_spaces_of_different_scale_are_matched_as_one():
    truth, scale = 1.5, 0.7
    image = half_pupil_image(np.random.default_rng(5), truth, noise=0.1)
    spaces = halves(), halves(scale)  # the same displacements are disparities 1 / 0.7 times as large in the second
    larger = LabelMap(IDENTITY.offset_px, IDENTITY.scale / np.float32(scale))
    # A layer itself: there interpolation has no bias, and what the noise does is smoothed away.
    assert np.abs(measured(image, spaces, (IDENTITY, larger)).value_px - truth).max() < 0.03
    wrong = measured(image, spaces, (IDENTITY, IDENTITY))  # labels that do not fit
    assert np.abs(wrong.value_px - truth).mean() > 0.05


@pytest.mark.parametrize("shape", [(7, 48), (40, 7), (3, 3)])
def test_of_a_picture_without_two_blocks_along_a_side_nothing_is_known(shape):
    image = half_pupil_image(np.random.default_rng(5), 1.0, noise=0.1)
    found = measured(image[: shape[0], : shape[1]], (halves(),))
    assert found.value_px.shape == found.sigma_px.shape == found.confidence.shape == shape
    assert np.isnan(found.value_px).all()
    assert np.isnan(found.sigma_px).all()
    assert not found.confidence.any()
    # With one more row or column they are two.
    assert np.isfinite(measured(image[: max(8, shape[0]), : max(8, shape[1])], (halves(),)).value_px).any()


def curved_lens(shape):
    """A and B of a lens with field curvature and vignetting: a flat wall bends by more than two layers."""
    y, x = (np.mgrid[: shape[0], : shape[1]] - np.array(shape)[:, None, None] / 2) / shape[1]
    return 4 - 5 * (x**2 + y**2), 8000 * (1 - 0.3 * (x**2 + y**2))


def test_labels_are_the_disparities_of_the_reference_pixel():
    a, b = curved_lens((30, 40))
    labels = label_map(a, b, reference=(4.0, 8000.0))
    for z_mm in (1000.0, 3000.0):
        # float32 maps of order 10
        np.testing.assert_allclose(labels.disparity(4.0 - 8000.0 / z_mm), a - b / z_mm, atol=3e-6)


def test_halved_label_maps_have_half_the_disparity_at_half_the_label():
    a, b = curved_lens((31, 40))
    labels = label_map(a, b, reference=(4.0, 8000.0))
    expected = labels.disparity(1.2)[::2, ::2] / 2
    np.testing.assert_allclose(labels.halved().disparity(0.6), expected, atol=1e-6)  # float32 of order 1
    assert IDENTITY.halved().is_identity
    assert not labels.halved().is_identity


class GivenCorrelations:
    """Evidence from a volume of correlations that is known beforehand."""

    noise = ESTIMATED_NOISE

    def __init__(self, volume, labels):
        self.volume, self.labels = volume, labels

    def at(self, image, layers_px, labels_px, *, noise_variance=None):
        likelihood = log_likelihood(self.volume, view_count=2)
        return block_means(cpu.read_at_labels(likelihood, layers_px, labels_px, self.labels))


def test_a_flat_wall_seen_by_a_curved_lens_is_found_flat():
    rng = np.random.default_rng(9)
    shape, layers_px = (45, 60), CONFIG.layers.values_px
    a, b = curved_lens(shape)
    truth = a - b / 2200.0
    noise = rng.normal(0, 0.25, (*shape, len(layers_px)))
    volume = np.clip(0.3 * np.exp(-((layers_px - truth[..., None]) ** 2)) + noise, -1, 1)
    image = rng.uniform(0, 0.5, (*shape, 3)).astype(np.float32)
    errors = []
    for labels in (IDENTITY, label_map(a, b, reference=(4.0, 8000.0))):
        evidence = GivenCorrelations(volume, labels)
        found = AccurateMethod(CONFIG, halves(), evidence, labels, execution_named("numba")).match(image)
        errors.append(np.abs(found.value_px - truth).mean())
    assert errors[1] < 0.05  # a tenth of a layer
    assert errors[0] > 2 * errors[1]
