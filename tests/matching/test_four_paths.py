"""The costs that quality "real-time" sums along rows and columns, against a search through every labelling."""

from itertools import product

import numpy as np
import pytest

from chromaperture.matching.readable.four_paths import summed_costs
from chromaperture.matching.readable.paths import PathPenalties, path_costs
from chromaperture.settings.stages import FourPathsConfig


def link(guide, here, there, paths):
    apart = abs(float(guide[here]) - float(guide[there]))
    return paths.edge_floor + (1 - paths.edge_floor) * np.exp(-apart / paths.edge_range)


def test_without_a_share_of_the_rows_it_is_semi_global_matching(rng):
    own, guide = rng.uniform(0, 4, (5, 6, 4)), rng.normal(0, 0.3, (5, 6))
    paths = FourPathsConfig(row_share=0.0, jump_penalty=2.0)
    penalties = PathPenalties(paths.jump_penalty, paths.jump_penalty, paths.edge_range, paths.edge_floor)
    expected = path_costs(-own, guide, penalties, paths=4)
    np.testing.assert_allclose(summed_costs(own, guide, paths), expected, atol=1e-12)  # the same sums in another order


@pytest.mark.parametrize("jump", [0.7, 3.0])
def test_with_all_of_the_rows_it_is_the_least_cost_of_a_tree(rng, jump):
    """A pixel's tree is its column, from whose pixels the rows branch off to both sides."""
    shape, labels = (3, 3), 2
    own, guide = rng.uniform(0, 4, (*shape, labels)), rng.normal(0, 0.3, shape)
    paths = FourPathsConfig(row_share=1.0, jump_penalty=jump)
    found = summed_costs(own, guide, paths)
    pixels = list(product(*map(range, shape)))
    for column in range(shape[1]):
        edges = [((y, x), (y, x + 1)) for y in range(shape[0]) for x in range(shape[1] - 1)]
        edges += [((y, column), (y + 1, column)) for y in range(shape[0] - 1)]
        weights = [jump * link(guide, a, b, paths) for a, b in edges]
        least = np.full((shape[0], labels), np.inf)
        for choice in product(range(labels), repeat=len(pixels)):
            chosen = dict(zip(pixels, choice, strict=True))
            cost = sum(own[(*p, chosen[p])] for p in pixels)
            cost += sum(w for w, (a, b) in zip(weights, edges, strict=True) if chosen[a] != chosen[b])
            for y in range(shape[0]):
                least[y, chosen[y, column]] = min(least[y, chosen[y, column]], cost)
        # Messages are counted from the least cost of their pixel: costs are right but for one number a pixel.
        np.testing.assert_allclose(np.diff(found[:, column], axis=1), np.diff(least, axis=1), atol=1e-9)


def test_rows_of_weak_texture_draw_no_streaks():
    """A wall whose pixels say little: pieces of rows err without a share of the rows, and hardly with it."""
    rng = np.random.default_rng(5)
    own = rng.normal(0, 1, (40, 60, 8))
    own[..., 3] -= 0.35
    guide = np.zeros(own.shape[:2])
    wrong = [
        np.mean(summed_costs(own, guide, FourPathsConfig(jump_penalty=5.0, row_share=share)).argmin(axis=2) != 3)
        for share in (0.0, 0.25)
    ]
    assert wrong[0] > 0.1
    assert wrong[1] < wrong[0] / 2
