"""Cross-filtered evidence: a plane blurred by known PSFs is found at its depth."""

from itertools import combinations

import cv2
import numpy as np
import pytest
import scipy.fft
from hypothesis import given, settings
from hypothesis import strategies as st

from chromaperture.matching.error_bar import sigma_of_range
from chromaperture.matching.estimate import estimate_disparity
from chromaperture.matching.evidence.blur import SPACING_PX, BlurEvidence
from chromaperture.matching.execution import execution_named
from chromaperture.matching.labels import IDENTITY, LabelMap
from chromaperture.matching.readable.pair_evidence import CONTRARY, MAX_CORRELATION2_OF_BANDS, explained_variance
from chromaperture.matching.readable.tiles import SAMPLING_PX, Nodes, signal_fraction
from chromaperture.matching.result import ESTIMATED_NOISE, NoiseModel
from chromaperture.optics.lens_blur import BlurModel
from chromaperture.settings.methods import AccurateConfig
from chromaperture.settings.stages import CrossFilterConfig
from chromaperture.system.errors import InputError
from worlds import at_block_middles, blurred, lens_blur, plane_behind

W, H = 160, 120
LENS = BlurModel(6.0, 12000.0, axial_red_px=-0.2, axial_blue_px=0.3, spherical_px=-0.8, lateral_red_px=0.0)


def blur_for(design, model=LENS, width=W, height=H):
    return lens_blur(model, width, height, design)


def likelihood(image, blur, layers_px, *, config=None, noise_variance=None):
    noise = ESTIMATED_NOISE if noise_variance is None else NoiseModel(lambda _: noise_variance, is_known=True)
    evidence = BlurEvidence(config or CrossFilterConfig(), blur, IDENTITY, noise, execution_named("numba"))
    return evidence.likelihood(image, layers_px)


def best_layer(volume, layers):
    sums = volume.mean(axis=(0, 1))
    i = int(np.clip(sums.argmax(), 1, len(layers) - 2))
    below, peak, above = sums[i - 1 : i + 2]
    return layers[i] + (layers[1] - layers[0]) * 0.5 * (below - above) / (below - 2 * peak + above)


@pytest.mark.parametrize("design", ["cy_halves", "cy_open", "rgb_squares", "cmy_circles"])
@pytest.mark.parametrize("edge_px", [-5.0, -0.6, 2.5])
def test_a_plane_is_found_at_its_depth(design, edge_px, rng):
    blur = blur_for(design)
    true = edge_px * blur.reach
    layers = true + np.linspace(-1.0, 1.0, 9) * blur.reach  # a quarter of a px of blur apart
    volume = likelihood(plane_behind(blur, true, rng), blur, layers)
    # The model is exact but for noise; the parabola is biased to the layers by a tenth of a step at most.
    assert best_layer(volume, layers) == pytest.approx(true, abs=0.03 * blur.reach)


@pytest.mark.parametrize("design", ["cy_halves", "cy_open", "rgb_squares"])
def test_primary_pairs_alone_are_the_limit_of_little_weight_for_the_others(design, rng):
    """Where they leave one channel out, the others' blurs are still their own."""
    blur = blur_for(design)
    layers = np.linspace(-2, 2, 5) * blur.reach
    image = plane_behind(blur, -0.8 * blur.reach, rng)
    alone, with_others = (
        likelihood(image, blur, layers, config=CrossFilterConfig(fallback_weight=weight)) for weight in (0.0, 1e-9)
    )
    np.testing.assert_allclose(alone, with_others, atol=1e-5)


@pytest.mark.parametrize("design", ["cy_halves", "cy_open", "rgb_squares", "cmy_circles"])
def test_weak_texture_is_found_where_strong_texture_is(design):
    """Filters of a wide blur leave less of a picture, which must not look like less agreement."""
    blur = blur_for(design)
    true = 5.0 * blur.reach
    layers = true + np.linspace(-2.0, 2.0, 9) * blur.reach
    strong = plane_behind(blur, true, np.random.default_rng(2), noise=0.0, finest_px=2.0)
    weak = 0.3 + 0.1 * (strong - 0.5)  # standard deviation .008 of the white level
    found, expected = (best_layer(likelihood(image, blur, layers), layers) for image in (weak, strong))
    # In px of blur: .004, .043, .000, .009; with a floor of 1e-12 under the product of both powers .03, .32, .01, .08.
    assert found == pytest.approx(expected, abs=0.06 * blur.reach)


