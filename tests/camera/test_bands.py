"""Depth and colours computed in bands of rows are those of the whole frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from chromaperture.camera.alignment import ChannelAlignment
from chromaperture.camera.method import default_config
from chromaperture.depth.conversion import disparity_to_depth
from chromaperture.depth.field import field_to_depth
from test_camera_scale import camera, field


def test_depth_in_bands_is_depth_of_the_whole(monkeypatch):
    monkeypatch.setattr("chromaperture.depth.field._BAND_PX", 96 * 5)
    rng = np.random.default_rng(4)
    d = rng.uniform(-5, 5, (64, 96)).astype(np.float32)
    d[3, 4] = np.nan
    found = field_to_depth(d, 0.1 + 0 * d, field(), max_depth_mm=20000.0)
    whole = disparity_to_depth(d, field().model(96, 64), 0.1 + 0 * d, max_depth_mm=20000.0)
    for a, b in zip(found, whole, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-6)


@pytest.mark.parametrize("quality", ["real-time", "accurate"])
@pytest.mark.parametrize("design", ["cy_halves", "rgb_squares"])
def test_colour_in_bands_is_colour_of_the_whole(monkeypatch, quality, design):
    rng = np.random.default_rng(6)
    made = camera()
    if design == "rgb_squares":
        film = dict(zip(("red", "green", "blue"), np.eye(3) * 0.9 + 0.05, strict=True))
        made = replace(made, design=design, film=replace(made.film, filters=film))
    alignment = ChannelAlignment(made, default_config(made, quality))
    image = rng.uniform(0, 0.8, (64, 96, 3)).astype(np.float32)
    d = np.where(rng.uniform(size=(64, 96)) < 0.02, np.nan, np.where(np.arange(96) < 40, -3.0, 2.0)).astype(np.float32)
    whole = alignment.align(image, d)
    monkeypatch.setattr("chromaperture.camera.alignment._BAND_PX", 96 * 7)
    monkeypatch.setattr("chromaperture.color.row_alignment._BAND_ROWS", 7)
    # Positions in a band are smaller numbers: float32 rounds them to 1e-6 px less of the frame's.
    np.testing.assert_allclose(alignment.align(image, d), whole, atol=1e-5)
