"""Point-spread functions of wave optics, for lenses of a few millimetres (``examples/diffraction_limit.py``)."""

from __future__ import annotations

import numpy as np

from chromaperture.optics.aperture import Aperture
from chromaperture.optics.pinhole import PupilCamera
from chromaperture.system.errors import InputError

_MOST_CELLS = 3000  # across the pupil: 3000^2 complex amplitudes are 144 MB a channel
_SUBPIXELS = 8  # image samples across a pixel, summed; chosen by hand, not tuned


def defocus_um(camera: PupilCamera, depth_mm: float) -> float:
    """Compute the wavefront defocus at the pupil's rim, W20 = (R^2 / 2)(1 / z_f - 1 / z) in um; of the sign of r."""
    radius_px = float(camera.blur_radius_px(depth_mm))
    return 1e3 * radius_px * camera.pixel_pitch_mm * camera.pupil_radius_mm / (2 * camera.image_distance_mm)


def diffraction_psf(
    aperture: Aperture,
    camera: PupilCamera,
    depth_mm: float,
    *,
    size: int,
    wavelengths_um: tuple[float, float, float] = (0.605, 0.540, 0.465),
) -> np.ndarray:
    """Compute point-spread functions integrated over pixels, one wavelength a channel.

    Light of one wavelength interferes across the whole pupil, so amplitudes are summed, not intensities: for green,
    both halves of a complementary aperture act as one.

    ``depth_mm``: distance of the point from the sensor plane; ``size``: side of the result in px, odd. Returns (3,
    size, size) float64; each sums to the fraction of the light inside the square.. Raises InputError: an even size, or
    a blur of so many waves that the pupil cannot be sampled.
    """
    if size % 2 == 0:
        raise InputError(f"the kernel needs an odd size, got {size}")
    w20 = defocus_um(camera, depth_mm)
    ratio = camera.pupil_radius_mm / camera.image_distance_mm  # R / F
    half_um = 1e3 * camera.pixel_pitch_mm * size / 2
    # At most a quarter wave between samples at the rim, for defocus and for the farthest image point.
    steps = (2 * abs(w20) + ratio * half_um * 2**0.5) / min(wavelengths_um)
    cells = 2 * int(np.ceil(max(32, 4 * steps)))
    if cells > _MOST_CELLS:
        raise InputError(
            f"the defocus of {w20:.0f} um is hundreds of waves: diffraction is lost in it, use the geometric PSF"
        )
    axis = (np.arange(cells) + 0.5) * 2 / cells - 1
    xi, eta = np.meshgrid(axis, axis)
    amplitude = np.sqrt(aperture.transmission_map(xi, eta))
    fine = ((np.arange(size * _SUBPIXELS) + 0.5) / _SUBPIXELS - size / 2) * 1e3 * camera.pixel_pitch_mm
    out = np.empty((3, size, size))
    for k, wave in enumerate(wavelengths_um):
        pupil = amplitude[..., k] * np.exp(2j * np.pi * w20 / wave * (xi**2 + eta**2))
        kernel = np.exp(-2j * np.pi * ratio / wave * np.outer(fine, axis))
        amplitudes = kernel @ pupil @ kernel.T
        step = ratio / wave * (fine[1] - fine[0]) * 2 / cells  # Parseval: the sum over all space is 1
        power = np.abs(amplitudes) ** 2 * step**2 / max(float((amplitude[..., k] ** 2).sum()), 1e-12)
        out[k] = power.reshape(size, _SUBPIXELS, size, _SUBPIXELS).sum(axis=(1, 3))
    return out