def test_blocks_have_the_evidence_at_their_middles(rng):
    """Between samples, as much as is left unexplained; labels mean other layers from column 30 on."""
    blur, config = blur_for("cy_halves", width=62, height=45), CrossFilterConfig(fallback_weight=0.0)
    layers = np.linspace(-2.0, 2.0, 9) * blur.reach  # so sharp that all are computed
    image = plane_behind(blur, 0.8 * blur.reach, rng)
    moved = 2 * (np.arange(62) // 30) + np.zeros((45, 1), int)
    labels = LabelMap((layers[1] - layers[0]) * moved, np.ones(moved.shape))
    evidence = BlurEvidence(config, blur, labels, ESTIMATED_NOISE, execution_named("numba"))
    factors = sum(config.band_weights)
    unexplained = np.exp(-2 / factors * likelihood(image, blur, layers, config=config))
    unexplained = np.take_along_axis(unexplained, moved[::SPACING_PX, ::SPACING_PX, None] + np.arange(5), axis=2)
    expected = -factors / 2 * np.log(at_block_middles(unexplained, image.shape[:2], SPACING_PX))
    np.testing.assert_allclose(evidence.at(image, layers, layers[:5]), expected, atol=1e-4)  # float32


# ---- correlations of either sign


@settings(max_examples=50, deadline=None)
@given(st.integers(1, 6), st.integers(0, 2**32 - 1))
def test_channels_that_rise_together_explain_the_square_of_their_correlation(pairs, seed):
    correlation = np.random.default_rng(seed).uniform(0, 1, (pairs, 2, 3, 4)).astype(np.float32)
    expected = np.minimum(correlation**2, MAX_CORRELATION2_OF_BANDS)
    np.testing.assert_allclose(explained_variance(correlation), expected, rtol=1e-6)  # float32


@pytest.mark.parametrize("order", [(0, 1, 2), (1, 0, 2), (2, 1, 0)])
@pytest.mark.parametrize(
    ("signs", "counted"),
    [
        ((1, -1, -1), (1, 1, 1)),  # one channel falls as the two others rise: a change between two colours
        ((-1, 1, 1), (0, 1, 1)),  # no two colours do that
        ((-1, -1, -1), (0, 0, 0)),  # nor that
        ((1, 1, -1), (1, 1, 0)),
    ],
)
def test_negative_correlations_count_where_two_colours_explain_all_three(signs, counted, order):
    size = np.array([0.9, 0.8, 0.7])
    correlation = (size * signs)[list(order)]
    expected = (size**2 * counted)[list(order)]
    found = explained_variance(correlation.astype(np.float32)[:, None, None])
    np.testing.assert_allclose(found[:, 0, 0], expected, rtol=1e-6)  # products of .56 and more are beyond CONTRARY


def test_a_negative_correlation_counts_as_far_as_the_others_contradict_each_other():
    other = np.array([0.0, 0.1, 0.25, 0.5, 1.0])
    correlation = np.stack([np.full(5, 0.6), -other, np.full(5, -0.8)]).astype(np.float32)
    share = np.minimum(0.6 * other / CONTRARY, 1)
    np.testing.assert_allclose(explained_variance(correlation)[2], 0.64 * share, rtol=1e-5)  # float32


@pytest.mark.parametrize("pairs", [1, 2])
def test_fewer_than_three_pairs_cannot_contradict_each_other(pairs):
    assert not explained_variance(np.full((pairs, 2, 4), -0.9, np.float32)).any()


def test_certainty_is_finite():
    assert explained_variance(np.ones((3, 2))).max() == pytest.approx(MAX_CORRELATION2_OF_BANDS)
    one_falls = explained_variance(np.array([1.0, -1.0, -1.0])[:, None])
    np.testing.assert_allclose(one_falls, MAX_CORRELATION2_OF_BANDS)


HUES = {
    "orange": (0.9, 0.45, 0.1), "blue": (0.15, 0.3, 0.9), "red": (0.8, 0.1, 0.1), "green": (0.1, 0.7, 0.15),
    "yellow": (0.85, 0.8, 0.1), "cyan": (0.1, 0.7, 0.8), "magenta": (0.8, 0.15, 0.7),
}  # fmt: skip
# Between these one channel changes alone, and there is nothing to compare.
ONE_CHANNEL = {("orange", "yellow"), ("green", "cyan")}
HUE_PAIRS = [pair for pair in combinations(HUES, 2) if pair not in ONE_CHANNEL]


def striped(blur, layer_px, hues, rng, noise=0.002):
    """A wall of vertical stripes, 5 to 15 px wide, of two hues in turn."""
    stripes = np.repeat(np.arange(60) % 2, rng.integers(5, 16, 60))[:256]
    at_infinity, scale = blur.reference
    first = blurred(np.broadcast_to(stripes.astype(float), (256, 256)), blur, (at_infinity - layer_px) / scale)
    one, other = (0.8 * np.array(HUES[name]) for name in hues)
    image = one * first + other * (1 - first)
    return (image + rng.normal(0, noise, image.shape)).astype(np.float32)


def accurately_measured(image, blur, design="cy_halves", *, noise):
    config = AccurateConfig.for_blur(blur.reach, one_pair=design == "cy_halves")
    config = config.with_range(-6 * blur.reach, 6 * blur.reach)
    found = estimate_disparity(
        image, aperture=design, config=config, label_maps=[IDENTITY], blur=blur,
        noise_variance=np.full_like(image, noise**2),
    )  # fmt: skip
    return found, config


@pytest.mark.parametrize("hues", HUE_PAIRS, ids="-".join)
@pytest.mark.parametrize("edge_px", [2.5, -3.0])
def test_a_wall_striped_in_two_hues_is_at_its_distance(hues, edge_px, rng):
    blur = blur_for("cy_halves")
    true_px = edge_px * blur.reach
    found, _ = accurately_measured(striped(blur, true_px, hues, rng), blur, noise=0.002)
    at_infinity, scale = blur.reference
    true_mm, found_mm = scale / (at_infinity - true_px), scale / (at_infinity - found.value_px)
    assert np.isfinite(found_mm).all()
    # Stripes are coarse, and hues of which one channel hardly differs leave little: red and magenta are off by .03,
    # most pairs by .006 at most. Beyond focus a px of blur is six times as far as before it.
    assert np.median(found_mm) == pytest.approx(true_mm, rel=0.05)
    assert np.quantile(np.abs(found_mm / true_mm - 1), 0.9) < 0.06


@pytest.mark.parametrize("design", ["cy_halves", "cy_open", "cmy_circles"])
@pytest.mark.parametrize("noise", [0.002, 0.02])
def test_a_blank_wall_is_unknown_or_as_wide_as_the_range(design, noise, rng):
    blur = blur_for(design, width=112, height=84)
    image = (0.5 + rng.normal(0, noise, (84, 112, 3))).astype(np.float32)
    found, config = accurately_measured(image, blur, design, noise=noise)
    known = np.isfinite(found.value_px)
    assert (found.sigma_px[known] >= 0.99 * sigma_of_range(config.layers.values_px)).all()
    assert known.mean() < 0.01  # none is found


@pytest.mark.slow
@pytest.mark.parametrize(("edge_px", "unknown_px"), [(-1.5, 0.08), (0.9, 0.03)])
def test_noise_does_not_bias_towards_more_blur(edge_px, unknown_px):
    """Near focus an open design's parallax is small, and more blur hides more noise."""
    blur = blur_for("cy_open")
    true, noise = edge_px * blur.reach, 0.045
    layers = true + np.arange(-12, 13) * 0.3 * blur.reach
    config = AccurateConfig.for_blur(blur.reach).evidence
    found = {True: [], False: []}
    for seed in range(4):
        rng = np.random.default_rng(seed)
        image = plane_behind(blur, true, rng, noise=noise, finest_px=1.5)
        for known in found:
            variance = np.full_like(image, noise**2) if known else None
            volume = likelihood(image, blur, layers, noise_variance=variance, config=config)
            found[known].append((best_layer(volume, layers) - true) / blur.reach)
    with_noise, without = abs(np.mean(found[True])), abs(np.mean(found[False]))
    # In px of blur; each picture's noise is worth 0.03. Unknown, noise biases by 0.12 and 0.04, and by 0.002 and 0.035
    # where it is known.
    assert with_noise < 0.05
    assert without > unknown_px


def test_the_signal_fraction_is_that_of_wieners_filter():
    """A texture of known spectrum S in white noise N: S / (S + N)."""
    rng, size, sigma = np.random.default_rng(5), 128, 0.3
    w2 = (2 * np.pi * scipy.fft.fftfreq(size))[:, None] ** 2 + (2 * np.pi * scipy.fft.rfftfreq(size)) ** 2
    colour = np.exp(-w2 / 2)
    texture = scipy.fft.irfft2(scipy.fft.rfft2(rng.standard_normal((3, size, size))) * colour)
    noisy = texture + sigma * rng.standard_normal((3, size, size))
    fraction = signal_fraction(scipy.fft.rfft2(noisy), np.full(3, sigma**2 * size**2))
    expected = colour**2 / (colour**2 + sigma**2)
    assert fraction.min() >= 0
    assert fraction.max() <= 1
    # The lag window leaves some thirty independent frequencies in each estimate: a fifth, on what is 1 - N / (S + N).
    assert np.abs(fraction - expected).mean() < 0.08
    assert np.abs(fraction - expected)[:, w2 < 0.5].max() < 0.05
    np.testing.assert_array_equal(signal_fraction(scipy.fft.rfft2(noisy), np.zeros(3)), 1)
    np.testing.assert_array_equal(signal_fraction(np.zeros((1, 8, 5), complex), np.ones(1)), 0)


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 300), st.integers(1, 300), st.floats(0, 40), st.integers(0, 2**32 - 1))
def test_the_tiles_of_nodes_add_up_to_the_picture(height, width, margin, seed):
    """Waves of less than a quarter of a cycle a px are read exactly between the pixels."""
    rng = np.random.default_rng(seed)
    fx, fy, phase = rng.uniform(-0.2, 0.2, 8), rng.uniform(0.02, 0.2, 8), rng.uniform(0, 2 * np.pi, 8)

    def waves(x, y):
        return np.cos(2 * np.pi * (fx * x[..., None] + fy * y[..., None]) + phase).sum(axis=-1).astype(np.float32)

    y, x = np.mgrid[:height, :width]
    image = np.repeat(waves(x, y)[..., None], 3, axis=2)
    nodes = Nodes(height, width, margin_px=margin)
    assert nodes.size >= 2 * (nodes.half + int(margin / SAMPLING_PX))
    assert nodes.shape == (int((height - 1) / SAMPLING_PX) + 1, int((width - 1) / SAMPLING_PX) + 1)
    canvas, inner = nodes.canvas(1), nodes.in_tile()
    for place, weight, tile in zip(nodes.places, nodes.weights, nodes.spectra(image, None), strict=True):
        back = scipy.fft.irfft2(tile.channels[:2], s=(nodes.size, nodes.size)).transpose(1, 2, 0)
        canvas[0, *nodes.on_canvas(place)] += back[inner, inner] * weight
    found = nodes.in_frame(canvas)[0, ..., 0]
    y, x = SAMPLING_PX * np.mgrid[: nodes.shape[0], : nodes.shape[1]]
    shading = cv2.GaussianBlur(image[..., 0], (0, 0), 30.0)  # which tiles do without
    expected = waves(x, y) - cv2.remap(shading, x.astype(np.float32), y.astype(np.float32), cv2.INTER_LINEAR)
    # Near the frame's border its mirror image is not a wave; the tiles' own borders let some of it in. Of 400 random
    # frames, most of them narrow, the worst differs by .28 here, by .35 six samples from the border.
    far = np.s_[12:-12, 12:-12]
    if min(found[far].shape, default=0) > 0:
        assert np.abs(found[far] - expected[far]).max() < 0.05 * 8


