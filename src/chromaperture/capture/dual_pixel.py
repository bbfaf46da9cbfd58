"""Dual-pixel sensors, which split every pixel in two: a photograph is the left and the right picture of one exposure.

Each half of a pixel sees one side of the pupil, as film of two halves does, so the two make a photograph of a
cyan/yellow pupil: red is the half that sees the right of the pupil, blue the other, green their mean. They are two
files, NAME_left and NAME_right, or one: a RAW file of two shots, or a TIFF or DNG file of two samples a pixel.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TypeVar

import cv2
import numpy as np
import tifffile

from chromaperture.capture.tiff import from_pages
from chromaperture.color.encoding import Halves
from chromaperture.system.errors import InputError

_OTHER_SIDE = {"left": "right", "Left": "Right", "LEFT": "RIGHT", "l": "r", "L": "R"}
_OTHER_SIDE |= {right: left for left, right in _OTHER_SIDE.items()}
_NAME = re.compile(f"(.+[._-])({'|'.join(_OTHER_SIDE)})")
_BLOCKS = 24  # along the shorter side, whose means are compared; chosen by hand
_DARKEST_BLOCK = 0.005  # of the white level; chosen by hand
# Ratio of a half's light to the other's. Of 17 published pairs the median is at most 1.04, of one without shading
# corrected 1.2, and its scatter over the frame .04 and .09. Two exposures a stop apart have 2; chosen by hand between.
_MOST_RATIO, _MOST_SCATTER = 1.4, 0.35
_SAME_SCATTER = 0.08  # of pictures of one exposure, whose shading is corrected
_CFA_PATTERN, _BLACK_LEVEL, _WHITE_LEVEL = 33422, 50714, 50717  # tags
N = TypeVar("N", Path, str)


def half_of(path: Path) -> tuple[str, bool] | None:
    """Return the name that both files of a pair share, and whether this is the right one; None for other names."""
    found = _NAME.fullmatch(path.stem)
    return None if found is None else (found[1][:-1], found[2][0] in "rR")


def shot_stem(path: Path, halves: Halves | None) -> str:
    """Return what results of a photograph are called after: of a pair what both names share."""
    half = None if halves is None else half_of(path)
    return path.stem if half is None else half[0]


def partner(path: Path) -> Path:
    """Return where the other half of a pair is."""
    found = _NAME.fullmatch(path.stem)
    assert found is not None  # of a half alone, see `half_of`
    return path.with_name(found[1] + _OTHER_SIDE[found[2]] + path.suffix)


def files_of(path: Path, right: Path | None = None) -> list[Path]:
    """Return the files of a photograph, left and right, or the one that holds both; raises InputError."""
    half = half_of(path)
    if right is None:
        if half is None:
            return [path]
        if half[1]:
            raise InputError(f"{path.name} is the right half of a photograph; give the left one, {partner(path).name}")
        right = partner(path)
        if not right.is_file():
            raise InputError(f"{path.name} is the left half of a photograph, and the right, {right.name}, is missing")
    for file, is_right in ((path, False), (right, True)):
        named = half_of(file)
        if named is not None and named[1] != is_right:
            side, other = ("right", "left") if is_right else ("left", "right")
            raise InputError(f"{file.name} is given as the {side} half, but is called {other}: exchange the two")
    return [path, right]


def pairs(names: Iterable[N], left_out: dict[Path, str]) -> list[N]:
    """Return the photographs among files: of pairs the left halves; ``left_out`` gets files that are no half."""
    names = list(names)
    known, kept = {Path(name) for name in names}, []
    for name in names:
        path = Path(name)
        half = half_of(path)
        if half is None and any(half_of(other) for other in known):
            left_out[path] = "no half of a dual-pixel photograph"
        elif half is None or not half[1] or partner(path) not in known:  # without its left half it is refused
            kept.append(name)
    return kept


def green_of(counts: np.ndarray, path: Path) -> np.ndarray:
    """Return the channel of a half that is matched: the green of a colour picture, all of a grey one; (H, W)."""
    if counts.ndim == 3 and counts.shape[2] in (3, 4):
        counts = counts[..., 1]
    counts = counts[..., 0] if counts.ndim == 3 and counts.shape[2] == 1 else counts
    if counts.ndim != 2 or counts.dtype not in (np.uint8, np.uint16, np.float32, np.float64):
        raise InputError(f"{path.name} is no half of a photograph: give grey or RGB of 8 or 16 bit or float")
    return counts


def joined(image: np.ndarray, name: str) -> np.ndarray:
    """Make the mean of red and blue, (H, W, 3), the green; raises InputError where they are not of one exposure."""
    right, left = image[..., 0], image[..., 2]
    if np.array_equal(right, left):
        raise InputError(f"{name}: left and right are the same picture; give the two halves of one exposure")
    median, scatter = _ratio(right, left)
    if abs(median) > np.log(_MOST_RATIO):
        brighter, times = ("right", median) if median > 0 else ("left", -median)
        raise InputError(
            f"{name}: the {brighter} half has {np.exp(times):.1f} times the light of the other: are both of one "
            "exposure, and of one kind of file?"
        )
    if scatter > _MOST_SCATTER:
        raise InputError(f"{name}: left and right do not show the same scene; give the two halves of one exposure")
    image[..., 1] = (right + left) / 2
    return image


def _ratio(first: np.ndarray, second: np.ndarray) -> tuple[float, float]:
    """Median and scatter over the frame of the logarithm of a picture's light over another's."""
    side = max(1, min(first.shape) // _BLOCKS)
    size = max(1, first.shape[1] // side), max(1, first.shape[0] // side)
    blocks = [cv2.resize(np.ascontiguousarray(part), size, interpolation=cv2.INTER_AREA) for part in (first, second)]
    lit = np.minimum(*blocks) > _DARKEST_BLOCK
    ratios = np.log(blocks[0][lit] / blocks[1][lit]) if lit.any() else np.zeros(1)
    median = float(np.median(ratios))
    return median, float(np.median(np.abs(ratios - median)))


def refuse_half(path: Path, image: np.ndarray, read: Callable[[Path], np.ndarray]) -> None:
    """Raise InputError where a photograph for a camera with film is a half of a pair, by name and by content."""
    if half_of(path) is None or not partner(path).is_file():
        return
    other = read(partner(path))
    if other.shape == image.shape and _ratio(image[..., 1], other[..., 1])[1] < _SAME_SCATTER:
        raise InputError(
            f"{path.name} and {partner(path).name} look like the halves of a dual-pixel photograph, but this camera "
            "has film; give the camera file of the dual-pixel camera, or rename them"
        )


def two_samples(path: Path) -> tuple[str, float, float] | None:
    """Return of a TIFF or DNG file of two samples a pixel its mosaic, "" without one, and its levels; else None."""

    def find(pages: Iterator[tifffile.TiffPage]) -> tuple[str, float, float] | None:
        page = max(pages, key=lambda p: p.imagewidth * p.imagelength)
        if page.samplesperpixel != 2:
            return None
        tags = {code: page.tags[code].value for code in (_CFA_PATTERN, _BLACK_LEVEL, _WHITE_LEVEL) if code in page.tags}
        mosaic = "".join("RGB"[colour] for colour in tags.get(_CFA_PATTERN, b""))
        highest = float(np.iinfo(page.dtype).max) if np.dtype(page.dtype).kind == "u" else 1.0
        black, white = (float(np.mean(tags.get(*tag))) for tag in ((_BLACK_LEVEL, 0.0), (_WHITE_LEVEL, highest)))
        return mosaic, black, white

    return from_pages(path, find, default=None)
