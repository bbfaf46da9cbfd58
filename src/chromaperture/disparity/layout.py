# mypy: disallow-untyped-defs=False
"""What the compiled matcher's stages hand to each other: maps, where samples are kept, scratch.

Rows are addressed in flat arrays by (start, step per px): a view that moves along x by 1/n px a layer is kept n times
up-sampled, so that eight neighbouring layers of a pixel are eight neighbours in memory (stored backwards if the view
moves backwards); views that move otherwise are rearranged row by row with `samples.spread_row`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

_OPTIONS: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract", "nsz", "arcp"}, "nogil": True}
# Numba keeps the machine code of these beside the package and renews it when their own file changes, not when a file
# they import from does: after editing one of those, touch `bands.py` and `strips.py`.
compiled = njit(cache=True, **_OPTIONS)
# Called by compiled functions only: without the wrappers that Python would need they compile twice as fast.
inner = njit(no_cpython_wrapper=True, no_cfunc_wrapper=True, **_OPTIONS)  # type: ignore[call-overload]

GROUP = 4  # rows walked together: four independent recursions fill the pipeline
BLOCK = 16  # columns that are neighbours in the volume
SCORE_SCALE = np.float32(32000)  # of a score in [-1, 1] in int16

ONE = np.float32(1)
ZERO = np.float32(0)


class Pictures(NamedTuple):
    """Maps of the whole picture, float32."""

    views: np.ndarray  # (K, H, W)
    noise: np.ndarray  # (K, H, W) or (K, 1, 1) where even
    covariance: np.ndarray  # (P, H, W) or (P, 1, 1) where even
    mask: np.ndarray  # (H, W)
    guide: np.ndarray  # (H, W)


class Samplings(NamedTuple):
    """How the views are sampled: one entry for every sub-pixel phase of every view.

    The samples of an entry at (row i, column x from ``-margin``) are at ``i * row_length + start + step * x`` of the
    flat arrays.
    """

    owner: np.ndarray  # (E,) int: the view it samples
    taps_x: np.ndarray  # (E, 4) float32
    taps_y: np.ndarray  # (E, 4) float32
    start: np.ndarray  # (E,) int
    step: np.ndarray  # (E,) int
    still: np.ndarray  # (K,) int: the entry of each view without any shift
    row_length: int
    margin: int


class Layers(NamedTuple):
    """Where a layer finds its samples."""

    direct: np.ndarray  # (K,) bool: layers are neighbours in memory
    start: np.ndarray  # (K,) int: of layer 0 at x = 0, where direct
    step: np.ndarray  # (K,) int: per px, where direct
    entry: np.ndarray  # (K, D8) int, elsewhere
    whole: np.ndarray  # (K, D8, 2) int: whole px (x, y) of each layer's shift, elsewhere
    overlap: np.ndarray  # (P * D8,) float32: share of the noise covariance left, debiasing included
    ceiling: np.ndarray  # (D8,) float32: 1, and -1 for the layers that only fill the last vector
    pairs: np.ndarray  # (P, 2) int


class Numbers(NamedTuple):
    """Parameters, float32 where not said otherwise."""

    decay: np.float32
    debias: np.float32
    weighting: bool
    near: np.float32  # link weight on an even guide
    epsilon: np.ndarray  # (K,)
    min_share: np.float32
    min_weight: np.float32


class RowMaps(NamedTuple):
    """What the filter along x needs of each row and leaves for the filter along y, float32."""

    weights: np.ndarray  # (H, W)
    links: np.ndarray  # (H, W + 1): of each pixel to its left neighbour
    links_y: np.ndarray  # (H, W16): of each pixel to its upper neighbour
    share: np.ndarray  # (H, W16): the weights, filtered along x
    scale: np.ndarray  # (H, W): from filtered scores to int16


class Scratch(NamedTuple):
    """Flat float32 arrays of one thread."""

    value: np.ndarray  # samples of all entries
    gain: np.ndarray  # 1 / standard deviation, of the same samples' windows
    mean_gain: np.ndarray  # mean times gain
    grain: np.ndarray  # noise variance
    ring: np.ndarray  # windows of the layers, above the current row
    carry: np.ndarray  # rows of the ring for the next band
    state: np.ndarray  # the same, below the current row
    lanes: np.ndarray  # rearranged rows
    scores: np.ndarray  # one row of scores
    line: np.ndarray  # a row of the picture
