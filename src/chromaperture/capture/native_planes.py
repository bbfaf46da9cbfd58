"""Luma and chroma as a file stores them to R, G and B, without making up chroma between its samples.

A decoder that brings chroma up to the size of luma moves detail between the channels, by the colour of the object, and
their displacement is what is measured. Here luma is brought down to the places of the chroma samples, by the low pass
whose centre they are; chroma stays untouched (ITU-T H.273, 8.7; ITU-T T.871, of JPEG: centred, full range, BT.601).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from chromaperture.capture.picture_format import LUMA_WEIGHTS, PictureFormat
from chromaperture.color.encoding import Siting
from chromaperture.system.threads import each_band

ENCODED_WHITE = 255.0  # of counts that were made from luma and chroma, whatever their bits


@dataclass(frozen=True)
class Planes:
    """Y', C'b and C'r as stored: (H, W), and (h, w) twice; uint8 or uint16."""

    luma: np.ndarray
    blue: np.ndarray
    red: np.ndarray


def rgb_of_planes(planes: Planes, form: PictureFormat) -> np.ndarray:
    """Return encoded R', G', B' at the places of the chroma samples; (h, w, 3) float32, to `ENCODED_WHITE`."""
    width, height = form.read_size_px
    across, down = form.chroma_factors
    rest = form.reduction // across, form.reduction // down  # of sides with more chroma samples
    matrix = _matrix(form)
    rgb = np.empty((height, width, 3), np.float32)

    def convert(rows: slice) -> None:
        chroma = (_mean(plane, rows, rest, width) for plane in (planes.blue, planes.red))
        parts = [part.astype(np.float32) for part in (_at_sites(planes.luma, rows, form), *chroma)]
        cv2.transform(cv2.merge(parts), matrix, dst=rgb[rows])

    each_band(convert, height)
    return rgb


def _matrix(form: PictureFormat) -> np.ndarray:
    """Return the matrix from stored Y', C'b, C'r and 1 to R', G', B' up to `ENCODED_WHITE`; (3, 4)."""
    unit, full = float(1 << (form.bits - 8)), float((1 << form.bits) - 1)
    black, luma_span, chroma_span = (0.0, full, full) if form.full_range else (16 * unit, 219 * unit, 224 * unit)
    red, blue = form.luma_weights or LUMA_WEIGHTS[2]
    red_gain, blue_gain, green = 2 * (1 - red), 2 * (1 - blue), 1 - red - blue
    of_parts = np.array(
        [[1, 0, red_gain], [1, -blue_gain * blue / green, -red_gain * red / green], [1, blue_gain, 0]]
    ) * (ENCODED_WHITE / np.array([luma_span, chroma_span, chroma_span]))
    return np.column_stack([of_parts, -of_parts @ [black, 128 * unit, 128 * unit]])


def _at_sites(luma: np.ndarray, rows: slice, form: PictureFormat) -> np.ndarray:
    """Return luma at the chroma samples of some rows of the result; (r, w) float32."""
    factor, (width, height) = form.reduction, form.read_size_px
    is_usual = form.chroma_factors == (2, 2) and form.siting != "top-left" and luma.dtype == np.uint8
    if is_usual and luma.shape == (2 * height, 2 * width):
        return _halved(luma[2 * rows.start : 2 * rows.stop], is_left=form.siting == "left")
    taps = [_taps(factor if form.chroma_factors[i] > 1 else 1, factor, form.siting, along=i) for i in (0, 1)]
    columns = _weighted(luma, taps[1], factor, rows.start, rows.stop, axis=0)
    return _weighted(columns, taps[0], factor, 0, width, axis=1)


def _halved(luma: np.ndarray, *, is_left: bool) -> np.ndarray:
    """Do the same for 4:2:0 of 8 bits and even sides, two samples of a row at a time, in a quarter of the time."""
    pairs = luma.view("<u2")
    first, second = ((part[::2] + part[1::2]) for part in (pairs & 255, pairs >> 8))
    if not is_left:
        return (first + second) * np.float32(1 / 4)
    total = 2 * first + second
    total[:, 1:] += second[:, :-1]
    total[:, 0] += first[:, 0]
    return total * np.float32(1 / 8)


def _taps(subsampled: int, factor: int, siting: Siting, *, along: int) -> dict[int, float]:
    """Return weights of luma samples by their offset from the first of a cell: the low pass about the chroma sample."""
    cosited = subsampled > 1 and (siting == "top-left" or (siting == "left" and along == 0))
    if not cosited:
        return dict.fromkeys(range(factor), 1 / factor)
    half = factor // 2
    return {i: (0.5 if abs(i) == half else 1.0) / factor for i in range(-half, half + 1)}


def _weighted(
    values: np.ndarray, taps: dict[int, float], factor: int, first: int, last: int, *, axis: int
) -> np.ndarray:
    """Return weighted sums of every cell from ``first`` to ``last`` along an axis; at borders the outermost repeats."""
    size = values.shape[axis]
    total: np.ndarray | None = None
    for offset, weight in taps.items():
        inside = first * factor + offset >= 0 and (last - 1) * factor + offset < size
        if inside:
            at = slice(first * factor + offset, (last - 1) * factor + offset + 1, factor)
            part = values[at] if axis == 0 else values[:, at]
        else:
            part = np.take(values, np.clip(np.arange(first, last) * factor + offset, 0, size - 1), axis=axis)
        part = part * np.float32(weight)
        total = part if total is None else np.add(total, part, out=total)
    assert total is not None
    return total


def _mean(plane: np.ndarray, rows: slice, rest: tuple[int, int], width: int) -> np.ndarray:
    """Return chroma of some rows of the result, averaged along a side with more samples; (r, w)."""
    across, down = rest
    if rest == (1, 1):
        return plane[rows, :width]
    taps = [dict.fromkeys(range(n), 1 / n) for n in (across, down)]
    return _weighted(_weighted(plane, taps[1], down, rows.start, rows.stop, axis=0), taps[0], across, 0, width, axis=1)