@pytest.mark.parametrize("design", ["cy_halves", "cy_open"])
def test_a_plane_is_flat_through_a_lens_of_curved_focus(design, rng):
    """Rendered with the blur of every 15 px; matched with that of every 40, mixed in between."""
    width, height = 360, 120
    blur = blur_for(design, BlurModel(6.0, 12000.0, curvature_px=2.5, lateral_red_px=0.3), width, height)
    at_infinity, scale = blur.reference
    true = -3.0 * blur.reach
    rows, columns = np.linspace(0, height - 1, 9), np.linspace(0, width - 1, 25)
    texture = scipy.fft.rfft2(rng.normal(0, 0.15, (180, 480)))
    y, x = np.mgrid[:height, :width]
    image = np.zeros((height, width, 3))
    for node_y in rows:
        for node_x in columns:
            psf = scipy.fft.irfft2(blur.transfer(node_x, node_y, (at_infinity - true) / scale, 64))
            padded = np.zeros((3, 180, 480))
            padded[:, :64, :64] = np.roll(psf, (32, 32), axis=(1, 2))
            sharp = scipy.fft.irfft2(texture * scipy.fft.rfft2(np.roll(padded, (-32, -32), axis=(1, 2))))
            weight = np.clip(1 - np.abs(y - node_y) / (rows[1] - rows[0]), 0, 1)
            weight *= np.clip(1 - np.abs(x - node_x) / (columns[1] - columns[0]), 0, 1)
            image += weight[..., None] * sharp[:, :height, :width].transpose(1, 2, 0)
    layers = true + np.linspace(-1.2, 1.2, 9) * blur.reach
    config = AccurateConfig.for_blur(blur.reach).evidence
    volume = likelihood((0.5 + image).astype(np.float32), blur, layers, config=config)
    found = [best_layer(volume[:, i : i + 7], layers) for i in range(0, width // SPACING_PX, 7)]
    # In px of blur; 0.032 is what is found, 0.02 if detail from elsewhere counts in full. Filters that do not mix leave
    # up to 0.25 at the tiles' seams.
    assert np.abs(np.array(found) - true).max() < 0.04 * blur.reach


def test_a_whole_measurement_with_a_saturated_patch_and_a_dead_pixel(rng):
    blur = blur_for("cy_halves")
    true = -1.2
    image = plane_behind(blur, true, rng)
    image[50:60, 70:90] = 1.0
    image[20, 30] = np.nan
    noise = np.full_like(image, 0.002**2)
    noise[18:23, 28:33] = np.nan  # as a noise model returns it
    config = AccurateConfig.for_blur(blur.reach).with_range(-2.0, 0.5)
    found = estimate_disparity(
        image, aperture="cy_halves", config=config, label_maps=[IDENTITY], blur=blur, noise_variance=noise
    )
    assert np.nanmedian(found.value_px) == pytest.approx(true, abs=0.02)  # 0.004 is found
    assert np.nanmean(np.abs(found.value_px - true) < 0.1) > 0.9  # 0.987 is found; the patch is 1 % of the frame
    assert (found.sigma_px[np.isfinite(found.value_px)] > 0).all()


def test_a_camera_of_another_size_is_refused():
    with pytest.raises(InputError, match="160 x 120"):
        likelihood(np.zeros((100, 100, 3), np.float32), blur_for("cy_halves"), np.arange(3.0))


def test_a_missing_blur_is_named(rng):
    image = rng.random((H, W, 3), dtype=np.float32)
    with pytest.raises(InputError, match="blur"):
        estimate_disparity(image, aperture="cy_halves", config=AccurateConfig.for_blur(0.4))


@settings(max_examples=8, deadline=None)
@given(st.integers(1, 45), st.integers(1, 45), st.sampled_from(["flat", "black", "one channel", "noise"]))
def test_any_small_picture_gives_finite_evidence(width, height, kind):
    image = np.random.default_rng(0).random((height, width, 3), dtype=np.float32)
    if kind == "flat":
        image[:] = 0.4
    elif kind == "black":
        image[:] = 0
    elif kind == "one channel":
        image[..., 1:] = 0
    volume = likelihood(image, blur_for("cy_halves", width=width, height=height), np.linspace(-1, 1, 3))
    assert volume.shape == (-(-height // SPACING_PX), -(-width // SPACING_PX), 3)
    assert np.isfinite(volume).all()
    assert (volume >= 0).all()
