"""Transfer functions of a fitted blur at arbitrary frequencies: sums over the pupil's rays, without a pixel grid.

How much of the disparity pixels cost: which pixels are small enough for a blur.

As in `depth_error_bound.py`, for two channels with the transfer functions h1 and h2, equal white noise, and a texture
of 1/f amplitudes, a frequency f holds about the disparity the information

    |h2' h1 - h1' h2|^2 / (|h1|^2 + |h2|^2) / f^2,       ' = d / d disparity.

Means over pixels of side s multiply the light by sinc(s fx) sinc(s fy), leave the noise a frequency as it is, and end
the frequencies at 1 / 2s. The standard deviation of the disparity is the root of one over the sum.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from chromaperture.optics.lens_blur import LensBlur, PupilSamples, displacement, rims

_MARGIN_PX = 8  # around a kernel, for the ringing of the cut-off at the sampling rate; chosen by hand, not tuned
_LEAST_LIGHT = 1e-3  # of the brightest ray: weaker ones are left out, to save time


class ChannelRays(NamedTuple):
    """Sensor positions of one channel's rays, (N, 2) px, and their weights, (N,), of unit sum."""

    points_px: np.ndarray
    weights: np.ndarray


def traced(blur: LensBlur, image_px: tuple[float, float], inverse_mm: float) -> list[ChannelRays]:
    """Trace the rays of an object point to the sensor.

    Positions are relative to the chief ray, less the mean displacement of the open pupil's light by aberrations: a
    displacement that all channels have in common, such as coma's, cancels in their differences, and a fit to those
    does not determine it.

    ``image_px`` (x, y); ``inverse_mm`` float, 1/mm: 1 / z, z from the entrance pupil. Returns list of three
    ChannelRays, of R, G and B.
    """
    position = blur.frame_position(*image_px)
    rim = rims(blur.model, blur.pupil.points, position)
    m = blur.model
    defocus = (m.infinity_px - m.scale_px_mm * inverse_mm) * blur.pupil.points
    aberrations = displacement(m, blur.pupil.points, position, inverse_mm, 1) - defocus
    origin = rim @ aberrations / rim.sum()
    out = []
    of_channels = blur.light_at(position) * rim
    for k, light in enumerate(of_channels):
        lit = light > _LEAST_LIGHT * light.max()
        points = displacement(blur.model, blur.pupil.points[lit], position, inverse_mm, k) - origin
        out.append(ChannelRays(points, light[lit] / light[lit].sum()))
    return out


def transfer_at(rays: ChannelRays, *, step: float, count: int) -> np.ndarray:
    """Compute the transfer function on a lattice of frequencies.

    ``step`` float, cycles/px: between two frequencies; ``count``: the lattice extends from -count to count steps in y,
    from 0 to count in x. Returns (2 count + 1, count + 1) complex64, 1 at frequency 0.
    """
    # Powers of the first frequency's phase factors: one multiplication each instead of one exponential.
    factors = np.empty((2, count + 1, len(rays.weights)), np.complex128)
    factors[:, 0] = 1
    factors[:, 1:] = np.exp((-2j * np.pi * step) * rays.points_px.T)[:, None]
    columns, up = np.cumprod(factors, axis=1, out=factors).astype(np.complex64)
    rows = np.concatenate([up[:0:-1].conj(), up]) * rays.weights.astype(np.float32)
    return np.asarray(rows @ columns.T)


def lens_kernels(blur: LensBlur, image_px: tuple[float, float], inverse_mm: float) -> np.ndarray:
    """Compute the point-spread functions of the three channels, band-limited to the sampling rate.

    ``image_px`` (x, y); ``inverse_mm`` float, 1/mm. Returns (3, s, s) float32 of unit sum, with the centre view's
    position at [s // 2, s // 2]; s is odd.
    """
    rays = traced(blur, image_px, inverse_mm)
    reach = math.ceil(max(float(np.abs(r.points_px).max()) for r in rays)) + _MARGIN_PX
    side = 2 * reach + 1
    otf = np.stack([transfer_at(r, step=1 / side, count=reach) for r in rays])
    kernels = np.fft.irfft2(np.fft.ifftshift(otf, axes=1), s=(side, side))
    return np.fft.fftshift(kernels, axes=(1, 2)).astype(np.float32)


_FREQUENCIES = 32  # steps to the highest frequency; 48 change the growth by 0.001
_RAYS = 2  # every second sample of the pupil: all change the growth by 0.015 at most, and take twice the time
# Cycles in the displacement of the pupil's edge where the blur is widest, up to which light counts. Of 1 / f texture in
# focus information has no end; beyond this the samples of the pupil, not the lens, would tell it (a flat floor), and it
# is the half cycle a px of bench50, from whose pixels the matchers' windows and bands are known to suffice.
_HIGHEST_CYCLES = 6.85


def mean_bars(
    blur: LensBlur, inverse_mm: Sequence[float] | np.ndarray, sides_px: Sequence[float] | np.ndarray
) -> np.ndarray:
    """Compute the bound of the disparity's standard deviation in the frame's middle, the mean over distances.

    ``inverse_mm`` (N,) float, 1/mm: 1 / z, z from the entrance pupil; ``sides_px`` (S,) float: sides of the pixels, px
    of the blur; 0 is light that no pixels divide. Returns (S,) float64: in one unknown unit: only ratios mean
    something.
    """
    widest = max(abs(blur.model.infinity_px - blur.model.scale_px_mm * z) for z in inverse_mm)
    step = _HIGHEST_CYCLES / max(float(widest), 1e-6) / _FREQUENCIES
    fy, fx = step * np.arange(-_FREQUENCIES, _FREQUENCIES + 1)[:, None], step * np.arange(_FREQUENCIES + 1)[None]
    power = 1 / np.maximum(fx**2 + fy**2, step**2) * np.where(fx > 0, 2, 1)  # half of the plane
    passed = []
    for side in np.asarray(sides_px, float):
        inside = (side * fx <= 0.5) & (side * np.abs(fy) <= 0.5)
        passed.append(np.where(inside, np.sinc(side * fx) * np.sinc(side * fy), 0) ** 2 * power)
    few = replace(blur, pupil=PupilSamples(blur.pupil.points[::_RAYS], blur.pupil.light[:, ::_RAYS].copy()))
    informed = [_information(few, z, step) for z in inverse_mm]
    sums = np.array([[float((info * each).sum()) for each in passed] for info in informed])
    return np.asarray((1 / np.sqrt(np.maximum(sums, 1e-30))).mean(axis=0))


def _information(blur: LensBlur, inverse_mm: float, step: float) -> np.ndarray:
    """Information of every frequency of a white texture; (2 F + 1, F + 1)."""
    first, second = blur.pairs[0]
    at = ((blur.width_px - 1) / 2, (blur.height_px - 1) / 2)

    def channels(z: float) -> np.ndarray:
        rays = traced(blur, at, z)
        return np.stack([transfer_at(rays[k], step=step, count=_FREQUENCIES) for k in (first, second)])

    change = 1e-2 / (step * _FREQUENCIES * blur.model.scale_px_mm)  # a hundredth of the shortest period
    h, slope = channels(inverse_mm), channels(inverse_mm + change) - channels(inverse_mm - change)
    power = (np.abs(h) ** 2).sum(axis=0)
    return np.asarray(np.abs(slope[1] * h[0] - slope[0] * h[1]) ** 2 / np.maximum(power, 1e-12)) / change**2
