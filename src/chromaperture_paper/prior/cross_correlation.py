"""Normalised cross-correlation in box windows, and phase correlation of blocks: the paper's [11] and [12]."""

from __future__ import annotations

from itertools import combinations

import cv2
import numpy as np

from chromaperture_paper.prior.shifts import best_layer, box, sampled, spline

_BLOCK_PX, _STEP_PX = 32, 4  # size and distance of the blocks of the phase correlation; chosen by hand


def cross_correlation(views: np.ndarray, directions: np.ndarray, layers_px: np.ndarray) -> np.ndarray:
    """Match views by the sum of their normalised cross-correlations.

    ``views`` (H, W, K) float: sensor channels or unmixed views; ``directions`` (K, 2) float: displacement (x, y) of
    each view per px of disparity; ``layers_px`` (D,) float. Returns (H, W) float64, px; NaN at the ends of the range.
    """
    planes = [spline(views[..., k]) for k in range(views.shape[2])]
    score = np.zeros((len(layers_px), *views.shape[:2]))
    for i, d in enumerate(layers_px):
        moved = [sampled(p, d * u, d * v).astype(np.float64) for p, (u, v) in zip(planes, directions, strict=True)]
        means = [box(p) for p in moved]
        variances = [np.maximum(box(p * p) - m * m, 1e-10) for p, m in zip(moved, means, strict=True)]
        for a, b in combinations(range(len(planes)), 2):
            covariance = box(moved[a] * moved[b]) - means[a] * means[b]
            score[i] += covariance / np.sqrt(variances[a] * variances[b])
    return best_layer(score, layers_px)


def phase_correlation(views: np.ndarray, directions: np.ndarray, layers_px: np.ndarray) -> np.ndarray:
    """Match views by the phase of the cross spectra of windowed blocks; parameters as in `cross_correlation`.

    For a pair (a, b) a block displaced by d has the cross spectrum |.| exp(-i w (u_a - u_b) d), so that

        score(d) = sum_w Re[ F_a conj(F_b) / |F_a F_b| exp(i w (u_a - u_b) d) ],

    is largest at the disparity. Only frequencies below a quarter of the sampling rate are used: above, noise dominates.

    Returns (H, W) float64, px; interpolated between the blocks.
    """
    height, width, count = views.shape
    half = _BLOCK_PX // 2
    rows, columns = np.arange(0, height, _STEP_PX), np.arange(0, width, _STEP_PX)
    window = np.outer(np.hanning(_BLOCK_PX + 2)[1:-1], np.hanning(_BLOCK_PX + 2)[1:-1])
    fy, fx = 2 * np.pi * np.fft.fftfreq(_BLOCK_PX)[:, None], 2 * np.pi * np.fft.rfftfreq(_BLOCK_PX)
    use = (np.hypot(fy, fx) < np.pi / 2) & ((fx > 0) | (fy > 0))
    wy, wx = (np.broadcast_to(f, use.shape)[use] for f in (fy, fx))
    padded = [np.pad(views[..., k].astype(np.float64), half, mode="reflect") for k in range(count)]
    coarse = np.zeros((len(layers_px), len(rows), len(columns)))
    for i, r in enumerate(rows):
        spectra = []
        for plane in padded:
            strip = np.lib.stride_tricks.sliding_window_view(plane[r : r + _BLOCK_PX], _BLOCK_PX, axis=1)[:, columns]
            blocks = strip.transpose(1, 0, 2)
            blocks = (blocks - blocks.mean(axis=(1, 2), keepdims=True)) * window
            spectra.append(np.fft.rfft2(blocks)[:, use])
        for a, b in combinations(range(count), 2):
            cross = spectra[a] * spectra[b].conj()
            cross /= np.maximum(np.abs(cross), 1e-12)
            u, v = directions[a] - directions[b]
            turns = np.exp(1j * np.outer(wx * u + wy * v, layers_px))
            # Not as a matrix product: for these sizes, synchronising the threads of BLAS takes longer than the sum.
            coarse[:, i] += np.einsum("bw,wd->db", cross, turns).real
    # Block centres lie on the pixels of the grid; every pixel is interpolated between them.
    x, y = np.meshgrid(np.arange(width, dtype=np.float32) / _STEP_PX, np.arange(height, dtype=np.float32) / _STEP_PX)
    fine = [cv2.remap(s.astype(np.float32), x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE) for s in coarse]
    return best_layer(np.stack(fine), layers_px)
