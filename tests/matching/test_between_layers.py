"""Where between two layers a surface lies: known offsets are found, and the whole surface has no bias to layers."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from chromaperture.matching.accurate import explained_surface, path_surface
from chromaperture.matching.execution import execution_named
from chromaperture.matching.readable.between_layers import between_layers
from chromaperture.settings.methods import AccurateConfig
from chromaperture.settings.stages import SurfaceConfig

LAYERS_PX = np.arange(9) * 0.1 - 0.4


def wall(disparity_px, rng, shape=(40, 60), floor=0.01, scatter_px=0.03):
    """Log-likelihood with its cusp, of a wall whose pixels scatter about one disparity; (H, W, D) float32."""
    own = disparity_px + rng.normal(0, scatter_px, (*shape, 1))
    return (-0.5 * np.log(floor + 1.5 * (LAYERS_PX - own) ** 2)).astype(np.float32)


@settings(max_examples=50, deadline=None)
@given(st.floats(-0.24, 0.24), st.sampled_from([1.0, 3.0, 8.0]))
def test_even_evidence_is_placed_exactly(disparity_px, sigma):
    start = np.full((12, 15), LAYERS_PX[np.abs(LAYERS_PX - disparity_px).argmin()])
    volume = wall(disparity_px, np.random.default_rng(0), (12, 15), scatter_px=0.0)
    found = between_layers(start, volume, LAYERS_PX, sigma=sigma)
    # The unexplained fraction is a parabola exactly: left is float32, 1e-7 of it against a bend of a hundredth of it.
    np.testing.assert_allclose(found, disparity_px, atol=2e-6)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_no_evidence_moves_a_pixel_by_more_than_half_a_layer(seed):
    rng = np.random.default_rng(seed)
    start = rng.uniform(LAYERS_PX[0], LAYERS_PX[-1], (8, 9))
    volume = rng.gamma(0.3, 3.0, (8, 9, len(LAYERS_PX))).astype(np.float32)
    found = between_layers(start, volume, LAYERS_PX, sigma=2.0)
    assert np.isfinite(found).all()
    assert np.abs(found - start).max() <= 0.2 + 1e-6  # to its layer, away from the border, from there; float32
    none = between_layers(start, np.zeros_like(volume), LAYERS_PX, sigma=2.0)
    assert np.abs(none - (np.clip(np.rint((start + 0.4) / 0.1), 1, 7) * 0.1 - 0.4)).max() < 1e-6  # rounding


def test_walls_between_layers_are_not_biased_to_the_layers():
    """Penalties of many nats a layer: the paths alone leave a wall at its layer."""
    config = AccurateConfig(surface=SurfaceConfig(slope_penalty=80.0, temperature=0.3))
    rng, bias, guide = np.random.default_rng(3), [], np.zeros((40, 60), np.float32)
    run, no_edges = execution_named("numba"), np.full((2, *guide.shape), -6.0, np.float32)
    for disparity_px in np.arange(-0.15, 0.151, 0.025):
        volume = wall(disparity_px, rng, guide.shape)
        paths = path_surface(volume, guide, LAYERS_PX, config=config, run=run)
        found = explained_surface(paths, no_edges, LAYERS_PX, (160, 240), config=config, run=run)
        bias.append(np.nanmedian(found.disparity_px) - disparity_px)
    # A scatter of .03 px leaves .0006 px of a wall of 2400 blocks; a parabola through three labels of a cusp errs by
    # .004. The paths alone are off by .023 halfway between two layers.
    assert np.abs(bias).max() < 0.006
