"""The compiled matcher: what ``reference.py`` computes, in float32, on all cores.

Schedule. Horizontal recursions want whole rows, vertical ones whole columns, and a volume of scores does not fit the
caches; so the picture is cut twice.

1. Bands of rows (`bands.py`), in parallel. A band samples its views at every sub-pixel phase the layers use, windows
   the samples and their squares once, and then, eight layers at a time, windows the products, makes correlations of
   them and filters these along x. What it works on stays in the cache; it leaves 16 bits a score.
2. Strips of columns (`strips.py`), in parallel: the filter along y, the best layer, the parabola.

A thread's first band needs ``halo`` rows above, every band as many below: so far does a window reach. A band that
follows another takes over its windows.

Memory: 2 bytes a score, and for each thread a scratch of 35 MB at 1280 px width for two views along x, up to 400 MB
for three views that take every layer at a phase of its own. Both are kept for the next call.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager
from functools import cache

import cv2
import numba
import numpy as np

from chromaperture.config import MatcherConfig
from chromaperture.disparity import bands, layout, reference, strips
from chromaperture.disparity.simd import LANES
from chromaperture.disparity.views import MatchInputs, is_even, view_pairs
from chromaperture.disparity.winner import Winner

# Share of a window's weight that a band may miss; small, because products have means far above their variances.
_FORGOTTEN = 1e-6
_BAND_ROWS = 180


def match(inputs: MatchInputs, config: MatcherConfig) -> Winner:
    """Match the views; the fast twin of `chromaperture.disparity.reference.match`.

    Parameters
    ----------
    inputs : MatchInputs
    config : MatcherConfig

    Returns
    -------
    Winner
    """
    near = _link_weight(config.bilateral_sigma_px)
    height, width = inputs.mask.shape
    layers = len(inputs.layers_px)
    step = inputs.layers_px[1] - inputs.layers_px[0]
    disparity, peak, curvature = (np.empty((height, width), np.float32) for _ in range(3))
    with _workspace() as workspace:
        volume, maps = _filtered_scores(inputs, config, near, workspace)
        scratch_size = strips.scratch_rows(height) * layout.BLOCK * _whole_slabs(layers)
        scratch = workspace.array("strip", (numba.get_num_threads(), scratch_size), np.float32)

        def take_winners(thread: int, first: int, last: int) -> None:
            strips.take_winners(
                volume,
                maps.share,
                maps.links_y,
                near,
                layers,
                np.float32(inputs.layers_px[0]),
                np.float32(step),
                first,
                last,
                scratch[thread],
                disparity,
                peak,
                curvature,
            )

        _in_parallel(take_winners, -(-width // layout.BLOCK))
    return Winner(disparity, peak, curvature)


def score_volume(inputs: MatchInputs, config: MatcherConfig) -> np.ndarray:
    """Score every layer; the fast twin of `chromaperture.disparity.reference.score_volume`.

    Returns
    -------
    (H, W, D) float32, rounded to 1 / 32000
    """
    out = np.empty((*inputs.mask.shape, len(inputs.layers_px)), np.float32)
    with _workspace() as workspace:
        volume, _ = _filtered_scores(inputs, config, np.float32(0), workspace)
        _in_parallel(lambda _, top, bottom: strips.unpack_scores(volume, top, bottom, out), len(out))
    return out


def texture_weights(inputs: MatchInputs, config: MatcherConfig) -> np.ndarray:
    """Weight of each pixel in the aggregation; the twin of the reference's function; (H, W) float32."""
    with _workspace() as workspace:
        _, maps = _filtered_scores(inputs, config, np.float32(0), workspace, weights_only=True)
        return maps.weights.copy()


