"""The matcher in Numba: what ``reference.py`` computes, layer by layer in float32 on both cores.

Schedule: the layers are independent until the winner is taken, so they are the parallel axis. A layer lives in a
few planes of the padded picture: shifted views, their window means and gains, one cross term a pair of views. Each
row of a plane is contiguous, so that every step except the recursion along a row runs over long vectors.

Memory: one float32 volume (D, H, W), and for each thread 3 K + 4 planes of the padded picture.
"""

# mypy: disallow-untyped-defs=False
from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

from chromaperture.config import MatcherConfig
from chromaperture.disparity import reference
from chromaperture.disparity.inputs import MatchInputs, view_pairs
from chromaperture.disparity.subpixel import Winner

_compile = njit(cache=True, error_model="numpy", fastmath={"contract", "nsz", "arcp", "reassoc"}, nogil=True)
_compile_parallel = njit(
    cache=True, error_model="numpy", fastmath={"contract", "nsz", "arcp", "reassoc"}, parallel=True
)

_ONE = np.float32(1)
_HALF = np.float32(0.5)
_BEND_FLOOR = np.float32(1e-12)


def match(inputs: MatchInputs, config: MatcherConfig) -> Winner:
    """Match the views; the fast twin of `chromaperture.disparity.reference.match`.

    Parameters
    ----------
    inputs : MatchInputs
    config : MatcherConfig

    Returns
    -------
    Winner
    """
    volume = _layer_planes(inputs, config)
    if config.bilateral_sigma_px > 0:
        weights = texture_weights(inputs, config)
        near = np.float32(math.exp(-math.sqrt(2) / config.bilateral_sigma_px))
        along_x, along_y = _links(np.ascontiguousarray(inputs.guide), near)
        _regularise(volume, weights, along_x, along_y, _ONE - near)
    step = inputs.layers_px[1] - inputs.layers_px[0]
    winner = Winner(*(np.empty(inputs.mask.shape, np.float32) for _ in range(3)))
    _take_winner(volume, np.float32(inputs.layers_px[0]), np.float32(step), *winner[:3])
    return winner


def score_volume(inputs: MatchInputs, config: MatcherConfig) -> np.ndarray:
    """Score every layer; the fast twin of `chromaperture.disparity.reference.score_volume`.

    Returns
    -------
    (H, W, D) float32
    """
    return _layers_innermost(_layer_planes(inputs, config))


def texture_weights(inputs: MatchInputs, config: MatcherConfig) -> np.ndarray:
    """Weight of each pixel; the fast twin of `chromaperture.disparity.reference.texture_weights`; (H, W) float32."""
    weights = np.ones(inputs.mask.shape, np.float32)
    if config.texture_weighting:
        _texture(
            _planes(inputs.views),
            _planes(inputs.noise_variance),
            reference.variance_floor(inputs.views).astype(np.float32),
            np.float32(config.window_decay),
            weights,
        )
    return np.maximum(weights * inputs.mask, np.float32(reference.MIN_WEIGHT))


def _layer_planes(inputs: MatchInputs, config: MatcherConfig) -> np.ndarray:
    """Score every layer; (D, H, W) float32."""
    height, width, view_count = inputs.views.shape
    pad = reference.padding(inputs)
    border = ((0, 0), (pad[1], pad[1]), (pad[0], pad[0]))
    offsets = inputs.layers_px[:, None, None] * inputs.directions  # (D, K, 2)
    whole = np.floor(offsets)
    taps = np.stack(reference.cubic_taps(offsets - whole), axis=-1)
    volume = np.empty((len(inputs.layers_px), height, width), np.float32)
    _score_layers(
        np.pad(_planes(inputs.views), border, mode="edge"),
        np.pad(_planes(inputs.noise_variance), border, mode="edge"),
        np.pad(_planes(inputs.noise_covariance), border, mode="edge"),
        inputs.noise_overlap.astype(np.float32),
        np.array(view_pairs(view_count)),
        whole.astype(np.int64),
        taps.astype(np.float32),
        reference.variance_floor(inputs.views).astype(np.float32),
        np.float32(config.window_decay),
        np.float32(config.noise_debiasing),
        pad,
        volume,
    )
    return volume


