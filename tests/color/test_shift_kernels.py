"""Cubics along rows: a second interpolator is the oracle, and a cubic picture comes back as it was."""

from __future__ import annotations

import cv2
import numpy as np

from chromaperture.color.alignment import shift_back
from chromaperture.color.row_alignment import shift_along_rows

HEIGHT, WIDTH = 11, 60


def test_opencv_agrees_where_its_table_has_the_place():
    draw = np.random.default_rng(0)
    image = draw.random((HEIGHT, WIDTH, 3), np.float32)
    # OpenCV rounds places to 1/32 px; these it has exactly. Some reach far beyond both edges.
    dx = (np.round(draw.normal(0, 6, (HEIGHT, WIDTH)) * 32) / 32).astype(np.float32)
    dx[0, :3], dx[1, -3:] = -500, 500
    found = np.full_like(image, -1)
    for k in range(3):
        shift_along_rows(image, dx, k, found)
    x, y = np.meshgrid(np.arange(WIDTH, dtype=np.float32), np.arange(HEIGHT, dtype=np.float32))
    expected = cv2.remap(image, x + dx, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    np.testing.assert_allclose(found, expected, atol=2e-6)  # four products in single precision


def test_between_the_places_of_a_table_it_is_smooth():
    """A straight ramp is shifted by any amount to one cubic's own error, far below a 1/32 px step of the ramp."""
    ramp = np.repeat(np.arange(WIDTH, dtype=np.float32)[None, :, None], 3, axis=2)
    ramp = np.repeat(ramp, HEIGHT, axis=0)
    shifts = np.linspace(0, 1, 257, dtype=np.float32)
    read = []
    for shift in shifts:
        displacement = np.zeros((3, 2, HEIGHT, WIDTH), np.float32)
        displacement[:, 0] = shift
        read.append(shift_back(ramp, displacement)[5, 30, 0] - 30 if shift else 0.0)
    steps = np.diff(read)
    assert steps.max() < 2 / 256  # a table of 1/32 px would stand still and then jump by 8 / 256
    assert steps.min() > 0
