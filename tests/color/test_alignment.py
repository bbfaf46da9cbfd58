"""The channels come back to the view of the pupil's centre."""

import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt

from chromaperture.color.alignment import (
    align_channels,
    channel_directions,
    fill_unknown,
    linear_displacement,
    shift_back,
    white_balance,
)
from chromaperture.color.row_alignment import visible_from
from chromaperture.color.srgb import linear_to_srgb, linear_to_srgb_bytes
from chromaperture.color.unmixing import own_film_unmixing
from chromaperture.optics.aperture import DESIGNS, centroids, channel_transmission
from chromaperture.optics.ray_table import pinhole_rays
from chromaperture.optics.simulator.render import render, render_depth
from chromaperture.system.errors import InputError
from worlds import MARGIN_PX, capture, card_before_wall, pinhole_camera, texture


@pytest.mark.parametrize("design", ["cy_halves", "rgb_squares"])
@pytest.mark.parametrize("disparity_px", [-3.3, 2.4])
def test_a_grey_plane_is_grey_again(rng, design, disparity_px):
    picture = texture(rng)
    image = capture(picture, design, disparity_px)
    disparity = np.full(picture.shape, disparity_px, np.float32)
    color = align_channels(image, disparity, channel_directions(DESIGNS[design], {}))
    inner = slice(MARGIN_PX, -MARGIN_PX)
    color = color[inner, inner]
    truth = picture[inner, inner]
    for k in range(3):
        if design == "cy_halves" and k == 1:
            continue  # green sees both halves at once: its blur is not a shift
        scaled = color[..., k] / color[..., k].mean() * truth.mean()
        # cubic interpolation of a texture of 1.5 px blur leaves 2e-3 of its 0.09 contrast
        assert np.sqrt(np.mean((scaled - truth) ** 2)) < 2e-3


def test_leaking_film_moves_a_channel_less():
    ideal = channel_directions(DESIGNS["cy_halves"], {})
    # The pupil's grid is good to 4e-4.
    np.testing.assert_allclose(ideal, [[1, 0], [0, 0], [-1, 0]], atol=5e-3)
    leaky = channel_directions(
        DESIGNS["cy_halves"], {"cyan": np.array([0.1, 0.63, 0.65]), "yellow": np.array([0.92, 0.85, 0.1])}
    )
    # Two point masses at +1 and -1: the centroid of red is (T_yellow - T_cyan) / (T_yellow + T_cyan).
    np.testing.assert_allclose(leaky[0, 0], (0.92 - 0.10) / (0.92 + 0.10), atol=5e-3)
    np.testing.assert_allclose(leaky[2, 0], -(0.65 - 0.10) / (0.65 + 0.10), atol=5e-3)


def test_unknown_takes_the_nearest_known():
    values = np.full((5, 5), np.nan)
    values[0, 0], values[4, 4] = 1.0, 2.0
    filled = fill_unknown(values)
    assert filled[1, 0] == 1.0
    assert filled[4, 3] == 2.0
    assert (fill_unknown(np.full((3, 3), np.nan)) == 0).all()


@pytest.mark.parametrize(("shape", "unknown"), [((60, 80), 0.5), ((37, 53), 0.98), ((1, 9), 0.7), ((9, 1), 0.7)])
def test_the_nearest_known_is_as_near_as_scipy_s(rng, shape, unknown):
    missing = rng.random(shape) < unknown
    missing[0, 0], missing[-1, -1] = False, True
    filled = fill_unknown(np.where(missing, np.nan, np.arange(missing.size).reshape(shape))).astype(int)
    rows, columns = np.divmod(filled, shape[1])  # where every value came from
    assert not missing[rows, columns].any()
    y, x = np.indices(shape)
    # Which of several equally near ones is left to each; the distances are roots of the same whole numbers.
    np.testing.assert_allclose(np.hypot(rows - y, columns - x), distance_transform_edt(missing), rtol=1e-14)


