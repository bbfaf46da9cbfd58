# mypy: disallow-untyped-defs=False
"""Memory layout of the compiled matcher, and the types that its stages pass on.

The volume, int16 (float32 of filtered scores), holds eight layers of a pixel (a vector) side by side, 16 columns of
those, then the next eight layers of the same 16 columns, then the next row, then the next 16 columns::

    flat index = ((((block * H + y) * slabs + slab) * BLOCK) + column) * 8 + lane

    block b     row y      slab 0                      slab 1
    (16 columns)           col 0   col 1  ...  col 15  col 0   ...
                           01234567 01234567  01234567 89abcdef      <- layers

so that a walk along a row and a walk down a block of columns both read whole cache lines.

Rows of samples are addressed in flat arrays by (start, step per px): a view that moves along x by 1/n px a layer is
kept n times up-sampled, so that eight neighbouring layers of a pixel are neighbours in memory (stored backwards if the
view moves backwards); views that move otherwise are transposed row by row with `samples.transpose_rows`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from chromaperture.matching.compiled.simd import LANES
from chromaperture.system.compilation import compiled, inlined

_OPTIONS: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract", "nsz", "arcp"}}
kernel = compiled(**_OPTIONS)  # called from Python
inner = inlined(**_OPTIONS)  # called by kernels

GROUP = 4  # rows walked together: four independent recursions fill the pipeline
BLOCK = 16  # columns that are neighbours in the volume
SCORE_SCALE = np.float32(32000)  # of a score in [-1, 1] in int16

ONE = np.float32(1)
ZERO = np.float32(0)
START = np.int64(0)  # an index; the literal 0 has a type of its own, for which Numba would compile a function again


def whole_vectors(layers: int) -> int:
    """Return the number of layers, rounded up to whole vectors."""
    return -(-layers // LANES) * LANES


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
    overlap: np.ndarray  # (P * D8,) float32: fraction of the noise covariance left, debiasing included
    ceiling: np.ndarray  # (D8,) float32: 1, and -1 for the layers that only fill the last vector
    pairs: np.ndarray  # (P, 2) int


class Numbers(NamedTuple):
    """Parameters, float32 unless annotated otherwise."""

    decay: np.float32
    debias: np.float32
    weighting: bool
    even_link: np.float32  # link weight on an even guide
    plain: bool  # scores are not filtered: their weights would cancel
    epsilon: np.ndarray  # (K,)
    min_fraction: np.float32
    min_weight: np.float32


class Plan(NamedTuple):
    """What is the same for all bands."""

    samplings: Samplings
    layers: Layers
    numbers: Numbers
    pad_x: int  # px beyond which every shifted view is constant
    pad_y: int
    halo: int  # rows after which the window's weight is negligible


class Band(NamedTuple):
    """The rows from ``top`` to before ``bottom``; ``begin`` unless the scratch holds the windows of the band above."""

    top: int
    bottom: int
    begin: bool


class RowMaps(NamedTuple):
    """What the filter along x needs of each row and leaves for the filter along y, float32."""

    weights: np.ndarray  # (H, W)
    links: np.ndarray  # (H, W + 1): link weight of each pixel to its left neighbour
    links_y: np.ndarray  # (H, W16): link weight of each pixel to its upper neighbour
    filtered: np.ndarray  # (H, W16): the weights, filtered along x


class Scratch(NamedTuple):
    """Flat float32 arrays of one thread."""

    value: np.ndarray  # samples of all entries
    gain: np.ndarray  # 1 / standard deviation, of the same samples' windows
    mean_gain: np.ndarray  # mean times gain
    noise_sample: np.ndarray  # noise variance
    ring: np.ndarray  # windows of the layers, above the current row
    carry: np.ndarray  # rows of the ring for the next band
    state: np.ndarray  # the same, below the current row
    lanes: np.ndarray  # rearranged rows
    scores: np.ndarray  # one row of scores
    line: np.ndarray  # a row of the picture