def _planes(maps: np.ndarray) -> np.ndarray:
    """(H, W, N) to contiguous (N, H, W) float32."""
    return np.ascontiguousarray(np.moveaxis(maps, 2, 0), np.float32)


@_compile_parallel
def _score_layers(
    views, noise, covariance, overlap, pairs, whole, taps, epsilon, decay, debias, pad, volume
):  # fmt: skip
    count, padded_height, padded_width = views.shape
    layers, height, width = volume.shape
    x0, y0 = pad
    share = np.float32(reference.MIN_VARIANCE_SHARE)
    for s in prange(layers):
        moved = np.empty_like(views)
        mean = np.empty_like(views)
        gain = np.empty_like(views)
        term = np.empty((padded_height, padded_width), np.float32)
        rho = np.empty((len(pairs), width), np.float32)
        cross = np.empty((len(pairs), padded_height, padded_width), np.float32)
        for k in range(count):
            _shift(noise[k], whole[s, k], taps[s, k], term, gain[k])
            _shift(views[k], whole[s, k], taps[s, k], term, moved[k])
            _product(moved[k], moved[k], term)
            _window(term, decay)
            mean[k] = moved[k]
            _window(mean[k], decay)
            for y in range(padded_height):
                for x in range(padded_width):
                    variance = term[y, x] - mean[k, y, x] * mean[k, y, x]
                    clean = max(variance - gain[k, y, x] * debias, share * variance)
                    gain[k, y, x] = _ONE / np.sqrt(max(clean, np.float32(0)) + epsilon[k])
        for p in range(len(pairs)):
            _product(moved[pairs[p, 0]], moved[pairs[p, 1]], cross[p])
            _window(cross[p], decay)
        for y in range(height):
            for p in range(len(pairs)):
                k, m = pairs[p]
                left = overlap[s, p] * debias
                for x in range(width):
                    i, j = y + y0, x + x0
                    value = cross[p, i, j] - mean[k, i, j] * mean[m, i, j] - left * covariance[p, i, j]
                    rho[p, x] = min(max(value * gain[k, i, j] * gain[m, i, j], -_ONE), _ONE)
            if count == 2:
                volume[s, y] = rho[0]
            else:
                for x in range(width):
                    a, b, c = rho[0, x], rho[1, x], rho[2, x]
                    determinant = _ONE + (a + a) * b * c - a * a - b * b - c * c
                    volume[s, y, x] = _ONE - np.sqrt(max(determinant, np.float32(0)))


@_compile
def _product(a, b, out):
    for y in range(out.shape[0]):
        for x in range(out.shape[1]):
            out[y, x] = a[y, x] * b[y, x]


@_compile
def _shift(view, whole, taps, scratch, out):
    """Sample a plane at x + whole + fraction, borders replicated: rows into ``scratch``, columns into ``out``."""
    height, width = view.shape
    dx, dy = whole
    t0, t1, t2, t3 = taps[0]
    first, last = min(max(1 - dx, 0), width), max(min(width - 2 - dx, width), 0)
    for y in range(height):
        for x in range(width):
            if x == first and last > first:
                break
            scratch[y, x] = _clamped_taps(view[y], x + dx, t0, t1, t2, t3)
        for x in range(first, last):
            i = x + dx
            scratch[y, x] = t0 * view[y, i - 1] + t1 * view[y, i] + t2 * view[y, i + 1] + t3 * view[y, i + 2]
        for x in range(max(first, last), width):
            scratch[y, x] = _clamped_taps(view[y], x + dx, t0, t1, t2, t3)
    t0, t1, t2, t3 = taps[1]
    end = height - 1
    for y in range(height):
        i = y + dy
        a, b = scratch[min(max(i - 1, 0), end)], scratch[min(max(i, 0), end)]
        c, d = scratch[min(max(i + 1, 0), end)], scratch[min(max(i + 2, 0), end)]
        for x in range(width):
            out[y, x] = t0 * a[x] + t1 * b[x] + t2 * c[x] + t3 * d[x]


