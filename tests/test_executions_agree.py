"""The compiled matcher against the plain one: every design, every switch, borders and odd sizes included."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import cv2
import numba
import numpy as np
import pytest

from chromaperture.color.noise import estimate_noise_variance
from chromaperture.color.unmixing import ideal_unmixing, view_directions
from chromaperture.config import MatcherConfig
from chromaperture.disparity import kernels, reference
from chromaperture.disparity.views import MatchInputs, guide_weights, prepare
from chromaperture.optics.aperture import design_named

DESIGNS = ("rgb_circles", "rgb_squares", "cmy_squares", "cmy_circles", "cy_halves", "cy_open")
SMALL = MatcherConfig(min_disparity_px=-4.0, max_disparity_px=4.0)

# float32 against float64: a variance is a difference of E[a^2] and E[a]^2, so a score carries the rounding 1e-7 over
# the share EVEN that an area's variance has of the whole view's: 1e-4. Even areas are no subject of comparison.
SCORE_TOLERANCE = 3e-4
EVEN = 1e-3
# Moving one score of a parabola of curvature 0.04 / px^2 by 1e-4, layers 0.5 px apart, moves the vertex by 0.0025 px.
# On flatter peaks the vertex is rounding divided by rounding.
DISPARITY_TOLERANCE_PX = 0.02
FLAT_CURVATURE = 0.04  # 1/px^2
BORDER_PX = 5


def capture(
    design: str, *, shape: tuple[int, int] = (61, 83), seed: int = 7, saturated: bool = True
) -> np.ndarray:
    """A noisy capture of a wavy surface with a step, made by shifting a texture view by view; (H, W, 3) float32."""
    rng = np.random.default_rng(seed)
    height, width = shape
    margin = 16
    big = (height + 2 * margin, width + 2 * margin)
    texture = sum(
        cv2.GaussianBlur(rng.normal(size=big).astype(np.float32), (0, 0), s) * s for s in (1.2, 4.0)
    )
    texture = 0.5 + 0.12 * texture / texture.std()
    y, x = np.mgrid[:height, :width].astype(np.float32)
    disparity = 2.5 * np.sin(x / 17) * np.cos(y / 13)
    disparity[height // 3 : height // 2, width // 4 : width // 2] -= 1.5
    aperture = design_named(design)
    x, y = x + margin, y + margin
    views = [
        cv2.remap(texture, x - disparity * np.float32(u), y - disparity * np.float32(v), cv2.INTER_CUBIC)
        for u, v in view_directions(aperture)
    ]
    image = np.stack(views, axis=-1) @ np.linalg.pinv(ideal_unmixing(aperture)).T
    image = image * (0.8 / image.max()) + rng.normal(0, 0.006, image.shape)
    image[-20:, -25:] = 0.3  # an even area without even noise
    if saturated:
        image[5:15, 40:50] = 1.0
    return image.astype(np.float32)


def inputs_of(image: np.ndarray, design: str, config: MatcherConfig) -> MatchInputs:
    aperture = design_named(design)
    return prepare(
        image,
        directions=view_directions(aperture),
        unmixing=ideal_unmixing(aperture),
        guide_rgb=guide_weights(aperture),
        noise_variance=estimate_noise_variance(image),
        config=config,
    )


def textured(inputs: MatchInputs, config: MatcherConfig) -> np.ndarray:
    """Where every view's variance stands clear of rounding; (H, W) bool."""
    views = inputs.views.astype(np.float64)
    window = [reference.exponential_window(maps, config.window_decay) for maps in (views**2, views)]
    return ((window[0] - window[1] ** 2) > EVEN * views.var(axis=(0, 1))).all(axis=2)


