# mypy: disallow-untyped-defs=False
"""From the working scale to the photograph's pixels, compiled; ``readable/upsample.py`` explains what is computed."""

from __future__ import annotations

import numpy as np

from chromaperture.matching.compiled.layout import ONE, ZERO, kernel
from chromaperture.matching.readable.upsample import JUMP_PX, LEAST_WEIGHT, Coarse, places
from chromaperture.system.threads import in_parallel

_JUMP, _LEAST, _HALF = np.float32(JUMP_PX), np.float32(LEAST_WEIGHT), np.float32(0.5)
_NAN = np.float32(np.nan)


def upsample(coarse: Coarse, image: np.ndarray, guide_rgb: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Bring maps to the pixels of the photograph, as `readable.upsample`."""
    height, width = image.shape[:2]
    maps = Coarse(*(np.ascontiguousarray(part) for part in coarse))
    rows, columns = places(height, len(maps.guide)), places(width, maps.guide.shape[1])
    rgb, factor = np.asarray(guide_rgb, np.float32), np.float32(width / maps.guide.shape[1])
    out = tuple(np.empty((height, width), np.float32) for _ in range(3))
    picture = np.ascontiguousarray(image, np.float32)
    in_parallel(lambda _, first, last: _fill(maps, picture, rgb, rows, columns, factor, out, first, last), height)
    return out  # type: ignore[return-value]


@kernel
def _fill(maps, image, rgb, rows, columns, factor, out, first, last):
    h, w = maps.guide.shape
    width = image.shape[1]
    surface, bar, confidence, guide = maps.disparity_px, maps.sigma_px, maps.confidence, maps.guide
    for y in range(first, last):
        top, down = rows[0][y], rows[1][y]
        low_row = min(top + 1, h - 1)
        for x in range(width):
            left, right = columns[0][x], columns[1][x]
            beside = min(left + 1, w - 1)
            if maps.unknown[low_row if down >= _HALF else top, beside if right >= _HALF else left]:
                out[0][y, x], out[1][y, x], out[2][y, x] = _NAN, _NAN, ZERO
                continue
            d0, d1, d2, d3 = surface[top, left], surface[top, beside], surface[low_row, left], surface[low_row, beside]
            w0, w1, w2, w3 = (ONE - down) * (ONE - right), (ONE - down) * right, down * (ONE - right), down * right
            low, high = min(min(d0, d1), min(d2, d3)), max(max(d0, d1), max(d2, d3))
            if high - low > _JUMP:
                here = image[y, x, 0] * rgb[0] + image[y, x, 1] * rgb[1] + image[y, x, 2] * rgb[2]
                middle = (low + high) * _HALF
                w0, w1, w2, w3 = w0 + _LEAST, w1 + _LEAST, w2 + _LEAST, w3 + _LEAST
                a, b = here - guide[top, left], here - guide[top, beside]
                c, d = here - guide[low_row, left], here - guide[low_row, beside]
                l0, l1, l2, l3 = w0 / (ONE + a * a), w1 / (ONE + b * b), w2 / (ONE + c * c), w3 / (ONE + d * d)
                balance = l0 if d0 < middle else -l0
                balance += l1 if d1 < middle else -l1
                balance += l2 if d2 < middle else -l2
                balance += l3 if d3 < middle else -l3
                first_side = balance > ZERO
                w0 = w0 if (d0 < middle) == first_side else ZERO
                w1 = w1 if (d1 < middle) == first_side else ZERO
                w2 = w2 if (d2 < middle) == first_side else ZERO
                w3 = w3 if (d3 < middle) == first_side else ZERO
            unit = ONE / (w0 + w1 + w2 + w3)
            out[0][y, x] = (w0 * d0 + w1 * d1 + w2 * d2 + w3 * d3) * unit * factor
            s = w0 * bar[top, left] + w1 * bar[top, beside] + w2 * bar[low_row, left] + w3 * bar[low_row, beside]
            out[1][y, x] = s * unit * factor
            s = w0 * confidence[top, left] + w1 * confidence[top, beside]
            s += w2 * confidence[low_row, left] + w3 * confidence[low_row, beside]
            out[2][y, x] = s * unit
