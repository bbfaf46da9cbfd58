"""The refocused picture is the one another lens would have taken."""

import cv2
import numpy as np
import pytest

from chromaperture.effects.edge_aware import filter_disparity
from chromaperture.effects.refocusing import (
    Focus,
    apply_background,
    background_weight,
    bokeh_kernel,
    bokeh_mask,
    desaturate_background,
    refocus,
    sweep,
    write_sweep,
)
from chromaperture.optics.aperture import DESIGNS
from chromaperture.optics.psf import geometric_psf
from chromaperture.optics.ray_table import pinhole_rays
from chromaperture.optics.simulator.render import render, render_depth, render_sharp
from chromaperture.system.errors import InputError
from worlds import card_before_wall, pinhole_camera

SIZE = (160, 112)
PLANES = card_before_wall([(0.9, 0.8, 0.5), (0.3, 0.5, 0.9)], texels=(80, 120), exponent=1.0,
                          distances_mm=(1500, 800), widths_mm=(900, 120))  # fmt: skip
CAMERA = pinhole_camera(*SIZE)


@pytest.fixture(scope="module")
def world():
    """Everything in focus, and the blur radius of a capture focused at 1 m."""
    table = pinhole_rays(CAMERA, DESIGNS["open"], cells=8)
    radius = CAMERA.blur_radius_px(render_depth(table, PLANES))
    return render_sharp(table, PLANES), radius.astype(np.float32)


@pytest.mark.parametrize(("focus_mm", "strength"), [(800.0, 1.6), (1000.0, 1.0), (1500.0, 1.6)])
def test_it_is_what_a_lens_focused_there_sees(world, focus_mm, strength):
    color, radius = world
    lens = pinhole_camera(*SIZE, focus_mm=focus_mm, radius_mm=25.0 * strength)
    truth = render(pinhole_rays(lens, DESIGNS["open"], cells=24), PLANES)
    mine = refocus(color, radius, Focus(float(CAMERA.blur_radius_px(focus_mm)), strength))
    inner = np.s_[16:-16, 16:-16]
    error, before = (np.sqrt(np.mean((p[inner] - truth[inner]) ** 2)) for p in (mine, color))
    # What the near card hides is guessed; rays through the pupil and over the pixel are samples. Contrast is 0.15.
    assert error < 0.02
    assert error < 0.45 * before


@pytest.mark.parametrize("tile_px", [48, 100])
@pytest.mark.parametrize("focus_mm", [800.0, 1500.0])
def test_tiles_leave_no_seams(focus_mm, tile_px):
    rng = np.random.default_rng(4)
    color = cv2.GaussianBlur(rng.random((230, 310, 3)).astype(np.float32), (0, 0), 1.5)
    y, x = np.mgrid[:230, :310]
    radius = np.where(np.hypot(x - 190, y - 90) < 40, -3.0, 3 + x / 150).astype(np.float32)
    focus = Focus(float(CAMERA.blur_radius_px(focus_mm)), 1.3)
    whole, tiled = refocus(color, radius, focus, tile_px=512), refocus(color, radius, focus, tile_px=tile_px)
    np.testing.assert_allclose(tiled, whole, atol=1e-6)  # the last bit


def test_no_halo(world):
    _, radius = world
    blue, red = np.float32([0.2, 0.2, 0.9]), np.float32([0.9, 0.2, 0.2])
    flat = np.where(radius[..., None] < 0, blue, red)
    near, far = radius.min(), radius.max()
    near_card = np.asarray(radius == near)
    on_card = refocus(flat, radius, Focus(float(near), 2.0))
    # A sharp card before a blurred wall: no light of the one in the other, up to the edge; 0.01 of 0.7 is rounding
    # of the layers' weights.
    assert np.abs(on_card[near_card] - blue).max() < 0.01
    assert np.abs(on_card[~near_card] - red).max() < 0.01
    on_wall = refocus(flat, radius, Focus(float(far), 1.0))
    # A blurred card before a sharp wall: mixtures only, all on the line between the two colours.
    share = (on_wall[..., 2] - 0.2) / 0.7
    # Float32 of light over coverage, as above.
    np.testing.assert_allclose(on_wall[..., 0], 0.9 - 0.7 * share, atol=0.01)
    assert ((share > 0.1) & (share < 0.9)).sum() > 200  # 2000 are found: else nothing was blurred


