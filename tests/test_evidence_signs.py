"""Signs of an error by the evidence: against plain sums, and on evidence whose best answer is known."""

from __future__ import annotations

import numpy as np
import pytest

from chromaperture.disparity.evidence_signs import SHIFTS, along_answer, known_planes, signs_of_evidence
from chromaperture.disparity.execution import execution_named
from chromaperture.disparity.plane_fit import Volume
from chromaperture.disparity.stages.planes import PlaneCosts

SIZE = 4
SHAPE = 24, 36  # blocks
LABELS = 60
BEST = 30.0
HEIGHT, WIDTH = SHAPE[0] * SIZE + 1, SHAPE[1] * SIZE + 3  # some pixels belong to no whole block


def evidence(best, *, bend=0.02):
    """Parabolas of evidence about the best label of every block, nats, of all the pixels of a block."""
    best = np.broadcast_to(best, SHAPE)[..., None]
    likelihood = SIZE**2 * np.maximum(2 - bend * (np.arange(LABELS) - best) ** 2, 0).astype(np.float32)
    return Volume(likelihood, np.linspace(-1, 4.9, LABELS), PlaneCosts(0.1, 1.0), execution_named("numpy"))


def signs(best, label, choice=None, **options):
    everywhere = np.full((HEIGHT, WIDTH), float(label))
    choice = np.zeros((HEIGHT, WIDTH), int) if choice is None else choice
    return signs_of_evidence(evidence(best, **options), everywhere, choice)


def test_reading_along_an_answer_is_interpolation(rng):
    volume, label = rng.normal(size=(5, 6, LABELS)).astype(np.float32), rng.uniform(-3, LABELS + 3, (5, 6))
    found = along_answer(volume, label)
    for y, x in np.ndindex(5, 6):
        expected = np.interp(label[y, x] + SHIFTS, np.arange(LABELS), volume[y, x])  # keeps the ends' values beyond
        np.testing.assert_allclose(found[y, x], expected, atol=1e-5)  # single precision of values near 1


def test_spread_is_the_distance_to_the_best_answer_where_that_is_sure():
    """Evidence of hundreds of nats: the standard deviation about the answer is how far the answer is off."""
    for off in (0, 3, 8):
        found = signs(BEST + off, BEST, bend=0.2)
        np.testing.assert_allclose(np.exp(found["spread"]) - 0.05, off, atol=0.02)


def test_wide_evidence_spreads_as_its_gaussian_does():
    # exp(-n 0.02 s^2 / alike) with n = 2 pi 12^2 pixels, ten alike: a standard deviation of (2 * 90.5 * 0.02)^-1/2.
    found = signs(BEST, BEST, bend=0.0005)
    expected = (2 * 2 * np.pi * 144 / 10 * 0.0005) ** -0.5
    np.testing.assert_allclose(np.exp(found["spread"]) - 0.05, expected, rtol=0.1)  # shifts are coarse


def test_evidence_is_the_mean_of_a_plane_at_the_answer():
    """Of the second plane every other block has no evidence; the third has the middle of no block."""
    choice = (np.arange(WIDTH) >= 8 * SIZE).astype(int) * np.ones((HEIGHT, 1), int)
    choice[0, 0] = 2
    volume = evidence(BEST)
    volume.likelihood[::2, 8:] = 0
    found = np.exp(signs_of_evidence(volume, np.full((HEIGHT, WIDTH), BEST), choice)["evidence"])
    for (y, x), nats in (((1, 1), 2), ((1, WIDTH - 1), 1), ((0, 0), 0)):
        assert found[y, x] == pytest.approx(nats + 1e-3, rel=1e-4)  # single precision


def test_planes_are_known_from_a_fall_of_their_evidence_on():
    """A parabola of bend b falls by 16 b nats a pixel over four labels; half of the blocks have half of it."""
    choice = (np.arange(WIDTH) >= WIDTH // 2).astype(int) * np.ones((HEIGHT, 1), int)
    answer = np.full((HEIGHT, WIDTH), BEST)
    for factor, expected in ((0.9, [False, False]), (1.2, [True, False]), (2.6, [True, True])):
        volume = evidence(BEST, bend=factor * 3e-4 / 16)
        volume.likelihood[::2, WIDTH // 2 // SIZE :] = 2.0 * SIZE**2
        np.testing.assert_array_equal(known_planes(volume, answer, choice, from_nats=3e-4), expected)
    choice[0, 0] = 2  # a plane without the middle of any block
    np.testing.assert_array_equal(known_planes(volume, answer, choice, from_nats=3e-4), [True, True, False])
    assert not known_planes(volume, answer + LABELS, choice, from_nats=3e-4).any()  # beyond all labels


def test_pixels_without_a_whole_block_take_those_of_the_next(rng):
    found = signs_of_evidence(
        evidence(BEST + rng.normal(0, 5, SHAPE)), np.full((HEIGHT, WIDTH), BEST), np.zeros((HEIGHT, WIDTH), int)
    )
    for values in found.values():
        assert values.shape == (HEIGHT, WIDTH)
        assert values.dtype == np.float32
        np.testing.assert_array_equal(values[-1], values[-2])
        np.testing.assert_array_equal(values[:, -1], values[:, -4])


def test_an_answer_beyond_the_labels_has_finite_signs():
    for label in (-20, LABELS + 30):
        assert all(np.isfinite(values).all() for values in signs(BEST, label).values())
