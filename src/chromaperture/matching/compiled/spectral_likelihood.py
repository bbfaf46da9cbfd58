# mypy: disallow-untyped-defs=False
"""Likelihood of windows' spectra, compiled; ``readable/spectral_likelihood.py`` explains what is computed.

A frequency's matrix is factored channel by channel. Colours correlate to 0.998, so that a determinant written out loses
five digits; what a channel has of its own, given those before it, loses three, and float32 has seven.
"""

from __future__ import annotations

import numpy as np

from chromaperture.matching.compiled.paths import FAST
from chromaperture.matching.readable.spectral_likelihood import (
    FIRST_CORRELATION,
    FIRST_ROUNDS,
    LEAST_AMPLITUDE,
    LEAST_DETERMINANT,
)
from chromaperture.system.compilation import compiled, inlined
from chromaperture.system.threads import in_parallel

_FACTORS = 4  # determinants of a product: each may be 1e-77 before it leaves the range of a double


def spectral_likelihood(
    spectra: np.ndarray, powers: np.ndarray, node: np.ndarray, noise: np.ndarray, *, channel_error: float, rounds: int
) -> np.ndarray:
    """Sum the log-likelihood of windows, as `readable.spectral_likelihood`; (M, D) float32."""
    parts = np.stack([spectra.real, spectra.imag], axis=2).reshape(len(spectra), 6, -1).astype(np.float32)
    out = np.empty((len(spectra), powers.shape[1]), np.float32)
    more, noise = np.float32(1 + channel_error), np.ascontiguousarray(noise, np.float32)
    in_parallel(
        lambda _, first, last: _windows(parts, powers, node, noise, more, rounds, first, last, out), len(spectra)
    )
    return out


@compiled(fastmath=FAST, error_model="numpy")
def _windows(parts, powers, node, noise, more, rounds, first, last, out):
    count = float(parts.shape[2])
    colours, gradient, determinants = np.empty(6), np.empty(6), np.empty(parts.shape[2])
    single = np.empty(6, np.float32)
    for m in range(first, last):
        _first_colours(parts[m], powers[node[m], 0], noise[m], colours)
        _copy(colours, single)
        for layer in range(powers.shape[1]):
            for _ in range(rounds + FIRST_ROUNDS * (layer == 0)):
                _gradient(parts[m], powers[node[m], layer], single, noise[m], more, gradient)
                _step(colours, gradient, count)
                _copy(colours, single)
            out[m, layer] = _log_likelihood(parts[m], powers[node[m], layer], single, noise[m], more, determinants)


@inlined()
def _copy(colours, single):
    for i in range(6):  # element by element: what Numba makes of `single[:] = colours` takes 2 s to compile
        single[i] = colours[i]


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
def _factors(power, s, noise, more, f):
    """Factor C = L D L^H at a frequency: the inverse of D, the product of D, and real and imaginary parts of L.

    C is S o G with a share ``more`` of a channel's own and the noise on its diagonal.
    """
    a, b = s[0] * power[0, f] * more + noise[0], s[1] * power[1, f] * more + noise[1]
    c = s[2] * power[2, f] * more + noise[2]
    dr, di, er, ei = s[3] * power[3, f], s[3] * power[4, f], s[4] * power[5, f], s[4] * power[6, f]
    fr, fi = s[5] * power[7, f], s[5] * power[8, f]
    inverse_a = np.float32(1) / a
    pr, pi, qr, qi = dr * inverse_a, -di * inverse_a, er * inverse_a, -ei * inverse_a  # L_10, L_20
    b -= dr * pr - di * pi
    gr, gi = fr - (pr * er - pi * ei), fi - (pr * ei + pi * er)
    inverse_b = np.float32(1) / b
    rr, ri = gr * inverse_b, -gi * inverse_b  # L_21
    c -= er * qr - ei * qi + gr * rr - gi * ri
    return inverse_a, inverse_b, np.float32(1) / c, a, b, c, pr, pi, qr, qi, rr, ri