def test_a_light_becomes_the_pupil_s_picture_far_and_near():
    color = np.full((81, 81, 3), 0.01, np.float32)
    color[40, 40] = 50.0
    for sign in (1, -1):
        out = refocus(color, np.full((81, 81), sign * 10.0, np.float32), Focus(0.0, 1.0, "disc"))
        y, x = np.nonzero(out[..., 1] > 0.05)
        # A pixel more on each side is partly lit; linear light is kept, but for resampling.
        assert (np.ptp(x), np.ptp(y)) == (pytest.approx(20, abs=2), pytest.approx(20, abs=2))
        np.testing.assert_allclose(out.sum(axis=(0, 1)), color.sum(axis=(0, 1)), rtol=0.02)


def test_a_picture_as_pupil_turns_over_before_the_focus(tmp_path):
    mask = np.zeros((64, 64), np.uint8)
    mask[24:40, 36:60] = 255  # on the right
    path = tmp_path / "pupil.png"
    assert cv2.imwrite(str(path), mask)
    color = np.zeros((61, 61, 3), np.float32)
    color[30, 30] = 10.0
    x = np.arange(61) - 30
    for sign in (1, -1):
        out = refocus(color, np.full((61, 61), sign * 8.0, np.float32), Focus(0.0, 1.0, str(path)))[..., 0]
        centroid = (out * x).sum() / out.sum()
        # The block's middle lies at (48 - 32) / 32 = half the pupil's radius.
        # Spots of this size are drawn at half the resolution, which moves a single pixel by up to half a pixel.
        assert centroid == pytest.approx(sign * 4.0, abs=0.6)


@pytest.mark.parametrize("radius", [0.4, 1.7, -3.2, 9.5])
def test_the_disc_is_that_of_an_open_pupil(radius):
    kernel = bokeh_kernel(bokeh_mask("disc"), radius)
    exact = geometric_psf(DESIGNS["open"], radius, kernel.shape[0])[1]
    # A pixel holds 1 / (pi r^2) of the light; both shapes are sampled, 256 cells wide here.
    np.testing.assert_allclose(kernel, exact, atol=2e-3 / max(abs(radius), 1) ** 2 + 2e-4)
    assert kernel.sum() == pytest.approx(1, abs=1e-5)  # float32


def test_the_hexagon_has_its_area():
    # Corners on the pupil's rim: 3 sqrt(3) / 2 of radius squared; edges are sampled by cells of 1/128 radius
    assert bokeh_mask("hex").mean() * 4 == pytest.approx(3 * np.sqrt(3) / 2, rel=2e-3)


def test_bad_pupils_and_maps_are_refused(tmp_path, world):
    color, radius = world
    black = tmp_path / "black.png"
    cv2.imwrite(str(black), np.zeros((8, 8), np.uint8))
    with pytest.raises(InputError, match="black"):
        bokeh_mask(str(black))
    with pytest.raises(InputError, match="unknown bokeh"):
        bokeh_mask("star")
    with pytest.raises(InputError, match="two photographs"):
        refocus(color, radius[1:], Focus(0.0))
    with pytest.raises(InputError, match="holes"):
        refocus(color, np.full_like(radius, np.nan), Focus(0.0))
    with pytest.raises(InputError, match="larger f-number"):
        refocus(color, radius, Focus(0.0, 100.0))
    with pytest.raises(InputError, match="size"):
        refocus(color, radius, Focus(0.0, -1.0))


def test_without_a_pupil_all_stays_sharp(world):
    color, radius = world
    np.testing.assert_array_equal(refocus(color, radius, Focus(2.0, 0.0)), color)


