"""Pictures and maps as files that other programs read: PNG and float TIFF."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import tifffile

from chromaperture.color.srgb import linear_to_srgb_bytes
from chromaperture.system.memory import Rows, RowsOnDemand


def write_float_tiff(path: str | Path, values: np.ndarray) -> None:
    """Write a map as float32 TIFF; NaN stays NaN.

    Parameters
    ----------
    path : str or Path
    values : (H, W) float

    Notes
    -----
    Not compressed: zlib makes measured floats a fifth smaller, and takes 0.9 s for 6 megapixels instead of 0.03 s.
    """
    tifffile.imwrite(path, np.asarray(values, np.float32), metadata=None)


def write_depth_png(path: str | Path, depth_mm: Rows) -> None:
    """Write depth as 16-bit PNG in whole mm; 0 is unknown or beyond 65535 mm.

    Parameters
    ----------
    path : str or Path
    depth_mm : (H, W) float, NaN where unknown
    """

    def whole(rows: slice) -> np.ndarray:
        depth = depth_mm[rows]
        with np.errstate(invalid="ignore"):  # NaN compares false
            known = (depth > 0) & (depth < 65535.5)
        return np.rint(np.where(known, depth, 0)).astype(np.uint16)

    write_png(path, RowsOnDemand(depth_mm.shape, np.dtype(np.uint16), whole))


def write_color_png(path: str | Path, color: np.ndarray) -> None:
    """Write a colour picture as 8-bit sRGB PNG.

    Parameters
    ----------
    path : str or Path
    color : (H, W, 3) float, linear RGB, 1.0 = white level; or uint8, sRGB
    """
    write_png(path, color if color.dtype == np.uint8 else linear_to_srgb_bytes(color))


def write_png(path: str | Path, picture: Rows) -> None:
    """Write a grey (H, W) or RGB (H, W, 3) picture of uint8 or uint16 as PNG."""
    Path(path).write_bytes(encode_png(picture))  # unlike `cv2.imwrite`, raises when the disk is full


def encode_png(picture: Rows) -> bytes:
    """Return the content of a PNG file of a grey (H, W) or RGB (H, W, 3) picture of uint8 or uint16."""
    whole = np.asarray(picture[:])
    return bytes(cv2.imencode(".png", whole if whole.ndim == 2 else np.ascontiguousarray(whole[..., ::-1]))[1])
