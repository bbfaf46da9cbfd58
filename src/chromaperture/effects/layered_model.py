"""The camera as a linear map from the sharp picture to the capture, and its adjoint.

    y_k = sum_l (m_l x_k) * h_kl / sum_l m_l * h_kl

m_l are the weights of the pixels in each layer. The denominator, the coverage, is 1 within a surface. At depth edges
light is added or hidden that the picture does not contain: there the division preserves energy, and the departure of
the coverage from 1 measures how unreliable the model is.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol, TypeAlias

import numpy as np
import scipy.fft

from chromaperture.camera.alignment import channel_shifts
from chromaperture.color.lens_shift import LensShift
from chromaperture.model.camera_file import Calibration
from chromaperture.optics.aperture import Aperture, centroids
from chromaperture.optics.lens_blur import lens_kernels
from chromaperture.optics.psf import geometric_otf
from chromaperture.settings.methods import Quality
from chromaperture.system.errors import InputError

_CACHE_SIZE = 64  # transfer functions: each layer of a tile is used several times

Size: TypeAlias = tuple[int, int]
Position: TypeAlias = tuple[float, float]


class Blur(Protocol):
    """Transfer functions of the three channels at one blur radius and one frame position."""

    def __call__(self, radius_px: float, shape: Size, *, frame_position: Position | None = None) -> np.ndarray:
        """Return the transfer functions, as of `numpy.fft.rfft2`, of a signed blur radius at a frame position."""
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


_SHARP_PX = 0.25  # blur radius below which a layer counts as in focus; half the distance of two layers
_COVERAGE_ERROR = 0.12  # departure of the coverage from 1 at which data weigh 1/e; chosen by hand, not tuned
_MIN_COVERAGE = 0.05  # bounds the division; chosen by hand, not tuned


def blurred_layers(
    radius_px: np.ndarray, blur: Blur, shape: tuple[int, int]
) -> Iterator[tuple[float, np.ndarray, np.ndarray]]:
    """Yield radius, weights and transfer functions, for pictures of a shape, of the layers that have pixels."""
    radii = layer_radii(radius_px)
    for radius, weight in zip(radii, layer_weights(radius_px, radii), strict=True):
        if weight.any():
            yield float(radius), weight, blur(float(radius) if abs(radius) > _SHARP_PX else 0.0, shape)


class LayeredModel:
    """Blur of one picture by its depth, as the signed blur radius of every pixel."""

    def __init__(self, radius_px: np.ndarray, blur: Blur) -> None:
        self.shape = (int(radius_px.shape[0]), int(radius_px.shape[1]))
        self._layers: list[tuple[tuple[slice, slice], np.ndarray, np.ndarray]] = []
        for _, weight, otf in blurred_layers(radius_px, blur, self.shape):
            rows, columns = np.flatnonzero(weight.any(axis=1)), np.flatnonzero(weight.any(axis=0))
            box = (slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1))
            self._layers.append((box, np.ascontiguousarray(weight[box]), otf))
        # Filters of unlike shape blur edges unlike: the coverage differs from channel to channel.
        self._coverage = np.maximum(self._blurred(np.ones((3, *self.shape), np.float32)), np.float32(_MIN_COVERAGE))

    @property
    def data_weight(self) -> np.ndarray:
        """(3, H, W) float32 in [0, 1]: low at depth edges, where the model lacks what is hidden."""
        return np.exp(-(((self._coverage - 1) / np.float32(_COVERAGE_ERROR)) ** 2))

    def forward(self, sharp: np.ndarray) -> np.ndarray:
        """Blur a sharp picture; (3, H, W) float32."""
        return self._blurred(sharp) / self._coverage

    def adjoint(self, capture: np.ndarray) -> np.ndarray:
        """Apply the transpose of `forward`; (3, H, W) float32."""
        out = np.zeros((3, *self.shape), np.float32)
        with scipy.fft.set_workers(-1):
            spectra = scipy.fft.rfft2(capture / self._coverage)
            for box, weight, otf in self._layers:
                back = scipy.fft.irfft2(np.conj(otf) * spectra, s=self.shape)
                out[:, *box] += weight * back[:, *box]
        return out

    def _blurred(self, sharp: np.ndarray) -> np.ndarray:
        total = np.zeros((3, self.shape[0], self.shape[1] // 2 + 1), np.complex64)
        masked = np.zeros((3, *self.shape), np.float32)
        with scipy.fft.set_workers(-1):
            for box, weight, otf in self._layers:
                masked[:] = 0
                masked[:, *box] = weight * sharp[:, *box]
                total += otf * scipy.fft.rfft2(masked)
            return np.asarray(scipy.fft.irfft2(total, s=self.shape))


# Distance of two layers in blur radius: the larger of a step, px, and a fraction of the radius, because a large blur
# changes slowly. Chosen by hand; not tuned. Finer layers cost one transform each.
_STEP_PX, _GROWTH = 0.5, 0.10


def layer_radii(radius_px: np.ndarray, *, growth: float = _GROWTH) -> np.ndarray:
    """Choose rising blur radii, px, fine near focus and apart by ``growth`` beyond; 0 where it is crossed."""
    low, high = float(radius_px.min()), float(radius_px.max())
    sides = []
    for reach in (max(-low, 0.0), max(high, 0.0)):
        nodes = [0.0]
        while nodes[-1] < reach:
            nodes.append(nodes[-1] + max(_STEP_PX, growth * nodes[-1]))
        sides.append(np.array(nodes))
    radii = np.concatenate([-sides[0][:0:-1], sides[1]])
    used = np.flatnonzero((radii >= low) & (radii <= high))
    if used.size == 0:  # between two nodes
        first = int(np.searchsorted(radii, low)) - 1
        return radii[first : first + 2]
    return radii[max(used[0] - 1, 0) if radii[used[0]] > low else used[0] : used[-1] + 2]


def layer_weights(radius_px: np.ndarray, radii: np.ndarray) -> Iterator[np.ndarray]:
    """Yield the weight of every pixel in each layer, in the order of the radii; (H, W) float32 that sum to 1."""
    for i, center in enumerate(radii):
        weight = np.ones(radius_px.shape, np.float32)
        if i > 0:
            weight = np.minimum(weight, (radius_px - np.float32(radii[i - 1])) / np.float32(center - radii[i - 1]))
        if i + 1 < len(radii):
            weight = np.minimum(weight, (np.float32(radii[i + 1]) - radius_px) / np.float32(radii[i + 1] - center))
        yield np.clip(weight, 0, 1, out=weight)
