"""What alignment by disparity leaves is found from the picture."""

import cv2
import numpy as np

from chromaperture.color.alignment import align_channels
from chromaperture.color.registration import residual_displacement
from planes import texture


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
    assert after < 0.5 * before
    assert np.abs(again[..., 0] - picture)[inner].mean() < 0.01


def test_a_picture_without_texture_is_left_alone(rng):
    flat = 0.5 + 0.001 * rng.normal(size=(60, 80, 3))
    np.testing.assert_array_equal(residual_displacement(flat, np.zeros((60, 80), np.float32)), 0)


def test_channels_that_have_nothing_in_common_are_left_alone(rng):
    image = np.dstack([texture(rng, 96, 96) for _ in range(3)])
    np.testing.assert_array_equal(residual_displacement(image, np.zeros((96, 96), np.float32)), 0)
