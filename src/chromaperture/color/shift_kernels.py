"""Cubic interpolation along rows, for the common apertures whose channels are displaced horizontally only."""

from __future__ import annotations

import numpy as np

from chromaperture.system.compilation import compiled
from chromaperture.system.threads import in_parallel

A = np.float32(-0.75)  # slope of the cubic at 1, as in OpenCV: `cv2.remap` gives the same picture


def shift_along_rows(image: np.ndarray, displacement_px: np.ndarray, channel: int, out: np.ndarray) -> None:
    """Sample a channel at x + displacement by cubic interpolation into ``out``, with replicated borders.

    ``image`` (H, W, C) float32; ``displacement_px`` (H, W) float32, finite; ``out`` (H, W, C) float32.
    """
    displacement = np.ascontiguousarray(displacement_px)
    in_parallel(lambda _, first, last: _shift(image, displacement, channel, out, first, last), len(displacement))


@compiled(error_model="numpy")
def _shift(image, displacement, k, out, first_row, last_row):  # type: ignore[no-untyped-def]
    width = displacement.shape[1]
    one, two, three, right = np.float32(1), np.float32(2), np.float32(3), np.float32(width + 4)
    for y in range(first_row, last_row):
        for x in range(width):
            at = np.float32(x) + displacement[y, x]
            # Beyond 4 px outside only the border is sampled. Adding 8 makes truncation round down.
            at = min(max(at, np.float32(-4)), right) + np.float32(8)
            first = np.int32(at)
            t = at - np.float32(first)
            first -= np.int32(8)
            # Weights of the cubic at distances 1 + t, t, 1 - t and 2 - t; their sum is 1.
            u = one - t
            w0, w3 = A * t * u * u, A * u * t * t
            w1 = ((A + two) * t - (A + three)) * t * t + one
            w2 = one - w0 - w1 - w3
            if 1 <= first < width - 2:
                out[y, x, k] = (
                    w0 * image[y, first - 1, k] + w1 * image[y, first, k]
                    + w2 * image[y, first + 1, k] + w3 * image[y, first + 2, k]
                )  # fmt: skip
            else:
                total = np.float32(0)
                for n, w in enumerate((w0, w1, w2, w3)):
                    total += w * image[y, min(max(first - 1 + n, 0), width - 1), k]
                out[y, x, k] = total
