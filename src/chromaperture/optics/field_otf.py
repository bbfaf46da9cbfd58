"""Transfer functions of a fitted blur at any frequencies: sums over the pupil's rays, without a grid of pixels."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from chromaperture.optics.field_blur import FieldBlur, displacement, rims

_ROOM_PX = 8  # around a kernel: what the cut-off at the pixels' own frequency rings over
_LEAST_LIGHT = 1e-3  # of the brightest point: rays that carry less are left out


class Rays(NamedTuple):
    """Where one channel's rays meet the sensor, (N, 2) px, and their share of light, (N,)."""

    places_px: np.ndarray
    weights: np.ndarray


def traced(blur: FieldBlur, place_px: tuple[float, float], inverse_mm: float) -> list[Rays]:
    """Follow the rays of a point to the sensor.

    Places count from the chief ray, but for what aberrations displace the whole of the open pupil's light by: a
    displacement that all channels share, such as coma's, shows in none of their differences, and a fit to those does
    not know it.

    Parameters
    ----------
    blur : FieldBlur
    place_px : (x, y)
    inverse_mm : float, 1/mm
        1 / z, z from the entrance pupil.

    Returns
    -------
    list of three Rays, of R, G and B
    """
    field = blur.field(*place_px)
    rim = rims(blur.model, blur.pupil.points, field)
    m = blur.model
    defocus = (m.infinity_px - m.scale_px_mm * inverse_mm) * blur.pupil.points
    aberrations = displacement(m, blur.pupil.points, field, inverse_mm, 1) - defocus
    origin = rim @ aberrations / rim.sum()
    out = []
    for k in range(3):
        light = blur.pupil.light[k] * rim
        lit = light > _LEAST_LIGHT * light.max()
        places = displacement(blur.model, blur.pupil.points[lit], field, inverse_mm, k) - origin
        out.append(Rays(places, light[lit] / light[lit].sum()))
    return out


def transfer_at(rays: Rays, *, step: float, count: int) -> np.ndarray:
    """Transfer function on a lattice of frequencies.

    Parameters
    ----------
    rays : Rays
    step : float, cycles a px
        Between two frequencies.
    count : int
        The lattice reaches from -count to count steps in y, from 0 to count in x.

    Returns
    -------
    (2 count + 1, count + 1) complex64, 1 at frequency 0
    """
    # Powers of the first frequency's phases: a multiplication each, not an exponential.
    phases = np.empty((2, count + 1, len(rays.weights)), np.complex128)
    phases[:, 0] = 1
    phases[:, 1:] = np.exp((-2j * np.pi * step) * rays.places_px.T)[:, None]
    columns, up = np.cumprod(phases, axis=1, out=phases).astype(np.complex64)
    rows = np.concatenate([up[:0:-1].conj(), up]) * rays.weights.astype(np.float32)
    return np.asarray(rows @ columns.T)


def field_kernels(blur: FieldBlur, place_px: tuple[float, float], inverse_mm: float) -> np.ndarray:
    """Point-spread functions of the three channels, cut off at the pixels' own frequency.

    Parameters
    ----------
    blur : FieldBlur
    place_px : (x, y)
    inverse_mm : float, 1/mm

    Returns
    -------
    (3, s, s) float32 of unit sum, with the centre view's place at [s // 2, s // 2]; s is odd
    """
    rays = traced(blur, place_px, inverse_mm)
    reach = math.ceil(max(float(np.abs(r.places_px).max()) for r in rays)) + _ROOM_PX
    side = 2 * reach + 1
    otf = np.stack([transfer_at(r, step=1 / side, count=reach) for r in rays])
    kernels = np.fft.irfft2(np.fft.ifftshift(otf, axes=1), s=(side, side))
    return np.fft.fftshift(kernels, axes=(1, 2)).astype(np.float32)
