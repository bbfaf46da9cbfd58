"""What the demo says of its two pictures follows from what was measured."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from chromaperture.cli.demo import explain_walls


def frame(depth_mm: float, sigma_mm: float) -> SimpleNamespace:
    depth = np.full((480, 720), 1300.0)  # the boxes
    depth[:150, 500:] = depth_mm  # the wall at the top right
    depth[20, 600] = np.nan
    sigma = np.where(depth == depth_mm, sigma_mm, 20.0)
    return SimpleNamespace(depth_mm=depth, sigma_mm=sigma)


def test_a_wall_that_is_wrong_beyond_its_error_bar_is_said_to_be():
    first, second = explain_walls(frame(3340, 130), frame(2400, 235))
    assert "3340 ± 130 mm" in first
    assert "2400 ± 235 mm" in second
    assert "940 mm too near" in second
    assert "4 times shorter" in second


def test_a_wall_that_agrees_within_its_error_bar_is_not_blamed():
    for opened in (frame(3000, 235), frame(3340, 10), frame(2400, 900)):
        assert "in agreement" in explain_walls(frame(3340, 130), opened)[1]


def test_a_wall_that_is_not_measured_is_not_judged():
    second = explain_walls(frame(3340, 130), frame(np.nan, np.nan))[1]
    assert "cannot be compared" in second
    assert "nan" not in second
