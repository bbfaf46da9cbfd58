"""Geometric point-spread functions: the scaled shadow of the aperture, per sensor channel.

The image of a point with signed blur radius r in channel k is A_k(x / r), upright beyond focus (r > 0) and turned by
180 degrees before it (r < 0).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from chromaperture.optics.aperture import Aperture
from chromaperture.optics.pinhole import PupilCamera
from chromaperture.system.errors import InputError

_LARGEST_KEPT = 500_000  # px, of cached transfer functions: 48 of these are 600 MB; VGA video needs about 30
_CELLS = 128  # across the pupil; the disc's second moment is then accurate to 1e-4


@lru_cache(maxsize=16)
def _mask(aperture: Aperture) -> tuple[np.ndarray, np.ndarray]:
    """Compute cell midpoints along an axis and the aperture's normalised light in the cells; (n,), (3, n, n)."""
    axis = (np.arange(_CELLS) + 0.5) * 2 / _CELLS - 1
    points, light = pupil_samples(aperture, _CELLS, 4)
    column, row = (np.clip(np.floor((points + 1) / 2 * _CELLS).astype(int), 0, _CELLS - 1)).T
    mask = np.zeros((3, _CELLS, _CELLS))
    mask[:, row, column] = light.T
    total = mask.sum(axis=(1, 2), keepdims=True)
    return axis, mask / np.where(total > 0, total, 1.0)


def geometric_otf(aperture: Aperture, radius_px: float, shape: tuple[int, int], *, pixel: bool = False) -> np.ndarray:
    """Compute the optical transfer function on the frequencies of `numpy.fft.rfft2`; (3, h, w // 2 + 1) complex64.

    From the mask itself, not from a rasterised kernel: at a radius of 2 px rasterising moves the centroid by 2 %.
    ``radius_px``: signed blur radius r; ``shape``: height and width of the image to filter; ``pixel``: multiply by the
    transfer function of the pixel's square area. Read-only; 1 at frequency 0 (0 for a channel without light).
    """
    if shape[0] * shape[1] <= _LARGEST_KEPT:
        return _kept_otf(aperture, float(radius_px), shape, pixel)
    return _otf(aperture, float(radius_px), shape, pixel)


def _otf(aperture: Aperture, radius_px: float, shape: tuple[int, int], pixel: bool) -> np.ndarray:
    axis, mask = _mask(aperture)
    fy = np.fft.fftfreq(shape[0])
    fx = np.fft.rfftfreq(shape[1])
    rows = np.exp(-2j * np.pi * radius_px * np.outer(fy, axis)).astype(np.complex64)
    columns = np.exp(-2j * np.pi * radius_px * np.outer(axis, fx)).astype(np.complex64)
    # Cells are squares of side 2 r / n on the image: multiply by the transfer function of a square.
    cell = np.outer(np.sinc(2 * radius_px / _CELLS * fy), np.sinc(2 * radius_px / _CELLS * fx))
    if pixel:
        cell = cell * np.outer(np.sinc(fy), np.sinc(fx))
    otf: np.ndarray = (rows @ mask.astype(np.complex64) @ columns) * cell.astype(np.float32)
    otf.flags.writeable = False
    return otf


_kept_otf = lru_cache(maxsize=48)(_otf)


def geometric_psf(aperture: Aperture, radius_px: float, size: int, *, oversampling: int = 1) -> np.ndarray:
    """Compute point spreads of a signed blur radius, integrated over pixels; unit sum, odd square."""
    if size % 2 == 0 or oversampling % 2 == 0 or size < 2 * abs(radius_px) + 1:
        need = 2 * abs(radius_px) + 1
        raise InputError(f"a blur of radius {radius_px:g} px needs an odd kernel of at least {need:.0f} px")
    axis, mask = _mask(aperture)
    edges = (np.arange(size * oversampling + 1) - size * oversampling / 2) / oversampling
    half = max(abs(radius_px) / _CELLS, 1e-9)
    # Overlap of each cell, a square on the image, with every sample, separately in x and y.
    covered = np.clip((edges[:, None] - radius_px * axis) / (2 * half) + 0.5, 0, 1)
    overlap = np.diff(covered, axis=0)
    return overlap @ mask @ overlap.T


@lru_cache(maxsize=64)
def pupil_samples(aperture: Aperture, cells: int, supersampling: int = 8) -> tuple[np.ndarray, np.ndarray]:
    """Sample the pupil by the cells of a grid: points (S, 2), and light in R, G, B (S, 3) weighted by area."""
    fine = cells * supersampling
    axis = (np.arange(fine) + 0.5) * 2 / fine - 1
    x, y = np.meshgrid(axis, axis)
    inside = (np.hypot(x, y) < 1).astype(float)

    def per_cell(values: np.ndarray) -> np.ndarray:
        blocks = values.reshape(cells, supersampling, cells, supersampling, -1)
        return blocks.sum(axis=(1, 3)).reshape(cells * cells, -1)

    area = per_cell(inside)[:, 0]
    used = area > 0
    light = per_cell(aperture.transmission_map(x, y))[used]
    points = np.hstack([per_cell(x * inside), per_cell(y * inside)])[used] / area[used, None]
    return points, light / area.sum()


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
