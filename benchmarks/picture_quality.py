"""Measures of a picture: PSNR, SSIM, CIEDE2000, local misalignment of its channels. Needs scikit-image."""

from __future__ import annotations

import cv2
import numpy as np

from chromaperture.color.srgb import linear_to_srgb

# Chosen by hand.
TEMPLATE, SEARCH, STRIDE = 35, 16, 14  # px; the search covers the largest displacement
PHASE_SIDE, PHASE_STRIDE = 48, 28  # px
PARTS = 3  # of a window, along each side, with independent errors
SURE_PX = 0.1  # largest standard error of the windows that are counted
LEAST_GRADIENT = 4e-3  # per px, of the square root of light, in the direction with less texture


def matched_exposure(picture: np.ndarray, reference: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Scale each channel to the reference: exposure and white balance are not errors of restoration."""
    gain = (reference * valid[..., None]).sum(axis=(0, 1)) / (picture * valid[..., None]).sum(axis=(0, 1))
    return picture * gain.astype(np.float32)


def compare(picture: np.ndarray, reference: np.ndarray, valid: np.ndarray) -> dict[str, float]:
    """PSNR and SSIM of sRGB values in [0, 1], mean CIEDE2000; both linear, over the valid pixels."""
    from skimage.color import deltaE_ciede2000, rgb2lab
    from skimage.metrics import structural_similarity

    a, b = (linear_to_srgb(p) for p in (matched_exposure(picture, reference, valid), reference))
    error = ((a - b) ** 2)[valid].mean()
    _, map_ = structural_similarity(b, a, channel_axis=2, data_range=1.0, gaussian_weights=True, full=True)
    return {
        "psnr": float(-10 * np.log10(error)),
        "ssim": float(map_[valid].mean()),
        "ciede2000": float(deltaE_ciede2000(rgb2lab(b), rgb2lab(a))[valid].mean()),
    }


def misalignment(picture: np.ndarray, *, least_ncc: float = 0.85) -> np.ndarray:
    """Measure the displacement of red and blue from green in windows; (N, 2) float, px.

    Columns are the displacement and its standard error, from the scatter between the parts of the window; NaN where no
    match is found. The windows form a fixed grid, so that pictures of the same size can be compared window by window.
    """
    p = np.maximum(np.asarray(picture, np.float32), 0)
    p = cv2.GaussianBlur(np.sqrt(p), (0, 0), 1.0)  # equal noise in dark and light
    height, width = p.shape[:2]
    half, reach = TEMPLATE // 2, TEMPLATE // 2 + SEARCH
    found = []
    for y in range(reach, height - reach, STRIDE):
        for x in range(reach, width - reach, STRIDE):
            area = p[y - reach : y + reach + 1, x - reach : x + reach + 1, 1]
            for k in (0, 2):
                found.append(_displacement(p[y - half : y + half + 1, x - half : x + half + 1, k], area, least_ncc))
    return np.array(found)


def phase_misalignment(picture: np.ndarray) -> np.ndarray:
    """Measure the same by phase correlation, which the restoration does not use; (N, 2) float.

    Columns are the displacement in px and the response of the peak, on another grid.
    """
    p = np.sqrt(np.maximum(np.asarray(picture, np.float32), 0))
    p = cv2.GaussianBlur(p, (0, 0), 1.0)
    window = cv2.createHanningWindow((PHASE_SIDE, PHASE_SIDE), cv2.CV_32F)
    found = []
    for y in range(8, p.shape[0] - PHASE_SIDE - 8, PHASE_STRIDE):
        for x in range(8, p.shape[1] - PHASE_SIDE - 8, PHASE_STRIDE):
            tile = p[y : y + PHASE_SIDE, x : x + PHASE_SIDE]
            tile = tile - tile.mean(axis=(0, 1))
            green = np.ascontiguousarray(tile[..., 1])
            for k in (0, 2):
                shift, response = cv2.phaseCorrelate(green, np.ascontiguousarray(tile[..., k]), window)
                found.append((float(np.hypot(*shift)), response))
    return np.array(found)


def _displacement(patch: np.ndarray, area: np.ndarray, least_ncc: float) -> tuple[float, float]:
    gy, gx = np.gradient(patch)
    # Texture in both directions: along a lone edge the displacement is undetermined.
    if np.linalg.eigvalsh(np.cov(gx.ravel(), gy.ravel()))[0] ** 0.5 < LEAST_GRADIENT:
        return np.nan, np.nan
    score = cv2.matchTemplate(area, patch, cv2.TM_CCOEFF_NORMED)
    _, best, _, (i, j) = cv2.minMaxLoc(score)
    if best < least_ncc or not (0 < i < 2 * SEARCH and 0 < j < 2 * SEARCH):
        return np.nan, np.nan
    dx = _peak(score[j, i - 1], score[j, i], score[j, i + 1]) + i - SEARCH
    dy = _peak(score[j - 1, i], score[j, i], score[j + 1, i]) + j - SEARCH
    middle = (area.shape[1] // 2 + dx, area.shape[0] // 2 + dy)
    there = cv2.getRectSubPix(np.ascontiguousarray(area), patch.shape[::-1], middle)
    return float(np.hypot(dx, dy)), _standard_error(patch, there, gx, gy)


def _standard_error(patch: np.ndarray, there: np.ndarray, gx: np.ndarray, gy: np.ndarray) -> float:
    """Of a displacement, from the residual of the patch, taken to be correlated within each part of the window."""
    tone = there - there.mean()
    left = patch - patch.mean()
    left = left - (left * tone).sum() / (tone * tone).sum() * tone
    edges = np.linspace(0, len(patch), PARTS + 1).astype(int)[:-1]
    sums = (np.add.reduceat(np.add.reduceat(g * left, edges, axis=0), edges, axis=1) for g in (gx, gy))
    pull = np.stack([s.ravel() for s in sums])
    pull -= pull.mean(axis=1, keepdims=True)
    normal = np.linalg.inv(np.array([[(a * b).sum() for a in (gx, gy)] for b in (gx, gy)]))
    parts = PARTS**2
    return float(np.sqrt(np.trace(normal @ (pull @ pull.T) @ normal) * parts / (parts - 1)))


def _peak(left: float, middle: float, right: float) -> float:
    curvature = left - 2 * middle + right
    return 0.0 if curvature >= 0 else float(0.5 * (left - right) / curvature)
