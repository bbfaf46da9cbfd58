"""Prior methods, written from the formulas of their publications, and OpenCV's semi-global matching.

Normalised cross-correlation in box windows [11], phase correlation of blocks [12], colour lines [4] and, for design VI,
the size of the blur [5]; numbers are the paper's references.
"""

from __future__ import annotations

from itertools import combinations

import cv2
import numpy as np
import scipy.fft
import scipy.ndimage

from chromaperture.matching.accurate import path_surface
from chromaperture.matching.execution import execution_named
from chromaperture.settings.methods import AccurateConfig
from chromaperture.settings.stages import SurfaceConfig

WINDOW_PX = 15  # side of the windows of the prior methods, the same for all; chosen by hand


def spline(view: np.ndarray) -> np.ndarray:
    """Fit a cubic spline to a view; return its coefficients for `sampled`, (H, W) float32."""
    view = np.asarray(view, np.float32)
    return np.asarray(scipy.ndimage.spline_filter(view, order=3, output=np.float32, mode="mirror"))


def sampled(coefficients: np.ndarray, dx: float, dy: float) -> np.ndarray:
    """Sample a view's spline at (x + dx, y + dy); (H, W) float32, mirrored at the rim.

    Splines, because OpenCV's cubic resampling shifts a ramp by up to 0.05 px. One shift for all pixels makes the four
    weights of an axis a filter.
    """
    x, y = _weights(dx), _weights(dy)
    return np.asarray(cv2.sepFilter2D(coefficients, -1, x, y, borderType=cv2.BORDER_REFLECT_101))


def _weights(shift: float) -> np.ndarray:
    """Return the weights of the coefficients about a pixel, for a value ``shift`` px beside it; float32."""
    whole = int(np.floor(shift))
    t = shift - whole
    reach = max(abs(whole - 1), abs(whole + 2))
    kernel = np.zeros(2 * reach + 1, np.float32)
    four = np.array([(1 - t) ** 3, 4 - 6 * t**2 + 3 * t**3, 1 + 3 * t + 3 * t**2 - 3 * t**3, t**3]) / 6
    kernel[reach + whole - 1 : reach + whole + 3] = four
    return kernel


def box(picture: np.ndarray) -> np.ndarray:
    """Average over a square window of WINDOW_PX; (H, W) float64."""
    values = np.asarray(picture, np.float64)
    return np.asarray(cv2.blur(values, (WINDOW_PX, WINDOW_PX), borderType=cv2.BORDER_REFLECT_101))


def best_layer(score: np.ndarray, layers_px: np.ndarray) -> np.ndarray:
    """Return the disparity of the largest score, refined by a parabola; NaN at the ends of the range.

    ``score`` (D, H, W) float; ``layers_px`` (D,) float, evenly spaced. Returns (H, W) float64, px.
    """
    best = score.argmax(axis=0)
    inner = np.clip(best, 1, len(layers_px) - 2)
    below, at, above = (np.take_along_axis(score, (inner + k)[None], axis=0)[0] for k in (-1, 0, 1))
    bend = below - 2 * at + above
    offset = np.where(bend < 0, 0.5 * (below - above) / np.where(bend < 0, bend, -1.0), 0.0)
    found = layers_px[inner] + np.clip(offset, -0.5, 0.5) * (layers_px[1] - layers_px[0])
    return np.where(best == inner, found, np.nan)


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


_PATHS = AccurateConfig(surface=SurfaceConfig(slope_penalty=1.0, jump_penalty=1.0))  # penalties chosen by hand
_LOG_SPAN = 16.0  # nats; a smaller measure, below exp(-16), depends on noise; chosen by hand
_GUIDE_STEP = 0.06  # unit of the guide's steps, of the bright level (99th percentile); chosen by hand


def colour_line_measure(image: np.ndarray, directions: np.ndarray, layers_px: np.ndarray) -> np.ndarray:
    """Return the determinant of the local colour covariance over the product of its diagonal.

    With eigenvalues l_i and channel variances s_c^2, L = l_0 l_1 l_2 / (s_r^2 s_g^2 s_b^2) in [0, 1]: 0 for colours on
    a line or plane, 1 for uncorrelated channels.

    ``image`` (H, W, 3) float; ``directions`` (3, 2) float: displacement (x, y) of R, G, B per px of disparity;
    ``layers_px`` (D,) float. Returns (D, H, W) float64.
    """
    measure = np.empty((len(layers_px), *image.shape[:2]))
    planes = [spline(image[..., c]) for c in range(3)]
    for i, d in enumerate(layers_px):
        r, g, b = (sampled(p, d * u, d * v).astype(np.float64) for p, (u, v) in zip(planes, directions, strict=True))
        mr, mg, mb = box(r), box(g), box(b)
        rr, gg, bb = box(r * r) - mr * mr, box(g * g) - mg * mg, box(b * b) - mb * mb
        rg, rb, gb = box(r * g) - mr * mg, box(r * b) - mr * mb, box(g * b) - mg * mb
        rr, gg, bb = (np.maximum(s, 1e-10) for s in (rr, gg, bb))
        determinant = rr * (gg * bb - gb**2) - rg * (rg * bb - gb * rb) + rb * (rg * gb - gg * rb)
        measure[i] = np.clip(determinant / (rr * gg * bb), 0, 1)
    return measure