@_compile
def _clamped_taps(row, i, t0, t1, t2, t3):
    end = len(row) - 1
    before, here = row[min(max(i - 1, 0), end)], row[min(max(i, 0), end)]
    after, beyond = row[min(max(i + 1, 0), end)], row[min(max(i + 2, 0), end)]
    return t0 * before + t1 * here + t2 * after + t3 * beyond


@_compile
def _window(plane, decay):
    """Average a plane in place in the window a^(|x|+|y|), the picture continued beyond its border."""
    height, width = plane.shape
    gain = _ONE - decay
    ending = _ONE / (_ONE + decay)
    # Along x four rows at a time: each row's recursion waits for itself, four of them fill the pipeline.
    for y in range(0, height - height % 4, 4):
        r0, r1, r2, r3 = plane[y], plane[y + 1], plane[y + 2], plane[y + 3]
        f0, f1, f2, f3 = r0[0], r1[0], r2[0], r3[0]
        for x in range(width - 1):
            f0 = gain * r0[x] + decay * f0
            f1 = gain * r1[x] + decay * f1
            f2 = gain * r2[x] + decay * f2
            f3 = gain * r3[x] + decay * f3
            r0[x], r1[x], r2[x], r3[x] = f0, f1, f2, f3
        x = width - 1
        f0 = r0[x] + (gain * r0[x] + decay * f0 - r0[x]) * ending
        f1 = r1[x] + (gain * r1[x] + decay * f1 - r1[x]) * ending
        f2 = r2[x] + (gain * r2[x] + decay * f2 - r2[x]) * ending
        f3 = r3[x] + (gain * r3[x] + decay * f3 - r3[x]) * ending
        r0[x], r1[x], r2[x], r3[x] = f0, f1, f2, f3
        for x in range(width - 2, -1, -1):
            f0 = gain * r0[x] + decay * f0
            f1 = gain * r1[x] + decay * f1
            f2 = gain * r2[x] + decay * f2
            f3 = gain * r3[x] + decay * f3
            r0[x], r1[x], r2[x], r3[x] = f0, f1, f2, f3
    for y in range(height - height % 4, height):
        row = plane[y]
        f = row[0]
        for x in range(width - 1):
            f = gain * row[x] + decay * f
            row[x] = f
        last = row[width - 1]
        f = last + (gain * last + decay * f - last) * ending
        row[width - 1] = f
        for x in range(width - 2, -1, -1):
            f = gain * row[x] + decay * f
            row[x] = f
    for y in range(1, height - 1):
        for x in range(width):
            plane[y, x] = gain * plane[y, x] + decay * plane[y - 1, x]
    if height > 1:
        for x in range(width):
            last = plane[height - 1, x]
            forward = gain * last + decay * plane[height - 2, x]
            plane[height - 1, x] = last + (forward - last) * ending
    for y in range(height - 2, -1, -1):
        for x in range(width):
            plane[y, x] = gain * plane[y, x] + decay * plane[y + 1, x]


@_compile_parallel
def _texture(views, noise, epsilon, decay, weights):
    count = len(views)
    root = _ONE / np.float32(count)
    share = np.empty_like(views)
    for k in prange(count):
        mean = views[k].copy()
        square = np.empty_like(mean)
        _product(mean, mean, square)
        _window(square, decay)
        _window(mean, decay)
        for y in range(mean.shape[0]):
            for x in range(mean.shape[1]):
                signal = max(square[y, x] - mean[y, x] * mean[y, x] - noise[k, y, x], np.float32(0))
                share[k, y, x] = signal / (signal + noise[k, y, x] + epsilon[k])
    for y in prange(weights.shape[0]):
        for x in range(weights.shape[1]):
            product = share[0, y, x]
            for k in range(1, count):
                product *= share[k, y, x]
            weights[y, x] = product**root


