"""Cramer-Rao bound of the disparity of an aperture design, under shot and read noise.

The scene is grey with an unknown texture of 1/f amplitudes. With h(w) the transfer functions of the channels, S their
noise covariance and I(w) the texture, the Fisher information of each frequency about the disparity d is

    |I|^2 h'^H P h',    P = S^-1 - S^-1 h h^H S^-1 / (h^H S^-1 h),    ' = d/dd:

the change of the pictures with d, orthogonal to any change of the texture. For two channels that is
|I|^2 |h2' h1 - h1' h2|^2 / (v1 |h2|^2 + v2 |h1|^2).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from chromaperture.optics.aperture import Aperture, aperture_figures, channel_transmission, film_unmixing
from chromaperture.optics.pinhole import PupilCamera
from chromaperture.optics.psf import geometric_otf
from chromaperture.optics.simulator.sensor import SensorModel

_PATCH = 128  # px: side of the patch whose frequencies are summed; 512 differ by a few percent of the variance
_STEP = 1e-2  # px of blur radius, for the central difference


@dataclass(frozen=True)
class Texture:
    """Texture of the scene and size of the matching window."""

    mean: float = 0.45  # reflectance, linear
    contrast: float = 0.18  # its standard deviation
    exponent: float = 1.0  # amplitudes fall as frequency^-exponent, from the lowest frequency of ``patch_px``
    patch_px: int = 512  # side of the picture that has this contrast
    # Independent pixels in the matching window; 320 is that of 0.80^(|x| + |y|), the window of quality "paper"
    window_px2: float = 320.0


@dataclass(frozen=True)
class ExpectedAccuracy:
    """Figures of one design at several distances."""

    depth_mm: np.ndarray  # (N,) float64; from the sensor plane
    disparity_px: np.ndarray  # (N,) float64; half disparity of the unmixed views
    blur_px: np.ndarray  # (N,) float64; signed blur radius
    disparity_per_mm: np.ndarray  # (N,) float64; slope of the disparity, px/mm
    # (N,) float64 each: bound on one standard deviation; inf for designs without disparity
    sigma_px: np.ndarray
    sigma_mm: np.ndarray


def expected_accuracy(
    aperture: Aperture,
    camera: PupilCamera,
    depth_mm: np.ndarray,
    *,
    sensor: SensorModel | None = None,
    texture: Texture | None = None,
    exposure: float = 1.0,
) -> ExpectedAccuracy:
    """Compute the lower bound of a design's depth error at distances, (N,) mm from the sensor plane."""
    sensor, texture = sensor or SensorModel(), texture or Texture()
    depth = np.atleast_1d(np.asarray(depth_mm, float))
    radius = camera.blur_radius_px(depth)
    beta = aperture_figures(aperture, film_unmixing(aperture)).beta if aperture.views else 0.0
    z = depth - camera.sensor_to_pupil_mm
    slope = camera.focal_px * camera.pupil_radius_mm / z**2 * beta
    sigma = np.array([disparity_bound(aperture, r, beta, sensor, texture, exposure) for r in radius])
    with np.errstate(divide="ignore", invalid="ignore"):
        sigma_mm = np.where(np.isfinite(sigma), sigma / slope, np.inf)
    return ExpectedAccuracy(depth, beta * radius, radius, slope, sigma, sigma_mm)


def disparity_bound(
    aperture: Aperture, radius_px: float, beta: float, sensor: SensorModel, texture: Texture, exposure: float
) -> float:
    """Compute the bound on the standard deviation of the half disparity, px; inf without information."""
    if beta == 0:
        return float("inf")
    light = channel_transmission(aperture)
    rows = film_unmixing(aperture)
    shot = light * texture.mean * exposure / sensor.full_well_electrons
    variance = shot + (sensor.read_noise_electrons / sensor.full_well_electrons) ** 2
    noise = rows @ np.diag(variance) @ rows.T
    shape = (_PATCH, _PATCH)

    def views(r: float) -> np.ndarray:
        otf = geometric_otf(aperture, float(r), shape, pixel=True).astype(complex) * (exposure * light)[:, None, None]
        return np.einsum("kc,chw->hwk", rows, otf)

    h = views(radius_px)
    slope = (views(radius_px + _STEP) - views(radius_px - _STEP)) / (2 * _STEP * beta)  # r = d / beta
    inverse = np.linalg.inv(noise)
    own = np.einsum("hwk,kl,hwl->hw", h.conj(), inverse, h).real
    moved = np.einsum("hwk,kl,hwl->hw", slope.conj(), inverse, slope).real
    both = np.einsum("hwk,kl,hwl->hw", h.conj(), inverse, slope)
    information = np.maximum(moved - np.abs(both) ** 2 / np.maximum(own, 1e-30), 0)
    # `rfft2` holds half of the frequencies: its inner columns count twice.
    twice = np.full(h.shape[1], 2.0)
    twice[[0, -1]] = 1
    per_pixel = float((information * _spectrum(texture) * twice).sum())
    return float("inf") if per_pixel <= 0 else float(1 / np.sqrt(per_pixel * texture.window_px2))


def _spectrum(texture: Texture) -> np.ndarray:
    """Compute the texture's variance in each cell of the frequency plane; (_PATCH, _PATCH // 2 + 1)."""
    side = texture.patch_px
    fy, fx = np.fft.fftfreq(side)[:, None], np.fft.fftfreq(side)[None]
    fine = np.hypot(fy, fx)
    fine[0, 0] = np.inf
    total = (fine ** (-2 * texture.exponent)).sum()
    coarse = np.hypot(np.fft.fftfreq(_PATCH)[:, None], np.fft.rfftfreq(_PATCH)[None])
    coarse[0, 0] = np.inf
    density = coarse ** (-2 * texture.exponent) / total * (side / _PATCH) ** 2
    return texture.contrast**2 * density
