"""Depth edges in a photograph: ray-traced cards, whose distances are known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from chromaperture.matching.blocks import BLOCK_PX
from chromaperture.matching.planes.depth_edges import contrast, edge_log_odds
from chromaperture.optics.aperture import DESIGNS
from chromaperture.optics.pinhole import focused_at
from chromaperture.optics.prescription import load_lens
from chromaperture.optics.ray_table import lens_rays
from chromaperture.optics.simulator.render import render, render_depth
from chromaperture.optics.simulator.scene import plane
from chromaperture.optics.simulator.sensor import SensorModel, develop, expose
from chromaperture.optics.simulator.textures import noise


def pattern(seed: int, color: tuple[float, float, float]) -> np.ndarray:
    grey = noise((300, 300), seed=seed, exponent=1.0, mean=0.5, contrast=0.15)
    return np.clip(grey[..., None] * np.array(color), 0.01, 1)


def captured(design: str, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A card at 1.3 m before a wall at 3 m, and its distances."""
    table = lens_rays(
        focused_at(load_lens("double_gauss_50"), 2000), DESIGNS[design], cells=12, width_px=240, height_px=160,
        pixel_pitch_mm=0.06,
    )  # fmt: skip
    planes = [
        plane(pattern(seed, (0.8, 0.9, 1.0)), center_mm=(0, 0, 3000), width_mm=1200),
        plane(pattern(seed + 1, (1.0, 0.7, 0.5)), center_mm=(20, 10, 1300), width_mm=150, tilt_deg=(0, 0, 8)),
    ]
    light = render(table, planes, seed=seed)
    image = develop(expose(light, SensorModel(), seed=seed, exposure=0.8 / light.max()), SensorModel())
    return np.minimum(image, 1), render_depth(table, planes)


@pytest.mark.parametrize("design", ["cy_halves", "rgb_squares", "cmy_circles", "cy_open"])
def test_the_outline_of_a_card_is_found(design: str) -> None:
    image, depth_mm = captured(design, seed=3)
    odds = edge_log_odds(image)
    near = depth_mm[BLOCK_PX // 2 :: BLOCK_PX, BLOCK_PX // 2 :: BLOCK_PX] < 2000
    for axis in (0, 1):
        a, b = (near[:-1], near[1:]) if axis == 0 else (near[:, :-1], near[:, 1:])
        true, found = a != b, (odds[0, :-1] if axis == 0 else odds[1, :, :-1])
        # Of a random pair of an edge and none the edge has the larger log odds: the area under the ROC curve.
        above = (found[true][:, None] > found[~true][None]).mean()
        assert above > 0.97, (axis, above)  # .984 to .992 when it was trained


def test_light_and_exposure_do_not_matter() -> None:
    image, _ = captured("cy_halves", seed=5)
    plain = edge_log_odds(image)
    # Roots of light scale with its root and are divided by their range again: rounding of float32 is left.
    np.testing.assert_allclose(edge_log_odds(0.25 * image), plain, atol=1e-3)


@settings(max_examples=10, deadline=None)
@given(height=st.integers(4, 70), width=st.integers(4, 70), seed=st.integers(0, 9))
def test_any_size_has_an_answer_for_every_whole_block(height: int, width: int, seed: int) -> None:
    image = np.random.default_rng(seed).random((height, width, 3)).astype(np.float32)
    odds = edge_log_odds(image)
    assert odds.shape == (2, height // BLOCK_PX, width // BLOCK_PX)
    assert np.isfinite(odds).all()
    assert np.array_equal(odds, edge_log_odds(image))


@pytest.mark.parametrize("light", [0.0, 0.5, 1.0])
def test_an_even_photograph_has_no_edges(light: float) -> None:
    assert (edge_log_odds(np.full((96, 128, 3), light)) < 0).all()
    assert np.abs(contrast(np.full((8, 8, 3), light))).max() < 1e-9  # rounding of the mean over the least range