def assert_agree(inputs: MatchInputs, config: MatcherConfig, tolerance: float = SCORE_TOLERANCE) -> None:
    expected, found = reference.match(inputs, config), kernels.match(inputs, config)
    step = config.step_px
    peaked = (expected.curvature > FLAT_CURVATURE) & textured(inputs, config)
    assert peaked.mean() > 0.2  # else the comparison below says little
    error = np.abs(found.disparity_px - expected.disparity_px)
    # Two layers whose scores differ by rounding may swap; that shows as NaN only where one is an end of the range.
    same = np.isfinite(found.disparity_px) == np.isfinite(expected.disparity_px)
    good = same & ~(error > DISPARITY_TOLERANCE_PX)
    border = np.ones(good.shape, bool)
    border[BORDER_PX:-BORDER_PX, BORDER_PX:-BORDER_PX] = False
    assert good[peaked].mean() > 0.999
    assert good[peaked & border].mean() > 0.998
    both = good & peaked & np.isfinite(expected.disparity_px)  # elsewhere the vertex lies beyond the layers
    peak_error = np.abs(found.peak - expected.peak)[both]
    bend_error = np.abs(found.curvature - expected.curvature)[both] * step**2
    assert np.quantile(peak_error, 0.999) < tolerance
    assert np.quantile(bend_error, 0.999) < 4 * tolerance  # a second difference: weights 1, 2, 1
    for field in found[:3]:
        assert field.dtype == np.float32
        assert field.shape == inputs.mask.shape


@pytest.mark.parametrize("design", DESIGNS)
def test_every_design_agrees_with_the_reference(design):
    assert_agree(inputs_of(capture(design), design, SMALL), SMALL)


@pytest.mark.parametrize("design", ["cy_halves", "cmy_squares"])
@pytest.mark.parametrize(
    "change",
    [
        {"noise_debiasing": False},
        {"texture_weighting": False},
        {"bilateral_sigma_px": 0.0},
        {"bilateral_sigma_px": 30.0, "window_decay": 0.9},
        {"window_decay": 0.3, "presmooth_sigma_px": 0.0},
        {"step_px": 0.25, "min_disparity_px": -3.0, "max_disparity_px": 4.0},
        {"step_px": 1.0, "min_disparity_px": -5.0, "max_disparity_px": 3.0},
        {"step_px": 0.3, "min_disparity_px": -3.1, "max_disparity_px": 4.0},
        {"step_px": 4.0, "max_disparity_px": 4.0},
        {"min_disparity_px": 1.0, "max_disparity_px": 16.0, "step_px": 0.5},
        {"min_disparity_px": -12.0, "max_disparity_px": 12.0, "step_px": 0.5},
    ],
    ids=lambda change: ",".join(f"{k}={v}" for k, v in change.items()),
)
def test_every_switch_agrees_with_the_reference(design, change):
    config = replace(SMALL, **change)
    assert_agree(inputs_of(capture(design), design, config), config)


@pytest.mark.parametrize("design", ["cy_halves", "cmy_circles"])
@pytest.mark.parametrize("shape", [(8, 8), (8, 65), (33, 9), (50, 64), (47, 101)])
def test_every_size_agrees_with_the_reference(design, shape):
    config = replace(SMALL, min_disparity_px=-3.0, max_disparity_px=3.0)
    inputs = inputs_of(
        capture(design, shape=(64, 104), saturated=False)[: shape[0], : shape[1]], design, config
    )
    expected = reference.score_volume(inputs, config)
    clear = textured(inputs, config)
    np.testing.assert_allclose(
        kernels.score_volume(inputs, config)[clear], expected[clear], atol=SCORE_TOLERANCE
    )
    found, wanted = kernels.match(inputs, config), reference.match(inputs, config)
    peaked = clear & (wanted.curvature > FLAT_CURVATURE)
    np.testing.assert_allclose(
        found.disparity_px[peaked], wanted.disparity_px[peaked], atol=DISPARITY_TOLERANCE_PX, equal_nan=True
    )


@pytest.mark.parametrize("design", DESIGNS)
def test_score_volume_agrees_with_the_reference(design):
    inputs = inputs_of(capture(design), design, SMALL)
    found = kernels.score_volume(inputs, SMALL)
    expected = reference.score_volume(inputs, SMALL)
    assert found.shape == expected.shape
    assert found.dtype == np.float32
    clear = textured(inputs, SMALL)
    np.testing.assert_allclose(found[clear], expected[clear], atol=SCORE_TOLERANCE)


