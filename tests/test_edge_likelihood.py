"""Likely places of depth edges: against simulated layers with a known edge, against scipy's Gaussian density."""

import numpy as np
import pytest
import scipy.fft
import scipy.stats

from chromaperture.disparity import cpu, edge_likelihood, stages
from chromaperture.disparity.edge_likelihood import GRID_PX, HALF, SHIFTS, EdgeLikelihood, Lines
from chromaperture.disparity.labels import IDENTITY
from chromaperture.disparity.plane_edges import choices_of, placed_edges
from chromaperture.disparity.result import NoiseModel
from chromaperture.disparity.stages.planes import potts_beliefs
from chromaperture.optics.lens_blur import BlurModel
from worlds import lens_blur

W, H, SIZE = 160, 120, 256
NOISE = 0.004
NEAR_PX, FAR_PX = -2.0, 1.0  # of half disparity
EDGE = 81  # first column, or row, of the far side


@pytest.fixture(scope="module")
def likelihood():
    blur = lens_blur(BlurModel(6.0, 12000.0), W, H)
    known = NoiseModel(lambda image: np.full(image.shape, NOISE**2, np.float32), is_known=True)
    return EdgeLikelihood(blur, IDENTITY, known, cpu)


def texture(rng):
    """Spectra of a grey texture with a little colour, standard deviation 0.1."""
    fy, fx = scipy.fft.fftfreq(SIZE)[:, None], scipy.fft.rfftfreq(SIZE)[None]
    amplitude = (fx**2 + fy**2 + 0.01**2) ** (-1.3 / 2)
    amplitude[0, 0] = 0
    grey, own = rng.standard_normal((SIZE, SIZE)), rng.standard_normal((3, SIZE, SIZE))
    made = scipy.fft.irfft2(amplitude * scipy.fft.rfft2(grey + 0.2 * own))
    return 0.1 * made / made.std()


def two_layers(rng, blur, *, along_rows, near_first):
    """A near half plane in front of a far plane, the product of texture and cover blurred exactly; (H, W, 3)."""
    at_infinity, scale = blur.reference
    middle = (W - 1) / 2, (H - 1) / 2
    near, far = (blur.transfer(*middle, (at_infinity - layer) / scale, SIZE) for layer in (NEAR_PX, FAR_PX))
    place = np.arange(SIZE)[None, :] if along_rows else np.arange(SIZE)[:, None]
    cover = np.broadcast_to(((place < EDGE) == near_first).astype(float), (SIZE, SIZE))
    through = lambda picture, transfer: scipy.fft.irfft2(scipy.fft.rfft2(picture) * transfer)  # noqa: E731
    light = through(cover * (0.5 + texture(rng)), near) + (1 - through(cover, near)) * through(0.4 + texture(rng), far)
    light += NOISE * rng.standard_normal(light.shape)
    return light.transpose(1, 2, 0)[:H, :W]