@inlined(fastmath=FAST, error_model="numpy")
def _log_likelihood(parts, power, s, noise, more, determinants):
    """Sum over the frequencies; ``determinants`` is room for one of each."""
    explained = np.float32(0)
    for k in range(parts.shape[1]):
        ia, ib, ic, a, b, c, pr, pi, qr, qi, rr, ri = _factors(power, s, noise, more, k)
        xr, xi = parts[0, k], parts[1, k]
        yr, yi = parts[2, k] - (pr * xr - pi * xi), parts[3, k] - (pr * xi + pi * xr)
        zr = parts[4, k] - (qr * xr - qi * xi) - (rr * yr - ri * yi)
        zi = parts[5, k] - (qr * xi + qi * xr) - (rr * yi + ri * yr)
        explained += (xr * xr + xi * xi) * ia + (yr * yr + yi * yi) * ib + (zr * zr + zi * zi) * ic
        determinants[k] = np.float64(a) * np.float64(b) * np.float64(c)
    total = -np.float64(explained)
    # One logarithm of a product of several: a logarithm takes as long as all before it, and makes no vectors.
    end = parts.shape[1] // _FACTORS * _FACTORS
    for k in range(0, end, _FACTORS):
        total -= np.log(determinants[k] * determinants[k + 1] * (determinants[k + 2] * determinants[k + 3]))
    for k in range(end, parts.shape[1]):
        total -= np.log(determinants[k])
    return total


@inlined(fastmath=FAST, error_model="numpy")
def _gradient(parts, power, s, noise, more, out):
    """M: with t = C^-1 y, the sum of Re (t t^H - C^-1) G*."""
    m0 = m1 = m2 = m3 = m4 = m5 = np.float32(0)
    for k in range(parts.shape[1]):
        ia, ib, ic, _, _, _, pr, pi, qr, qi, rr, ri = _factors(power, s, noise, more, k)
        xr, xi = parts[0, k], parts[1, k]
        yr, yi = parts[2, k] - (pr * xr - pi * xi), parts[3, k] - (pr * xi + pi * xr)
        zr = parts[4, k] - (qr * xr - qi * xi) - (rr * yr - ri * yi)
        zi = parts[5, k] - (qr * xi + qi * xr) - (rr * yi + ri * yr)
        # t = L^-H D^-1 L^-1 y, from the last channel on
        cr, ci = zr * ic, zi * ic
        br, bi = yr * ib - (rr * cr + ri * ci), yi * ib - (rr * ci - ri * cr)
        ar = xr * ia - (pr * br + pi * bi) - (qr * cr + qi * ci)
        ai = xi * ia - (pr * bi - pi * br) - (qr * ci - qi * cr)
        # The inverse, likewise: 22, 12, 11, 02, 01, 00
        wr, wi = -rr * ic, ri * ic
        q = ib - (rr * wr - ri * wi)
        vr, vi = -(pr * wr + pi * wi + qr * ic), -(pr * wi - pi * wr - qi * ic)
        ur, ui = -(pr * q + qr * wr - qi * wi), pi * q + qr * wi + qi * wr
        p = ia - (pr * ur - pi * ui + qr * vr - qi * vi)
        m0 += (ar * ar + ai * ai - p) * power[0, k]
        m1 += (br * br + bi * bi - q) * power[1, k]
        m2 += (cr * cr + ci * ci - ic) * power[2, k]
        m3 += (ar * br + ai * bi - ur) * power[3, k] + (ai * br - ar * bi - ui) * power[4, k]
        m4 += (ar * cr + ai * ci - vr) * power[5, k] + (ai * cr - ar * ci - vi) * power[6, k]
        m5 += (br * cr + bi * ci - wr) * power[7, k] + (bi * cr - br * ci - wi) * power[8, k]
    out[0], out[1], out[2], out[3], out[4], out[5] = m0, m1, m2, m3, m4, m5