@pytest.mark.parametrize("design", ["cy_halves", "rgb_circles"])
@pytest.mark.parametrize("texture_weighting", [True, False])
def test_texture_weights_agree_with_the_reference(design, texture_weighting):
    config = replace(SMALL, texture_weighting=texture_weighting)
    inputs = inputs_of(capture(design), design, config)
    expected = reference.texture_weights(inputs, config)
    # Signal is a difference of two variances; where it nearly vanishes, its cube root spreads 1e-7 to 5e-3.
    np.testing.assert_allclose(kernels.texture_weights(inputs, config), expected, atol=5e-3)
    np.testing.assert_allclose(
        kernels.texture_weights(inputs, config), expected, rtol=1e-3, atol=1e-3 * expected.max()
    )


def test_noise_that_varies_over_the_frame_agrees_with_the_reference():
    inputs = inputs_of(capture("cy_halves"), "cy_halves", SMALL)
    ramp = np.linspace(0, 2, inputs.mask.shape[1], dtype=np.float32)[None, :, None]
    inputs = replace(
        inputs, noise_variance=inputs.noise_variance * ramp, noise_covariance=inputs.noise_covariance * ramp
    )
    assert_agree(inputs, SMALL)


def test_a_large_offset_of_brightness_costs_no_precision():
    # Halves that differ by 0.6: the window's mean is far from zero, its variance a few 1e-3 of the view's. What 1e-7 of
    # rounding does to a correlation there is 1e-3.
    image = capture("cy_halves", saturated=False)
    image = 0.1 * (image - image.mean()) + 0.2
    image[:, 40:] += 0.6
    assert_agree(inputs_of(image.astype(np.float32), "cy_halves", SMALL), SMALL, tolerance=1e-3)


def test_the_inputs_are_left_as_they_are():
    inputs = inputs_of(capture("cy_halves"), "cy_halves", SMALL)
    before = {name: np.copy(value) for name, value in vars(inputs).items()}
    kernels.match(inputs, SMALL)
    for name, value in before.items():
        np.testing.assert_array_equal(getattr(inputs, name), value)


@pytest.mark.parametrize("design", ["cy_halves", "cmy_circles"])
def test_bands_leave_no_seams(design, monkeypatch):
    # Bands of a few rows: each takes its windows over from the one above and forgets 1e-4 of those below.
    config = replace(SMALL, window_decay=0.6, min_disparity_px=-3.0, max_disparity_px=3.0)
    inputs = inputs_of(capture(design, shape=(97, 60)), design, config)
    whole = kernels.score_volume(inputs, config)
    monkeypatch.setattr(kernels, "_BAND_ROWS", 9)
    cut = kernels.score_volume(inputs, config)
    clear = textured(inputs, config)
    np.testing.assert_allclose(cut[clear], whole[clear], atol=2e-3)
    assert_agree(inputs, config)


def test_the_number_of_threads_does_not_matter():
    config = replace(SMALL, window_decay=0.6)
    inputs = inputs_of(capture("cmy_squares", shape=(97, 60)), "cmy_squares", config)
    threads = numba.get_num_threads()
    try:
        numba.set_num_threads(1)
        one = kernels.match(inputs, config)
        numba.set_num_threads(min(2, threads))
        two = kernels.match(inputs, config)
    finally:
        numba.set_num_threads(threads)
    # Each thread starts its rows with a halo of its own, which differs by 1e-4 of a window from what it replaces.
    peaked = one.curvature > FLAT_CURVATURE
    good = np.abs(one.disparity_px - two.disparity_px)[peaked] < DISPARITY_TOLERANCE_PX
    assert (good | np.isnan(one.disparity_px[peaked])).mean() > 0.999


def test_calls_do_not_disturb_each_other():
    # Memory is used again by later calls and by calls of other sizes, also at the same time.
    cases = [inputs_of(capture(d, shape=s), d, SMALL) for d, s in (("cy_halves", (61, 83)), ("cmy_circles", (40, 50)))]
    alone = [kernels.match(case, SMALL) for case in cases]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lambda i: kernels.match(cases[i % 2], SMALL), range(8)))
    for i, winner in enumerate(together):
        for a, b in zip(winner[:3], alone[i % 2][:3], strict=True):
            np.testing.assert_array_equal(a, b)