def lines_beside(shifted, *, along_rows, near_first):
    """Lines across a border that is off by grid points, at every eighth pixel."""
    across = np.arange(24, (H if along_rows else W) - 24, 8) // GRID_PX
    border = np.full(len(across), (EDGE - 1) // GRID_PX - shifted)
    y, x = (across, border) if along_rows else (border, across)
    sides = (np.full(len(across), value) for value in (NEAR_PX, FAR_PX))
    return Lines(along_rows, y, x, *sides, np.full(len(across), near_first))


@pytest.mark.parametrize("near_first", [True, False])
@pytest.mark.parametrize("along_rows", [True, False])
@pytest.mark.parametrize("shifted", [0, -4, 5])
def test_the_likeliest_place_is_that_of_the_edge(likelihood, rng, along_rows, near_first, shifted):
    near, together = [], []
    for _ in range(6):
        image = two_layers(rng, likelihood.blur, along_rows=along_rows, near_first=near_first)
        lines = lines_beside(shifted, along_rows=along_rows, near_first=near_first)
        cost = likelihood.costs(likelihood.photograph(image), lines)
        assert (cost.min(axis=1) == 0).all()
        near.append(np.abs(cost.argmin(axis=1) - SHIFTS - shifted) <= 2)
        together.append(cost.sum(axis=0))
    # Grid points; a tenth of the near side's blur each.
    assert abs(np.sum(together, axis=0).argmin() - SHIFTS - shifted) <= 1
    # Of single lines some meet two textures of equal light. By chance a third would be as near; halves of the pupil,
    # left and right, displace nothing along columns.
    assert np.mean(near) > (0.75 if along_rows else 0.45)


def test_the_cost_is_that_of_a_gaussian_density(likelihood, rng):
    """The covariance composed entry by entry, of spectra transformed in two dimensions, in scipy's density."""
    image = two_layers(rng, likelihood.blur, along_rows=True, near_first=True)
    lines = lines_beside(0, along_rows=True, near_first=True)
    node = next(iter(likelihood._depths(lines)[0]))
    textures = {}
    for layer in (NEAR_PX, FAR_PX):
        found = likelihood._texture(node, round(layer / edge_likelihood.LAYER_PX), True)
        textures[layer] = found
        at_infinity, scale = likelihood.blur.reference
        size = found.size
        y, x = (part / (edge_likelihood.NODES - 1) for part in divmod(node, edge_likelihood.NODES))
        transfer = likelihood.blur.transfer(x * (W - 1), y * (H - 1), (at_infinity - layer) / scale, size)
        fy, fx = scipy.fft.fftfreq(size)[:, None], scipy.fft.rfftfreq(size)[None]
        transfer = transfer * np.exp(-2 * np.pi**2 * (fx**2 + fy**2))
        power = (fx**2 + fy**2 + edge_likelihood.SOFTEST**2) ** -edge_likelihood.SLOPE
        for j, k, one, other in ((0, 0, 3, 3), (0, 2, 10, 4), (2, 1, 0, 17)):
            whole = scipy.fft.irfft2(power * transfer[j] * transfer[k].conj(), s=(size, size))
            expected = whole[0, GRID_PX * (one - other)]
            # float32 transfer functions
            assert found.covariance[j, k, one, other] == pytest.approx(expected, rel=1e-4, abs=1e-5 * whole[0, 0])
    photograph = likelihood.photograph(image)
    samples, colours = photograph.samples(lines), photograph.colours
    mean = float(samples.mean())
    powers = 2.0**-12, 2.0**-10
    level = (edge_likelihood.UNKNOWN_LEVEL * mean) ** 2 / np.trace(colours) * 3
    likelihood.groups(photograph, lines, samples)  # keeps the textures
    groups = edge_likelihood.Groups(
        np.zeros(4, int), *([(node, round(z / edge_likelihood.LAYER_PX), True)] for z in (NEAR_PX, FAR_PX)),
        np.array([True]), *(np.array([power]) for power in powers), np.array([level]), np.full((1, 3), NOISE**2),
    )  # fmt: skip
    given = samples[:4].reshape(4, -1)
    covariances = likelihood.covariances(groups, 0, colours)
    costs = stages.edge_costs(given, *covariances)
    for shift in (0, SHIFTS, SHIFTS + 3):
        share = covariances[2][shift].reshape(3, -1)
        whole = np.zeros((3, 2 * HALF, 3, 2 * HALF))
        for j in range(3):
            for k in range(3):
                sides = (colours[j, k] * (p * textures[z].covariance[j, k] + level)
                         for p, z in zip(powers, (NEAR_PX, FAR_PX), strict=True))  # fmt: skip
                near, far = sides
                whole[j, :, k] = np.outer(share[j], share[k]) * near + np.outer(1 - share[j], 1 - share[k]) * far
            whole[j, :, j] += NOISE**2 * edge_likelihood.noise_covariance()
        density = scipy.stats.multivariate_normal(cov=whole.reshape(6 * HALF, 6 * HALF), allow_singular=True)
        constant = 6 * HALF / 2 * np.log(2 * np.pi)
        # Of some hundreds; 1e-9 of the trace was added to the diagonal.
        np.testing.assert_allclose(costs[:, shift], -density.logpdf(given) - constant, rtol=1e-3)


@pytest.mark.parametrize(("lines", "noise"), [(1, 1e-2), (7, 1e-8)])
def test_both_executions_agree(rng, lines, noise):
    count = 30
    near, far = (part @ part.T for part in rng.standard_normal((2, count, 2 * count)))
    share = np.sort(rng.uniform(0, 1, (5, count)), axis=1)
    given = rng.standard_normal((lines, count)), near, far, share, noise * np.eye(count)
    # Doubles: a condition of 1e9 leaves 1e-7.
    np.testing.assert_allclose(cpu.edge_costs(*given), stages.edge_costs(*given), rtol=1e-7)


def test_empty_channels_and_pixels_without_light_are_no_trouble(likelihood, rng):
    image = two_layers(rng, likelihood.blur, along_rows=True, near_first=True)
    lines = lines_beside(2, along_rows=True, near_first=True)
    for spoiled in (image * [1, 1, 0], np.zeros_like(image), np.where(image > 0.5, np.nan, image), np.ones_like(image)):
        assert np.isfinite(likelihood.costs(likelihood.photograph(spoiled), lines)).all()


@pytest.mark.parametrize("grown_px", [8, -6])
def test_borders_move_to_the_edges_of_layers(likelihood, rng, grown_px):
    """A guide without any edge: what moves the border is the likelihood alone."""
    image = two_layers(rng, likelihood.blur, along_rows=True, near_first=True)
    choice = np.zeros((H, W), int) + (np.arange(W) >= EDGE + grown_px)
    planes = np.array([[0, 0, NEAR_PX], [0, 0, FAR_PX]])
    moved = placed_edges(
        choice, planes, np.zeros((H, W)), reach_px=8, apart_px=0.3, choices=choices_of(potts_beliefs),
        line_costs=lambda lines: likelihood.costs(likelihood.photograph(image), lines),
    )  # fmt: skip
    edge = (moved == 0).sum(axis=1)
    assert np.abs(edge - EDGE).mean() < 2.0  # the grid's spacing
