"""Signs of an error that the evidence itself gives, by what it would say if the answer lay elsewhere.

The evidence of a window, and that of a whole plane, is read along the answer, and again with all of the answer shifted
by a few steps. A plane whose evidence hardly falls with the shift, or a window that another shift suits as well, is the
less sure. Everything counts in steps between labels.
"""

from __future__ import annotations

import cv2
import numpy as np

from chromaperture.disparity.plane_fit import Volume

SHIFTS = np.array([-24, -16, -12, -8, -6, -4, -3, -2, -1, 0, 1, 2, 3, 4, 6, 8, 12, 16, 24], float)  # steps
SHARP_STEPS = 4  # over which a plane's evidence must fall to be sharp: of 1, 2 and 4 the best; docs/measurements.md
WINDOW_PX = 12.0  # sigma of the windows; of 4, 12 and 30 the best; docs/measurements.md
# Pixels of a window that say one thing: detail and windows of correlation are that wide. Chosen by hand: it only scales
# a sign, whose weight is learned.
PIXELS_ALIKE = 10.0
LEAST_SPREAD = 0.05  # steps, chosen by hand: every sign needs a finite logarithm
LEAST_NATS = 1e-4  # a pixel, likewise


def signs_of_evidence(blocks: Volume, label: np.ndarray, choice: np.ndarray) -> dict[str, np.ndarray]:
    """Return what the evidence says of an answer; (H, W) float32 each, logarithms.

    ``spread``: of the standard deviation of the shift by a window's evidence, about the answer. ``sharpness``: of the
    nats a pixel by which the evidence of a pixel's plane falls when the answer is shifted.

    Parameters
    ----------
    blocks : Volume
        Sums over blocks of pixels.
    label : (H, W) float
        The answer in steps, 0 the first label.
    choice : (H, W) int
        Plane of every pixel.
    """
    height, width = blocks.likelihood.shape[:2]
    size = label.shape[0] // height
    middles = np.s_[size // 2 :: size, size // 2 :: size]
    profile = along_answer(blocks.likelihood, label[middles][:height, :width]) / np.float32(size**2)
    pooled = cv2.GaussianBlur(profile, (0, 0), WINDOW_PX / size, borderType=cv2.BORDER_REFLECT_101)
    likely = np.exp((pooled - pooled.max(axis=2, keepdims=True)) * (2 * np.pi * WINDOW_PX**2 / PIXELS_ALIKE))
    likely *= np.gradient(SHIFTS).astype(np.float32)  # every shift stands for the shifts about it
    variance = likely @ np.square(SHIFTS).astype(np.float32) / likely.sum(axis=2)
    of_blocks = {
        "spread": np.log(np.sqrt(variance) + LEAST_SPREAD),
        "sharpness": _sharpness(profile, choice[middles][:height, :width]),
    }
    rows, columns = (np.minimum(np.arange(n) // size, m - 1) for n, m in zip(label.shape, (height, width), strict=True))
    return {name: values.astype(np.float32)[rows[:, None], columns] for name, values in of_blocks.items()}


def along_answer(likelihood: np.ndarray, label: np.ndarray) -> np.ndarray:
    """Read a volume (H, W, N) at an answer (H, W), in labels, and at `SHIFTS` from it; (H, W, S) float32."""
    most = likelihood.shape[2] - 1
    out = np.empty((*label.shape, len(SHIFTS)), np.float32)
    for i, shift in enumerate(SHIFTS):
        place = np.clip(label + shift, 0, most)
        below = np.minimum(place.astype(np.intp), most - 1)[..., None]
        part = (place[..., None] - below).astype(np.float32)
        low, high = (np.take_along_axis(likelihood, at, axis=2) for at in (below, below + 1))
        out[..., i] = (low + part * (high - low))[..., 0]
    return out


def _sharpness(profile: np.ndarray, choice: np.ndarray) -> np.ndarray:
    least, middle, most = (int(np.flatnonzero(shift == SHIFTS)[0]) for shift in (-SHARP_STEPS, 0, SHARP_STEPS))
    falls = profile[..., middle] - (profile[..., least] + profile[..., most]) / 2
    blocks = np.maximum(np.bincount(choice.ravel()), 1)
    mean = np.bincount(choice.ravel(), falls.ravel()) / blocks
    return np.log(np.maximum(mean, 0) + LEAST_NATS)[choice]