def _in_parallel(work: Callable[[int, int, int], None], count: int, threads: int | None = None) -> None:
    """Run ``work(thread, first, last)`` over ``count`` pieces, in contiguous shares, on Numba's number of threads.

    The compiled functions release the interpreter's lock. Plain threads compile several times faster than parallel
    loops and may be used from any thread of the caller.
    """
    threads = min(numba.get_num_threads() if threads is None else threads, count)
    shares = [(i, count * i // threads, count * (i + 1) // threads) for i in range(threads)]
    others = [_pool().submit(work, *share) for share in shares[1:]]
    try:
        work(*shares[0])
    finally:
        wait(others)  # whatever happened, nobody writes to the arrays any more
    for other in others:
        other.result()


@cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(os.cpu_count(), thread_name_prefix="matcher")


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pool.cache_clear)  # threads do not survive a fork


class Workspace:
    """Memory that one call after the other may use; the system takes as long to hand it out as the work takes.

    Everything handed out starts on a cache line (half of all vectors would else straddle two) and holds finite
    numbers, if any.
    """

    def __init__(self) -> None:
        self._kept: dict[str, np.ndarray] = {}

    def array(self, name: str, shape: tuple[int, ...], dtype: type) -> np.ndarray:
        """Give an array with whatever finite numbers an earlier call left in it."""
        size = math.prod(shape) * np.dtype(dtype).itemsize
        raw = self._kept.get(name)
        if raw is None or not size + 64 <= len(raw) <= 2 * size + 64:
            raw = self._kept[name] = np.zeros(size + 64, np.uint8)
        start = -raw.ctypes.data % 64
        return raw[start : start + size].view(dtype).reshape(shape)


_spare: list[Workspace] = []  # append and pop are atomic: threads that match at the same time take different ones


@contextmanager
def _workspace() -> Iterator[Workspace]:
    """Lend a workspace; what it handed out must not outlive the loan."""
    try:
        workspace = _spare.pop()
    except IndexError:
        workspace = Workspace()
    try:
        yield workspace
    finally:
        _spare.append(workspace)


def _link_weight(sigma_px: float) -> np.float32:
    return np.float32(math.exp(-math.sqrt(2) / sigma_px) if sigma_px > 0 else 0)


def _whole_slabs(layers: int) -> int:
    return -(-layers // LANES) * LANES


def _filtered_scores(
    inputs: MatchInputs, config: MatcherConfig, near: np.float32, workspace: Workspace, *, weights_only: bool = False
) -> tuple[np.ndarray, layout.RowMaps]:
    """Score all layers and filter the scores along x; see `bands.score_bands`."""
    height, width = inputs.mask.shape
    pad = reference.padding(inputs)
    samplings, layers = _plan(inputs, config, pad)
    if weights_only:
        layers = layers._replace(ceiling=layers.ceiling[:0])
    halo = math.ceil(math.log(_FORGOTTEN) / math.log(config.window_decay))
    least = 2 * pad[1] + 8
    threads = max(1, min(numba.get_num_threads(), height // max(least, halo)))
    rows_of_thread = -(-height // threads)
    band_rows = -(-rows_of_thread // (-(-rows_of_thread // max(_BAND_ROWS, least))))

    padded = width + 2 * pad[0]
    rows = band_rows + 2 * halo + 4 * pad[1] + 3 * layout.GROUP
    views = inputs.views.shape[2]
    pairs = len(layers.pairs)
    samples = (rows + 1) * samplings.row_length + 64
    sizes = dict(
        value=samples,
        gain=samples,
        mean_gain=samples,
        grain=samplings.row_length + 64 if is_even(inputs.noise_variance) else samples,
        ring=pairs * (rows + 1) * padded * LANES,
        carry=(-(-len(samplings.owner) // 4) + len(layers.ceiling) // LANES * pairs) * padded * LANES,
        state=pairs * padded * LANES,
        lanes=(views * layout.GROUP + 2) * (padded + LANES) * LANES,
        scores=width * LANES,
        line=width + 2 * samplings.margin + 16,
    )
    scratch = layout.Scratch(
        *(
            workspace.array(name, (threads, -(-size // 16) * 16), np.float32)
            for name, size in sizes.items()
        )
    )
    wide = -(-width // layout.BLOCK) * layout.BLOCK
    volume = workspace.array("volume", (wide * height * len(layers.ceiling),), np.int16)
    widths = dict(weights=width, links=width + 1, links_y=wide, share=wide, scale=width)
    maps = layout.RowMaps(
        *(workspace.array(name, (height, size), np.float32) for name, size in widths.items())
    )
    pictures = layout.Pictures(
        views=_planes(inputs.views),
        noise=_planes(inputs.noise_variance),
        covariance=_planes(inputs.noise_covariance),
        mask=np.ascontiguousarray(inputs.mask, np.float32),
        guide=np.ascontiguousarray(inputs.guide, np.float32),
    )
    numbers = layout.Numbers(
        decay=np.float32(config.window_decay),
        debias=np.float32(config.noise_debiasing),
        weighting=config.texture_weighting,
        near=near,
        epsilon=_variance_floor(pictures.views),
        min_share=np.float32(reference.MIN_VARIANCE_SHARE),
        min_weight=np.float32(reference.MIN_WEIGHT),
    )

    def score_bands(thread: int, first: int, last: int) -> None:
        own = layout.Scratch(*(array[thread] for array in scratch))
        for band in range(first, last):
            top, bottom = band * band_rows, min((band + 1) * band_rows, height)
            begin = band == first
            bands.score_band(
                pictures, samplings, layers, numbers, pad, halo, top, bottom, begin, own, volume, maps
            )

    _in_parallel(score_bands, -(-height // band_rows), threads)
    return volume, maps


def _plan(
    inputs: MatchInputs, config: MatcherConfig, pad: tuple[int, int]
) -> tuple[layout.Samplings, layout.Layers]:
    """Decide which sub-pixel phases of the views are sampled, where they are kept, and how the layers find them."""
    width = inputs.mask.shape[1]
    count = len(inputs.layers_px)
    lanes = _whole_slabs(count)
    layers_px = inputs.layers_px
    step_px = layers_px[1] - layers_px[0]
    views = len(inputs.directions)
    pairs = view_pairs(views)
    margin = 2 * pad[0] + 2 * LANES + 4
    row_samples = width + 2 * margin

    owner: list[int] = []
    phases: list[tuple[float, float]] = []
    starts: list[int] = []
    steps: list[int] = []
    still = np.zeros(views, np.int64)
    direct = np.zeros(views, bool)
    start = np.zeros(views, np.int64)
    step = np.zeros(views, np.int64)
    entry = np.zeros((views, lanes), np.int64)
    whole = np.zeros((views, lanes, 2), np.int64)
    length = 0

    def keep(k: int, phase: tuple[float, float], at: int, along: int) -> int:
        owner.append(k)
        phases.append(phase)
        starts.append(at)
        steps.append(along)
        return len(owner) - 1

    for k, direction in enumerate(inputs.directions):
        per_layer = step_px * direction
        up = round(1 / abs(per_layer[0])) if abs(per_layer[0]) > 1e-9 else 0
        direct[k] = 1 <= up <= 8 and abs(abs(per_layer[0]) * up - 1) < 1e-9 and direction[1] == 0
        known: dict[tuple[float, float], int] = {}
        if direct[k]:
            origin = up * layers_px[0] * direction[0]
            ahead = math.floor(origin + 1e-9)
            part = max(origin - ahead, 0.0)
            forward = per_layer[0] > 0
            size = up * row_samples
            for j in range(up):
                phase = ((j + part) / up, 0.0)
                at = length + (j if forward else size - 1 - j)
                known[phase] = keep(k, phase, at, up if forward else -up)
            first = up * margin + ahead
            start[k] = length + (first if forward else size - 1 - first)
            step[k] = up if forward else -up
            length += size
        else:
            offsets = layers_px[:, None] * direction
            base = np.floor(offsets + 1e-9)
            parts = np.maximum(offsets - base, 0)
            for s in range(lanes):
                layer = min(s, count - 1)
                phase = (round(float(parts[layer, 0]), 9), round(float(parts[layer, 1]), 9))
                if phase not in known:
                    known[phase] = keep(k, phase, length, 1)
                    length += row_samples
                entry[k, s] = known[phase]
                whole[k, s] = base[layer]
        if (0.0, 0.0) not in known:
            known[0.0, 0.0] = keep(k, (0.0, 0.0), length, 1)
            length += row_samples
        still[k] = known[0.0, 0.0]

    taps = np.array([[reference.cubic_taps(t) for t in phase] for phase in phases], np.float32)
    overlap = np.zeros((len(pairs), lanes), np.float32)
    overlap[:, :count] = inputs.noise_overlap.T * config.noise_debiasing
    ceiling = np.where(np.arange(lanes) < count, 1, -1).astype(np.float32)
    samplings = layout.Samplings(
        owner=np.array(owner),
        taps_x=np.ascontiguousarray(taps[:, 0]),
        taps_y=np.ascontiguousarray(taps[:, 1]),
        start=np.array(starts),
        step=np.array(steps),
        still=still,
        row_length=length,
        margin=margin,
    )
    return samplings, layout.Layers(
        direct, start, step, entry, whole, overlap.ravel(), ceiling, np.array(pairs)
    )


def _planes(maps: np.ndarray) -> np.ndarray:
    """(H, W, N) to contiguous (N, H, W) float32, or to (N, 1, 1) where even."""
    return np.ascontiguousarray(np.moveaxis(maps[:1, :1] if is_even(maps) else maps, 2, 0), np.float32)


def _variance_floor(planes: np.ndarray) -> np.ndarray:
    """Do as `chromaperture.disparity.reference.variance_floor`, for planes (K, H, W); (K,) float32."""
    variances = [cv2.norm(plane, cv2.NORM_L2SQR) / plane.size - cv2.mean(plane)[0] ** 2 for plane in planes]
    return (reference.RELATIVE_EPSILON * np.array(variances) + 1e-30).astype(np.float32)
