"""Transfer functions of a fitted blur at arbitrary frequencies: sums over the pupil's rays, without a pixel grid."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from chromaperture.optics.lens_blur import LensBlur, displacement, rims

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
