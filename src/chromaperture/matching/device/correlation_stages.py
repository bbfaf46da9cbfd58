"""Scores of all layers on the device: ``readable/correlation.py``, in WGSL.

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

from chromaperture.matching.device.device import GROUP, Array, Chain
from chromaperture.matching.device.view_stages import GUIDE_SCALE, Planes
from chromaperture.matching.integer_light import LOGARITHM, whole_taps
from chromaperture.matching.readable.correlation import (
    CELL_EPSILON,
    CELL_TAPS,
    CONTRARY,
    LEAST_FLOOR,
    RELATIVE_EPSILON,
    SAMPLING,
    SCORE_PARTS,
    padding,
    window_reach,
)
from chromaperture.matching.readable.enlarge import JUMP_PX
from chromaperture.matching.readable.four_paths import LEAST_DETERMINANT, NAT_PARTS
from chromaperture.settings.stages import CorrelationConfig

_BLOCK = 64  # most px of a line that an invocation takes
_CHUNK_BYTES = 128e6  # of the largest array of a chunk: WebGPU's default limit of a binding
_EACH = 16  # neighbours that an invocation samples: 5 % more taps are read than with all of a line
_PHASES = 1e6  # sub-pixel phases that differ by less than one part are one
WINDOW_REACH_PX = len(CELL_TAPS) // 2  # of a cell's window
# What `nats` needs.
LIKELIHOOD: dict[str, Any] = {
    "least_determinant": LEAST_DETERMINANT,
    "nat_parts": NAT_PARTS,
    "logarithm_terms": LOGARITHM,
    "logarithm_count": len(LOGARITHM),
}
_CELLS = 8  # that an invocation takes, one below the other: they share the sums of 3 of their 5 rows


class Kept(NamedTuple):
    """What the last stage makes of a score before it leaves it: a section with the function ``keep``."""

    name: str  # of the array that is left
    uses: tuple[str, ...]  # sections, that with ``keep`` among them
    constants: dict[str, Any]  # what these need
    more: int = 0  # further maps of a pixel behind those of a chunk's layers
    together: int = 1  # the maps of a pixel are filled up to a multiple of this

    def pitch_of(self, layers: int) -> int:
        """Return the maps of a pixel in a chunk of so many layers."""
        quads = -(-layers // 4)
        filled = 4 * quads - 1 if layers < 4 * quads else layers  # one place is free, or none
        return -(-((filled if self.more else layers) + self.more) // self.together) * self.together


class Chunk(NamedTuple):
    """Some layers and where they find their samples."""

    first: int
    size: int
    phases_y: np.ndarray  # (Ey, 8) float32: four taps, the view, three of nothing
    phases_x: np.ndarray  # (E, 8) float32: four taps, the phase along y, three of nothing
    places: np.ndarray  # (K, C, 4) int32: entry, whole px along x, along y, 0

    @property
    def quads(self) -> int:
        """Layers by four; the last four are filled with the last layer."""
        return -(-self.size // 4)


def chunks_of(
    layers_px: np.ndarray,
    directions: np.ndarray,
    sampling: str,
    most_entries: int,
    most_layers: int,
    *,
    whole: bool = False,
) -> list[Chunk]:
    """Cut the layers into chunks of at most so many entries and layers, the first the largest.

    All chunks but the last have a multiple of four layers, and four layers may need more than that. Where ``whole``,
    the taps are whole parts (`integer_light.whole_taps`).
    """
    found: list[Chunk] = []
    first = 0
    while first < len(layers_px):
        count = min(len(layers_px) - first, found[-1].size if found else max(4, most_layers // 4 * 4))
        chunk = _chunk(layers_px, directions, sampling, first, count, whole=whole)
        while len(chunk.phases_x) > most_entries and count > 4:
            count = 4 * -(-count // 8)
            chunk = _chunk(layers_px, directions, sampling, first, count, whole=whole)
        found.append(chunk)
        first += count
    return found


def _chunk(
    layers_px: np.ndarray, directions: np.ndarray, sampling: str, first: int, count: int, *, whole: bool
) -> Chunk:
    along_y: dict[tuple[int, float], int] = {}
    along_x: dict[tuple[int, float], int] = {}
    places = np.zeros((len(directions), count, 4), np.int32)
    for k, direction in enumerate(directions):
        for c in range(count):
            (whole_x, phase_x), (whole_y, phase_y) = (_split(layers_px[first + c] * part) for part in direction)
            y = along_y.setdefault((k, phase_y), len(along_y))
            entry = along_x.setdefault((y, phase_x), len(along_x))
            places[k, c] = entry, whole_x, whole_y, 0

    def taps(phase: float) -> tuple[float, ...]:
        exact = SAMPLING[sampling](phase)
        return tuple(whole_taps(exact)) if whole else exact

    rows = np.array([(*taps(phase), view, 0, 0, 0) for view, phase in along_y], np.float32)
    columns = np.array([(*taps(phase), y, 0, 0, 0) for y, phase in along_x], np.float32)
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
    kept: Kept | None = None,
) -> Iterator[tuple[Array, Chunk]]:
    """Add the scores, chunk after chunk; what is added between two chunks may read the last one's.

    ``layers_px``: (D,), ``directions``: (K, 2). With ``pitch``, layers of a pixel in one volume (h, w, pitch) of all
    chunks; without it every chunk has (h, w, C) of its own. ``chunked``: chunks are small enough for their scores, too,
    to fit. ``kept``: what is left of the scores instead of themselves.
    """
    pad_x, pad_y = padding(layers_px, directions, config.sampling)
    kept = kept or Kept("score", ("scores_kept",), {})
    tall, wide = planes.height + 2 * pad_y, planes.width + 2 * pad_x
    most_bytes = min(_CHUNK_BYTES, chain.device.largest_bytes)
    reach = window_reach(config.window_decay)
    # Of an entry, two deviations; of a layer of its own, score and weight.
    most_entries = max(1, int(most_bytes // (8 * (tall + reach) * (wide + reach))))
    most_layers = max(1, int(most_bytes // (4 * tall * wide)) - 1) if chunked else len(layers_px)
    words = 4 if planes.view_count == 2 else 12  # of the covariances of all pairs, of four layers
    (block_x, blocks_x), (block_y, blocks_y) = (_even_blocks(side) for side in (planes.width, planes.height))
    steps_x, steps_y = block_x + max(reach, pad_x), block_y + max(reach, pad_y)
    columns = -(-planes.width // 4) * 4
    of_quad = words * max(tall * blocks_x * steps_x, columns * blocks_y * steps_y)  # numbers that wait in `ahead`
    # The last workgroup is a whole one, of up to four columns an invocation.
    waiting = chain.device.largest_bytes // 4 - words * GROUP * 4 * max(steps_x, steps_y)
    most_layers = min(most_layers, 4 * int(waiting // of_quad))
    chunks = chunks_of(layers_px, directions, config.sampling, most_entries, most_layers)
    volume = _largest(chain, kept.name, [planes.pixels * (pitch or kept.pitch_of(c.size)) for c in chunks])
    samples_y = _largest(chain, "samples_y", [tall * planes.width * len(c.phases_y) for c in chunks])
    samples = _largest(chain, "samples", [tall * wide * len(c.phases_x) for c in chunks])
    windows = _largest(chain, "windows", [2 * tall * (wide + reach) * len(c.phases_x) for c in chunks])
    apart_x = _largest(chain, "deviations_x", [2 * tall * (wide + reach) * len(c.phases_x) for c in chunks])
    apart_y = _largest(chain, "deviations_y", [2 * (tall + reach) * wide * len(c.phases_x) for c in chunks])
    gains = _largest(chain, "gains", [(tall + reach) * wide * len(c.phases_x) for c in chunks])
    quads = [chunk.quads for chunk in chunks]
    covariances = _largest(chain, "covariances", [words * tall * planes.width * count for count in quads])
    invocations = [(tall * blocks_x * count, planes.width * blocks_y * count) for count in quads]
    most_steps = [max(-(-x // GROUP) * steps_x, -(-y // GROUP) * steps_y) for x, y in invocations]
    ahead = _largest(chain, "ahead", [words * GROUP * steps for steps in most_steps])
    pairs = "pairs_two" if planes.view_count == 2 else "pairs_three"
    decay = float(config.window_decay)
    window: dict[str, Any] = {"decay": decay, "reach": reach}
    unit = math.sqrt(decay * (1 - decay))  # of deviations, so that their products need no factor
    size: dict[str, Any] = {"width": planes.width, "height": planes.height, "pad_x": pad_x, "pad_y": pad_y}
    for number, chunk in enumerate(chunks):
        entries = len(chunk.phases_x)
        filled = np.pad(chunk.places, ((0, 0), (0, 4 * chunk.quads - chunk.size), (0, 0)), mode="edge")
        places = chain.constant(f"places{number}", filled)
        taps_y, taps_x = add_samples(chain, planes, chunk, number, samples_y, samples, pad_x=pad_x, pad_y=pad_y)
        frame: dict[str, Any] = {"row_count": tall, "columns": wide, "entry_count": entries, **window}
        block, blocks = _even_blocks(wide + reach)
        chain.add(
            "windows_x", [samples, windows, apart_x], tall * blocks * entries, block=block, deviation_unit=unit,
            **frame,
        )  # fmt: skip
        block, blocks = _even_blocks(tall + reach)
        chain.add(
            "windows_y", [windows, taps_x, taps_y, planes.stats, apart_y, gains], wide * blocks * entries,
            relative_epsilon=RELATIVE_EPSILON, block=block, deviation_unit=unit, **frame,
        )  # fmt: skip
        layers: dict[str, Any] = {"quads": quads[number], "entry_count": entries, **size, **window}
        layers["view_count"] = planes.view_count
        mask = [] if kept.uses == ("scores_kept",) else [planes.planes]
        score: dict[str, Any] = {
            "pitch": pitch or kept.pitch_of(chunk.size), "first_layer": chunk.first if pitch else 0,
            "layer_count": chunk.size, "kept_at": 5, **kept.constants,
        }  # fmt: skip
        along_x, along_y = [apart_x, places, ahead, covariances], [covariances, places, apart_y, gains, ahead, volume]
        along_y += mask
        of_x, of_y = invocations[number]
        chain.add("products_x", along_x, of_x, uses=(pairs,), block=block_x, **layers)
        chain.add("correlation", along_y, of_y, uses=(pairs, *kept.uses), block=block_y, **layers, **score)
        yield volume, chunk


def add_samples(
    chain: Chain,
    planes: Planes,
    chunk: Chunk,
    number: int,
    samples_y: Array,
    samples: Array,
    *,
    pad_x: int,
    pad_y: int,
    whole: bool = False,
) -> tuple[Array, Array]:
    """Add the samples of a chunk, (h + 2 pad_y, w + 2 pad_x, E); return the taps along y and along x.

    Where ``whole``, light counts in whole units.
    """
    tall, wide = planes.height + 2 * pad_y, planes.width + 2 * pad_x
    entries = len(chunk.phases_x)
    taps_y = add_samples_y(chain, planes, chunk, number, samples_y, margin=0, pad_y=pad_y, whole=whole)
    taps_x = chain.constant(f"taps_x{number}", chunk.phases_x)
    chain.add(
        "sample_x", [samples_y, taps_x, samples], tall * -(-wide // _EACH) * entries, width=planes.width,
        height=planes.height, pad_y=pad_y, phase_count=len(chunk.phases_y), whole=whole, each=_EACH, pad_x=pad_x,
        entry_count=entries,
    )  # fmt: skip
    return taps_y, taps_x


def add_samples_y(
    chain: Chain, planes: Planes, chunk: Chunk, number: int, samples_y: Array, *, margin: int, pad_y: int, whole: bool
) -> Array:
    """Add the samples of a chunk between rows, (h + 2 pad_y, w + 2 margin, Ey); return the taps along y."""
    tall, wide, phases = planes.height + 2 * pad_y, planes.width + 2 * margin, len(chunk.phases_y)
    taps_y = chain.constant(f"taps_y{number}", chunk.phases_y)
    chain.add(
        "sample_y", [planes.planes, taps_y, planes.stats, samples_y], -(-tall // _EACH) * wide * phases,
        width=planes.width, height=planes.height, margin=margin, pad_y=pad_y, phase_count=phases, whole=whole,
        each=_EACH,
    )  # fmt: skip
    return taps_y


def _even_blocks(pixels: int) -> tuple[int, int]:
    """Return the length of the blocks of a line, about equal ones, and their number."""
    blocks = -(-pixels // _BLOCK)
    return -(-pixels // blocks), blocks


def _largest(chain: Chain, name: str, sizes: list[int]) -> Array:
    return chain.array(name, max(sizes))


def add_cell_planes(chain: Chain, planes: Planes) -> Planes:
    """Add views, guide and mask of the cells of a halved picture."""
    tall, wide, count = -(-planes.height // 2), -(-planes.width // 2), planes.view_count + 2
    cells = chain.array("cell_planes", count * tall * wide)
    chain.add(
        "cell_planes", [planes.planes, cells], cells.size, plane_count=count, width=planes.width, height=planes.height,
        cells_wide=wide, cells_tall=tall,
    )  # fmt: skip
    return Planes(cells, planes.stats, None, wide, tall, planes.view_count)


def add_cell_scores(
    chain: Chain,
    planes: Planes,
    cells: Planes,
    layers_px: np.ndarray,
    directions: np.ndarray,
    config: CorrelationConfig,
) -> Array:
    """Add the scores of all layers; (cells, D)."""
    pad_x, pad_y = (pad + WINDOW_REACH_PX for pad in padding(layers_px, directions, config.sampling))
    # A second column of cells at the border reaches 2 px further, the taps that three views read with it another one.
    pad_x += 2 * WINDOW_REACH_PX
    tall, wide = planes.height + 2 * pad_y, planes.width + 2 * pad_x
    three = planes.view_count == 3
    most = int(min(_CHUNK_BYTES, chain.device.largest_bytes) // (4 * tall * wide))
    chunks = chunks_of(layers_px, directions, config.sampling, most, len(layers_px), whole=True)
    margin = pad_x if three else 0
    most_phases = max(len(chunk.phases_y) for chunk in chunks)
    samples = samples_y = chain.array("samples_y", tall * (planes.width + 2 * margin) * most_phases)
    if not three:
        samples = chain.array("samples", tall * wide * max(len(chunk.phases_x) for chunk in chunks))
    score = chain.array("score", cells.pixels * len(layers_px))
    for number, chunk in enumerate(chunks):
        if three:
            add_samples_y(chain, planes, chunk, number, samples_y, margin=margin, pad_y=pad_y, whole=True)
            further = [chain.constant(f"taps_x{number}", chunk.phases_x)]
        else:
            add_samples(chain, planes, chunk, number, samples_y, samples, pad_x=pad_x, pad_y=pad_y, whole=True)
            further = []
        chain.add(
            "cell_scores", [samples, chain.constant(f"places{number}", chunk.places), planes.stats, score, *further],
            -(-cells.height // _CELLS) * -(-cells.width // 2) * chunk.size,
            uses=("cells_three" if three else "cells_two",), views=planes.view_count, cells_each=_CELLS,
            cells_wide=cells.width, cells_tall=cells.height, entry_count=len(chunk.phases_x),
            phase_count=len(chunk.phases_y), layer_count=chunk.size, first_layer=chunk.first, all_layers=len(layers_px),
            reach=WINDOW_REACH_PX, score_parts=SCORE_PARTS, relative_epsilon=sum(CELL_TAPS) ** 4 * CELL_EPSILON,
            least_floor=sum(CELL_TAPS) ** 4 * LEAST_FLOOR, width=planes.width, pad_x=pad_x, pad_y=pad_y,
        )  # fmt: skip
    if not three:
        chain.add(
            "own_sign", [score], cells.pixels, cell_count=cells.pixels, all_layers=len(layers_px),
            contrary=float(SCORE_PARTS * CONTRARY),
        )  # fmt: skip
    return score


def add_label_likelihood(
    chain: Chain,
    cells: Planes,
    score: Array,
    labels: Array,
    layers_px: np.ndarray,
    labels_px: np.ndarray,
    *,
    pitch: int,
    score_parts: int,
    of_labels: dict[str, Any],
) -> Array:
    """Add the log-likelihoods of all labels; (cells, pitch)."""
    likelihood = chain.array("likelihood", cells.pixels * pitch)
    chain.add(
        "label_likelihood", [score, labels, cells.planes, likelihood], likelihood.size // 4, width=cells.width,
        height=cells.height, view_count=cells.view_count, all_layers=len(layers_px), label_count=len(labels_px),
        pitch=pitch, parts=(len(labels_px) - 1) // (len(layers_px) - 1), first_px=float(layers_px[0]),
        layer_step_px=float(layers_px[1] - layers_px[0]), **LIKELIHOOD, score_parts=score_parts, **of_labels,
    )  # fmt: skip
    return likelihood


def add_enlarged_cells(chain: Chain, planes: Planes, cells: Planes, surface: Array) -> Array:
    """Add the surface at the pixels of the halved picture; (h, w, 4)."""
    enlarged = chain.array("surface_enlarged", 4 * planes.pixels)
    chain.add(
        "cells_enlarged", [surface, planes.planes, planes.stats, enlarged], planes.pixels, width=planes.width,
        height=planes.height, half_width=cells.width, jump_px=JUMP_PX, guide_start=planes.view_count * planes.pixels,
        guide_scale=GUIDE_SCALE,
    )  # fmt: skip
    return enlarged
