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


def test_all_evidence_of_a_plane_tells_the_spread_of_its_shift():
    """A parabola of bend b over n pixels, a hundred of which say one thing, is a Gaussian of variance 50 / (n b)."""
    choice = (np.arange(WIDTH) >= 8 * SIZE).astype(int) * np.ones((HEIGHT, 1), int)
    found = signs_of_evidence(evidence(BEST, bend=4e-4), np.full((HEIGHT, WIDTH), BEST), choice)
    for x, columns in ((0, 8), (WIDTH - 1, SHAPE[1] - 8)):
        expected = (50 / (columns * SHAPE[0] * SIZE**2 * 4e-4)) ** 0.5
        np.testing.assert_allclose(np.exp(found["spread_of_plane"][:, x]) - 0.05, expected, rtol=0.1)  # coarse shifts
        np.testing.assert_allclose(np.exp(found["evidence"][:, x]) - 1e-3, 2, rtol=1e-5)  # single precision
    # Where evidence is sure it is the distance to the best answer, here for both planes.
    off = signs_of_evidence(evidence(BEST + 6, bend=0.2), np.full((HEIGHT, WIDTH), BEST), choice)
    np.testing.assert_allclose(np.exp(off["spread_of_plane"]) - 0.05, 6, atol=0.02)


def test_a_plane_without_the_middle_of_any_block_has_no_evidence():
    choice = np.zeros((HEIGHT, WIDTH), int)
    choice[0, 0] = 1
    found = signs_of_evidence(evidence(BEST), np.full((HEIGHT, WIDTH), BEST), choice)
    assert np.exp(found["evidence"][0, 0]) == pytest.approx(1e-3, rel=1e-4)
    even = np.sqrt(np.average(SHIFTS**2, weights=np.gradient(SHIFTS)))  # every shift is as likely
    assert np.exp(found["spread_of_plane"][0, 0]) == pytest.approx(even + 0.05, rel=1e-4)


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
