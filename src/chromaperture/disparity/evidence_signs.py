"""Signs of an error that the evidence itself gives, by what it would say if the answer lay elsewhere.

The evidence of a window, and that of a whole plane, is read along the answer, and again with all of the answer shifted
by a few steps. A plane whose evidence hardly falls with the shift, or a window that another shift suits as well, is the
less sure. Everything counts in steps between labels.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from chromaperture.disparity.plane_fit import Volume, of_pixels

SHIFTS = np.array([-24, -16, -12, -8, -6, -4, -3, -2, -1, 0, 1, 2, 3, 4, 6, 8, 12, 16, 24], float)  # steps
OF_FALL = (-4, 0, 4)  # steps at which the fall of a plane's evidence is read; docs/measurements.md
WINDOW_PX = 12.0  # sigma of the windows; of 4, 12 and 30 the best; docs/measurements.md
# Pixels of a window that say one thing: detail and windows of correlation are that wide. Chosen by hand: it only scales
# a sign, whose weight is learned.
PIXELS_ALIKE = 10.0
LEAST_SPREAD = 0.05  # steps, chosen by hand: every sign needs a finite logarithm
LEAST_EVIDENCE = 1e-3  # nats a pixel, likewise


def signs_of_evidence(blocks: Volume, label: np.ndarray, choice: np.ndarray) -> dict[str, np.ndarray]:
    """Return what the evidence says of an answer; (H, W) float32 each, logarithms.

    ``spread``: of the standard deviation of the shift by a window's evidence, about the answer. ``evidence``: of the
    nats a pixel of a pixel's plane at the answer.

    Parameters
    ----------
    blocks : Volume
        Sums over blocks of pixels.
    label : (H, W) float
        The answer in steps, 0 the first label.
    choice : (H, W) int
        Plane of every pixel.
    """
    size = _size(blocks, label)
    profile = along_answer(blocks.likelihood, _in_middles(label, blocks)) / np.float32(size**2)
    pooled = cv2.GaussianBlur(profile, (0, 0), WINDOW_PX / size, borderType=cv2.BORDER_REFLECT_101)
    likely = np.exp((pooled - pooled.max(axis=2, keepdims=True)) * (2 * np.pi * WINDOW_PX**2 / PIXELS_ALIKE))
    likely *= np.gradient(SHIFTS).astype(np.float32)  # every shift stands for the shifts about it
    variance = likely @ np.square(SHIFTS).astype(np.float32) / likely.sum(axis=2)
    spread = np.log(np.sqrt(variance) + LEAST_SPREAD).astype(np.float32)
    here = means_of_planes(profile[..., SHIFTS == 0], _in_middles(choice, blocks), int(choice.max()) + 1)[:, 0]
    evidence = np.log(np.maximum(here, 0) + LEAST_EVIDENCE).astype(np.float32)
    return {"spread": of_pixels(spread, label.shape, size), "evidence": evidence[choice]}


def known_planes(blocks: Volume, label: np.ndarray, choice: np.ndarray, *, from_nats: float) -> np.ndarray:
    """Find the planes whose evidence falls by at least ``from_nats`` a pixel when the answer is shifted; (K,) bool.

    One pixel may suit several places, where the texture repeats; all pixels of its plane together single out one. The
    evidence of noise hardly falls. Parameters are those of `signs_of_evidence`.
    """
    profile = along_answer(blocks.likelihood, _in_middles(label, blocks), OF_FALL)
    profile /= np.float32(_size(blocks, label) ** 2)
    means = means_of_planes(profile, _in_middles(choice, blocks), int(choice.max()) + 1)
    before, middle, behind = means.T
    return np.asarray(np.maximum(middle - (before + behind) / 2, 0) >= from_nats)


def along_answer(
    likelihood: np.ndarray, label: np.ndarray, shifts: Sequence[float] | np.ndarray = SHIFTS
) -> np.ndarray:
    """Read a volume (H, W, N) at an answer (H, W), in labels, shifted by S numbers of them; (H, W, S) float32."""
    most = likelihood.shape[2] - 1
    out = np.empty((*label.shape, len(shifts)), np.float32)
    for i, shift in enumerate(shifts):
        place = np.clip(label + shift, 0, most)
        below = np.minimum(place.astype(np.intp), most - 1)[..., None]
        part = (place[..., None] - below).astype(np.float32)
        low, high = (np.take_along_axis(likelihood, at, axis=2) for at in (below, below + 1))
        out[..., i] = (low + part * (high - low))[..., 0]
    return out


def _size(blocks: Volume, values: np.ndarray) -> int:
    """Return the side of a block, px, by a map of pixels."""
    return int(values.shape[0] // blocks.likelihood.shape[0])


def _in_middles(values: np.ndarray, blocks: Volume) -> np.ndarray:
    """Return what a map of pixels has in the middle of every whole block; (h, w)."""
    (height, width), size = blocks.likelihood.shape[:2], _size(blocks, values)
    return values[size // 2 :: size, size // 2 :: size][:height, :width]


def means_of_planes(profile: np.ndarray, choice: np.ndarray, planes: int) -> np.ndarray:
    """Return the means (K, S) of evidence (h, w, S) over the blocks of every plane; 0 where it has none."""
    of = choice.ravel()
    sums = [np.bincount(of, part.ravel(), minlength=planes) for part in np.moveaxis(profile, 2, 0)]
    return np.stack(sums, axis=1) / np.maximum(np.bincount(of, minlength=planes), 1)[:, None]
