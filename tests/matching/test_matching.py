"""Quality "paper" as a whole: textured planes, displaced by Fourier shifts, and captures that are refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from chromaperture.matching.estimate import estimate_disparity
from chromaperture.matching.labels import parabola_winner
from chromaperture.system.errors import InputError
from worlds import LAYOUT, NARROW, capture, measured, texture


@pytest.mark.parametrize("disparity_px", [-2.8, -0.2, 0.0, 1.25, 3.4])
@pytest.mark.parametrize("design", sorted(LAYOUT))
def test_a_textured_plane_is_found(rng, design, disparity_px):
    found, _ = measured(capture(texture(rng), design, disparity_px), design)
    # Left are the parabola over layers 0.5 px apart and cubic interpolation: 0.02 px is promised at this step.
    assert abs(np.median(found) - disparity_px) < 0.01
    assert np.sqrt(np.mean((found - disparity_px) ** 2)) < 0.02
    assert np.abs(found - disparity_px).max() < 0.1  # and no outlier


def test_yellow_is_on_the_right_so_far_objects_move_right_in_red():
    """By hand: three px to the right in red, three to the left in blue, which each see one ideal half alone."""
    rng = np.random.default_rng(5)
    sheet = texture(rng, 80, 120)
    center = sheet[:, 10:110]
    red, blue = sheet[:, 7:107], sheet[:, 13:113]
    # what column x of the centre view shows is at x + 3 in red and at x - 3 in blue
    assert red[40, 53] == center[40, 50] == blue[40, 47]
    far = 0.45 * np.stack([red, red + blue, blue], axis=-1).astype(np.float32)  # green passes through both
    found, _ = measured(far, "cy_halves")
    # 1e-4 is found without noise; 0.02 is a twenty-fifth of a layer.
    assert np.median(found) == pytest.approx(3, abs=0.02)
    near, _ = measured(np.ascontiguousarray(far[:, ::-1]), "cy_halves")
    assert np.median(near) == pytest.approx(-3, abs=0.02)  # as above


@pytest.mark.parametrize("design", sorted(LAYOUT))
@pytest.mark.parametrize("disparity_px", [-4.9, -4.0, 4.0, 4.9])
def test_at_and_beyond_the_ends_of_the_range_is_unknown(rng, design, disparity_px):
    found, sigma = measured(capture(texture(rng), design, disparity_px), design)
    # At the end itself interpolation may make the last but one layer win in a few pixels.
    assert np.isnan(found).mean() > 0.97
    assert (np.isnan(sigma) == np.isnan(found)).all()


def test_both_sides_of_a_depth_edge_are_found(rng):
    """Left half near, right half far; a periodic texture each, cut out of its own plane."""
    left, right = (capture(texture(rng), "cy_halves", d) for d in (-2.2, 2.7))
    image = np.concatenate([left[:, :48], right[:, 48:]], axis=1)
    found, _ = measured(image, "cy_halves")
    # 0.002 is found; 0.02 is a twenty-fifth of a layer.
    assert np.median(found[:, :16]) == pytest.approx(-2.2, abs=0.02)
    assert np.median(found[:, -16:]) == pytest.approx(2.7, abs=0.02)  # as above


def test_a_saturated_or_missing_patch_is_bridged_and_leaves_the_rest_alone(rng):
    image = capture(texture(rng, 80, 140), "cy_halves", 1.3)
    image[30:36, 40:46] = 1.0
    image[60, 20, 1] = np.nan
    found, _ = measured(image, "cy_halves")
    far_from_patch = found[:, 65:]  # 35 px: the window has fallen to 0.8^35 = 4e-4
    assert np.quantile(np.abs(far_from_patch - 1.3), 0.99) < 0.02
    assert np.isfinite(found).mean() > 0.98


def test_noise_correlated_by_unmixing_does_not_bias_towards_zero(rng):
    """Unmixing correlates the noise of the views, which is worst at disparity 0 and at low contrast."""
    scene, noise = capture(texture(rng, 120, 160), "cy_halves", 0.5), 0.05
    image = (scene + rng.normal(0, noise, scene.shape)).astype(np.float32)
    found, _ = measured(image, "cy_halves", replace(NARROW, space="unmixed"), noise)
    assert abs(np.nanmedian(found) - 0.5) < 0.05  # 0.005 is found; biased by whole layers without the correction


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (np.zeros((40, 50), np.float32), "RGB image"),
        (np.zeros((40, 50, 4), np.float32), "RGB image"),
        (np.zeros((40, 50, 3), np.uint8), "linear float"),
        (np.zeros((7, 50, 3), np.float32), "smaller"),
        (np.full((40, 50, 3), 0.5, np.float32), "constant"),
        (np.ones((40, 50, 3), np.float32), "saturated"),
        (np.full((40, 50, 3), np.nan, np.float32), "not finite"),
    ],
)
def test_what_cannot_be_matched_is_refused_with_what_to_do(image, message):
    with pytest.raises(InputError, match=message):
        estimate_disparity(image, aperture="cy_halves", config=NARROW, execution="numpy")


def test_a_wrong_number_of_unmixing_rows_is_refused():
    with pytest.raises(InputError, match="unmixing"):
        estimate_disparity(np.zeros((40, 50, 3), np.float32), aperture="cmy_circles", unmixing=np.eye(3)[:2])


@pytest.mark.parametrize("design", sorted(LAYOUT))
def test_sharp_texture_in_focus_is_not_taken_for_noise(rng, design):
    """Without a noise model the noise is estimated from the image, and sharp texture resembles grain."""
    image = capture(texture(rng, blur_px=0.6), design, 0.02)
    found = estimate_disparity(image, aperture=design, config=NARROW, execution="numpy").value_px
    inner = found[16:-16, 16:-16]
    assert np.median(inner) == pytest.approx(0.02, abs=0.02)  # 0.003 is found, of views that are 0.04 px apart
    assert np.isfinite(inner).all()


# ---- the best layer and its parabola


@given(peak_at=st.floats(-2.9, 2.9), height=st.floats(0.1, 1), bend=st.floats(0.01, 0.5), costs=st.booleans())
def test_a_parabola_is_found_exactly(peak_at, height, bend, costs):
    layers = np.arange(-4, 4.5, 0.5)
    score = (height - bend * (layers - peak_at) ** 2)[None, None, :]
    winner = parabola_winner(-score if costs else score, layers, lower_is_better=costs)
    assert winner.disparity_px[0, 0] == pytest.approx(peak_at, abs=1e-6)  # float32
    assert winner.peak[0, 0] == pytest.approx(height, abs=1e-6)  # float32
    assert winner.curvature[0, 0] == pytest.approx(2 * bend, rel=1e-5)  # float32


@pytest.mark.parametrize("best", [0, 8])
def test_a_winner_at_an_end_of_the_range_is_unknown(best):
    layers = np.arange(-2, 2.5, 0.5)
    winner = parabola_winner(-np.abs(np.arange(9.0) - best)[None, None], layers)
    assert np.isnan(winner.disparity_px).all()


def test_a_flat_score_gives_finite_numbers():
    winner = parabola_winner(np.zeros((1, 1, 5)) + np.array([0, 1.0, 1.0, 1.0, 0]), np.arange(5.0))
    assert np.isfinite(winner.peak).all()
    assert (winner.curvature >= 0).all()
