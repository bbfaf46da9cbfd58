"""RAW files (CR2, NEF, DNG, ...) to half-size colour through LibRaw, without interpolation between channels."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from chromaperture.capture.bayer import superpixels
from chromaperture.capture.picture_format import SENSOR_LIGHT, PictureFormat
from chromaperture.capture.picture_header import check_size
from chromaperture.capture.raw_container import check_complete
from chromaperture.color.encoding import Encoding
from chromaperture.errors import InputError, MissingDependencyError
from chromaperture.validation import quoted

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
    """Read the mosaic and make one pixel of every 2 x 2 cell.

    Parameters
    ----------
    path : Path
    size_px : (int, int), optional
        Width and height of the camera, whose pixels are these cells; see `check_size`.

    Returns
    -------
    counts : (H, W, 3) uint16 or float32, twice the mosaic's
    encoding : Encoding
        With the file's own levels, doubled too.

    Raises
    ------
    MissingDependencyError
        rawpy is not installed.
    InputError
        A file that cannot be read or ends too early, or a sensor without a Bayer mosaic.
    """
    with _opened(path) as raw:
        check_size(raw.sizes.width // 2, raw.sizes.height // 2, path.name, size_px)
        layout = None if raw.raw_pattern is None else np.asarray(raw.raw_pattern)
        if layout is None or layout.shape != (2, 2) or raw.raw_image_visible.ndim != 2:
            raise InputError(
                f"{path.name} has no Bayer mosaic (X-Trans, Foveon or already developed); "
                "develop it with 'dcraw -4 -q 0 -o 0 -r 1 1 1 1 -T FILE' (linear, camera colours, unmixed)"
            )
        # The pattern begins at the sensor's corner, the picture behind a masked border: perhaps an odd pixel away.
        top, left = raw.sizes.top_margin, raw.sizes.left_margin
        layout = np.roll(layout, (-top, -left), axis=(0, 1))
        mosaic = raw.raw_image_visible.copy()
        black = np.array(raw.black_level_per_channel, float)[layout]
        names, white = raw.color_desc.decode(), _white_level(raw)
    pattern = "".join(names[i] for i in layout.ravel())
    counts, encoding = superpixels(mosaic, pattern, black_level=float(black.mean()), white_level=white)
    if np.ptp(black) > 0:
        counts = _with_one_black(counts, pattern, black)
    return counts, replace(encoding, given=False)  # the levels of the camera file are more exact


def _white_level(raw: Any) -> float:
    """Return the count up to which all channels are linear: that of the format, or what the camera states if lower.

    Sony's ARW states 15360 of 16383 counts. Neither has black subtracted (LibRaw, `libraw_colordata_t`).
    """
    stated = getattr(raw, "camera_white_level_per_channel", None) or ()
    return float(min([raw.white_level, *(level for level in stated if level > 0)]))


def _with_one_black(counts: np.ndarray, pattern: str, black: np.ndarray) -> np.ndarray:
    """Move the counts of each colour so that black is at the mean of the cell's black levels; (H, W, 3) float32."""
    moved = counts.astype(np.float32)
    for place, level in zip(pattern, black.ravel(), strict=True):
        factor = 1 if place == "G" else 2  # as in `superpixels`: a cell has two G
        moved[..., "RGB".index(place)] -= np.float32(factor * (level - black.mean()))
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
        with rawpy.imread(str(path)) as raw:
            check_complete(path)
            yield raw
    except rawpy.LibRawError as error:
        what = error.args[0].decode() if error.args and isinstance(error.args[0], bytes) else str(error)
        raise InputError(f"{path.name} is damaged or not a RAW file ({what}); copy the file again") from None
