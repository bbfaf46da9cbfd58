# mypy: disallow-untyped-defs=False
"""Likelihood of windows' spectra, compiled; ``stages/spectral_likelihood.py`` explains what is computed."""

from __future__ import annotations

import numpy as np

from chromaperture.compilation import compiled, inlined
from chromaperture.disparity.cpu.paths import FAST
from chromaperture.disparity.stages.spectral_likelihood import (
    FIRST_CORRELATION,
    FIRST_ROUNDS,
    LEAST_AMPLITUDE,
    LEAST_DETERMINANT,
)
from chromaperture.threads import in_parallel

_FACTORS = 4  # determinants of a product: each may be 1e-77 before it leaves the range of a double


def spectral_likelihood(
    spectra: np.ndarray, powers: np.ndarray, node: np.ndarray, noise: np.ndarray, *, channel_error: float, rounds: int
) -> np.ndarray:
    """Sum the log-likelihood of windows, as `stages.spectral_likelihood`; (M, D) float32."""
    parts = np.stack([spectra.real, spectra.imag], axis=2).reshape(len(spectra), 6, -1).astype(np.float32)
    out = np.empty((len(spectra), powers.shape[1]), np.float32)
    error = float(channel_error)
    noise = np.ascontiguousarray(noise, np.float64)  # doubles: colours correlate to 0.998, determinants cancel
    in_parallel(
        lambda _, first, last: _windows(parts, powers, node, noise, error, rounds, first, last, out), len(spectra)
    )
    return out


@compiled(fastmath=FAST, error_model="numpy")
def _windows(parts, powers, node, noise, error, rounds, first, last, out):
    count = float(parts.shape[2])
    colours, gradient, determinants = np.empty(6), np.empty(6), np.empty(parts.shape[2])
    for m in range(first, last):
        _first_colours(parts[m], powers[node[m], 0], noise[m], colours)
        for layer in range(powers.shape[1]):
            for _ in range(rounds + FIRST_ROUNDS * (layer == 0)):
                _gradient(parts[m], powers[node[m], layer], colours, noise[m], error, gradient)
                _step(colours, gradient, count)
            out[m, layer] = _log_likelihood(parts[m], powers[node[m], layer], colours, noise[m], error, determinants)


@inlined(fastmath=FAST, error_model="numpy")
def _first_colours(parts, power, noise, colours):
    for k in range(3):
        seen, passed = 0.0, 0.0
        for f in range(parts.shape[1]):
            seen += parts[2 * k, f] ** 2 + parts[2 * k + 1, f] ** 2 - noise[k]
            passed += power[k, f]
        colours[k] = max(seen / passed, LEAST_AMPLITUDE)
    for n, (i, j) in enumerate(((0, 1), (0, 2), (1, 2))):
        colours[3 + n] = FIRST_CORRELATION * np.sqrt(colours[i] * colours[j])


@inlined(fastmath=FAST, error_model="numpy")
def _step(s, g, count):
    """Compute S + S M S / F for symmetric matrices of the diagonal, then 01, 02, 12; a third of it where that fails."""
    # T = S M / F
    t00, t01, t02 = _row(s[0], s[3], s[4], g, count)
    t10, t11, t12 = _row(s[3], s[1], s[5], g, count)
    t20, t21, t22 = _row(s[4], s[5], s[2], g, count)
    a, b, c = (
        t00 * s[0] + t01 * s[3] + t02 * s[4],
        t10 * s[3] + t11 * s[1] + t12 * s[5],
        t20 * s[4] + t21 * s[5] + t22 * s[2],
    )
    d, e = t00 * s[3] + t01 * s[1] + t02 * s[5], t00 * s[4] + t01 * s[5] + t02 * s[2]
    f = t10 * s[4] + t11 * s[5] + t12 * s[2]
    x, y, z, u, v, w = s[0] + a, s[1] + b, s[2] + c, s[3] + d, s[4] + e, s[5] + f
    minor = x * y - u * u
    determinant = z * minor + 2 * u * v * w - y * v * v - x * w * w
    valid = min(x, y, z) > LEAST_AMPLITUDE and minor > 0 and determinant > LEAST_DETERMINANT * x * y * z
    part = 1.0 if valid else 1.0 / 3.0
    s[0] += part * a
    s[1] += part * b
    s[2] += part * c
    s[3] += part * d
    s[4] += part * e
    s[5] += part * f


@inlined(fastmath=FAST, error_model="numpy")
def _row(x, y, z, g, count):
    """Return a row of S times M / F."""
    return (
        (x * g[0] + y * g[3] + z * g[4]) / count,
        (x * g[3] + y * g[1] + z * g[5]) / count,
        (x * g[4] + y * g[5] + z * g[2]) / count,
    )