def colour_lines(
    image: np.ndarray, directions: np.ndarray, layers_px: np.ndarray, *, optimised: bool = True
) -> np.ndarray:
    """Match by `colour_line_measure`, pixel by pixel or with a global optimisation.

    The original optimises a Markov random field by graph cuts; here semi-global paths replace them.

    Returns (H, W) float64, px; NaN at the ends of the range.
    """
    measure = colour_line_measure(image, directions, layers_px)
    if not optimised:
        return best_layer(-measure, layers_px)
    likelihood = -np.log(np.maximum(measure, np.exp(-_LOG_SPAN)))
    bright = max(float(np.percentile(image, 99)), 1e-6)
    guide = np.ascontiguousarray(image.mean(axis=2) / (_GUIDE_STEP * bright), np.float32)
    volume = np.ascontiguousarray(np.moveaxis(likelihood, 0, 2), np.float32)
    found = path_surface(volume, guide, layers_px, config=_PATHS, run=execution_named("numba")).label_px
    half = (layers_px[1] - layers_px[0]) / 2
    inside = (found > layers_px[0] + half) & (found < layers_px[-1] - half)
    return np.where(inside, found.astype(float), np.nan)


_NOISE = 1e-3  # lambda of the corrective kernels, on the power of the gradient; chosen by hand


