"""Evidence of all three channels together on a device; ``spectral_evidence.py`` explains what is computed.

What the blur of every layer passes on of a texture's power depends on the camera alone: it is computed once, by the
CPU, and goes up when the chain is composed. Of a photograph only the noise in every window goes up besides its pixels.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from chromaperture.matching.device.device import Array, Chain
from chromaperture.matching.device.workgroups import GROUP, groups_for
from chromaperture.matching.evidence.spectral import EVERY_LAYER, LEARNING_ROUNDS, LEAST_SHARE, SpectralEvidence
from chromaperture.matching.evidence.spectral_model import Windows
from chromaperture.matching.labels import LabelMap
from chromaperture.matching.readable.spectral_likelihood import (
    FIRST_CORRELATION,
    FIRST_ROUNDS,
    LEAST_AMPLITUDE,
    LEAST_DETERMINANT,
)

_LANES = 8  # invocations of a window


@dataclass(frozen=True)
class WindowGrid:
    """Windows around every ``stride``-th pixel of a photograph.

    Attributes
    ----------
    height, width, stride : int, px
    """

    height: int
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

    Parameters
    ----------
    chain : Chain
    source : SpectralEvidence
    grid : WindowGrid
    arrays : three Array
        Image (H, W, 3), its shading alike, and the noise's power in every window, (windows, 3).
    layers_px, labels_px : float, px
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
        "window_rows", [image, shading, table, rows], groups=groups_for(rows.size // 4),
        height=grid.height, **same,
    )  # fmt: skip
    chain.add(
        "window_spectra", [rows, table, numbers, taper, spectra], groups=groups_for(grid.count, 1),
        window_columns=len(grid.columns), frequencies=len(windows.fy), **same,
    )  # fmt: skip
    return spectra


def add_likelihood(
    chain: Chain, spectra: Array, powers: np.ndarray, nodes: Array, noise: Array, *, source: SpectralEvidence
) -> Array:
    """Append `stages.spectral_likelihood` for every slope: (layers, slopes, windows).

    Parameters
    ----------
    chain : Chain
    spectra : Array
        (windows, 3, 2, F).
    powers : (slopes, nodes, layers, 9, F) float32
    nodes, noise : Array
        (windows,) and (windows, 3).
    source : SpectralEvidence
    """
    slopes, node_count, layers, _, frequencies = powers.shape
    windows = nodes.size
    by_slope = chain.array("by_slope", layers * slopes * windows)
    chain.add(
        "spectral_likelihood", [spectra, chain.constant("window_powers", powers), nodes, noise, by_slope],
        groups=groups_for(slopes * windows, GROUP // _LANES),
        windows=windows, slopes=slopes, node_count=node_count,
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
        "slope_evidence", [by_slope, of_slope], groups=groups_for(grid.count),
        layers=len(few_px), redundancy=float(windows.redundancy), **same,
    )  # fmt: skip
    chain.add("slope_shares", [of_slope, shares], groups=(1,), rounds=LEARNING_ROUNDS, least_share=LEAST_SHARE, **same)
    map_ = source.pairs.label_map
    if not map_.is_identity:
        map_ = LabelMap(*(part[np.ix_(grid.rows, grid.columns)] for part in map_))
    begin = (map_.offset_px + (map_.scale - 1) * few_px[0]) / step
    at_windows = chain.constant("window_label_map", np.stack(np.broadcast_arrays(begin, map_.scale), axis=-1))
    earned = chain.array("windows", grid.count * len(labels_px))
    chain.add(
        "window_labels", [by_slope, shares, at_windows, earned], groups=groups_for(grid.count, 1),
        layers=len(few_px), count=len(labels_px), redundancy=float(windows.redundancy),
        area_px2=float(windows.area_px2), one_map=map_.is_identity,
        first_label=float((labels_px[0] - few_px[0]) / step),
        label_step=float((labels_px[1] - labels_px[0]) / step), gain=float(config.gain),
        cap_nats=float(config.cap_nats), **same,
    )  # fmt: skip
    return earned
