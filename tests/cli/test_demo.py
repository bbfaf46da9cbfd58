"""What the demo says of its two pictures follows from what was measured."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from chromaperture.cli.demo import explain_walls


def frame(depth_mm: float, sigma_mm: float) -> SimpleNamespace:
    depth = np.full((480, 720), 1300.0)  # the boxes
    depth[:150, 500:] = depth_mm  # the wall at the top right
    depth[20, 600] = np.nan
    sigma = np.where(depth == depth_mm, sigma_mm, 20.0)
    return SimpleNamespace(depth_mm=depth, sigma_mm=sigma)


@pytest.mark.parametrize(
    ("depth_mm", "sigma_mm", "said"),
    [
        (2400, 235, ["2400 ± 235 mm", "940 mm too near", "4 times shorter"]),  # wrong beyond its error bar
        (3000, 235, ["in agreement"]),
        (3340, 10, ["in agreement"]),
        (2400, 900, ["in agreement"]),
        (np.nan, np.nan, ["cannot be compared"]),
    ],
)
def test_a_wall_is_judged_by_its_error_bar(depth_mm, sigma_mm, said):
    first, second = explain_walls(frame(3340, 130), frame(depth_mm, sigma_mm))
    assert "3340 ± 130 mm" in first
    for words in said:
        assert words in second
    assert "nan" not in second
