"""Edges of planes on a GPU: the lines' likelihood, the planes that a pixel may lie on, the choice."""

import cv2
import numpy as np
import pytest

from chromaperture.disparity import stages
from chromaperture.disparity.edge_likelihood import EdgeLikelihood, covariance_of_colours, products_of_shades
from chromaperture.disparity.labels import IDENTITY
from chromaperture.disparity.plane_edges import border_lines, choices_of, edge_links, placed_edges
from chromaperture.disparity.result import NoiseModel
from chromaperture.optics.lens_blur import BlurModel
from test_edge_likelihood import NOISE, H, W, lines_beside, two_layers
from test_gpu_surface import any_device, device_as
from worlds import lens_blur

pytestmark = pytest.mark.extra("gpu", "wgpu")


def likelihood(noise=NOISE):
    known = NoiseModel(lambda image: np.full(image.shape, noise**2, np.float32), is_known=True)
    return EdgeLikelihood(lens_blur(BlurModel(6.0, 12000.0), W, H), IDENTITY, known, stages)


STEP = 0.15  # px of a label


def lines_on_device(chain, edges, image, labels_px):
    """What lines need, with their photograph."""
    from chromaperture.disparity.gpu.line_stages import add_colours, inputs_of, line_arrays
    from chromaperture.disparity.gpu.line_textures import line_textures

    arrays = line_arrays(chain, line_textures(edges, image.shape[:2], labels_px))
    add_colours(chain, chain.constant("image", image), image.shape[:2], arrays.shared)
    for name, values in inputs_of(edges.photograph(image)).items():
        chain.write(chain.arrays[name], values)
        chain.arrays[name] = chain.arrays[name]._replace(is_constant=True)
    return arrays


@pytest.mark.parametrize("software", [True, False])
@pytest.mark.parametrize(("noise", "tolerance"), [(NOISE, 2e-4), (0.0, 0.02)])
def test_costs_of_lines_agree(rng, software, noise, tolerance):
    """Lines of both directions, both orders and several powers; more of a group than are eliminated at once."""
    from chromaperture.disparity.gpu import line_stages
    from chromaperture.disparity.gpu.device import Chain

    edges = likelihood(noise)
    image = two_layers(rng, edges.blur, along_rows=True, near_first=True).astype(np.float32)
    image[:40] *= 0.2
    expected, keys = [], []
    chain = Chain(device_as(software=software))
    arrays = lines_on_device(chain, edges, image, np.arange(-4.0, 4.01, STEP))
    sizes, (height, width) = arrays.textures, arrays.textures.maps.shape[:2]
    for down, along_rows in enumerate((True, False)):
        parts = [lines_beside(shift, along_rows=along_rows, near_first=first) for shift in (0, 5) for first in (0, 1)]
        several = [np.concatenate([part[i] for part in parts] * 3) for i in range(1, 6)]
        several[4] = several[4].astype(bool)
        lines = parts[0]._replace(**dict(zip(parts[0]._fields[1:], several, strict=True)))
        photograph = edges.photograph(image)
        expected.append(edges.costs(photograph, lines))
        assert np.bincount(edges.groups(photograph, lines, photograph.samples(lines)).of_line).max() > 16
        node, *sides = edges._depths(lines)
        near, far = (side - sizes.first_layer for side in sides)
        key = (((2 * down + lines.near_first) * 9 + node) * sizes.layers + near) * sizes.layers + far
        keys.append(np.stack([(down * height + lines.y) * width + lines.x, key], axis=1))
    expected, keys = np.concatenate(expected), np.concatenate(keys).astype(np.uint32)
    # Slanted stripes: lines of both directions cross their borders.
    choice = np.add.outer(np.arange(height), np.arange(width)) // 16 % 2
    listed = line_stages.Listed(
        chain.array("at", 1), chain.constant("about", np.ones((len(keys), 4), np.uint32)),
        chain.constant("keys", keys), chain.constant("numbers", np.array([len(keys), 0], np.uint32)), len(keys),
    )  # fmt: skip
    costs = line_stages.add_line_costs(chain, chain.constant("choice", choice.astype(np.uint32)), listed, arrays)
    got = chain.run({}, [costs.name, "numbers", "about"])
    found = got[costs.name].reshape(-1, line_stages.PLACES)
    crossing = got["about"].reshape(-1, 4)[:, 2] > 0
    assert crossing.mean() > 0.9
    found, expected = found[crossing], expected[crossing]
    found -= found.min(axis=1, keepdims=True)
    # Of the most that a place of the edge costs, tens to thousands of nats. Without noise only a share of 1e-9 of the
    # variance keeps the matrix from being singular.
    relative = np.abs(found - expected) / expected.max(axis=1, keepdims=True)
    assert np.percentile(relative, 99) < tolerance


@pytest.mark.parametrize("shape", [(31, 50), (122, 163)])
def test_covariances_of_colours_agree(rng, shape):
    from chromaperture.disparity.gpu.device import Chain
    from chromaperture.disparity.gpu.line_stages import add_colours

    image = cv2.GaussianBlur(rng.uniform(0, 1, (*shape, 3)).astype(np.float32), (0, 0), 5) @ [
        [1, 0, 0.5],
        [0.2, 1, 0],
        [0, 0, 1],
    ]
    image = image.astype(np.float32)
    chain = Chain(any_device())
    add_colours(chain, chain.constant("image", image), shape, chain.array("colours", 9))
    found = chain.run({}, ["colours"])["colours"].reshape(3, 3)
    # The difference of two Gaussians that are nearly the same light.
    np.testing.assert_allclose(found, covariance_of_colours(products_of_shades(image)), atol=3e-4)


