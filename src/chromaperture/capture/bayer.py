"""Bayer mosaics to colour without demosaicing: every 2 x 2 cell is one pixel, and channels are not mixed.

Demosaicing transfers edges between channels, which biases the displacement between them, the measured signal, towards
zero. A cell samples R and B a quarter of the new pixel off its centre: `Encoding.channel_offsets_px` holds the offsets,
and `Frame.image` corrects them by interpolation within each channel.
"""

from __future__ import annotations

import numpy as np

from chromaperture.color.encoding import Encoding, Offsets
from chromaperture.errors import InputError

PATTERNS = ("RGGB", "BGGR", "GRBG", "GBRG")


def superpixels(
    mosaic: np.ndarray, pattern: str, *, black_level: float, white_level: float
) -> tuple[np.ndarray, Encoding]:
    """Make one pixel of every 2 x 2 cell: R, the mean of both G, B.

    Parameters
    ----------
    mosaic : (2H, 2W) uint8 or uint16
        An odd last row or column is ignored.
    pattern : {"RGGB", "BGGR", "GRBG", "GBRG"}
        Colours of the top-left cell, row by row.
    black_level, white_level : float
        Of the mosaic.

    Returns
    -------
    counts : (H, W, 3) uint16, or float32 where twice the white level needs more than 16 bits
        Twice the mosaic's, so that the mean of two counts is an integer.
    encoding : Encoding

    Raises
    ------
    InputError
        Unknown pattern, or no mosaic.
    """
    if pattern not in PATTERNS:
        raise InputError(f"unknown Bayer pattern {pattern!r}: choose {', '.join(PATTERNS)}")
    if mosaic.ndim != 2 or min(mosaic.shape) < 2:
        raise InputError(f"a Bayer mosaic has rows and columns, got shape {mosaic.shape}")
    height, width = mosaic.shape[0] // 2, mosaic.shape[1] // 2
    wide = np.dtype(np.float32 if 2 * max(int(mosaic.max()), white_level) > 65535 else np.uint16)
    counts = np.zeros((height, width, 3), wide)
    offsets = [[0.0, 0.0] for _ in range(3)]
    for i, colour in enumerate(pattern):
        row, column = divmod(i, 2)
        channel = "RGB".index(colour)
        factor = 1 if colour == "G" else 2  # a cell has two G
        counts[..., channel] += mosaic[row : 2 * height : 2, column : 2 * width : 2].astype(wide) * wide.type(factor)
        offsets[channel][0] += (column - 0.5) / 2 * factor / 2
        offsets[channel][1] += (row - 0.5) / 2 * factor / 2
    placed: Offsets = tuple((x, y) for x, y in offsets)  # type: ignore[assignment]
    return counts, Encoding(2 * black_level, 2 * white_level, "linear", placed)
