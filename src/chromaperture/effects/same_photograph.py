"""Test whether a disparity belongs to a photograph: aligned by its own, the channels correlate better than before."""

from __future__ import annotations

from itertools import combinations

import cv2
import numpy as np

from chromaperture.system.errors import InputError

_SMOOTH_PX, _WINDOW_PX = 1.0, 8.0  # standard deviations against noise and of the local window; chosen by hand
# Of larger pictures so many bands are compared, evenly spaced, of so many pixels together; chosen by hand.
_BANDS, _MOST_PX = 8, 1 << 21
_MAX_LOSS = 0.03  # of correlation. On bench50 a scene's own disparity gains 0.02 to 0.15, another's loses 0.035 to 0.2


def channel_agreement(color: np.ndarray) -> float:
    """Return the local correlation of the channels, whatever its sign, weighted by their contrast; 0 to 1.

    ``color`` (H, W, 3) float32, linear RGB.
    """
    correlated = contrast = 0.0
    for band in _bands(*color.shape[:2]):
        tone = np.sqrt(np.maximum(np.asarray(color[band], np.float32), 0))
        tone = cv2.GaussianBlur(tone, (0, 0), _SMOOTH_PX) - cv2.GaussianBlur(tone, (0, 0), _WINDOW_PX)
        power = cv2.GaussianBlur(tone * tone, (0, 0), _WINDOW_PX)
        for a, b in combinations(range(3), 2):
            correlated += float(np.abs(cv2.GaussianBlur(tone[..., a] * tone[..., b], (0, 0), _WINDOW_PX)).sum())
            contrast += float(np.sqrt(power[..., a] * power[..., b]).sum())
    return correlated / contrast if contrast > 0 else 1.0


def _bands(height: int, width: int) -> list[slice]:
    """Return the rows of a picture that are compared: all of them, or evenly spaced bands."""
    rows = _MOST_PX // (_BANDS * width)
    if height <= _BANDS * rows:
        return [slice(0, height)]
    return [slice(top, top + max(rows, 1)) for top in (height - rows) * (2 * np.arange(_BANDS) + 1) // (2 * _BANDS)]


def check_same_photograph(image: np.ndarray, aligned: np.ndarray) -> None:
    """Reject a disparity that moves the channels farther apart.

    ``image``, ``aligned`` (H, W, 3) float32, linear RGB: channels as captured, and moved by the disparity. Raises
    InputError: the channels correlate clearly less once they are aligned.
    """
    if channel_agreement(aligned) < channel_agreement(image) - _MAX_LOSS:
        raise InputError(
            "this disparity moves the photograph's channels farther apart instead of together: it is of another "
            "photograph, or of another camera; measure it again from this one"
        )
