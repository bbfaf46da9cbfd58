"""Planes that explain a surface: known planes, spoilt, and asked for back."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from chromaperture.disparity.accurate import judged
from chromaperture.disparity.execution import execution_named
from chromaperture.disparity.planar import block_links, block_sums, planes_of_surface, trust_of_moved
from chromaperture.disparity.plane_agreement import where_they_agree
from chromaperture.disparity.plane_edges import choices_of, placed_edges
from chromaperture.disparity.plane_fit import Candidate, Planes, Volume, best_planes, candidates, distinct
from chromaperture.disparity.plane_merging import merged_planes
from chromaperture.disparity.stages.plane_refining import PointSets, plane_sums
from chromaperture.disparity.stages.planes import PlaneCosts
from chromaperture.disparity.winner import Surface
from chromaperture.errors import InputError
from chromaperture.planes_config import PlanesConfig
from chromaperture.stage_config import SurfaceConfig

SLOW, FAST = execution_named("numpy"), execution_named("numba")
LABELS_PX = np.arange(-3.0, 3.01, 0.1)
COSTS = PlaneCosts(slope=0.3, outside=0.05)
NO_COSTS = PlaneCosts(slope=0.0, outside=0.0)
# float32 volumes and messages of some nats: 1e-7 of them, a few thousand times added.
ROUNDING = 2e-4


def plane_label(plane: np.ndarray, height: int, width: int) -> np.ndarray:
    return plane[0] * np.arange(width) + plane[1] * np.arange(height)[:, None] + plane[2]


def volume_about(label_px: np.ndarray, *, nats: float = 0.5, width_px: float = 0.6) -> np.ndarray:
    """Evidence that falls off as a parabola from the true label and ends at 0."""
    away = (LABELS_PX - label_px[..., None]) / width_px
    return (nats * np.maximum(0, 1 - away**2)).astype(np.float32)


def of(likelihood: np.ndarray, costs: PlaneCosts = NO_COSTS) -> Volume:
    return Volume(likelihood, LABELS_PX, costs, FAST)


def refined(plane: np.ndarray, x: np.ndarray, y: np.ndarray, volume: Volume, *, even: bool = False) -> np.ndarray:
    return best_planes(plane[None, None], [(y, x)], volume, even=even)[0][0]


def log_likelihood(plane: np.ndarray, x: np.ndarray, y: np.ndarray, volume: Volume) -> float:
    return float(best_planes(plane[None, None], [(y, x)], volume, steps=0)[1][0])


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**31), height=st.integers(1, 9), width=st.integers(1, 9), count=st.integers(1, 4))
def test_compiled_planes_agree_with_numpy(seed: int, height: int, width: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    likelihood = rng.random((height, width, len(LABELS_PX)), np.float32)
    planes = rng.normal(0, (0.3, 0.3, 2), (count, 3))
    slow, fast = (run.plane_costs(likelihood, planes, LABELS_PX, COSTS) for run in (SLOW, FAST))
    np.testing.assert_allclose(fast, slow, atol=ROUNDING)

    y, x = (a.ravel() for a in np.mgrid[:height, :width])
    points = PointSets.of([(y, x), (y[:2], x[:2])])
    starts = np.stack([planes, planes[::-1]])
    (slow_planes, slow_values), (fast_planes, fast_values) = (
        run.best_planes(likelihood, points, starts, LABELS_PX, COSTS, steps=0) for run in (SLOW, FAST)
    )
    np.testing.assert_allclose(fast_planes, slow_planes, atol=1e-9)
    np.testing.assert_allclose(fast_values, slow_values, atol=ROUNDING)

    links = rng.random((2, height, width), np.float32)
    slow, fast = (run.potts_beliefs(slow_costs, links, sweeps=3) for run, slow_costs in ((SLOW, slow), (FAST, slow)))
    np.testing.assert_allclose(fast, slow, atol=ROUNDING)


@pytest.mark.parametrize("even", [False, True])
def test_compiled_refining_agrees_with_numpy(even: bool) -> None:
    rng = np.random.default_rng(4)
    label = plane_label(np.array([0.01, -0.02, 0.3]), 80, 90)
    likelihood = volume_about(label + rng.normal(0, 0.05, label.shape))
    y, x = (a.ravel() for a in np.mgrid[:80, :90])  # more points than a fit takes
    points = PointSets.of([(y, x), (y[:4000], x[:4000]), (y[::90], x[::90])])  # the last on a line: no slope across
    starts = np.array([0.01, -0.02, 0.3]) + rng.normal(0, (2e-3, 2e-3, 0.1), (3, 2, 3))
    slow, fast = (
        run.best_planes(likelihood, points, starts, LABELS_PX, COSTS, steps=6, even=even) for run in (SLOW, FAST)
    )
    for one, other in zip(slow, fast, strict=True):  # doubles, of sums in another order
        np.testing.assert_allclose(other, one, rtol=1e-7, atol=1e-9)


def test_derivatives_of_a_plane_are_its_differences() -> None:
    rng = np.random.default_rng(6)
    label = plane_label(np.array([0.01, -0.02, 0.3]), 20, 30)
    likelihood = volume_about(label, nats=0.5, width_px=2.0).astype(float)
    y, x = (a.ravel() for a in np.mgrid[:20, :30])
    plane = np.array([0.01, -0.02, 0.35])
    sums = plane_sums(likelihood, x, y, plane, LABELS_PX)
    direction, step = rng.normal(0, (0.01, 0.01, 0.2), 3), 0.1
    values = [plane_sums(likelihood, x, y, plane + k * step * direction, LABELS_PX).value for k in (-1, 0, 1)]
    # Evidence is a parabola, read linearly between labels that are 0.1 px apart.
    assert direction @ sums.gradient == pytest.approx((values[2] - values[0]) / (2 * step), rel=0.02)
    bend = (values[2] - 2 * values[1] + values[0]) / step**2
    assert direction @ sums.hessian @ direction == pytest.approx(bend, rel=0.05)


@pytest.mark.parametrize("axis", [0, 1])
def test_beliefs_on_a_line_are_those_of_all_assignments(axis: int) -> None:
    rng = np.random.default_rng(3)
    cost, penalty = rng.random((6, 3)), 0.6 * rng.random(6)
    best = np.full(cost.shape, np.inf)
    for choice in itertools.product(range(3), repeat=6):
        total = sum(cost[i, k] for i, k in enumerate(choice))
        total += sum(penalty[i] for i in range(5) if choice[i] != choice[i + 1])
        for i, k in enumerate(choice):
            best[i, k] = min(best[i, k], total)
    shape = (1, 6) if axis == 0 else (6, 1)
    links = np.zeros((2, *shape))
    links[axis] = penalty.reshape(shape)
    beliefs = FAST.potts_beliefs(cost.reshape(*shape, 3), links, sweeps=1).reshape(6, 3)
    # Messages are counted from their least, so a pixel's beliefs are known up to a constant.
    np.testing.assert_allclose(
        beliefs - beliefs.min(axis=1, keepdims=True), best - best.min(axis=1, keepdims=True), atol=1e-5
    )


def test_refining_finds_the_plane_of_noisy_evidence() -> None:
    rng = np.random.default_rng(5)
    true = np.array([0.01, -0.02, 0.3])
    label = plane_label(true, 40, 60)
    likelihood = volume_about(label + rng.normal(0, 0.1, label.shape))
    y, x = (a.ravel() for a in np.mgrid[:40, :60])
    found = refined(true + np.array([0.003, -0.003, 0.1]), x, y, of(likelihood))
    # The mean of 2400 labels that scatter by 0.1 px is known to 0.002 px, the slope over 60 px to 0.0001.
    assert np.abs(plane_label(found - true, 40, 60)).max() < 0.015


def test_refining_an_even_plane_keeps_it_even() -> None:
    likelihood = volume_about(plane_label(np.array([0.01, 0, 0]), 20, 30))
    y, x = (a.ravel() for a in np.mgrid[:20, :30])
    found = refined(np.array([0, 0, 0.3]), x, y, of(likelihood), even=True)
    np.testing.assert_allclose(found, [0, 0, 0.01 * 14.5], atol=0.01)  # the mean label; a tenth of a layer


def test_candidates_hold_the_planes_of_two_surfaces() -> None:
    rng = np.random.default_rng(7)
    wall, floor = np.array([0.0, 0.0, 1.2]), np.array([0.0, -0.02, 1.5])
    height, width = 96, 96
    label = np.where(
        np.arange(height)[:, None] < 40, plane_label(wall, height, width), plane_label(floor, height, width)
    )
    noisy = (label + rng.normal(0, 0.05, label.shape)).astype(np.float32)
    found = candidates(noisy, np.full(label.shape, 0.05), of(volume_about(label)), (48, 96))
    upper, lower = np.array([48, 20, 1]), np.array([48, 70, 1])
    for plane, place in ((wall, upper), (floor, lower)):
        assert np.abs((found - plane) @ place).min() < 0.02  # a fifth of a layer


def test_planes_alike_over_their_square_are_one() -> None:
    one = Candidate(np.array([0.0, 0.0, 1.0]), 50, 50, 100)
    near = Candidate(np.array([0.0004, 0.0, 1.0]), 50, 50, 40)  # 0.03 px apart where it was found
    far = Candidate(np.array([0.0, 0.0, 1.2]), 50, 50, 40)
    assert len(distinct([near, far, one], 0.07)) == 2


@pytest.mark.parametrize(("gap_px", "left"), [(0.0, 1), (1.0, 2)])
def test_parts_of_one_plane_are_joined_and_two_planes_are_not(gap_px: float, left: int) -> None:
    planes = np.array([[0.0, 0.01, 0.0], [0.0, 0.01, gap_px]])
    choice = np.zeros((30, 40), int)
    choice[:, 20:] = 1
    label = np.where(choice == 0, plane_label(planes[0], 30, 40), plane_label(planes[1], 30, 40))
    config = PlanesConfig(plane_penalty=5.0)
    found, joined = merged_planes(
        choice, planes + np.array([0, 0, 0.05]), of(volume_about(label)), config=config, border=2
    )
    assert len(found) == left == joined.max() + 1
    explained = np.stack([plane_label(plane, 30, 40) for plane in found])
    assert np.abs(np.take_along_axis(explained, joined[None], axis=0)[0] - label).max() < 0.03  # a third of a layer


def test_two_even_walls_are_not_one_sloped_plane_which_takes_more_numbers() -> None:
    walls, slopes = np.array([[0, 0, 0.0], [0, 0, 0.4]]), np.array([[0.015, 0, -0.1], [0.015, 0, -0.1]])
    choice = np.zeros((30, 40), int)
    choice[:, 20:] = 1

    def joined(planes: np.ndarray) -> np.ndarray:
        label = np.where(choice == 0, plane_label(planes[0], 30, 40), plane_label(planes[1], 30, 40))
        config = PlanesConfig(plane_penalty=60.0, plane_tolerance=0.0)
        return merged_planes(choice, planes, of(volume_about(label)), config=config, border=2)[0]

    even = joined(walls)
    assert len(even) == 2
    assert not even[:, :2].any()
    assert len(joined(slopes)) == 1
    # One sloped plane would lose less than the 60 nats that a plane costs: only the numbers keep the walls apart.
    label = np.where(choice == 0, 0.0, 0.4)
    pixels = of(volume_about(label))
    y, x = (part.ravel() for part in np.indices(label.shape))
    one = refined(np.array([0.015, 0, -0.1]), x, y, pixels)
    sides = [choice.ravel() == k for k in range(2)]
    apart = sum(log_likelihood(wall, x[side], y[side], pixels) for wall, side in zip(walls, sides, strict=True))
    assert 0 < apart - log_likelihood(one, x, y, pixels) < 60


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("of_missed", "slope_px", "kept"), [(0.09, 0.0, False), (0.0, 0.0, True), (0.09, 0.02, True)])
def test_a_slope_has_to_gain_a_share_of_what_the_level_plane_misses(
    seed: int, of_missed: float, slope_px: float, kept: bool
) -> None:
    rng = np.random.default_rng(seed)
    plane = np.array([[slope_px, 0.0, -15 * slope_px]])
    # Blocks find their labels with errors of .3 px, three layers: some slope explains these a little better than none.
    label = plane_label(plane[0], 20, 30) + rng.normal(0, 0.3, (20, 30))
    start, config = plane + np.array([0.002, 0.002, 0.0]), PlanesConfig(slope_tolerance=0.0)
    found, _ = merged_planes(
        np.zeros((20, 30), int), start, of(volume_about(label)), config=config, border=2, of_missed=of_missed
    )
    assert found[0, :2].any() == kept
    # The mean of 600 blocks with such errors is known within .012 px, their slope along 30 columns within .0014: six or
    # seven of these.
    assert abs(found[0] @ [15, 10, 1] - (plane[0] @ [15, 10, 1])) < 0.08
    assert abs(found[0, 0] - slope_px) < 0.01


def test_blocks_add_up_and_keep_the_weakest_link() -> None:
    rng = np.random.default_rng(9)
    likelihood = rng.random((11, 9, 5)).astype(np.float32)
    np.testing.assert_allclose(block_sums(likelihood, 4).sum(), likelihood[:8, :8].sum(), rtol=1e-5)
    weights = np.ones((2, 12, 12), np.float32)
    weights[0, :, 3] = 0.1  # between the first and the second column of blocks
    weights[1, 7, :] = 0.2  # between the second and the third row
    links = block_links(weights, 4)
    np.testing.assert_allclose(links[0, :, 0], 0.1)
    np.testing.assert_allclose(links[0, :, 1], 1.0)
    np.testing.assert_allclose(links[1, 1], 0.2)
    np.testing.assert_allclose(links[1, 0], 1.0)


def scene(noise_px: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A slanted card before a wall, weak evidence a pixel: label, spoilt volume, guide."""
    rng = np.random.default_rng(11)
    height, width = 96, 144
    label = np.full((height, width), 1.4)
    card = np.s_[24:72, 40:104]
    label[card] = plane_label(np.array([0.008, 0.0, -1.5]), height, width)[card]
    patches = rng.normal(0, noise_px, (height // 8, width // 8)).repeat(8, 0).repeat(8, 1)  # windows share their noise
    guide = np.zeros((height, width))
    guide[card] = 1.0
    return label, volume_about(label + patches, nats=0.3), guide


def test_a_scene_of_planes_is_found_again() -> None:
    label, likelihood, guide = scene(noise_px=0.15)
    start = LABELS_PX[likelihood.argmax(axis=2)]
    found = planes_of_surface(
        start, np.full(label.shape, 0.15), likelihood, guide, LABELS_PX,
        config=PlanesConfig(), surface=SurfaceConfig(), run=FAST,
    )  # fmt: skip
    assert found is not None
    error = np.abs(found.label_px - label)
    assert np.abs(start - label).mean() > 0.08  # what the evidence alone says
    # 48 patches of the card, each 0.15 px off: 0.02 px in its middle and 0.06 px at a corner; two of these.
    assert np.quantile(error, 0.98) < 0.12
    # On the wrong side of an edge: a px along the card's 224 px of border is 1.6 % of the picture.
    assert (error > 0.5).mean() < 0.02


def test_both_executions_find_the_same_planes() -> None:
    label, likelihood, guide = scene(noise_px=0.1)
    part = np.s_[:64, :96]
    slow, fast = (
        planes_of_surface(
            label[part], np.full(label[part].shape, 0.1), likelihood[part], guide[part], LABELS_PX,
            config=PlanesConfig(tiles_px=(48, 96), rounds=3), surface=SurfaceConfig(), run=run,
        )
        for run in (SLOW, FAST)
    )  # fmt: skip
    assert slow is not None
    assert fast is not None
    np.testing.assert_allclose(fast.label_px, slow.label_px, atol=1e-3)  # Newton's steps end at 1e-5 of the value


@pytest.mark.parametrize("grown_px", [-2, 6])
def test_the_guide_decides_where_a_near_plane_ends(grown_px: int) -> None:
    planes = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    guide = np.zeros((80, 80), np.float32)
    guide[20:60, 20:60] = 1.0
    choice = np.zeros((80, 80), int)
    choice[20 - grown_px : 60 + grown_px, 20 - grown_px : 60 + grown_px] = 1
    moved = placed_edges(choice, planes, guide, reach_px=8, apart_px=0.1, choices=choices_of(FAST.potts_beliefs))
    wrong = (moved == 1) != (guide > 0)
    # Borders are found on every second pixel, and corners of a band are cut: a px along a border of 160.
    assert wrong.sum() < 160 * 1.2 < ((choice == 1) != (guide > 0)).sum()


def test_planes_give_way_to_a_surface_that_knows_better() -> None:
    planes, surface, sigma = even_plane(40, 60), np.full((40, 60), 0.15), np.full((40, 60), 0.1)
    surface[:, 30:] = 0.5  # five standard deviations away
    surface[20, 10] = 0.5  # a single pixel does not decide against its neighbours
    taken = where_they_agree(planes, surface, sigma)
    np.testing.assert_array_equal(
        taken, np.where(np.arange(60) < 30, np.float32(0), np.float32(0.5))[None].repeat(40, 0)
    )


def test_an_edge_that_moves_to_a_trusted_plane_is_trusted() -> None:
    before = np.repeat([0, 1, 2], 8)[None].repeat(4, axis=0)
    trusted = np.isin(np.arange(24), [0, 1, 2, 8, 9, 10, 11, 12, 18])[None].repeat(4, axis=0)  # 3, 5 and 1 of 8 columns
    choice = before.copy()
    choice[:, 6:9] = 1  # plane 1 gains two columns
    choice[:, 14:16] = 2  # plane 2, which is not trusted, as well
    choice[:, 23] = 1
    expected = trusted.copy()
    expected[:, [6, 7, 23]] = True
    np.testing.assert_array_equal(trust_of_moved(trusted, before, choice), expected)


def even_plane(height: int, width: int) -> Planes:
    """One plane of label 0 everywhere."""
    return Planes(np.zeros((1, 3)), np.zeros((height, width), int))


def test_planes_hold_in_spots_that_they_surround_and_where_nearly_all_agrees() -> None:
    surface, sigma = np.zeros((80, 120)), np.full((80, 120), 0.1)
    surface[20:60, 20:60] = 0.5  # a sixth of the area: too much to agree as a whole, but surrounded
    np.testing.assert_array_equal(where_they_agree(even_plane(80, 120), surface, sigma), np.zeros((80, 120)))
    planes = even_plane(80, 120)
    planes.choice[:, 100:] = 1
    planes = Planes(np.array([[0.0, 0, 0], [0, 0, 3.0]]), planes.choice)
    surface[:, 100:] = 3
    np.testing.assert_array_equal(where_they_agree(planes, surface, sigma)[20:60, 20:60], 0)
    surface[20:60, 60:100] = 0.5  # now the spot ends at the other plane
    np.testing.assert_allclose(where_they_agree(planes, surface, sigma)[24:56, 24:96], 0.5)
    surface[:, :100] = 0
    surface[30:50, 90:100] = 0.5  # at the border, but a fortieth of the area
    np.testing.assert_array_equal(where_they_agree(planes, surface, sigma)[:, :100], 0)
    surface[:, :60] = 0.5  # of most of the area the surface knows better
    surface[30:50, 10:30] = 0
    np.testing.assert_allclose(where_they_agree(planes, surface, sigma)[:, 2:8], 0.5)


def test_a_plane_is_known_as_a_whole_by_its_evidence() -> None:
    """In a texture that repeats, and beside a border, the posterior of a pixel is wide, whatever its plane knows."""
    choice = (np.arange(100) >= 48)[None].repeat(40, 0).astype(int)
    planes = Planes(np.array([[0.0, 0, -1], [0, 0, 1]]), choice)
    disparity = planes.label_px.copy()
    disparity[:, 45] = 0.0  # not on a plane
    sharp = 16 * np.exp(-(((LABELS_PX + 1) / 0.3) ** 2))

    def known(likelihood: np.ndarray, sigma_px: np.ndarray) -> np.ndarray:
        """Of the first plane every block has some evidence, of the second none."""
        volume = np.zeros((10, 25, len(LABELS_PX)), np.float32)
        volume[:, :12] = likelihood
        blocks = Volume(volume, LABELS_PX, COSTS, FAST)
        surface = judged(
            Surface(disparity, sigma_px, np.ones((40, 100))), np.zeros((40, 100)), LABELS_PX,
            first_px=disparity, explained_by=planes._replace(blocks=blocks), learned=False, known_within_px=1.0,
            known_from_nats=3e-4, edge_share=0.4,
        )  # fmt: skip
        return np.isfinite(surface.disparity_px)

    wide, short = np.full((40, 100), 2.0), np.full((40, 100), 0.1)
    on_first = (choice == 0) & (np.arange(100) != 45)
    np.testing.assert_array_equal(known(sharp, wide), on_first)
    np.testing.assert_array_equal(known(sharp, short), True)  # and without a plane's evidence, as before
    # Evidence that is alike everywhere says nothing, however much of it there is.
    assert not known(np.full(len(LABELS_PX), 16.0), wide).any()


def test_a_far_plane_holds_beside_a_nearer_one_where_the_surface_lies_between() -> None:
    """Windows beside a near plane see its outline: the surface makes it too large. The near plane may give way."""
    planes = Planes(np.array([[0.0, 0, 0], [0, 0, -3.0]]), np.repeat([[0] * 60 + [1] * 60], 80, axis=0))
    surface, sigma = planes.label_px.copy(), np.full((80, 120), 0.1)
    surface[:, 50:60] = -2.5  # grown by 10 px
    np.testing.assert_array_equal(where_they_agree(planes, surface, sigma), planes.label_px)
    surface[:, 50:60] = -4.0  # nearer than both: something else is there
    np.testing.assert_array_equal(where_they_agree(planes, surface, sigma)[10:-10, 52:58], -4.0)
    surface[:, 40:60] = 0
    surface[:, 60:80] = -0.5  # the near plane ends farther to the right
    np.testing.assert_array_equal(where_they_agree(planes, surface, sigma)[10:-10, 62:70], -0.5)


def test_planes_can_be_switched_off_and_need_room() -> None:
    label, likelihood, guide = scene(noise_px=0.0)
    for part, config in ((np.s_[:], PlanesConfig(rounds=0)), (np.s_[:5], PlanesConfig())):
        found = planes_of_surface(
            label[part], np.full(label[part].shape, 0.1), likelihood[part], guide[part], LABELS_PX,
            config=config, surface=SurfaceConfig(), run=FAST,
        )  # fmt: skip
        assert found is None


@pytest.mark.parametrize(
    "wrong",
    [
        {"tiles_px": ()},
        {"tiles_px": (4,)},
        {"block_px": 0},
        {"rounds": -1},
        {"plane_penalty": -1.0},
        {"boundary_penalty": float("nan")},
    ],
)
def test_settings_that_make_no_sense_are_refused(wrong: dict) -> None:
    with pytest.raises(InputError):
        PlanesConfig(**wrong)
