"""Saturated pixels of a picture that is reduced by area averages."""

from __future__ import annotations

import itertools
import math

import numpy as np

from chromaperture.color.image import SATURATION
from chromaperture.system.compilation import compiled
from chromaperture.system.threads import in_parallel

_NAN = np.float32(np.nan)
_LEAST = 1e-3  # of a pixel: what OpenCV's area averages leave out


def mark_cut_off(image: np.ndarray, small: np.ndarray) -> None:
    """Make a reduced pixel NaN where a pixel of the picture below it is saturated."""
    below = [_pixels_below(*sides) for sides in zip(image.shape[:2], small.shape[:2], strict=True)]
    in_parallel(lambda _, first, last: _mark(image, small, *below, first, last), len(small))


def _pixels_below(count: int, reduced_count: int) -> np.ndarray:
    """Return the first pixel below each reduced one and that behind the last; (reduced_count, 2) int64."""
    ends = [i * count / reduced_count for i in range(reduced_count + 1)]
    pairs = [(math.floor(a + _LEAST), math.ceil(b - _LEAST)) for a, b in itertools.pairwise(ends)]
    return np.array(pairs, np.int64)


@compiled(error_model="numpy")
def _mark(image, small, below_rows, below_columns, first, last):  # type: ignore[no-untyped-def]
    limit = np.float32(SATURATION)
    for row in range(first, last):
        for column in range(small.shape[1]):
            found = 0
            for y in range(below_rows[row, 0], below_rows[row, 1]):
                for x in range(below_columns[column, 0], below_columns[column, 1]):
                    for k in range(3):
                        found |= image[y, x, k] >= limit
            if found:
                small[row, column, 0] = small[row, column, 1] = small[row, column, 2] = _NAN
