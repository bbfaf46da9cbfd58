"""Correlation of shifted views, compiled; ``readable/correlation.py`` explains what is computed.

Schedule. Horizontal recursions need whole rows, vertical ones whole columns, and a volume of scores does not fit the
caches; so the picture is cut twice.

1. Bands of rows (`bands.py`), in parallel. A band samples its views at every sub-pixel phase the layers use, windows
   the samples and their squares once, and then, eight layers at a time, windows the products, makes correlations of
   them and filters these along x. What it works on stays in the cache; it leaves 16 bits
   a score, 32 a filtered one: rounded to 1 / 32000 these moved the depth of 1 to 4 % of the pixels by over 0.1 %.
2. Strips of columns (`strips.py`), in parallel: the filter along y, the best layer, the parabola.

Bands come in runs, and a run is the work of one thread. The first band of a run needs ``halo`` rows above, every band
as many below: the reach of a window. A band that follows another takes over its windows. Runs and bands depend on the
picture's size only, so the result does not depend on the number of threads.

Memory: 2 bytes a score (4 a filtered one), and for each thread a scratch of 35 MB at 1280 px width for two views along
x, up to 400 MB for three views that take every layer at a phase of its own. Both are kept for the next call.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import cv2
import numpy as np

from chromaperture.matching.compiled import bands, layout, strips
from chromaperture.matching.compiled.cell_scores import cell_scores
from chromaperture.matching.compiled.layout import LANES, whole_vectors
from chromaperture.matching.compiled.workspace import Workspace, workspace
from chromaperture.matching.readable.correlation import (
    MIN_VARIANCE_FRACTION,
    MIN_WEIGHT,
    RELATIVE_EPSILON,
    SAMPLING,
    padding,
    sampled_noise,
    window_reach,
)
from chromaperture.matching.views import ViewNoise, Views, is_even, view_pairs
from chromaperture.settings.stages import CorrelationConfig
from chromaperture.system.threads import in_parallel, thread_count

_BAND_ROWS = 180  # most rows of a band, chosen by hand: fewer repeat more of the halo, more take more memory
_RUN_HALOS = (
    6  # most rows of a run, in halos; chosen by hand: short runs repeat more rows, long ones leave threads idle
)
_MOST_SAMPLES_A_PX = 8  # of an up-sampled view; finer layers are sampled one by one


def correlate(views: Views, layers_px: np.ndarray, *, config: CorrelationConfig) -> np.ndarray:
    """Score every layer, as `readable.correlate`; (H, W, D) float32, rounded to 1 / 32000."""
    height, width = views.mask.shape
    shape = (height, width) if config.cell_px == 1 else (-(-height // 2), -(-width // 2))
    out = np.empty((*shape, len(layers_px)), np.float32)
    with workspace() as memory:
        if config.cell_px == 2:
            volume = cell_scores(views, layers_px, memory, config=config)
        else:
            volume, _ = filtered_scores(views, layers_px, memory, config=config)
        in_parallel(lambda _, top, bottom: strips.unpack_scores(volume, top, bottom, out), len(out))
    return out


def texture_weights(views: Views, *, config: CorrelationConfig) -> np.ndarray:
    """Weight every pixel by its texture against its noise, as `readable.texture_weights`; (H, W) float32."""
    with workspace() as memory:
        _, maps = filtered_scores(views, np.zeros(0), memory, config=config)
        return maps.weights.copy()


def filtered_scores(
    views: Views,
    layers_px: np.ndarray,
    memory: Workspace,
    *,
    config: CorrelationConfig,
    even_link: float | None = None,
    texture_weighting: bool = True,
) -> tuple[np.ndarray, layout.RowMaps]:
    """Score all layers and filter the scores along x.

    ``layers_px`` (D,) float, px: None at all: only the weights are computed; ``even_link``: link weight of the filter
    on an even guide. When absent nothing is filtered, and of the maps only the signal fractions are computed, where
    there are no layers; ``texture_weighting``: weight the scores by texture against noise before they are filtered.
    Returns ``volume`` int16, or float32 of filtered scores, flat; see ``layout.py``; ``maps`` RowMaps.
    """
    height, width = views.mask.shape
    known = sampled_noise(views, config)
    noise = _noise_planes(known, views.pictures.shape[2])
    plan = _plan(views, known, layers_px, config, even_link, texture_weighting)
    least = 2 * plan.pad_y + 8  # rows of the smallest band
    run_rows = _equal_parts(height, most=max(_BAND_ROWS, _RUN_HALOS * plan.halo, least))
    band_rows = _equal_parts(run_rows, most=max(_BAND_ROWS, least))
    runs = -(-height // run_rows)
    threads = min(thread_count(), runs)
    scratch = _scratch(plan, band_rows, width, threads, even_noise=noise[0].shape[1] == 1, memory=memory)
    wide = -(-width // layout.BLOCK) * layout.BLOCK
    name, dtype = ("volume", np.int16) if plan.numbers.plain else ("filtered_volume", np.float32)
    volume = memory.array(name, (wide * height * len(plan.layers.ceiling),), dtype)
    widths = dict(weights=width, links=width + 1, links_y=wide, filtered=wide)
    maps = layout.RowMaps(*(memory.array(name, (height, size), np.float32) for name, size in widths.items()))
    pictures = layout.Pictures(
        _planes(views.pictures),
        *noise,
        mask=np.ascontiguousarray(views.mask, np.float32),
        guide=np.ascontiguousarray(views.guide, np.float32),
    )

    def score_bands(thread: int, first: int, last: int) -> None:
        own = layout.Scratch(*(array[thread] for array in scratch))
        for run in range(first, last):
            start, end = run * run_rows, min((run + 1) * run_rows, height)
            for top in range(start, end, band_rows):
                band = layout.Band(top, min(top + band_rows, end), top == start)
                bands.score_band(pictures, plan, band, own, volume, maps)

    in_parallel(score_bands, runs, threads=threads)
    return volume, maps


def _equal_parts(rows: int, *, most: int) -> int:
    """Rows of each part when rows are cut into as few nearly equal parts of at most ``most`` rows as possible."""
    return -(-rows // -(-rows // most))


def _noise_planes(noise: ViewNoise | None, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Noise variance of ``count`` views and covariance of their pairs as planes; 0 where no use is made of them."""
    if noise is None:
        return tuple(np.zeros((n, 1, 1), np.float32) for n in (count, len(view_pairs(count))))  # type: ignore[return-value]
    return _planes(noise.variance), _planes(noise.covariance)


