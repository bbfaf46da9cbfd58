"""Scores of all layers on the device: ``stages/correlation.py``, in WGSL.

Layers share samples: a view moved by whole px is the same samples elsewhere. So each view is sampled and windowed once
at every sub-pixel phase (an entry), and a layer only windows the product of two entries. Layers come in chunks whose
entries fit the memory: 32 layers of two halves need 8 entries, three filters one each for every layer and view.
Windows are joined from deviations, not from mean squares, so that 32 bits hold the scores of even areas, too.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from chromaperture.disparity.gpu.device import Array, Chain
from chromaperture.disparity.gpu.view_stages import SHARED, Planes
from chromaperture.disparity.gpu.workgroups import groups_for
from chromaperture.disparity.stages.correlation import RELATIVE_EPSILON, SAMPLING, padding
from chromaperture.stage_config import CorrelationConfig

# Share of a window's weight that lies beyond the samples a block of a line starts from, where the picture counts as
# even.
_NEGLIGIBLE = 1e-6
_BLOCK = 64  # most px of a line that an invocation takes
_CHUNK_BYTES = 128e6  # of the largest array of a chunk: WebGPU's default limit of a binding
_PHASES = 1e6  # sub-pixel phases that differ by less than one part are one


class Chunk(NamedTuple):
    """Some layers and where they find their samples."""

    first: int
    size: int
    phases_y: np.ndarray  # (Ey, 5) float32: four taps, the view
    phases_x: np.ndarray  # (E, 5) float32: four taps, the phase along y
    places: np.ndarray  # (K, C, 4) int32: entry, whole px along x, along y, 0


def chunks_of(
    layers_px: np.ndarray, directions: np.ndarray, sampling: str, most_entries: int, most_layers: int
) -> list[Chunk]:
    """Cut the layers into chunks of at most so many entries and layers, the first the largest.

    A single layer may need more entries than that.
    """
    found: list[Chunk] = []
    first = 0
    while first < len(layers_px):
        count = min(len(layers_px) - first, found[-1].size if found else most_layers)
        chunk = _chunk(layers_px, directions, sampling, first, count)
        while len(chunk.phases_x) > most_entries and count > 1:
            count = -(-count // 2)
            chunk = _chunk(layers_px, directions, sampling, first, count)
        found.append(chunk)
        first += count
    return found


def _chunk(layers_px: np.ndarray, directions: np.ndarray, sampling: str, first: int, count: int) -> Chunk:
    along_y: dict[tuple[int, float], int] = {}
    along_x: dict[tuple[int, float], int] = {}
    places = np.zeros((len(directions), count, 4), np.int32)
    for k, direction in enumerate(directions):
        for c in range(count):
            (whole_x, phase_x), (whole_y, phase_y) = (_split(layers_px[first + c] * part) for part in direction)
            y = along_y.setdefault((k, phase_y), len(along_y))
            entry = along_x.setdefault((y, phase_x), len(along_x))
            places[k, c] = entry, whole_x, whole_y, 0
    taps = SAMPLING[sampling]
    rows = np.array([(*taps(phase), view) for view, phase in along_y], np.float32)
    columns = np.array([(*taps(phase), y) for y, phase in along_x], np.float32)
    return Chunk(first, count, rows, columns, places)


def _split(offset_px: float) -> tuple[int, float]:
    """Whole px and the phase in [0, 1), of 1 / `_PHASES`."""
    parts = round(float(offset_px) * _PHASES)
    return math.floor(parts / _PHASES), (parts % _PHASES) / _PHASES


def add_correlation(
    chain: Chain,
    planes: Planes,
    layers_px: np.ndarray,
    directions: np.ndarray,
    config: CorrelationConfig,
    *,
    pitch: int | None = None,
    chunked: bool = False,
) -> Iterator[tuple[Array, Chunk]]:
    """Add the scores, chunk after chunk; what is added between two chunks may read the last one's.

    Parameters
    ----------
    chain : Chain
    planes : Planes
    layers_px : (D,) float, px
    directions : (K, 2) float
    config : CorrelationConfig
    pitch : int, optional
        Layers of a pixel in one volume (h, w, pitch) of all chunks; without it every chunk has (h, w, C) of its own.
    chunked : bool
        Chunks are small enough for their scores, too, to fit.

    Yields
    ------
    score : Array
    chunk : Chunk
    """
    pad_x, pad_y = padding(layers_px, directions, config.sampling)
    tall, wide = planes.height + 2 * pad_y, planes.width + 2 * pad_x
    most_bytes = min(_CHUNK_BYTES, chain.device.largest_bytes)
    # Of an entry, mean and gain; of a layer of its own, score and weight.
    most_entries = max(1, int(most_bytes // (8 * tall * wide)))
    most_layers = max(1, int(most_bytes // (4 * tall * wide)) - 1) if chunked else len(layers_px)
    chunks = chunks_of(layers_px, directions, config.sampling, most_entries, most_layers)
    volume = _largest(chain, "score", [planes.pixels * (pitch or c.size) for c in chunks])
    samples_y = _largest(chain, "samples_y", [tall * planes.width * len(c.phases_y) for c in chunks])
    samples = _largest(chain, "samples", [tall * wide * len(c.phases_x) for c in chunks])
    windows = _largest(chain, "windows", [2 * tall * wide * len(c.phases_x) for c in chunks])
    gains = _largest(chain, "gains", [tall * wide * len(c.phases_x) for c in chunks])
    words = 1 if planes.view_count == 2 else 4  # of the covariances of all pairs; WGSL aligns three to four
    covariances = _largest(chain, "covariances", [words * tall * planes.width * c.size for c in chunks])
    pairs = "pairs_two" if planes.view_count == 2 else "pairs_three"
    reach = math.ceil(math.log(_NEGLIGIBLE) / math.log(config.window_decay))
    window: dict[str, Any] = {"decay": float(config.window_decay), "reach": reach}
    size: dict[str, Any] = {"width": planes.width, "height": planes.height, "pad_x": pad_x, "pad_y": pad_y}
    for number, chunk in enumerate(chunks):
        entries, phases = len(chunk.phases_x), len(chunk.phases_y)
        taps_y, taps_x = (
            chain.constant(f"taps_y{number}", chunk.phases_y),
            chain.constant(f"taps_x{number}", chunk.phases_x),
        )
        places = chain.constant(f"places{number}", chunk.places)
        chain.add(
            "sample_y", [planes.planes, taps_y, samples_y],
            groups=groups_for(tall * planes.width * phases), uses=SHARED,
            width=planes.width, height=planes.height, pad_y=pad_y, phase_count=phases,
        )  # fmt: skip
        chain.add(
            "sample_x", [samples_y, taps_x, samples], groups=groups_for(tall * wide * entries), uses=SHARED,
            phase_count=phases, entry_count=entries, **size,
        )  # fmt: skip
        frame: dict[str, Any] = {"row_count": tall, "columns": wide, "entry_count": entries, **window}
        block, blocks = _even_blocks(wide)
        chain.add(
            "windows_x", [samples, windows], groups=groups_for(tall * blocks * entries), uses=SHARED,
            block=block, **frame,
        )  # fmt: skip
        block, blocks = _even_blocks(tall)
        chain.add(
            "windows_y", [windows, taps_x, taps_y, planes.stats, gains],
            groups=groups_for(wide * blocks * entries), uses=SHARED,
            relative_epsilon=RELATIVE_EPSILON, block=block, **frame,
        )  # fmt: skip
        layers: dict[str, Any] = {"layer_count": chunk.size, "entry_count": entries, **size, **window}
        layers["view_count"] = planes.view_count
        block, blocks = _even_blocks(planes.width)
        chain.add(
            "products_x", [samples, places, covariances],
            groups=groups_for(tall * blocks * chunk.size), uses=(*SHARED, pairs), block=block, **layers,
        )  # fmt: skip
        block, blocks = _even_blocks(planes.height)
        chain.add(
            "correlation", [covariances, places, windows, gains, volume],
            groups=groups_for(planes.width * blocks * chunk.size), uses=(*SHARED, pairs),
            pitch=pitch or chunk.size, first_layer=chunk.first if pitch else 0, block=block, **layers,
        )  # fmt: skip
        yield volume, chunk


def _even_blocks(pixels: int) -> tuple[int, int]:
    """Return the length of the blocks of a line, about equal ones of at most `_BLOCK` px, and their number."""
    blocks = -(-pixels // _BLOCK)
    return -(-pixels // blocks), blocks


def _largest(chain: Chain, name: str, sizes: list[int]) -> Array:
    return chain.array(name, max(sizes))
