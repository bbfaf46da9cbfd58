"""Bayer mosaics to colour without demosaicing: every 2 x 2 cell is one pixel, and channels are not mixed.

Demosaicing transfers edges between channels, which biases the displacement between them, the measured signal, towards
zero. A cell samples R and B a quarter of the new pixel off its centre: `Encoding.channel_offsets_px` holds the offsets,
and `Frame.image` corrects them by interpolation within each channel.
"""

from __future__ import annotations

import numpy as np

from chromaperture.color.encoding import PATTERNS, Encoding, Offsets
from chromaperture.system.errors import InputError

# A Bayer mosaic's 2 x 2 cells have the same mean colours wherever they are, a Quad-Bayer's photosites within a cell:
# of the sample capture 0.0002 and 0.275 of the mean apart, the other way round for quad. Chosen by hand between.
_LEAST_OF_CELLS, _TIMES_OF_SITES = 0.02, 3.0
_BLOCKS = 500  # of 4 x 4 photosites each way, from which the means are taken


def superpixels(
    mosaic: np.ndarray, pattern: str, *, black_level: float, white_level: float
) -> tuple[np.ndarray, Encoding]:
    """Make a pixel of every 2 x 2 cell, (H, W, 3), counts twice the mosaic's so that both G add up."""
    if pattern not in PATTERNS:
        raise InputError(f"unknown Bayer pattern {pattern!r}: choose {', '.join(PATTERNS)}")
    if mosaic.ndim != 2 or min(mosaic.shape) < 2:
        raise InputError(f"a Bayer mosaic has rows and columns, got shape {mosaic.shape}")
    height, width = mosaic.shape[0] // 2, mosaic.shape[1] // 2
    is_deep = mosaic.dtype.kind == "f" or 2 * max(int(mosaic.max()), white_level) > 65535
    wide = np.dtype(np.float32 if is_deep else np.uint16)
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


def quad_message(name: str) -> str:
    """Return what to say of a mosaic of 2 x 2 photosites a colour."""
    return (
        f"{name} is a Quad-Bayer mosaic, of 2 x 2 photosites a colour: set the camera or phone to binned RAW (12 MP "
        "instead of 48 or 50 MP), which has one photosite a colour"
    )


def check_not_quad(mosaic: np.ndarray, name: str, *, black_level: float) -> None:
    """Raise InputError for a Quad-Bayer mosaic, which phones tag as a Bayer one."""
    rows, columns = (n // 4 for n in mosaic.shape)
    if not rows or not columns:
        return
    blocks = mosaic[: 4 * rows, : 4 * columns].reshape(rows, 4, columns, 4)
    sites = blocks[:: -(-rows // _BLOCKS), :, :: -(-columns // _BLOCKS)].mean((0, 2), dtype=np.float64)
    sites = sites.reshape(2, 2, 2, 2) - black_level
    of_cells, of_sites = sites.mean((1, 3)).std(), sites.mean((0, 2)).std()
    if of_cells > max(_LEAST_OF_CELLS * sites.mean(), _TIMES_OF_SITES * of_sites):
        raise InputError(quad_message(name))
