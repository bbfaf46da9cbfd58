"""Log-likelihoods at labels on a device: of fractions or scores of layers, and of windows of all channels.

What the blur of every layer passes on of a texture's power depends on the camera alone: it is computed once, by the
CPU, and goes up when the chain is composed. Of a photograph only the noise in every window goes up besides its pixels.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from chromaperture.matching.blocks import BLOCK_PX
from chromaperture.matching.device.correlation_stages import add_correlation
from chromaperture.matching.device.device import GROUP, Array, Chain, groups_for
from chromaperture.matching.device.evidence_stages import EvidencePlan
from chromaperture.matching.device.surface_stages import Grid, add_block_means
from chromaperture.matching.device.view_stages import add_views
from chromaperture.matching.evidence.blur import SPACING_PX
from chromaperture.matching.evidence.correlation import MOST_EXPLAINED, CorrelationEvidence
from chromaperture.matching.evidence.spectral import EVERY_LAYER, LEARNING_ROUNDS, LEAST_SHARE, SpectralEvidence
from chromaperture.matching.evidence.spectral_model import Windows
from chromaperture.matching.labels import LabelMap
from chromaperture.matching.readable.paths import EDGE_LAYERS, LEAST_UNEXPLAINED
from chromaperture.matching.readable.spectral_likelihood import (
    FIRST_CORRELATION,
    FIRST_ROUNDS,
    LEAST_AMPLITUDE,
    LEAST_DETERMINANT,
)

_LANES = 8  # invocations of a window


@dataclass(frozen=True)
class WindowGrid:
    """Windows around every ``stride``-th pixel of a photograph."""

    height: int  # px, all three
    width: int
    stride: int

    @property
    def rows(self) -> np.ndarray:
        """Middles along y, px."""
        return np.arange(0, self.height, self.stride)

    @property
    def columns(self) -> np.ndarray:
        """Middles along x, px."""
        return np.arange(0, self.width, self.stride)

    @property
    def count(self) -> int:
        """Windows."""
        return len(self.rows) * len(self.columns)


def add_windows(
    chain: Chain,
    source: SpectralEvidence,
    grid: WindowGrid,
    arrays: tuple[Array, Array, Array],
    layers_px: np.ndarray,
    labels_px: np.ndarray,
) -> Array:
    """Append `SpectralEvidence.of_windows`: what labels earn in every window, (windows, N) nats a pixel.

    ``arrays``: image (H, W, 3), its shading alike, and the noise's power in every window, (windows, 3).
    """
    image, shading, noise = arrays
    few_px = layers_px[::EVERY_LAYER]
    model = source.model(few_px)
    spectra = add_spectra(chain, model.windows, grid, image, shading)
    nodes = chain.constant("window_nodes", model.nodes(grid.rows, grid.columns).astype(np.uint32))
    by_slope = add_likelihood(chain, spectra, source.powers_of(model), nodes, noise, source=source)
    return _add_labels(chain, source, grid, by_slope, few_px, labels_px)


def add_spectra(chain: Chain, windows: Windows, grid: WindowGrid, image: Array, shading: Array) -> Array:
    """Append `Windows.spectra`: (windows, 3, 2, F), real and imaginary parts."""
    few = len(windows.waves) // 2
    pairs = -(-few // 2)
    waves = np.zeros((windows.side, 2 * pairs, 2), np.float32)
    waves[:, :few, 0], waves[:, :few, 1] = windows.waves[:few].T, windows.waves[few:].T
    table = chain.constant("window_waves", waves)
    down, across = windows.wave_numbers
    numbers = chain.constant("wave_numbers", np.stack([across, down], axis=-1).astype(np.int32))
    taper = chain.constant("taper", windows.taper.view(np.float32))
    rows = chain.array("window_rows", len(grid.rows) * pairs * grid.width * 12)
    spectra = chain.array("window_spectra", grid.count * 6 * len(windows.fy))
    same: dict[str, Any] = dict(
        width=grid.width, window_rows=len(grid.rows), stride=grid.stride, side=windows.side, pairs=pairs
    )  # fmt: skip
    chain.add(
        "window_rows", [image, shading, table, rows], rows.size // 4, height=grid.height, **same,
    )  # fmt: skip
    chain.add(
        "window_spectra", [rows, table, numbers, taper, spectra], groups=groups_for(grid.count, 1),
        window_columns=len(grid.columns), frequencies=len(windows.fy), **same,
    )  # fmt: skip
    return spectra


def add_likelihood(
    chain: Chain, spectra: Array, powers: np.ndarray, nodes: Array, noise: Array, *, source: SpectralEvidence
) -> Array:
    """Append `readable.spectral_likelihood` for every slope: (layers, slopes, windows).

    ``powers``: (slopes, nodes, layers, 9, F) float32; ``nodes``: (windows,); ``noise``: (windows, 3).
    """
    slopes, node_count, layers, _, frequencies = powers.shape
    windows = nodes.size
    by_slope = chain.array("by_slope", layers * slopes * windows)
    chain.add(
        "spectral_likelihood", [spectra, chain.constant("window_powers", powers), nodes, noise, by_slope],
        groups=groups_for(slopes * windows, GROUP // _LANES), windows=windows, slopes=slopes, node_count=node_count,
        layers=layers, frequencies=frequencies, rounds=source.config.rounds, first_rounds=FIRST_ROUNDS,
        channel_error=float(source.config.channel_error), first_correlation=FIRST_CORRELATION,
        least_amplitude=LEAST_AMPLITUDE, least_determinant=LEAST_DETERMINANT,
    )  # fmt: skip
    return by_slope


def _add_labels(
    chain: Chain, source: SpectralEvidence, grid: WindowGrid, by_slope: Array, few_px: np.ndarray, labels_px: np.ndarray
) -> Array:
    """Append the average over slopes, and what labels earn."""
    config, windows = source.config, Windows(source.config)
    slopes, step = len(config.slopes), float(few_px[1] - few_px[0])
    same: dict[str, Any] = dict(windows=grid.count, slopes=slopes)
    of_slope, shares = (chain.array(name, n) for name, n in (("of_slope", slopes * grid.count), ("shares", slopes)))
    chain.add(
        "slope_evidence", [by_slope, of_slope], grid.count, layers=len(few_px), redundancy=float(windows.redundancy),
        **same,
    )  # fmt: skip
    chain.add("slope_shares", [of_slope, shares], groups=(1,), rounds=LEARNING_ROUNDS, least_share=LEAST_SHARE, **same)
    map_ = source.pairs.label_map.at(grid.rows, grid.columns)
    at_windows = _label_map(chain, map_, few_px, name="window_label_map")
    earned = chain.array("windows", grid.count * len(labels_px))
    chain.add(
        "window_labels", [by_slope, shares, at_windows, earned], groups=groups_for(grid.count, 1), layers=len(few_px),
        count=len(labels_px), redundancy=float(windows.redundancy), area_px2=float(windows.area_px2),
        one_map=map_.is_identity, first_label=float((labels_px[0] - few_px[0]) / step),
        label_step=float((labels_px[1] - labels_px[0]) / step), gain=float(config.gain),
        cap_nats=float(config.cap_nats), **same,
    )  # fmt: skip
    return earned


class WindowEvidence(NamedTuple):
    """What labels earn in windows of all channels, and where the photograph is usable."""

    earned: Array
    usable: Array
    grid: WindowGrid


def add_labels(
    chain: Chain,
    plan: EvidencePlan,
    unexplained: Array,
    counted: Array,
    likelihood: Array,
    labels_px: np.ndarray,
    *,
    windows: WindowEvidence | None = None,
) -> None:
    """Append `readable.read_at_labels`, in the blocks of the photograph, and add what windows say.

    ``unexplained``: (samples, D); ``counted``: (h, w), factor on the evidence of pairs; ``likelihood``: (h, w, N),
    written.
    """
    source, samples = plan.source, plan.samples
    height, width = source.blur.height_px, source.blur.width_px
    at_labels = chain.array("at_labels", samples[0] * samples[1] * len(labels_px))
    same: dict[str, Any] = dict(
        width=width, height=height, count=len(labels_px), spacing=SPACING_PX,
        sample_height=samples[0], sample_width=samples[1],
    )  # fmt: skip
    chain.add(
        "labels_of_samples", [unexplained, _label_map(chain, source.label_map, plan.layers_px), at_labels],
        groups=groups_for(samples[0] * samples[1], 1), **same,
        **_polynomial(plan.layers_px, labels_px, source.label_map),
    )  # fmt: skip
    rows, columns = height // BLOCK_PX, width // BLOCK_PX
    arrays, uses = [at_labels, counted, likelihood], "windows_none"
    more: dict[str, Any] = {}
    if windows is not None:
        grid, uses = windows.grid, "windows_enlarged"
        arrays += [windows.earned, windows.usable]
        more = dict(window_rows=len(grid.rows), window_columns=len(grid.columns), stride=grid.stride)
    chain.add(
        "labels_between", arrays, groups=groups_for(rows * columns, 1), uses=(uses,), factors=float(plan.factors),
        block_rows=rows, block_columns=columns, block_px=BLOCK_PX, **same, **more,
    )  # fmt: skip


def add_views_evidence(
    chain: Chain,
    source: CorrelationEvidence,
    shape: tuple[int, int],
    arrays: tuple[Array, Array, Array],
    layers_px: np.ndarray,
    labels_px: np.ndarray,
) -> None:
    """Append the evidence of shifted views, `CorrelationEvidence.at`; ``shape`` is (H, W).

    ``arrays``: image, how far blocks are usable, and the likelihood, which is written.
    """
    image, usable, likelihood = arrays
    of_pixels = chain.array("pixel_likelihood", shape[0] * shape[1] * len(labels_px))
    for i, (space, label_map) in enumerate(zip(source.spaces, source.label_maps, strict=True)):
        planes = add_views(chain, image, shape, space, source.views)
        score: Array | None = None
        for volume, *_ in add_correlation(
            chain, planes, layers_px, space.directions, source.config.correlation, pitch=len(layers_px)
        ):
            score = volume
        assert score is not None
        chain.add(
            "labels_read", [score, _label_map(chain, label_map, layers_px), of_pixels],
            groups=groups_for(shape[0] * shape[1], 1), height=shape[0], width=shape[1], count=len(labels_px),
            factors=len(space.rows) - 1.0, views_of_score=len(space.rows), is_first=i == 0,
            most_explained=MOST_EXPLAINED, weight=1 / len(source.spaces),
            **_polynomial(layers_px, labels_px, label_map),
        )  # fmt: skip
    add_block_means(chain, of_pixels, usable, likelihood, Grid(*shape, len(labels_px)), BLOCK_PX)


def _polynomial(layers_px: np.ndarray, labels_px: np.ndarray, label_map: LabelMap) -> dict[str, Any]:
    """Return the constants of `label_polynomial` and of the places that it is given."""
    step = float(layers_px[1] - layers_px[0])
    return dict(
        layers=len(layers_px), one_map=label_map.is_identity,
        first_label=float((labels_px[0] - layers_px[0]) / step),
        label_step=float((labels_px[1] - labels_px[0]) / step),
        least_unexplained=LEAST_UNEXPLAINED, edge_layers=EDGE_LAYERS,
    )  # fmt: skip


def _label_map(chain: Chain, label_map: LabelMap, layers_px: np.ndarray, *, name: str = "label_map") -> Array:
    """Offset and scale of a label at every pixel, in layers from the first."""
    return chain.constant(
        name, np.stack(np.broadcast_arrays(label_map.first_layer(layers_px), label_map.scale), axis=-1)
    )
