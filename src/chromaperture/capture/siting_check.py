"""Where the chroma samples of files lie, by photographs of a neutral and of a coloured print.

Chroma that is taken for d px beside its place moves a channel C against luma Y by d (1 - Y/C), and so R against B by
d (Y/B - Y/R): nothing on grey, .93 px on an orange for half a pixel. Lateral colour of the lens and parallax move both
prints alike, so that the difference between the two is the siting's. Y/C is that of the texture, not of the mean:
orange ink on white paper varies most in blue.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from chromaperture.capture.picture_format import LUMA_WEIGHTS, PictureFormat
from chromaperture.system.robust import MEDIAN_INEFFICIENCY, robust_sigma

LEAST_CONTRAST = 0.4  # of Y/B - Y/R: half a pixel of chroma is then .2 px of R against B
_LEAST_WINDOWS = 4
_SIDES_PX = 128, 64  # of windows; the smaller where the picture has fewer than three of the larger
_BANDS = 0.05, 0.12  # cycles a px: the first tells displacements of up to 8 px from their wraps, the second is precise
_LEAST_COHERENCE = 0.8  # of R and B of a print: below, noise is half as strong as the texture
_LEAST_ASPECT = 0.1  # of the band's moments: stripes tell nothing along themselves
_NOTHING = (np.nan, np.nan, np.nan)


class ChromaError(NamedTuple):
    """By how far chroma lies beside the place that it is taken for: (x, y), px of luma, and the standard error.

    ``contrast`` is Y/B - Y/R of the coloured print less that of the neutral one, in so many ``windows`` where both have
    texture. What is not known is NaN.
    """

    error_px: np.ndarray
    sigma_px: np.ndarray
    contrast: float
    windows: int


def find_chroma_error(neutral: np.ndarray, coloured: np.ndarray, form: PictureFormat) -> ChromaError:
    """Measure by how far chroma lies beside the place that it is taken for.

    Parameters
    ----------
    neutral, coloured : (h, w, 3) array
        Encoded R, G, B of both photographs, as `rgb_of_planes` makes them.
    form : PictureFormat
        Of both, with the siting that they were read by.
    """
    differences = _windows(coloured, form) - _windows(neutral, form)
    differences = differences[np.isfinite(differences[:, 2])]
    typical = float(np.median(differences[:, 2])) if len(differences) else float("nan")
    differences = differences[np.abs(differences[:, 2]) >= LEAST_CONTRAST]
    if len(differences) < _LEAST_WINDOWS:
        return ChromaError(np.full(2, np.nan), np.full(2, np.nan), typical, len(differences))
    errors = form.reduction * differences[:, :2] / differences[:, 2:]
    error = np.median(errors, axis=0)
    sigma = [MEDIAN_INEFFICIENCY * robust_sigma(rest) / len(rest) ** 0.5 for rest in (errors - error).T]
    return ChromaError(error, np.array(sigma), float(np.median(differences[:, 2])), len(differences))


def _windows(rgb: np.ndarray, form: PictureFormat) -> np.ndarray:
    """Return `_window` of windows that overlap by half, (N, 3)."""
    height, width = rgb.shape[:2]
    side = next((side for side in _SIDES_PX if 3 * side <= min(height, width)), _SIDES_PX[-1])
    rows, columns = (range(0, length - side + 1, side // 2) for length in (height, width))
    red, blue = form.luma_weights or LUMA_WEIGHTS[2]
    weights = np.array([red, 1 - red - blue, blue])
    return np.reshape([_window(rgb[y : y + side, x : x + side], weights) for y in rows for x in columns], (-1, 3))


def _window(rgb: np.ndarray, luma_weights: np.ndarray) -> tuple[float, float, float]:
    """Return displacement of R against B, x and y in px, and Y/B - Y/R; NaN without texture."""
    side, taper = len(rgb), np.hanning(len(rgb))[:, None]
    turns = np.stack(np.meshgrid(np.fft.rfftfreq(side), np.fft.fftfreq(side)), axis=-1)
    radius = np.hypot(turns[..., 0], turns[..., 1])
    band = (radius > 1.5 / side) & (radius < _BANDS[-1]) & ((turns[..., 0] > 0) | (turns[..., 1] > 0))
    tapered = (rgb - rgb.mean(axis=(0, 1), dtype=float)) * (taper * taper.T)[..., None]
    spectrum, turns, radius = np.fft.rfft2(tapered, axes=(0, 1))[band], turns[band], radius[band]
    red, blue, luma = spectrum[:, 0], spectrum[:, 2], spectrum @ luma_weights
    power, cross, moved = [(np.abs(c) ** 2).sum() for c in (red, blue)], red * np.conj(blue), np.zeros(2)
    for most in _BANDS:  # least squares of the phase that is left, weighted by its precision
        weighted = np.where(radius < most, np.abs(cross), 0.0)[:, None] * turns
        low, high = np.linalg.eigvalsh(moments := weighted.T @ turns)
        if not low > _LEAST_ASPECT * high:
            return _NOTHING
        rest = np.angle(cross * np.exp(2j * np.pi * (turns @ moved))) / (2 * np.pi)
        moved = moved - np.linalg.solve(moments, weighted.T @ rest)
    if np.abs((cross * np.exp(2j * np.pi * (turns @ moved))).sum()) < _LEAST_COHERENCE * np.sqrt(power[0] * power[1]):
        return _NOTHING
    share_red, share_blue = ((luma * np.conj(c)).real.sum() / p for c, p in zip((red, blue), power, strict=True))
    return moved[0], moved[1], share_blue - share_red
