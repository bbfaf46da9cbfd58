"""The executions of the stages, so that a case is written once and runs in each that has the stage.

Readable NumPy is the oracle; compiled code has every stage, shaders have those that stand alone on a device.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from chromaperture.matching.device.correlation_stages import add_correlation
from chromaperture.matching.device.device import Array, Chain
from chromaperture.matching.device.label_stages import add_likelihood
from chromaperture.matching.device.real_time_chain import add_links, add_recursions
from chromaperture.matching.device.surface_stages import LANES, Grid, add_paths
from chromaperture.matching.device.view_stages import GUIDE_SCALE, STATS, Planes
from chromaperture.matching.evidence.blur import BlurEvidence
from chromaperture.matching.evidence.spectral import SpectralEvidence
from chromaperture.matching.execution import execution_named
from chromaperture.matching.labels import IDENTITY
from chromaperture.matching.readable.bilateral import even_link
from chromaperture.matching.result import ESTIMATED_NOISE
from chromaperture.matching.views import Views
from chromaperture.optics.lens_blur import BlurModel
from chromaperture.settings.stages import CorrelationConfig, CrossFilterConfig, SpectralConfig, SurfaceConfig
from devices import any_device
from worlds import lens_blur

READABLE, COMPILED = execution_named("numpy"), execution_named("numba")
_VARIANCE_AT = 8  # in the statistics of the views
# Invocations of a path and steps that are read ahead, by the number of layers: each of the schedules is seen.
LANES_AND_AHEAD = {3: (1, 1), 9: (4, 4), 21: (16, 3), 70: (8, 1)}


def slanted_volume(rng: np.random.Generator, height: int, width: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Peaks about a slanted surface with a step, as correlations make them, and a guide with an edge there."""
    y, x = np.mgrid[:height, :width]
    truth = 1.5 + (count - 4) * (0.2 + 0.4 * x / width + 0.1 * y / height) + (x > width // 2) * count * 0.2
    away = np.arange(count) - truth[..., None]
    likelihood = 2.0 * np.exp(-0.5 * (away / 1.3) ** 2) + rng.gamma(0.3, 0.3, (height, width, count))
    guide = (x > width // 2) * 1.5 + rng.normal(0, 0.1, (height, width))
    return likelihood.astype(np.float32), guide.astype(np.float32)


class Shaders:
    """The stages that shaders have, with the parameters of `Execution`; each call compiles them for its sizes."""

    def correlate(self, views: Views, layers_px: np.ndarray, *, config: CorrelationConfig) -> np.ndarray:
        height, width, count = views.pictures.shape
        chain = Chain(any_device())
        planes = Planes(
            chain.array("planes", (count + 2) * height * width), chain.array("stats", STATS), None, width, height, count
        )
        pitch = len(layers_px)
        for _ in add_correlation(chain, planes, layers_px, views.directions, config, pitch=pitch):
            pass
        stats = np.zeros(STATS)
        stats[_VARIANCE_AT : _VARIANCE_AT + count] = views.pictures.var(axis=(0, 1), dtype=float)
        stack = np.concatenate([np.moveaxis(views.pictures, -1, 0), views.guide[None], views.mask[None]])
        return chain.run({"planes": stack, "stats": stats}, ["score"])["score"].reshape(height, width, -1)

    def smooth_along_surface(
        self, maps: Sequence[np.ndarray], guide: np.ndarray, layer: np.ndarray, *, sigma_px: float
    ) -> list[np.ndarray]:
        (height, width), count = guide.shape, len(maps)
        chain = Chain(any_device())
        sizes = {"guide": guide.size, "stats": STATS, "layer": guide.size, "maps": count * guide.size}
        guide_, stats_, layer_, maps_ = (chain.array(*each) for each in sizes.items())
        planes = Planes(guide_, stats_, None, width, height, 0)
        links = add_links(chain, planes, layer_, even=even_link(sigma_px), edge_range=1.0, by_layer=True)
        add_recursions(chain, planes, maps_, links, map_count=count, gain=1.0, own=1.0)
        stats = np.zeros(STATS)
        stats[GUIDE_SCALE] = 1.0
        inputs = {"guide": guide, "stats": stats, "layer": layer, "maps": np.stack(maps, axis=-1)}
        return list(np.moveaxis(chain.run(inputs, ["maps"])["maps"].reshape(height, width, count), -1, 0))

    def aggregate_paths(
        self, likelihood: np.ndarray, guide: np.ndarray, layers_px: np.ndarray, *, config: SurfaceConfig
    ) -> np.ndarray:
        chain = Chain(any_device())
        sizes = {"likelihood": likelihood.size, "guide": guide.size, "total": likelihood.size}
        arrays: list[Array] = [chain.array(*each) for each in sizes.items()]
        lanes, ahead = LANES_AND_AHEAD.get(len(layers_px), (LANES, None))
        add_paths(chain, *arrays, Grid(*likelihood.shape), layers_px, config=config, lanes=lanes, ahead=ahead)
        return chain.run({"likelihood": likelihood, "guide": guide}, ["total"])["total"].reshape(likelihood.shape)

    def spectral_likelihood(
        self,
        spectra: np.ndarray,
        powers: np.ndarray,
        node: np.ndarray,
        noise: np.ndarray,
        *,
        channel_error: float,
        rounds: int,
    ) -> np.ndarray:
        config = SpectralConfig(slopes=(1.0,), channel_error=channel_error, rounds=rounds)
        blur = lens_blur(BlurModel(6.0, 12000.0), 97, 70, "cy_open")
        pairs = BlurEvidence(CrossFilterConfig(), blur, IDENTITY, ESTIMATED_NOISE, READABLE)
        chain = Chain(any_device())
        parts = np.stack([spectra.real, spectra.imag], axis=2)
        given = {"spectra": parts, "nodes": node.astype(np.uint32), "noise": noise}
        first, *others = (chain.constant(name, values) for name, values in given.items())
        found = add_likelihood(chain, first, powers[None], *others, source=SpectralEvidence(config, pairs))
        return chain.run({}, [found.name])[found.name].reshape(powers.shape[1], len(spectra)).T


SHADERS = Shaders()
compiled_run = pytest.param(COMPILED, id="compiled")
shaders_run = pytest.param(SHADERS, id="shaders", marks=pytest.mark.extra("gpu", "wgpu"))
READABLE_AND_COMPILED = pytest.mark.parametrize("run", [COMPILED, READABLE], ids=["compiled", "readable"])
