"""Transfer functions of a camera's blur, from different sources, for the restoration."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol, TypeAlias

import numpy as np
import scipy.fft

from chromaperture.camera.alignment import channel_shifts
from chromaperture.color.lens_shift import LensShift
from chromaperture.model.camera_file import Calibration
from chromaperture.optics.aperture import Aperture, centroids
from chromaperture.optics.lens_otf import lens_kernels
from chromaperture.optics.psf import geometric_otf
from chromaperture.settings.methods import Quality
from chromaperture.system.errors import InputError

_CACHE_SIZE = 64  # transfer functions: each layer of a tile is used several times

Size: TypeAlias = tuple[int, int]
Position: TypeAlias = tuple[float, float]


class Blur(Protocol):
    """Transfer functions of the three channels at one blur radius and one frame position."""

    def __call__(self, radius_px: float, shape: Size, *, frame_position: Position | None = None) -> np.ndarray:
        """Return the transfer functions at the frequencies of `numpy.fft.rfft2`.

        ``radius_px``: signed displacement of the pupil's rim, + beyond focus; ``shape`` (int, int): size of the picture
        it multiplies; ``frame_position`` (x, y): -1 to 1 from border to border; the middle when absent. Returns (3, h,
        w // 2 + 1) complex64, with phases relative to the view of the pupil's centre.
        """
        ...


@dataclass(frozen=True)
class ThinLensBlur:
    """Scaled shadow of the aperture, the same over the whole frame."""

    aperture: Aperture  # with the camera's measured film

    def __call__(self, radius_px: float, shape: Size, *, frame_position: Position | None = None) -> np.ndarray:
        """See `Blur`."""
        return np.asarray(geometric_otf(self.aperture, radius_px, shape))


class LensTransfer:
    """Blur of a calibrated lens, which changes over the frame; ``shift`` relates blur radius and distance."""

    def __init__(self, shift: LensShift) -> None:
        self.shift = shift
        self._kept = lru_cache(_CACHE_SIZE)(self._computed)

    def __call__(self, radius_px: float, shape: Size, *, frame_position: Position | None = None) -> np.ndarray:
        """See `Blur`."""
        return self._kept(radius_px, shape, frame_position or (0.0, 0.0))

    def _computed(self, radius_px: float, shape: Size, frame_position: Position) -> np.ndarray:
        blur, (x, y) = self.shift.blur, frame_position
        pixel = ((x + 1) * blur.width_px / 2 - 0.5, (y + 1) * blur.height_px / 2 - 0.5)
        return kernel_otf(lens_kernels(blur, pixel, float(self.shift.inverse_mm(radius_px))), shape)


def kernel_otf(kernels: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Return the transfer functions of kernels (3, s, s), s odd, centred; (3, h, w // 2 + 1) complex64."""
    size = kernels.shape[-1]
    if size > min(shape):
        raise InputError(f"a kernel of {size} px does not fit into a picture of {shape[1]}x{shape[0]} px")
    padded = np.zeros((3, *shape), np.float32)
    padded[:, :size, :size] = kernels / kernels.sum(axis=(1, 2), keepdims=True)
    centred = np.roll(padded, (-(size // 2), -(size // 2)), axis=(1, 2))
    return np.asarray(scipy.fft.rfft2(centred)).astype(np.complex64)


def radius_per_disparity(calibration: Calibration, quality: Quality) -> float:
    """Return the displacement of the pupil's rim per px of the disparity measured at a quality."""
    shifts = channel_shifts(calibration, quality)
    pupil = np.nan_to_num(centroids(calibration.aperture.with_film(calibration.film.transmissions())))
    # Least squares over the channels: shift = radius * centroid.
    return float((shifts * pupil).sum() / (pupil**2).sum())
