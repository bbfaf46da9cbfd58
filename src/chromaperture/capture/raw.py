"""RAW files (CR2, NEF, DNG, ...) to half-size colour through LibRaw, without interpolation between channels."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from chromaperture.capture.bayer import check_not_quad, quad_message, superpixels
from chromaperture.capture.picture_format import SENSOR_LIGHT, PictureFormat
from chromaperture.capture.picture_header import check_size
from chromaperture.capture.raw_container import black_of_cells, check_complete, check_kind, developed
from chromaperture.color.encoding import PATTERNS, Encoding
from chromaperture.system.errors import InputError, MissingDependencyError
from chromaperture.system.validation import quoted

_TURNS = {3: 180, 5: 270, 6: 90}  # LibRaw's codes of an orientation, degrees clockwise


def raw_format(path: Path) -> PictureFormat:
    """Return what a RAW file is; raises like `read_raw`."""
    with _opened(path) as raw:
        sizes, bits = raw.sizes, int(raw.white_level).bit_length()
        # An odd last row or column has no whole cell.
        return PictureFormat(
            "RAW", (sizes.width // 2 * 2, sizes.height // 2 * 2), bits, (2, 2), space=SENSOR_LIGHT, mosaic="Bayer",
            turn_degrees=_TURNS.get(sizes.flip, 0), known_from={"mosaic": "tag"},
        )  # fmt: skip


def read_raw(path: Path, *, size_px: tuple[int, int] | None = None) -> tuple[np.ndarray, Encoding]:
    """Read the mosaic and make one pixel of every 2 x 2 cell; counts are twice its, levels the file's own, doubled.

    Raises InputError for what cannot be read, ends too early or is no Bayer mosaic; MissingDependencyError.
    """
    with _opened(path) as raw:
        check_size(raw.sizes.width // 2, raw.sizes.height // 2, path.name, size_px)
        layout = None if raw.raw_pattern is None else np.asarray(raw.raw_pattern)
        if layout is None or layout.shape != (2, 2) or raw.raw_image_visible.ndim != 2:
            what = "an X-Trans mosaic" if layout is not None and layout.shape == (6, 6) else "no Bayer mosaic"
            raise InputError(f"{path.name} has {what}, of which no 2 x 2 cells can be made; {developed(path.name)}")
        # The pattern begins at the sensor's corner, the picture behind a masked border: perhaps an odd pixel away.
        top, left = raw.sizes.top_margin, raw.sizes.left_margin
        layout = np.roll(layout, (-top, -left), axis=(0, 1))
        mosaic = raw.raw_image_visible.copy()
        black = black_of_cells(path, top, left)
        if black is None:
            black = np.array(raw.black_level_per_channel, float)[layout]
        names, white = raw.color_desc.decode(), _white_level(raw)
    pattern = "".join(names[i] for i in layout.ravel())
    if pattern not in PATTERNS and set(pattern) <= set("RGB"):  # LibRaw folds the 4 x 4 pattern of a DNG
        raise InputError(quad_message(path.name))
    if np.ptp(black) > 0:
        mosaic = _with_one_black(mosaic, black)
    check_not_quad(mosaic, path.name, black_level=float(black.mean()))
    counts, encoding = superpixels(mosaic, pattern, black_level=float(black.mean()), white_level=white)
    return counts, replace(encoding, given=False)  # the levels of the camera file are more exact


def _white_level(raw: Any) -> float:
    """Return the count up to which all channels are linear: that of the format, or what the camera states if lower.

    Sony's ARW states 15360 of 16383 counts. Neither has black subtracted (LibRaw, `libraw_colordata_t`).
    """
    stated = getattr(raw, "camera_white_level_per_channel", None) or ()
    return float(min([raw.white_level, *(level for level in stated if level > 0)]))


def _with_one_black(mosaic: np.ndarray, black: np.ndarray) -> np.ndarray:
    """Move the counts of each photosite so that black is at the mean of the repeating cell's levels; (H, W) float32."""
    moved = mosaic.astype(np.float32)
    for (row, column), level in np.ndenumerate(black):
        moved[row :: black.shape[0], column :: black.shape[1]] -= np.float32(level - black.mean())
    return moved


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """Open a file with LibRaw; what it raises becomes InputError."""
    if not os.path.isfile(path):
        raise InputError(f"cannot read {quoted(path)}: no such file")
    try:
        import rawpy
    except ImportError:
        raise MissingDependencyError(
            f"{path.name} is a RAW file; install the extra that reads them: pip install 'chromaperture[raw]'"
        ) from None
    try:
        check_kind(path)
        with rawpy.imread(str(path)) as raw:
            check_complete(path)
            yield raw
    except rawpy.LibRawError as error:
        what = error.args[0].decode() if error.args and isinstance(error.args[0], bytes) else str(error)
        raise InputError(f"{path.name} is damaged or not a RAW file ({what}); copy the file again") from None
