"""Filtering channels with each other's blur, compiled; ``readable/cross_filter.py`` explains what is computed.

P and Q are the real and the imaginary part of one picture, whose spectrum is transformed back at once.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from chromaperture.matching.compiled.paths import FAST
from chromaperture.matching.readable.cross_filter import Tile
from chromaperture.optics.splat_kernels import point_transforms
from chromaperture.system.compilation import compiled


def cross_filter(
    tiles: Sequence[Tile],
    channels: np.ndarray,
    defocus_px: np.ndarray,
    canvas: np.ndarray,
    *,
    size_px: int,
    damping: float,
) -> None:
    """Add P and Q of tiles at one distance to a canvas, as `readable.cross_filter`."""
    pairs, _, size, columns = tiles[0].spectra.shape
    transfers = np.empty((len(tiles[0].rays.light), size, columns), np.complex64)
    both, views = np.empty((pairs, size, size, 2), np.float32), np.empty((size, size, 2), np.float32)
    for tile in tiles:
        point_transforms(tile.rays.at_infinity_px - defocus_px, tile.rays.light, size_px, size, out=transfers)
        # As pairs of floats: loops over these become vectors. OpenCV's own scaling takes a fifth of the time of its
        # transform (160 samples).
        spectra, of_channels = tile.spectra.view(np.float32), transfers.view(np.float32)
        rows = both.reshape(pairs, size, -1)
        spectra_of_both(spectra, of_channels, channels, np.float32(damping), np.float32(1 / size**2), rows)
        for spectrum, part in zip(both, canvas, strict=True):
            cv2.dft(spectrum, dst=views, flags=cv2.DFT_INVERSE)
            cv2.accumulateProduct(views[tile.inner, tile.inner], tile.weight, part[tile.place])


@compiled(fastmath=FAST, error_model="numpy")
def spectra_of_both(spectra, transfers, channels, damping, scale, both):  # type: ignore[no-untyped-def]
    """Compute the spectra of P + i Q of all pairs from halves of spectra, times ``scale``: at -w it is P* + i Q*."""
    size = both.shape[1]
    columns = size // 2 + 1
    negative = np.empty(2 * columns, np.float32)  # at -w, in the order of w
    for pair in range(len(channels)):
        for y in range(size):
            a, b, here = spectra[pair, 0, y], spectra[pair, 1, y], both[pair, y]
            of_a, of_b = transfers[channels[pair, 0], y], transfers[channels[pair, 1], y]
            for x in range(columns):
                ha, ia, hb, ib = of_a[2 * x], of_a[2 * x + 1], of_b[2 * x], of_b[2 * x + 1]
                power = (ha * ha + ia * ia + hb * hb + ib * ib) * np.float32(0.5)
                gain = scale / np.sqrt(power + damping)
                ar, ai, br, bi = a[2 * x] * gain, a[2 * x + 1] * gain, b[2 * x] * gain, b[2 * x + 1] * gain
                p_real, p_imaginary = ar * hb - ai * ib, ar * ib + ai * hb
                q_real, q_imaginary = br * ha - bi * ia, br * ia + bi * ha
                here[2 * x] = p_real - q_imaginary
                here[2 * x + 1] = p_imaginary + q_real
                negative[2 * x] = p_real + q_imaginary
                negative[2 * x + 1] = q_real - p_imaginary
            mirrored, end = both[pair, size - y if y > 0 else 0], 2 * size
            for x in range(1, size - columns + 1):
                mirrored[end - 2 * x] = negative[2 * x]
                mirrored[end - 2 * x + 1] = negative[2 * x + 1]