def _scratch(
    plan: layout.Plan, band_rows: int, width: int, threads: int, *, even_noise: bool, memory: Workspace
) -> layout.Scratch:
    """Memory of all threads, one row a thread."""
    samplings, layers = plan.samplings, plan.layers
    views, pairs, padded = len(layers.direct), len(layers.pairs), width + 2 * plan.pad_x
    rows = band_rows + 2 * plan.halo + 4 * plan.pad_y + 3 * layout.GROUP
    samples = (rows + 1) * samplings.row_length + 64
    windows = -(-len(samplings.owner) // 4) + len(layers.ceiling) // LANES * pairs
    sizes = dict(
        value=samples,
        gain=samples,
        mean_gain=samples,
        noise_sample=samplings.row_length + 64 if even_noise else samples,
        ring=pairs * (rows + 1) * padded * LANES,
        carry=windows * padded * LANES,
        state=pairs * padded * LANES,
        lanes=(views * layout.GROUP + 2) * (padded + LANES) * LANES,
        scores=width * LANES,
        line=width + 2 * samplings.margin + 16,
    )
    return layout.Scratch(
        *(memory.array(name, (threads, -(-size // 16) * 16), np.float32) for name, size in sizes.items())
    )


@dataclass
class _Entries:
    """Where the samples of every sub-pixel phase of every view are kept."""

    owner: list[int] = field(default_factory=list)
    phases: list[tuple[float, float]] = field(default_factory=list)
    start: list[int] = field(default_factory=list)
    step: list[int] = field(default_factory=list)
    of_phase: dict[tuple[int, tuple[float, float]], int] = field(default_factory=dict)
    length: int = 0

    def add(self, view: int, phase: tuple[float, float], start: int, step: int) -> int:
        self.of_phase[view, phase] = len(self.owner)
        self.owner.append(view)
        self.phases.append(phase)
        self.start.append(start)
        self.step.append(step)
        return len(self.owner) - 1

    def find_or_append(self, view: int, phase: tuple[float, float], size: int) -> int:
        """Return the entry of a view's phase; a new one is kept behind all others."""
        if (view, phase) not in self.of_phase:
            self.add(view, phase, self.length, 1)
            self.length += size
        return self.of_phase[view, phase]


def _plan(
    views: Views,
    noise: ViewNoise | None,
    layers_px: np.ndarray,
    config: CorrelationConfig,
    even_link: float | None,
    texture_weighting: bool,
) -> layout.Plan:
    """Choose the sub-pixel phases at which the views are sampled, where they are kept, and how layers find them."""
    directions, pairs = views.directions, view_pairs(len(views.directions))
    pad = padding(layers_px, directions, config.sampling) if len(layers_px) else (0, 0)
    count, lanes = len(layers_px), whole_vectors(len(layers_px))
    margin = 2 * pad[0] + 2 * LANES + 4
    row = views.mask.shape[1] + 2 * margin
    entries = _Entries()
    direct = np.array([_is_direct(layers_px, direction) for direction in directions])
    start, step, still = (np.zeros(len(directions), np.int64) for _ in range(3))
    entry, whole = np.zeros((len(directions), lanes), np.int64), np.zeros((len(directions), lanes, 2), np.int64)
    for k, direction in enumerate(directions):
        if direct[k]:
            start[k], step[k] = _keep_direct(entries, k, layers_px, direction[0], row, margin)
        else:
            offsets = layers_px[:, None] * direction
            base = np.floor(offsets + 1e-9)  # 1e-9: a whole shift but for rounding is whole
            parts = np.maximum(offsets - base, 0)
            for s in range(lanes if count else 0):
                layer = min(s, count - 1)  # lanes beyond the last layer repeat it
                phase = (round(float(parts[layer, 0]), 9), round(float(parts[layer, 1]), 9))
                entry[k, s] = entries.find_or_append(k, phase, row)
                whole[k, s] = base[layer]
        still[k] = entries.find_or_append(k, (0.0, 0.0), row)

    taps_of = SAMPLING[config.sampling]
    taps = np.array([[taps_of(t) for t in phase] for phase in entries.phases], np.float32)
    overlap = np.zeros((len(pairs), lanes), np.float32)
    if noise is not None:
        overlap[:, :count] = noise.overlap(layers_px, directions).T * config.noise_debiasing
    ceiling = np.where(np.arange(lanes) < count, 1, -1).astype(np.float32)
    samplings = layout.Samplings(
        owner=np.array(entries.owner),
        taps_x=np.ascontiguousarray(taps[:, 0]),
        taps_y=np.ascontiguousarray(taps[:, 1]),
        start=np.array(entries.start),
        step=np.array(entries.step),
        still=still,
        row_length=entries.length,
        margin=margin,
    )
    numbers = layout.Numbers(
        decay=np.float32(config.window_decay),
        debias=np.float32(config.noise_debiasing),
        weighting=texture_weighting,
        even_link=np.float32(even_link or 0),
        plain=even_link is None and count > 0,
        epsilon=_variance_floor(_planes(views.pictures)),
        min_fraction=np.float32(MIN_VARIANCE_FRACTION),
        min_weight=np.float32(MIN_WEIGHT),
    )
    layers = layout.Layers(direct, start, step, entry, whole, overlap.ravel(), ceiling, np.array(pairs))
    halo = window_reach(config.window_decay)
    return layout.Plan(samplings, layers, numbers, *pad, halo)


def _is_direct(layers_px: np.ndarray, direction: np.ndarray) -> bool:
    """Whether a view moves along x by 1/n px a layer, so that neighbouring layers are neighbours in memory."""
    if len(layers_px) < 2:
        return False
    per_layer = abs(float((layers_px[1] - layers_px[0]) * direction[0]))
    samples_a_px = round(1 / per_layer) if per_layer > 1e-9 else 0
    fits = 1 <= samples_a_px <= _MOST_SAMPLES_A_PX and abs(per_layer * samples_a_px - 1) < 1e-9
    return bool(fits and direction[1] == 0)


def _keep_direct(
    entries: _Entries, view: int, layers_px: np.ndarray, direction: float, row: int, margin: int
) -> tuple[int, int]:
    """Keep a view n times up-sampled; return where layer 0 of the pixel at x = 0 lies, and the step of a px."""
    per_layer = float((layers_px[1] - layers_px[0]) * direction)
    up = round(1 / abs(per_layer))
    origin = up * layers_px[0] * direction
    ahead = math.floor(origin + 1e-9)
    part = max(origin - ahead, 0.0)
    size, base, sign = up * row, entries.length, 1 if per_layer > 0 else -1
    for j in range(up):
        entries.add(view, ((j + part) / up, 0.0), base + (j if sign > 0 else size - 1 - j), sign * up)
    entries.length += size
    first = up * margin + ahead
    return base + (first if sign > 0 else size - 1 - first), sign * up


def _planes(maps: np.ndarray) -> np.ndarray:
    """(H, W, N) to contiguous (N, H, W) float32, or to (N, 1, 1) where even."""
    return np.ascontiguousarray(np.moveaxis(maps[:1, :1] if is_even(maps) else maps, 2, 0), np.float32)


def _variance_floor(planes: np.ndarray) -> np.ndarray:
    """Variance below which a view counts as even, as `readable.correlation.variance_floor`; (K,) float32."""
    variances = [cv2.norm(plane, cv2.NORM_L2SQR) / plane.size - cv2.mean(plane)[0] ** 2 for plane in planes]
    return (RELATIVE_EPSILON * np.array(variances) + 1e-30).astype(np.float32)