def test_white_paper_comes_out_white():
    white = np.array([0.46, 0.67, 0.34])
    np.testing.assert_allclose(white_balance(np.tile(white, (2, 2, 1)), white), 0.67, rtol=1e-6)  # float32


def photographed(design):
    """A near card before a wall, rendered ray by ray; returns image, true half disparity, sharp colour, directions."""
    aperture, camera = DESIGNS[design], pinhole_camera(120, 80)
    # Three shades of one colour each: colour lines hold, and grey levels vary.
    planes = card_before_wall([(0.9, 0.6, 0.4), (0.4, 0.6, 0.9)], texels=(200, 300), exponent=1.5, contrast=0.12,
                              distances_mm=(1250, 850), widths_mm=(700, 110))  # fmt: skip
    table = pinhole_rays(camera, aperture, cells=16)
    reach = np.linalg.norm(centroids(aperture, own_film_unmixing(aperture)), axis=1).mean()
    d = camera.disparity_px(render_depth(table, planes), reach).astype(np.float32)
    image = render(table, planes) / channel_transmission(aperture).astype(np.float32)
    open_table = pinhole_rays(camera, DESIGNS["open"], cells=16)
    return image, d, render(open_table, planes), channel_directions(aperture, {})


@pytest.mark.slow
@pytest.mark.parametrize("design", ["cy_halves", "rgb_squares", "cmy_circles"])
def test_strips_hidden_from_a_channel_get_their_own_surface_s_colour(design):
    image, d, natural, u = photographed(design)
    visible = np.stack([visible_from(d, v) for v in u], -1)
    inner = np.zeros(d.shape, bool)
    inner[10:-10, 14:-14] = True
    hidden = ~visible & inner[..., None]
    assert hidden.sum() > 100  # there is something to fill
    shifted, filled = shift_back(image, linear_displacement(d, u)), align_channels(image, d, u)
    before = np.sqrt(np.mean((shifted - natural)[hidden] ** 2))
    after = np.sqrt(np.mean((filled - natural)[hidden] ** 2))
    # Blurred edges mix both surfaces, which no colour line undoes; a sixth of the error at least is gone.
    assert after < 0.87 * before
    # What every channel saw is left alone.
    np.testing.assert_array_equal(filled[visible], shifted[visible])


def test_a_channel_sees_past_an_edge_on_its_own_side_only():
    d = np.full((8, 40), 4.0, np.float32)  # a wall, 4 px beyond focus
    d[:, 15:25] = -2.0  # a card before it
    seen = visible_from(d, np.array([1.0, 0.0]))
    # The wall moves right by 4, the card left by 2: wall pixel x is under the card where x + 4 is in [13, 23).
    hidden = np.flatnonzero(~seen[4, :36])
    np.testing.assert_array_equal(hidden, np.arange(9, 15))
    assert visible_from(d, np.array([0.0, 0.0])).all()
    upwards = visible_from(np.ascontiguousarray(d.T), np.array([0.0, 1.0]))
    np.testing.assert_array_equal(upwards[:36], seen.T[:36])


def test_depth_of_another_photograph_is_refused():
    with pytest.raises(InputError, match="two photographs"):
        align_channels(np.zeros((9, 9, 3), np.float32), np.zeros((8, 9), np.float32), np.zeros((3, 2)))


def test_bytes_from_the_table_are_the_curve_rounded():
    light = np.concatenate([np.linspace(-0.1, 1.1, 40_001), [np.nan, np.inf, -np.inf]]).astype(np.float32)
    # Half a level by rounding, and half a step of the table, 1 / 131070, where the curve is steepest: 12.92 x 255.
    assert np.abs(linear_to_srgb_bytes(light) - 255.0 * linear_to_srgb(light))[:-2].max() < 0.5 + 0.03
    assert linear_to_srgb_bytes(light)[-3:].tolist() == [0, 255, 0]