def _corrective(target: np.ndarray, own: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Return the transfer function that turns one channel's blur into another's, damped at zeros; (h, w // 2 + 1).

    F[k_R] conj(F[k_i]) / (|F[k_i]|^2 + lambda (|F dx|^2 + |F dy|^2)), from the transfer functions of both blurs
    """
    fy, fx = np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1])
    gradient = 4 * np.sin(np.pi * fx) ** 2 + 4 * np.sin(np.pi * fy) ** 2
    return np.asarray(target * own.conj() / (np.abs(own) ** 2 + _NOISE * np.maximum(gradient, 1e-6)))


def annulus_radius(
    image: np.ndarray, transfer: list[np.ndarray], radii_px: np.ndarray, padded: tuple[int, int]
) -> np.ndarray:
    """Find the size of the blur behind a magenta annulus, the paper's [5].

    Green passes the inner disc only and is sharper than red and blue. For each size of blur, green is given the blur
    that it lacks; at the right size, the gradients of the three channels lie on a line. Blur before and beyond the
    focus is the same disc, so the sign is unknown.

    ``image`` (H, W, 3) float, linear; ``transfer`` list of (3, h, w // 2 + 1) complex: of R, G, B at each radius, on
    the padded grid; ``radii_px`` (D,) float, >= 0, evenly spaced; ``padded`` (h, w): at least the image's size; the
    picture is mirrored into the rest. Returns (H, W) float64, px; NaN where the largest radius is best.
    """
    height, width = image.shape[:2]
    rims = (0, padded[0] - height, 0, padded[1] - width)
    big = cv2.copyMakeBorder(np.asarray(image, np.float32), *rims, borderType=cv2.BORDER_REFLECT_101)
    spectra = [scipy.fft.rfft2(big[..., c]) for c in range(3)]
    score = np.empty((len(radii_px), height, width))
    for i, otf in enumerate(transfer):
        corrected = [spectra[0], *(spectra[c] * _corrective(otf[0], otf[c], padded) for c in (1, 2))]
        planes = [scipy.fft.irfft2(s, s=padded)[:height, :width] for s in corrected]
        score[i] = -misfit(np.stack(planes, axis=-1))
    found = best_layer(score, radii_px)
    return np.where(np.isnan(found) & (score.argmax(axis=0) == 0), radii_px[0], found)


def misfit(channels: np.ndarray) -> np.ndarray:
    """Return the fraction of the gradient energy off the local colour line, over four orientations; (H, W) float64.

    In windows along each orientation's gradient: tr L - l_1 of the 3 x 3 second moments, over the trace, since blur
    alone reduces the energy.
    """
    base = cv2.GaussianBlur(np.asarray(channels, np.float32), (0, 0), 1.0)
    gy, gx = np.gradient(base.astype(np.float64), axis=(0, 1))
    root = np.sqrt(0.5)
    directions = ((1.0, 0.0), (0.0, 1.0), (root, root), (root, -root))
    total, energy = np.zeros(channels.shape[:2]), np.full(channels.shape[:2], 1e-12)
    for x, y in directions:
        slope = np.asarray(x * gx + y * gy)
        rr, gg, bb, rg, rb, gb = (
            _mean_along(slope[..., a] * slope[..., b], x, y)
            for a, b in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
        )
        trace = rr + gg + bb
        total += trace - largest_eigenvalue(rr, gg, bb, rg, rb, gb)
        energy += trace
    return total / energy


def _mean_along(values: np.ndarray, x: float, y: float) -> np.ndarray:
    """Average over 15 px of a row, a column or a diagonal; (H, W) float64."""
    if 0 in (x, y):
        size = (WINDOW_PX, 1) if x else (1, WINDOW_PX)
        return np.asarray(cv2.blur(values, size, borderType=cv2.BORDER_REFLECT_101))
    half, (height, width) = WINDOW_PX // 2, values.shape
    big = cv2.copyMakeBorder(values, half, half, half, half, cv2.BORDER_REFLECT_101)
    down = range(WINDOW_PX) if x * y > 0 else range(WINDOW_PX - 1, -1, -1)
    total = np.zeros_like(values)
    for j, i in enumerate(down):
        total += big[i : i + height, j : j + width]
    return total / WINDOW_PX


def largest_eigenvalue(
    rr: np.ndarray, gg: np.ndarray, bb: np.ndarray, rg: np.ndarray, rb: np.ndarray, gb: np.ndarray
) -> np.ndarray:
    """Return the largest eigenvalue of symmetric 3 x 3 matrices, from their diagonal and the rest; (H, W) float64.

    With q the mean of the diagonal and p^2 = |A - q|^2 / 6 it is q + 2 p cos(arccos(det((A - q) / p) / 2) / 3), the
    cosine solution of the cubic.
    """
    q = (rr + gg + bb) / 3
    r, g, b = rr - q, gg - q, bb - q
    p = np.sqrt(np.maximum((r * r + g * g + b * b + 2 * (rg * rg + rb * rb + gb * gb)) / 6, 1e-60))
    determinant = r * (g * b - gb * gb) - rg * (rg * b - gb * rb) + rb * (rg * gb - g * rb)
    angle = np.arccos(np.clip(determinant / (2 * p**3), -1, 1)) / 3
    return np.asarray(q + 2 * p * np.cos(angle))


_SGBM_BLOCK_PX = 7  # chosen by hand


def stereo_sgbm(views: np.ndarray, directions: np.ndarray, layers_px: np.ndarray) -> np.ndarray:
    """Match two views that move along x as a stereo pair by OpenCV.

    ``views`` (H, W, 2) float; ``directions`` (2, 2) float: opposed, along x; ``layers_px`` (D,) float: its ends are the
    range. Returns (H, W) float64, px of half disparity in the centre view; NaN where OpenCV has no match.
    """
    left, right = (1, 0) if directions[1, 0] > directions[0, 0] else (0, 1)
    pair = [_bytes(views[..., k]) for k in (left, right)]
    ratio = float(directions[left, 0] - directions[right, 0])  # px of stereo disparity per px of half disparity
    lowest = int(np.floor(ratio * layers_px[0]))
    count = 16 * int(np.ceil((ratio * layers_px[-1] - lowest + 1) / 16))
    # Padded by the search range, in which OpenCV finds no match.
    rim = count + max(0, -lowest)
    padded = [cv2.copyMakeBorder(p, 0, 0, rim, rim, cv2.BORDER_REFLECT_101) for p in pair]
    raw = semi_global_matching(padded[0], padded[1], lowest, count)[:, rim:-rim]
    half = np.where(raw < lowest, np.nan, raw / ratio).astype(np.float32)
    # Disparities are of the left view, where pixel x of the centre is at x + d u; two rounds find that d.
    x, y = np.meshgrid(np.arange(half.shape[1], dtype=np.float32), np.arange(half.shape[0], dtype=np.float32))
    center = half
    for _ in range(2):
        at = x + np.nan_to_num(center) * np.float32(directions[left, 0])
        center = np.asarray(cv2.remap(half, at, y, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE))
    return center.astype(np.float64)


def semi_global_matching(left: np.ndarray, right: np.ndarray, lowest_px: int, count: int) -> np.ndarray:
    """Match two 8-bit pictures by OpenCV; (H, W) float32, px of ``count`` disparities from the lowest, less unknown."""
    area = _SGBM_BLOCK_PX**2  # penalties as OpenCV's documentation recommends
    matcher = cv2.StereoSGBM.create(
        lowest_px, count, _SGBM_BLOCK_PX, P1=8 * area, P2=32 * area, uniquenessRatio=5, mode=cv2.STEREO_SGBM_MODE_HH
    )
    return np.asarray(matcher.compute(left, right), np.float32) / 16


def _bytes(view: np.ndarray) -> np.ndarray:
    """Stretch a view to 8 bits between its first and last percentile; (H, W) uint8."""
    low, high = np.percentile(view, (1, 99))
    return np.asarray(np.clip(255 * (view - low) / max(float(high - low), 1e-6), 0, 255), np.uint8)