@inlined(fastmath=FAST, error_model="numpy")
def _covariance(power, s, noise, error, f):
    """Entries of C at a frequency: 00, 11, 22, then real and imaginary parts of 01, 02, 12."""
    more = 1.0 + error
    return (
        s[0] * power[0, f] * more + noise[0], s[1] * power[1, f] * more + noise[1],
        s[2] * power[2, f] * more + noise[2], s[3] * power[3, f], s[3] * power[4, f],
        s[4] * power[5, f], s[4] * power[6, f], s[5] * power[7, f], s[5] * power[8, f],
    )  # fmt: skip


@inlined(fastmath=FAST, error_model="numpy")
def _adjugate(a, b, c, dr, di, er, ei, fr, fi):
    """Adjugate of [[a, d, e], [d*, b, f], [e*, f*, c]], in the same order, and the determinant."""
    p, q, r = b * c - fr * fr - fi * fi, a * c - er * er - ei * ei, a * b - dr * dr - di * di
    ur, ui = er * fr + ei * fi - dr * c, ei * fr - er * fi - di * c  # e f* - d c
    vr, vi = dr * fr - di * fi - er * b, dr * fi + di * fr - ei * b  # d f - e b
    wr, wi = dr * er + di * ei - a * fr, dr * ei - di * er - a * fi  # d* e - a f
    return p, q, r, ur, ui, vr, vi, wr, wi, a * p + dr * ur + di * ui + er * vr + ei * vi


@inlined(fastmath=FAST, error_model="numpy")
def _log_likelihood(parts, power, s, noise, error, determinants):
    """Sum over the frequencies; ``determinants`` is room for one of each."""
    total = 0.0
    for k in range(parts.shape[1]):
        p, q, r, ur, ui, vr, vi, wr, wi, det = _adjugate(*_covariance(power, s, noise, error, k))
        xr, xi, yr, yi, zr, zi = parts[0, k], parts[1, k], parts[2, k], parts[3, k], parts[4, k], parts[5, k]
        explained = p * (xr * xr + xi * xi) + q * (yr * yr + yi * yi) + r * (zr * zr + zi * zi)
        explained += 2 * (ur * (xr * yr + xi * yi) + ui * (xi * yr - xr * yi))
        explained += 2 * (vr * (xr * zr + xi * zi) + vi * (xi * zr - xr * zi))
        explained += 2 * (wr * (yr * zr + yi * zi) + wi * (yi * zr - yr * zi))
        total -= explained / det
        determinants[k] = det
    # One logarithm of a product of several: a logarithm takes as long as all before it, and makes no vectors.
    end = parts.shape[1] // _FACTORS * _FACTORS
    for k in range(0, end, _FACTORS):
        total -= np.log(determinants[k] * determinants[k + 1] * (determinants[k + 2] * determinants[k + 3]))
    for k in range(end, parts.shape[1]):
        total -= np.log(determinants[k])
    return total


@inlined(fastmath=FAST, error_model="numpy")
def _gradient(parts, power, s, noise, error, out):
    """M: with t = C^-1 y, the sum of Re (t t^H - C^-1) G*."""
    m0 = m1 = m2 = m3 = m4 = m5 = 0.0
    for k in range(parts.shape[1]):
        p, q, r, ur, ui, vr, vi, wr, wi, det = _adjugate(*_covariance(power, s, noise, error, k))
        x, y, z = parts[0, k], parts[2, k], parts[4, k]
        xi, yi, zi = parts[1, k], parts[3, k], parts[5, k]
        i = 1.0 / det
        ar, ai = i * (p * x + ur * y - ui * yi + vr * z - vi * zi), i * (p * xi + ur * yi + ui * y + vr * zi + vi * z)
        br, bi = i * (ur * x + ui * xi + q * y + wr * z - wi * zi), i * (ur * xi - ui * x + q * yi + wr * zi + wi * z)
        cr, ci = i * (vr * x + vi * xi + wr * y + wi * yi + r * z), i * (vr * xi - vi * x + wr * yi - wi * y + r * zi)
        m0 += (ar * ar + ai * ai - p * i) * power[0, k]
        m1 += (br * br + bi * bi - q * i) * power[1, k]
        m2 += (cr * cr + ci * ci - r * i) * power[2, k]
        m3 += (ar * br + ai * bi - ur * i) * power[3, k] + (ai * br - ar * bi - ui * i) * power[4, k]
        m4 += (ar * cr + ai * ci - vr * i) * power[5, k] + (ai * cr - ar * ci - vi * i) * power[6, k]
        m5 += (br * cr + bi * ci - wr * i) * power[7, k] + (bi * cr - br * ci - wi * i) * power[8, k]
    out[0], out[1], out[2], out[3], out[4], out[5] = m0, m1, m2, m3, m4, m5
