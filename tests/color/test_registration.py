"""What alignment by disparity leaves is found from the picture."""

import cv2
import numpy as np

from chromaperture.color.alignment import align_channels
from chromaperture.color.registration import residual_displacement, standard_error
from worlds import texture


def spoiled(rng):
    """A grey picture whose red is magnified a little and whose blue moves with the disparity."""
    height, width = 160, 200
    picture = texture(rng, height, width, blur_px=1.8).astype(np.float32)
    y, x = np.mgrid[:height, :width].astype(np.float32)
    nx, ny = 2 * x / (width - 1) - 1, 2 * y / (height - 1) - 1
    disparity = (2 * np.sign(np.sin(x / 25))).astype(np.float32)
    truth = np.zeros((3, 2, height, width), np.float32)
    truth[0] = np.stack([0.6 * nx + 0.2, 0.6 * ny])
    truth[2] = np.stack([0.15 * disparity, np.full_like(x, -0.3)])
    planes = [cv2.remap(picture, x - t[0], y - t[1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
              for t in truth]  # fmt: skip
    image = np.dstack(planes) + 0.004 * rng.normal(size=(height, width, 3))
    return image.astype(np.float32), disparity, truth, picture


def test_lateral_colour_and_moved_centroids_are_found(rng):
    image, disparity, truth, picture = spoiled(rng)
    found = residual_displacement(image, disparity)
    inner = np.s_[..., 20:-20, 20:-20]
    # Windows straddle the steps of the disparity, and noise of 0.004 against a contrast of 0.09 is left.
    assert np.abs(found - truth)[inner].mean() < 0.05
    np.testing.assert_array_equal(found[1], 0)
    again = align_channels(image, disparity, np.zeros((3, 2)), displacement_px=found)
    inner = np.s_[20:-20, 20:-20]
    before, after = (np.std((p[..., 0] - p[..., 1])[inner]) for p in (image, again))
    assert after < 0.5 * before  # 0.34 is found
    # 0.003 is found, noise of 0.004 averaged; the contrast is 0.09.
    assert np.abs(again[..., 0] - picture)[inner].mean() < 0.01


def test_a_picture_without_texture_is_left_alone(rng):
    flat = 0.5 + 0.001 * rng.normal(size=(60, 80, 3))
    np.testing.assert_array_equal(residual_displacement(flat, np.zeros((60, 80), np.float32)), 0)


def test_channels_that_have_nothing_in_common_are_left_alone(rng):
    image = np.dstack([texture(rng, 96, 96) for _ in range(3)])
    np.testing.assert_array_equal(residual_displacement(image, np.zeros((96, 96), np.float32)), 0)


def test_without_surfaces_only_what_is_smooth_is_found(rng):
    image, disparity, truth, _ = spoiled(rng)
    found = residual_displacement(image, disparity, surfaces=False)
    # What spoilt the picture is linear in the place and in the disparity.
    assert np.abs(found - truth)[..., 20:-20, 20:-20].mean() < 0.05
    x, y = np.meshgrid(np.linspace(-1, 1, 200), np.linspace(-1, 1, 160))
    basis = np.stack(np.broadcast_arrays(1.0, x, y, disparity))
    rows = basis.reshape(4, -1).T
    for plane in found[[0, 2]].reshape(4, -1):
        left = plane - rows @ np.linalg.lstsq(rows, plane, rcond=None)[0]
        assert np.abs(left).max() < 1e-4  # float32


def test_a_window_knows_its_own_error(rng):
    picture = texture(rng, 400, 400, blur_px=1.5).astype(np.float32)
    off, told = [], []
    for y in range(0, 361, 40):
        for x in range(0, 361, 40):
            fixed = picture[y : y + 39, x : x + 39]
            # What one channel has and the other has not: it hangs together over some px, as colours do.
            other = 0.04 * cv2.GaussianBlur(rng.normal(size=fixed.shape), (0, 0), 1.5)
            gy, gx = np.gradient(fixed)
            shift = rng.uniform(-0.2, 0.2, 2)
            moved = (0.3 + 0.8 * (fixed - shift[0] * gx - shift[1] * gy) + other).astype(np.float32)
            score = np.stack([gx.ravel(), gy.ravel(), fixed.ravel(), np.ones(fixed.size)], axis=1)
            a, b, gain, _ = np.linalg.lstsq(score, moved.ravel(), rcond=None)[0]
            off.append(np.square([a / gain + shift[0], b / gain + shift[1]]).sum())
            told.append(standard_error(moved, fixed) ** 2)
    # 100 windows with some ten degrees of freedom each: a mean of squares is known to a tenth or two.
    assert 0.6 < np.sqrt(np.mean(told) / np.mean(off)) < 1.6
    assert np.mean(off) > 1e-5