@_compile_parallel
def _links(guide, near):
    """Weight with which pixels hear their left and upper neighbours; the first column and row stay unused."""
    height, width = guide.shape
    along_x = np.zeros_like(guide)
    along_y = np.zeros_like(guide)
    for y in prange(height):
        for x in range(1, width):
            along_x[y, x] = near * np.exp(-abs(guide[y, x] - guide[y, x - 1]))
        if y > 0:
            for x in range(width):
                along_y[y, x] = near * np.exp(-abs(guide[y, x] - guide[y - 1, x]))
    return along_x, along_y


@_compile_parallel
def _regularise(volume, weights, along_x, along_y, gain):
    layers, height, width = volume.shape
    share = weights.copy()
    _bilateral(share, along_x, along_y, gain)
    for s in prange(layers):
        _product(volume[s], weights, volume[s])
        _bilateral(volume[s], along_x, along_y, gain)
        for y in range(height):
            for x in range(width):
                volume[s, y, x] /= share[y, x]


@_compile
def _bilateral(plane, along_x, along_y, gain):
    """Replace a plane by the sum of its forward and backward recursions along x, then along y."""
    height, width = plane.shape
    backward = np.empty(width, np.float32)
    for y in range(height):
        row, link = plane[y], along_x[y]
        state = row[width - 1]
        backward[width - 1] = state
        for x in range(width - 2, -1, -1):
            state = gain * row[x] + link[x + 1] * state
            backward[x] = state
        state = row[0]
        row[0] = state + backward[0]
        for x in range(1, width):
            state = gain * row[x] + link[x] * state
            row[x] = state + backward[x]
    above = np.empty((height, width), np.float32)
    above[0] = plane[0]
    for y in range(1, height):
        for x in range(width):
            above[y, x] = gain * plane[y, x] + along_y[y, x] * above[y - 1, x]
    below = plane[height - 1].copy()
    for x in range(width):
        plane[height - 1, x] = above[height - 1, x] + below[x]
    for y in range(height - 2, -1, -1):
        for x in range(width):
            below[x] = gain * plane[y, x] + along_y[y + 1, x] * below[x]
            plane[y, x] = above[y, x] + below[x]


@_compile_parallel
def _take_winner(volume, first, step, disparity, peak, curvature):
    layers, height, width = volume.shape
    for y in prange(height):
        best = volume[0, y].copy()
        index = np.zeros(width, np.int32)
        for s in range(1, layers):
            for x in range(width):
                higher = volume[s, y, x] > best[x]
                best[x] = volume[s, y, x] if higher else best[x]
                index[x] = s if higher else index[x]
        for x in range(width):
            inner = min(max(index[x], 1), layers - 2)
            left, center, right = volume[inner - 1, y, x], volume[inner, y, x], volume[inner + 1, y, x]
            bend = max(center + center - left - right, np.float32(0))
            slope = right - left
            offset, rise = np.float32(0), np.float32(0)
            if bend > _BEND_FLOOR:
                offset = min(max(_HALF * slope / bend, -_HALF), _HALF)
                rise = slope * slope / (np.float32(8) * bend)
            disparity[y, x] = first + step * (np.float32(inner) + offset) if index[x] == inner else np.nan
            peak[y, x] = center + rise
            curvature[y, x] = bend / (step * step)


@_compile_parallel
def _layers_innermost(volume):
    layers, height, width = volume.shape
    out = np.empty((height, width, layers), np.float32)
    for y in prange(height):
        for x in range(width):
            for s in range(layers):
                out[y, x, s] = volume[s, y, x]
    return out
