"""Edges of planes on a GPU: the lines' likelihood, the planes that a pixel may lie on, the choice."""

import cv2
import numpy as np
import pytest

from chromaperture.disparity import stages
from chromaperture.disparity.edge_likelihood import EdgeLikelihood, products_of_shades
from chromaperture.disparity.labels import IDENTITY
from chromaperture.disparity.plane_edges import BorderLines, choices_of, edge_links, on_grid, placed_edges
from chromaperture.disparity.result import NoiseModel
from chromaperture.optics.lens_blur import BlurModel
from test_edge_likelihood import NOISE, H, W, lines_beside, two_layers
from test_gpu_surface import any_device, device_as
from worlds import lens_blur

pytestmark = pytest.mark.extra("gpu", "wgpu")


def likelihood(noise=NOISE):
    known = NoiseModel(lambda image: np.full(image.shape, noise**2, np.float32), is_known=True)
    return EdgeLikelihood(lens_blur(BlurModel(6.0, 12000.0), W, H), IDENTITY, known, stages)


@pytest.mark.parametrize("software", [True, False])
@pytest.mark.parametrize(("noise", "tolerance"), [(NOISE, 2e-4), (0.0, 0.02)])
def test_costs_of_lines_agree(rng, monkeypatch, software, noise, tolerance):
    """Lines of both directions, both orders and several powers; more of a group than are eliminated at once."""
    from chromaperture.disparity.gpu import edge_stages
    from chromaperture.disparity.gpu.device import Chain

    edges = likelihood(noise)
    image = two_layers(rng, edges.blur, along_rows=True, near_first=True)
    image[:40] *= 0.2
    photograph = edges.photograph(image.astype(np.float32))
    given = {}
    for along_rows in (True, False):
        parts = [lines_beside(shift, along_rows=along_rows, near_first=first) for shift in (0, 5) for first in (0, 1)]
        several = [np.concatenate([part[i] for part in parts] * 3) for i in range(1, 6)]
        several[4] = several[4].astype(bool)
        given[along_rows] = parts[0]._replace(**dict(zip(parts[0]._fields[1:], several, strict=True)))

    def lines_of(choice, planes, along_rows, apart_px):
        count = len(given[along_rows].y)
        zero, all_of_pair = np.zeros(count, int), np.ones((count, 14), bool)
        return BorderLines(given[along_rows], zero, zero, zero, zero + 1, np.ones(count), all_of_pair)

    monkeypatch.setattr(edge_stages, "border_lines", lines_of)
    heard = edge_stages.lines_heard(np.zeros((H // 2, W // 2), int), None, 0.3, edges, photograph)
    assert heard.numbers[:, 4].max() == edge_stages.MOST_LINES
    assert len(heard.textures) >= 4
    chain = Chain(device_as(software=software))
    edge_stages.add_line_costs(chain, heard, photograph.colours)
    found = chain.run({}, ["line_costs"])["line_costs"].reshape(-1, edge_stages.PLACES)
    found -= found.min(axis=1, keepdims=True)
    expected = []
    for lines in given.values():
        groups = edges.groups(photograph, lines, photograph.samples(lines))
        expected.append(edges.costs(photograph, lines)[np.argsort(groups.of_line, kind="stable")])
    expected = np.concatenate(expected)
    # Of the most that a place of the edge costs, tens to thousands of nats. Without noise only a share of 1e-9 of the
    # variance keeps the matrix from being singular.
    relative = np.abs(found - expected) / expected.max(axis=1, keepdims=True)
    assert np.percentile(relative, 99) < tolerance


@pytest.mark.parametrize("shape", [(31, 50), (122, 163)])
def test_covariances_of_colours_agree(rng, shape):
    from chromaperture.disparity.gpu.device import Chain
    from chromaperture.disparity.gpu.edge_stages import SHADES, add_shades, products_of

    image = cv2.GaussianBlur(rng.uniform(0, 1, (*shape, 3)).astype(np.float32), (0, 0), 5) @ [
        [1, 0, 0.5],
        [0.2, 1, 0],
        [0, 0, 1],
    ]
    image = image.astype(np.float32)
    chain = Chain(any_device())
    add_shades(chain, chain.constant("image", image), shape)
    found, expected = products_of(chain.run({}, [SHADES])[SHADES]), products_of_shades(image)
    # The difference of two Gaussians that are nearly the same light.
    np.testing.assert_allclose(found, expected, atol=1e-4 * np.trace(expected))


def blobs(rng, height, width, block):
    """Three planes: one in the background, a near one with a thin part, a nearer one at the corner."""
    y, x = np.mgrid[: height // block, : width // block]
    choice = np.zeros(y.shape, int)
    choice[(np.hypot(y - 12, x - 14) < 7) | (np.abs(y - 12) < 1)] = 1
    choice[(y > 18) & (x + rng.integers(0, 2, y.shape) > 28)] = 2
    planes = np.array([[0.002, 0.0, 1.2], [0.0, -0.01, 0.1], [0.0, 0.0, -1.0], [0, 0, 3.0]])
    return choice, planes


def edges_of(rng, device, *, lines):
    """A chain that places edges and its output's name, what the CPU makes of it, and the choice before."""
    from chromaperture.disparity.gpu.device import Chain
    from chromaperture.disparity.gpu.edge_stages import EdgeGrid, add_placed_edges, lines_heard

    block, step, apart_px, reach = 4, 0.15, 0.225, 8
    height, width = 121, 162  # no multiples of a block, nor of the grid
    of_blocks, planes = blobs(rng, height, width, block)
    rows, columns = (np.minimum(np.arange(n) // block, n // block - 1) for n in (height, width))
    choice = of_blocks[rows[:, None], columns]
    guide = rng.normal(0, 0.1, (height, width)) + choice
    edges = likelihood()
    image = np.zeros((height, width, 3), np.float32)
    image[:H, :W] = two_layers(rng, edges.blur, along_rows=True, near_first=True)
    image[H:], image[:, W:] = image[H - 1], image[:, W - 1, None]
    edges = EdgeLikelihood(lens_blur(BlurModel(6.0, 12000.0), width, height), IDENTITY, edges.noise, stages)
    photograph = edges.photograph(image)
    expected = placed_edges(
        choice, planes, guide, reach_px=reach, apart_px=apart_px, choices=choices_of(stages.potts_beliefs),
        line_costs=(lambda some: edges.costs(photograph, some)) if lines else None,
    )  # fmt: skip
    chain = Chain(device)
    blocks = chain.constant("blocks", of_blocks.astype(np.uint32))
    used, coarse, _ = on_grid(choice, planes)
    heard = lines_heard(used[coarse], planes * (2, 2, 1), apart_px, edges, photograph) if lines else None
    in_layers = planes / step
    found = add_placed_edges(
        chain, blocks, in_layers, edge_links(guide, reach), None if heard is None else (heard, photograph.colours),
        EdgeGrid(height, width, block), reach_px=reach, apart=apart_px / step,
    )  # fmt: skip
    assert heard is None or len(heard.samples) > 40
    return chain, found.name, expected, choice


@pytest.mark.parametrize("lines", [True, False])
def test_edges_are_placed_alike(rng, lines):
    chain, name, expected, choice = edges_of(rng, any_device(), lines=lines)
    got = chain.run({}, [name])[name].reshape(expected.shape)
    assert (expected != choice).mean() > 0.02
    assert (got == expected).mean() > 0.999