@pytest.mark.parametrize("apart", [0.3, 1.5])
def test_the_same_lines_are_heard(rng, apart):
    """Planes in rough areas: some borders are too short, too slanted, too close to the frame, of planes too alike."""
    from chromaperture.disparity.gpu import line_stages
    from chromaperture.disparity.gpu.device import Chain

    edges = likelihood()
    image = two_layers(rng, edges.blur, along_rows=True, near_first=True).astype(np.float32)
    labels_px = np.arange(-4.0, 4.01, STEP)
    height, width = H // 2, W // 2
    choice = cv2.GaussianBlur(rng.normal(0, 1, (height, width)), (0, 0), 6)
    choice = np.digitize(choice, np.quantile(choice, (0.3, 0.5, 0.8)))
    planes = np.array([[0.002, 0, 1.2], [0, -0.01, 0.1], [0, 0, -1.0], [0.004, 0, 0.6]])
    in_layers = (planes - (0, 0, labels_px[0])) / STEP
    chain = Chain(any_device())
    arrays = lines_on_device(chain, edges, image, labels_px)
    unfinished = chain.constant("unfinished", np.zeros(1, np.uint32))
    given = chain.constant("choice", choice.astype(np.uint32))
    of_points = chain.constant("planes", np.concatenate([in_layers, np.zeros((4, 1))], axis=1))
    listed = line_stages.add_listed(
        chain, given, of_points, arrays, unfinished, apart=apart / STEP, most=2 * height * width
    )
    costs = line_stages.add_line_costs(chain, given, listed, arrays)
    got = chain.run({}, ["line_at", "line_about", costs.name, "line_numbers"])
    at, about = got["line_at"].reshape(2, height, width), got["line_about"].reshape(-1, 4)
    costs_found, count = got[costs.name].reshape(-1, line_stages.PLACES), 0
    photograph = edges.photograph(image)
    for line_at, along_rows in zip(at, (True, False), strict=True):
        expected = border_lines(choice, planes, along_rows, apart)
        numbers = line_at[expected.lines.y, expected.lines.x]
        assert (numbers > 0).all()
        heard = (line_at > 0) & (about[np.maximum(line_at, 1) - 1, 2] > 0)
        assert heard.sum() == len(numbers)
        near, far, bits, weight = about[numbers - 1].T
        np.testing.assert_array_equal(near, expected.near)
        np.testing.assert_array_equal(far, expected.far)
        np.testing.assert_array_equal(bits >> 31, expected.lines.near_first)
        np.testing.assert_array_equal((bits[:, None] >> np.arange(14)) & 1, expected.of_pair)
        np.testing.assert_allclose(weight.view(np.float32), expected.weight, rtol=1e-3)
        each, mine = edges.costs(photograph, expected.lines), costs_found[numbers - 1]
        relative = np.abs(mine - mine.min(axis=1, keepdims=True) - each) / each.max(axis=1, keepdims=True)
        # Lines whose power is just between two steps of its share them with others: by a rasteriser in software .02 of
        # the costs differ by 3e-4 then, by an H200, whose logarithms are less exact, .05 (and .02 by 1.3e-3).
        assert np.percentile(relative, 90) < 3e-4
        assert np.percentile(relative, 98) < 2e-3
        count += len(numbers)
    assert count > 40
    assert got["line_numbers"][0] >= count


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
    from chromaperture.disparity.gpu.edge_stages import EdgeGrid, HeardLines, add_placed_edges, add_planes_of_pixels

    block, step, apart_px, reach = 4, STEP, 0.225, 8
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
    labels_px = np.arange(-4.0, 4.01, step)
    middle = (block - 1) / 2
    of_blocks_px = np.stack([*(block * planes[:, :2].T), planes[:, 2] + planes[:, :2].sum(axis=1) * middle], axis=1)
    in_layers = (of_blocks_px - (0, 0, labels_px[0])) / step
    given = chain.constant("block_planes", np.concatenate([in_layers, np.zeros((len(planes), 1))], axis=1))
    number = chain.constant("plane_count", np.array([len(planes)], np.uint32))
    unfinished = chain.constant("unfinished", np.zeros(1, np.uint32))
    of_pixels = add_planes_of_pixels(chain, given, number, unfinished, block=block, most=9)
    heard = HeardLines(lines_on_device(chain, edges, image, labels_px), 4000, unfinished) if lines else None
    found = add_placed_edges(
        chain, blocks, of_pixels, chain.constant("edge_links", edge_links(guide, reach)), heard,
        EdgeGrid(height, width, block), reach_px=reach, apart=apart_px / step,
    )  # fmt: skip
    return chain, found.name, expected, choice


@pytest.mark.parametrize("lines", [True, False])
def test_edges_are_placed_alike(rng, lines):
    chain, name, expected, choice = edges_of(rng, any_device(), lines=lines)
    got = chain.run({}, [name])[name].reshape(expected.shape)
    assert (expected != choice).mean() > 0.02
    assert (got == expected).mean() > 0.999
