"""Evidence and labels of blocks of 4 px, and how they come back to pixels."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import median_filter

from chromaperture.matching.accurate import known_blocks
from chromaperture.matching.blocks import at_pixels, block_means, block_middles, of_pixels
from chromaperture.matching.execution import execution_named
from chromaperture.matching.planes.block_surface import BlockSurface, read_along, speaks_against, surface_of_blocks
from chromaperture.matching.planes.regions import Regions
from chromaperture.settings.stages import PlanesConfig, PlateConfig

FAST = execution_named("numba")
SHAPES = st.tuples(st.integers(4, 30), st.integers(4, 30))
SEEDS = st.integers(0, 2**31)


# ---- from pixels to blocks


@settings(max_examples=20, deadline=None)
@given(SHAPES, SEEDS)
def test_blocks_have_the_means_of_their_pixels_and_lie_in_the_middle_of_them(shape: tuple[int, int], seed: int) -> None:
    volume = np.random.default_rng(seed).normal(0, 5, (*shape, 3)).astype(np.float32)
    volume[..., 1:] = np.moveaxis(np.indices(shape), 0, -1)  # rows and columns
    means = block_means(volume)
    assert means.shape == (shape[0] // 4, shape[1] // 4, 3)  # what is left over is left out
    for y, x in np.ndindex(means.shape[:2]):
        part = volume[4 * y : 4 * y + 4, 4 * x : 4 * x + 4, 0]
        assert means[y, x, 0] == pytest.approx(part.mean(dtype=float), abs=1e-5)  # float32 sums of 16 numbers of 5
    np.testing.assert_array_equal(means[..., 1:], np.stack(np.meshgrid(*map(block_middles, shape), indexing="ij"), -1))


@settings(max_examples=30, deadline=None)
@given(SEEDS, st.integers(2, 9))
def test_volumes_are_read_linearly_and_at_their_ends_beyond(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    nats, label = rng.normal(size=(3, 4, count)).astype(np.float32), rng.uniform(-2, count + 1, (3, 4))
    label[0, :2] = 0, count - 1
    found = read_along(nats, label)
    for y, x in np.ndindex(label.shape):
        assert found[y, x] == pytest.approx(np.interp(label[y, x], np.arange(count), nats[y, x]), abs=1e-5)


# ---- from blocks to pixels


@pytest.mark.parametrize("shape", [(60, 80), (63, 82)])
def test_a_plane_of_blocks_is_the_same_plane_of_pixels(shape: tuple[int, int]) -> None:
    a, b, c = 0.4, 0.3, 20.0
    y, x = np.mgrid[: shape[0] // 4, : shape[1] // 4]
    found = at_pixels(a * x + b * y + c, shape)
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    expected = a * (columns - 1.5) / 4 + b * (rows - 1.5) / 4 + c  # the middle of a block is a pixel and a half in
    inside = np.s_[6:-9, 6:-9]  # medians reach 4 px, and the outermost 2 px lie beyond the middles of blocks
    # OpenCV reads between pixels at 32nds of them: 0.012 of a label between two blocks.
    np.testing.assert_allclose(found[inside], expected[inside], atol=0.02)


@pytest.mark.parametrize("step", [3.0, 5.0, 9.0])
def test_a_step_has_no_labels_between(step: float) -> None:
    label = np.where(np.arange(20) < 10, 5.0, 5.0 + step)[None].repeat(15, axis=0)
    found = at_pixels(label, (60, 80))
    np.testing.assert_array_equal(found, np.where(np.arange(80) < 40, 5.0, 5.0 + step)[None].repeat(60, axis=0))


@pytest.mark.parametrize("length", [4, -4])
def test_teeth_of_one_block_get_shorter_and_longer_ones_stay(length: int) -> None:
    label = np.full((15, 20), 5.0)
    label[:, 10:] = 19.0
    label[7, 10 : 10 + length] = 5.0
    label[7, 10 + length : 10] = 19.0
    found, plain = at_pixels(label, (60, 80)), label.repeat(4, axis=0).repeat(4, axis=1)
    # By SciPy: medians alone tell what is left of a step's outline.
    expected = median_filter(median_filter(plain, 5, mode="nearest"), 5, mode="nearest")
    np.testing.assert_allclose(found, expected, atol=1.0)  # in corners something may lie between, up to a label
    assert 0 < (np.abs(found - plain) > 1).sum() <= 24  # its corners, of 64 px


@settings(max_examples=20, deadline=None)
@given(SHAPES, SEEDS)
def test_pixels_keep_the_range_of_their_blocks(shape: tuple[int, int], seed: int) -> None:
    label = np.random.default_rng(seed).uniform(0, 9, (shape[0] // 4, shape[1] // 4))
    found = at_pixels(label, shape)
    assert found.shape == shape
    assert found.dtype == np.float32
    assert label.min() - 1e-5 <= found.min() <= found.max() <= label.max() + 1e-5


def test_pixels_left_over_belong_to_the_last_block() -> None:
    found = of_pixels(np.arange(6).reshape(2, 3), (11, 14))
    expected = np.arange(6).reshape(2, 3)[np.minimum(np.arange(11) // 4, 1)][:, np.minimum(np.arange(14) // 4, 2)]
    np.testing.assert_array_equal(found, expected)


# ---- the surface


def evidence_about(label: np.ndarray, nats: float, count: int = 41, width: float = 4.0) -> np.ndarray:
    """Sums of the evidence of blocks: a parabola that ends at 0."""
    away = (np.arange(count) - label[..., None]) / width
    return (nats * np.maximum(0, 1 - away**2)).astype(np.float32)


def test_where_blocks_speak_against_a_plane_their_own_surface_stays() -> None:
    truth = np.full((15, 30), 10.0)
    truth[:, 15:] = 13.0
    nats, label = evidence_about(truth, 16.0), np.full((15, 30), 10.0)
    config = PlateConfig(own_evidence_nats=4.0)  # of nine nats that three of four labels cost
    found = speaks_against(nats, truth, label, config)
    assert not found[:, :14].any()  # a window ahead some of them count
    assert found[:, 17:].all()
    assert not speaks_against(nats, truth, truth, config).any()
    assert not speaks_against(0 * nats, truth, label, PlateConfig(own_evidence_nats=0.0)).any()


@pytest.mark.parametrize("seed", range(2))
def test_a_card_before_a_wall_and_a_ball_are_found(seed: int) -> None:
    """The wall is weak and its plane is found; the ball has no plane, but strong evidence."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:40, :60]
    ball = np.hypot(y - 20, x - 42)
    truth = 12.0 + 0.02 * x
    truth[10:30, 8:24] = 24.0
    truth = np.where(ball < 10, 20.0 + 1.5 * np.maximum(100 - ball**2, 0) ** 0.5, truth)
    strength = np.where(ball < 10, 40.0, 1.0)
    nats = evidence_about(truth, 1.0) * strength[..., None] + rng.normal(0, 0.2, (40, 60, 41))
    area = np.zeros((40, 60), int)
    area[10:30, 8:24], area[ball < 10] = 1, 2
    odds = np.full((2, 40, 60), -5.0, np.float32)
    odds[0, :-1][area[1:] != area[:-1]] = 4.0
    odds[1, :, :-1][area[:, 1:] != area[:, :-1]] = 4.0
    scatter = np.where(ball < 10, 0.3, 1.5)
    first = truth + scatter * rng.normal(size=truth.shape)
    found = surface_of_blocks(
        nats.astype(np.float32), first, scatter, odds, planes=PlanesConfig(), plate=PlateConfig(), run=FAST
    )
    error = np.abs(found.label - truth)
    # The first surface is off by a label on average, on the ball by .2 and its plane by 1.7. Found are .02, .07, .07.
    for part in (area == 0, area == 1, ball < 9):
        assert np.median(error[part]) < 0.15
    assert (error > 2).mean() < 0.01  # of the ball's outline a block here or there is on the wrong side


# ---- what is known


def test_regions_are_known_whose_evidence_falls_beside_their_surface() -> None:
    region = (np.arange(30) >= 12)[None].repeat(20, axis=0).astype(int)
    label = np.full((20, 30), 15.0)
    nats = np.full((20, 30, 41), 16.0, np.float32)  # much evidence, alike everywhere: it says nothing
    nats[:, 3:6] = evidence_about(label[:, 3:6], 8.0, width=3.0)  # a quarter of the first region, half a nat a pixel
    edges = np.full((2, 20, 30), -5.0, np.float32)
    surface = BlockSurface(label, nats, edges, label, Regions(region, label))
    # A quarter of .5 nats a pixel: what lies four labels away, on both sides, is beyond the parabola's end.
    np.testing.assert_array_equal(known_blocks(surface, 0.12), region == 0)
    assert not known_blocks(surface, 0.13).any()
    np.testing.assert_array_equal(known_blocks(surface, 0.0), region == 0)  # evidence of nothing at all is none
