"""RAW files (CR2, NEF, DNG, ...) to half-size colour through LibRaw, without interpolation between channels."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from chromaperture.capture.bayer import superpixels
from chromaperture.capture.source import Encoding
from chromaperture.errors import InputError, MissingDependencyError


def read_raw(path: Path) -> tuple[np.ndarray, Encoding]:
    """Read the mosaic and make one pixel of every 2 x 2 cell.

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
        A file that cannot be read, or a sensor without a Bayer mosaic.
    """
    if not path.is_file():
        raise InputError(f"cannot read {path}: no such file")
    try:
        import rawpy
    except ImportError:
        raise MissingDependencyError(
            f"{path.name} is a RAW file; install the extra that reads them: pip install 'chromaperture[raw]'"
        ) from None
    try:
        with rawpy.imread(str(path)) as raw:
            layout, names = raw.raw_pattern, raw.color_desc.decode()
            mosaic = raw.raw_image_visible.copy()
            black, white = float(np.mean(raw.black_level_per_channel)), float(raw.white_level)
    except rawpy.LibRawError as error:
        what = error.args[0].decode() if error.args and isinstance(error.args[0], bytes) else str(error)
        raise InputError(f"{path.name} is damaged or not a RAW file ({what}); copy the file again") from None
    pattern = "" if layout is None else "".join(names[i] for i in np.asarray(layout).ravel())
    if len(pattern) != 4 or mosaic.ndim != 2:
        raise InputError(
            f"{path.name} has no Bayer mosaic (X-Trans, Foveon or already developed); "
            "develop it to a linear 16-bit TIFF without sharpening"
        )
    counts, encoding = superpixels(mosaic, pattern, black_level=black, white_level=white)
    return counts, replace(encoding, given=False)  # the levels of the camera file are more exact
