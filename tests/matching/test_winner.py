"""The best layer of every pixel and its parabola."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from chromaperture.matching.labels import parabola_winner


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
