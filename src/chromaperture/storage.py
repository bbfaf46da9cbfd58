"""Atomic writing of output files, and encodings of depth that other programs read."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import shutil
import stat
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import tifffile

from chromaperture.color.srgb import linear_to_srgb_bytes
from chromaperture.errors import InputError

# Of the filters and strategies of OpenCV's PNG encoder this is the smallest, and the fastest to within 5 %: 6 mega-
# pixels of colour take 0.18 s and 6.7 MB; by default 0.17 s and 7.3 MB, by level 6 of zlib's strategy 2.2 s and 7.6 MB.
_PNG = (cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE, cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_AVG)


class Stage:
    """A private folder beside the outputs, whose files are moved to their final names together."""

    def __init__(self, folder: Path, private: Path) -> None:
        self.folder, self.private, self.names = folder, private, list[str]()

    def path(self, name: str) -> Path:
        """Return the temporary path of the file that will be ``name``."""
        self.names.append(name)
        return self.private / name


@contextlib.contextmanager
def staged(folder: str | Path) -> Iterator[Stage]:
    """Write a set of files so that none remain after an error, a full disk or Ctrl-C.

    Raises
    ------
    InputError
        The folder cannot be created or written to, or the disk is full.
    """
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        private = Path(tempfile.mkdtemp(prefix=".chromaperture-", dir=folder))
    except OSError as error:  # of any number: /proc reports that there is no such file
        raise _cannot_write(folder, error) from None
    try:
        stage = Stage(folder, private)
        yield stage
        for name in stage.names:
            if _is_device(folder / name):
                raise InputError(f"{folder / name} is a device, which a file would replace; choose another name")
        for name in stage.names:
            os.replace(private / name, folder / name)
    except OSError as error:
        if error.errno in _FULL or error.errno in _REFUSED:
            raise _cannot_write(folder, error) from None
        raise
    finally:
        shutil.rmtree(private, ignore_errors=True)


_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_REFUSED = (errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOTDIR, errno.EEXIST, errno.EISDIR, errno.ENOTEMPTY)


def _cannot_write(folder: Path, error: OSError) -> InputError:
    if error.errno in _FULL:
        return InputError(f"the disk is full: nothing was written to {folder}; free some space and repeat")
    return InputError(f"cannot write to {folder} ({error.strerror or error}); choose another folder with --out")


def _is_device(path: Path) -> bool:
    """Find what is there and is neither a file nor a folder: replacing /dev/full would delete the device."""
    try:
        mode = path.stat().st_mode
    except OSError:
        return False
    return not (stat.S_ISREG(mode) or stat.S_ISDIR(mode))


def write_float_tiff(path: str | Path, values: np.ndarray) -> None:
    """Write (H, W) as float32 TIFF; NaN stays NaN.

    Not compressed: zlib makes measured floats a fifth smaller, and takes 0.9 s for 6 megapixels instead of 0.03 s.
    """
    tifffile.imwrite(path, np.asarray(values, np.float32), metadata=None)


def write_depth_png(path: str | Path, depth_mm: np.ndarray) -> None:
    """Write (H, W) depth as 16-bit PNG in whole mm; 0 is unknown or beyond 65535 mm."""
    with np.errstate(invalid="ignore"):  # NaN compares false
        known = (depth_mm > 0) & (depth_mm < 65535.5)
    write_png(path, np.rint(np.where(known, depth_mm, 0)).astype(np.uint16))


def write_color_png(path: str | Path, color: np.ndarray) -> None:
    """Write linear RGB (H, W, 3) as 8-bit sRGB PNG."""
    write_png(path, linear_to_srgb_bytes(color))


def write_png(path: str | Path, picture: np.ndarray) -> None:
    """Write a grey (H, W) or RGB (H, W, 3) picture of uint8 or uint16 as PNG."""
    path = Path(path)
    stored = cv2.cvtColor(picture, cv2.COLOR_RGB2BGR) if picture.ndim == 3 else np.ascontiguousarray(picture)
    ok, encoded = cv2.imencode(".png", stored, _PNG)
    if not ok:
        raise InputError(f"cannot encode {path.name}")
    path.write_bytes(encoded.data)  # unlike `cv2.imwrite`, raises when the disk is full


def write_json(path: Path, value: Any) -> None:
    """Write readable JSON; NaN and infinity become null."""
    path.write_text(to_json(value) + "\n", encoding="utf-8")


def to_json(value: Any) -> str:
    """Format as readable JSON; NumPy scalars and arrays become numbers and lists, NaN null."""
    return json.dumps(_plain(value), indent=2, allow_nan=False)


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return str(value) if isinstance(value, Path) else value