def test_the_background_turns_grey_at_its_own_luminance(world):
    color, radius = world
    out = desaturate_background(color, radius, float(radius.min()))
    share = background_weight(radius, float(radius.min()))
    far = share == 1
    assert far.any()
    assert np.ptp(out[far], axis=1).max() < 1e-5  # float32
    weights = np.array([0.2126, 0.7152, 0.0722])  # of linear sRGB, IEC 61966-2-1
    np.testing.assert_allclose(out[far] @ weights, color[far] @ weights, rtol=1e-4)  # weights of four digits
    np.testing.assert_array_equal(out[radius == radius.min()], color[radius == radius.min()])


def test_blurring_the_background_leaves_what_is_nearer_sharp(world):
    color, radius = world
    out = apply_background(color, radius, Focus(0.0, 1.0), "blur")
    near = cv2.erode((radius < -0.5).astype(np.uint8), np.ones((9, 9))) > 0
    np.testing.assert_allclose(out[near], color[near], atol=1e-4)  # light over coverage, float32
    assert np.abs(out - color)[radius > 1].mean() > 0.01
    with pytest.raises(InputError, match="unknown background"):
        apply_background(color, radius, Focus(0.0), "sepia")


@pytest.mark.parametrize("suffix", [".gif", ".mp4"])
def test_a_sweep_is_a_film_from_near_to_far(tmp_path, world, suffix):
    color, radius = world
    frames = list(sweep(color, radius, Focus(0.0, 1.0), frames=4))

    def detail(frame, where):
        return np.abs(cv2.Laplacian(frame[..., 1].astype(np.float32), -1))[where].mean()

    near = cv2.erode((radius < 0).astype(np.uint8), np.ones((9, 9))) > 0
    assert detail(frames[0], near) > 1.5 * detail(frames[-1], near)  # 24 times is found
    assert detail(frames[-1], ~near) > 1.5 * detail(frames[0], ~near)  # 2.5 times is found
    path = tmp_path / f"film{suffix}"
    write_sweep(path, iter(frames))
    film = cv2.VideoCapture(str(path))
    if suffix == ".mp4":
        assert int(film.get(cv2.CAP_PROP_FRAME_COUNT)) == 6  # there and back without repeating the ends
    else:
        from PIL import Image

        with Image.open(path) as picture:
            assert picture.n_frames == 6
    with pytest.raises(InputError, match=r"\.gif or \.mp4"):
        write_sweep(tmp_path / "film.avi", iter(frames))


def test_filtered_disparity_is_filled_and_follows_the_picture_s_edges(rng):
    truth = np.where(np.arange(90)[None, :] < 40, -2.0, 3.0) * np.ones((60, 1))
    guide = np.where(truth[..., None] < 0, [0.8, 0.3, 0.2], [0.2, 0.4, 0.7]).astype(np.float32)
    sigma = np.full(truth.shape, 0.3, np.float32)
    spoiled = (truth + sigma * rng.normal(size=truth.shape)).astype(np.float32)
    spoiled[10:20, 20:30] = np.nan
    spoiled[30:33, 60:63] = -6.0  # a speck
    found, scatter = filter_disparity(spoiled, sigma, guide)
    assert np.isfinite(found).all()
    error = np.abs(found - truth)
    # 0.3 px averaged over a few dozen px; the speck weighs a twentieth
    assert np.median(error) < 0.06
    assert np.percentile(error, 99) < 0.5
    assert np.median(scatter) == pytest.approx(0.3, abs=0.1)  # of a few dozen samples: 0.03, and the edge in reach


def test_unknown_everywhere_is_refused():
    with pytest.raises(InputError, match="unknown everywhere"):
        filter_disparity(np.full((9, 9), np.nan), None, np.zeros((9, 9, 3)))
    with pytest.raises(InputError, match="two photographs"):
        filter_disparity(np.zeros((9, 9)), None, np.zeros((9, 8, 3)))
