"""How a camera blurs: the transfer functions the restoration divides by, whatever their origin."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import scipy.fft

from chromaperture.camera import channel_shifts
from chromaperture.camera_file import Calibration
from chromaperture.color.lens_shift import LensShift
from chromaperture.config import Quality
from chromaperture.errors import InputError
from chromaperture.optics.aperture import Aperture, centroids
from chromaperture.optics.lens_otf import lens_kernels
from chromaperture.optics.psf import geometric_otf

_KEPT = 64  # transfer functions: the layers of one tile are asked for several times


class Blur(Protocol):
    """Transfer functions of the three channels at one blur radius, in one part of the frame."""

    def __call__(
        self, radius_px: float, shape: tuple[int, int], *, center: tuple[float, float] | None = None
    ) -> np.ndarray:
        """Transfer function on the frequencies of `numpy.fft.rfft2`.

        Parameters
        ----------
        radius_px : float
            Signed displacement of the pupil's edge, + beyond focus.
        shape : (int, int)
            Size of the picture it multiplies.
        center : (x, y), optional
            Where in the frame, -1 to 1 from rim to rim; the middle when absent.

        Returns
        -------
        (3, h, w // 2 + 1) complex64, with phases relative to the view of the pupil's centre
        """
        ...


@dataclass(frozen=True)
class ThinLensBlur:
    """The scaled shadow of the aperture, the same all over the frame.

    Attributes
    ----------
    aperture : Aperture
        Made of the camera's film.
    in_focus_sigma_px : float
        Gaussian blur that is to be removed even in focus; 0 leaves what is in focus as it is.
    """

    aperture: Aperture
    in_focus_sigma_px: float = 0.0

    def __call__(
        self, radius_px: float, shape: tuple[int, int], *, center: tuple[float, float] | None = None
    ) -> np.ndarray:
        """See `Blur`."""
        fy, fx = np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1])[None]
        lens = np.exp(-2 * (np.pi * self.in_focus_sigma_px) ** 2 * (fx**2 + fy**2)).astype(np.float32)
        return np.asarray(geometric_otf(self.aperture, radius_px, shape) * lens)


@dataclass(frozen=True)
class MeasuredBlur:
    """Measured kernels on a grid of field positions and blur radii.

    Attributes
    ----------
    kernels : (rows, columns, radii, 3, s, s) float
        Centred on the view of the pupil's centre; s is odd.
    radii_px : (radii,) float
        Rising.
    """

    kernels: np.ndarray
    radii_px: np.ndarray

    def __post_init__(self) -> None:
        shape = self.kernels.shape
        if len(shape) != 6 or shape[3] != 3 or shape[4] != shape[5] or shape[4] % 2 == 0:
            raise InputError(f"kernels must be (rows, columns, radii, 3, odd, odd), got {shape}")
        if shape[2] != len(self.radii_px) or np.any(np.diff(self.radii_px) <= 0):
            raise InputError("radii_px must rise and number as many as the kernels' third dimension")

    def __call__(
        self, radius_px: float, shape: tuple[int, int], *, center: tuple[float, float] | None = None
    ) -> np.ndarray:
        """See `Blur`; the nearest field position, linear between two radii."""
        rows, columns = self.kernels.shape[:2]
        x, y = center or (0.0, 0.0)
        row = int(np.clip(round((y + 1) / 2 * rows - 0.5), 0, rows - 1))
        column = int(np.clip(round((x + 1) / 2 * columns - 0.5), 0, columns - 1))
        position = float(np.interp(radius_px, self.radii_px, np.arange(len(self.radii_px))))
        below = min(int(position), max(len(self.radii_px) - 2, 0))
        share = position - below
        stack = self.kernels[row, column]
        kernel = (1 - share) * stack[below] + share * stack[min(below + 1, len(stack) - 1)]
        return _transfer(kernel, shape)


class LensBlur:
    """The blur of a calibrated lens, which changes over the frame.

    Parameters
    ----------
    shift : LensShift
        Of the camera: names distances by blur radii.
    """

    def __init__(self, shift: LensShift) -> None:
        self.shift = shift
        self._kept: dict[tuple, np.ndarray] = {}

    def __call__(
        self, radius_px: float, shape: tuple[int, int], *, center: tuple[float, float] | None = None
    ) -> np.ndarray:
        """See `Blur`."""
        key = (radius_px, shape, center)
        if key not in self._kept:
            if len(self._kept) >= _KEPT:
                self._kept.clear()
            blur, (x, y) = self.shift.blur, center or (0.0, 0.0)
            place = ((x + 1) * blur.width_px / 2 - 0.5, (y + 1) * blur.height_px / 2 - 0.5)
            self._kept[key] = _transfer(lens_kernels(blur, place, float(self.shift.inverse_mm(radius_px))), shape)
        return self._kept[key]


def _transfer(kernels: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Transfer functions of kernels with an odd side, centred in it."""
    size = kernels.shape[-1]
    if size > min(shape):
        raise InputError(f"a kernel of {size} px does not fit into a picture of {shape[1]}x{shape[0]} px")
    padded = np.zeros((3, *shape), np.float32)
    padded[:, :size, :size] = kernels / kernels.sum(axis=(1, 2), keepdims=True)
    centred = np.roll(padded, (-(size // 2), -(size // 2)), axis=(1, 2))
    return np.asarray(scipy.fft.rfft2(centred)).astype(np.complex64)


def radius_per_disparity(calibration: Calibration, quality: Quality) -> float:
    """Displacement of the pupil's edge per px of the disparity that a quality measures, from the channels' own."""
    shifts = channel_shifts(calibration, quality)
    pupil = centroids(calibration.aperture.with_film(calibration.film.transmissions()))
    pupil = np.nan_to_num(pupil)
    # least squares over the channels: shift = radius * centroid
    return float((shifts * pupil).sum() / (pupil**2).sum())


def camera_blur(calibration: Calibration) -> ThinLensBlur:
    """Give the blur of a calibrated camera to first order: its aperture with its film, before a thin lens."""
    return ThinLensBlur(calibration.aperture.with_film(calibration.film.transmissions()))
