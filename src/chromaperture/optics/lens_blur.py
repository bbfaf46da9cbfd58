"""Position-dependent geometric point-spread function of a real lens, described by 28 numbers.

A ray through the pupil point xi (in stop radii), from a point at the frame position f (in half widths) and at the
distance z from the pupil, meets the sensor at this distance from the chief ray::

    X = (A - B/z) xi + (aberrations of the third and fifth order in xi and f),         px

The image of the point in channel k is the film's transmission T_k(xi), vignetted by two round rims that move with f,
and mapped by X. All numbers are fitted to photographs of boards (``calibration/fit_blur.py``).

References
----------
W. Welford: Aberrations of Optical Systems (1986), for the terms; the derivation is in ``docs/equations.md``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy.fft

from chromaperture.optics.aperture import Aperture
from chromaperture.system.errors import InputError

PointTransforms = Callable[[np.ndarray, np.ndarray, int, int], np.ndarray]

_POINTS = 1500  # samples of the pupil: ten times as many change the transfer functions by 1e-3
_RIM_SOFTNESS = 0.06  # pupil radii over which a rim fades, being out of focus at the stop; chosen by hand, not tuned
# Distance of two channels' centroids over that of the widest pair; chosen by hand, not tuned: complementary halves
# give 1, 0.5 and 0.5, three equal filters 1, 1 and 1.
_WIDE = 0.7  # at least: a primary pair
_NARROW = 0.3  # at least, but below _WIDE: a secondary pair
_RAMP = 16 / (3 * np.pi)  # slope of a ramp whose centroid over a disc is that of a step: 4 * 4 / (3 pi)
_MIN_SEPARATION = 0.05  # pupil radii; below, the aperture has no parallax. Chosen by hand, not tuned


@dataclass(frozen=True)
class BlurModel:
    """Aberrations and rims of a lens, in px of displacement on the sensor at the pupil's edge and the frame's side."""

    # A and B: the pupil's edge is displaced by A - B / z, + beyond the focus surface
    infinity_px: float
    scale_px_mm: float
    # Axial colour, relative to green
    axial_red_px: float = 0.0
    axial_blue_px: float = 0.0
    # Field curvature, of second and fourth order in the frame position
    curvature_px: float = 0.0
    curvature4_px: float = 0.0
    # Spherical aberration, of third and fifth order in the pupil
    spherical_px: float = 0.0
    spherical5_px: float = 0.0
    # Oblique spherical aberration
    oblique_px: float = 0.0
    oblique_tangential_px: float = 0.0
    # Astigmatism and coma
    astigmatism_px: float = 0.0
    astigmatism4_px: float = 0.0
    coma_px: float = 0.0
    coma4_px: float = 0.0
    coma_zonal_px: float = 0.0
    coma_elliptical_px: float = 0.0
    # Lateral colour, relative to green, of first and third order in the frame position
    lateral_red_px: float = 0.0
    lateral_blue_px: float = 0.0
    lateral3_red_px: float = 0.0
    lateral3_blue_px: float = 0.0
    # Additions to green's spherical aberration and field curvature for red and blue
    spherical_red_px: float = 0.0
    spherical_blue_px: float = 0.0
    curvature_red_px: float = 0.0
    curvature_blue_px: float = 0.0
    # Vignetting, pupil radii: radius of each rim, and shift of its centre between the frame's centre and side
    front_rim_radius: float = 1.1
    front_rim_shift: float = 0.0
    rear_rim_radius: float = 1.1
    rear_rim_shift: float = 0.0
    # Of a dual-pixel sensor, 0 for film: its halves see ramps of the pupil in place of half pupils, and the ramps'
    # slope is divided by 1 + (fall * x / half width)^2. Known of the sensor, not fitted to boards
    contrast_fall: float = 0.0


class PupilSamples(NamedTuple):
    """Points (N, 2) of equal area in the pupil, in its radii, and the film's transmission (3, N) there in R, G, B."""

    points: np.ndarray
    light: np.ndarray


class Rays(NamedTuple):
    """Sensor positions of pupil rays for a point at infinity, (C, N, 2) px, and their weights, (C, N), of unit sum."""

    at_infinity_px: np.ndarray
    light: np.ndarray

    def of(self, channels: np.ndarray) -> Rays:
        """Return the rays of some channels."""
        return Rays(self.at_infinity_px[channels], self.light[channels])


def sample_pupil(aperture: Aperture) -> PupilSamples:
    """Sample the pupil evenly on a Fermat spiral; a square lattice would alias with the pixels."""
    i = np.arange(_POINTS) + 0.5
    radius, angle = np.sqrt(i / _POINTS), np.pi * (1 + np.sqrt(5)) * i
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)
    return PupilSamples(points, aperture.transmission_map(points[:, 0], points[:, 1]).T.copy())


def displacement(
    model: BlurModel, points: np.ndarray, position: np.ndarray, inverse_mm: float, channel: int
) -> np.ndarray:
    """Compute where rays through pupil points meet the sensor, relative to green's chief ray; (N, 2) px."""
    return displacements(model, points, position, inverse_mm, (channel,))[0]


def displacements(
    model: BlurModel, points: np.ndarray, position: np.ndarray, inverse_mm: float, channels: Sequence[int]
) -> np.ndarray:
    """Compute the `displacement` of several channels, what they have in common once; (C, N, 2) float64, px."""
    m = model
    x2 = points[:, 0] ** 2 + points[:, 1] ** 2
    along = points @ position
    f2 = float(position @ position)
    coma = m.coma_px + m.coma4_px * f2
    # Gradient of the wave aberration: even terms act along the pupil vector, odd terms along the position as well.
    fifth = m.spherical5_px * x2
    odd = (2 * coma + 4 * m.coma_zonal_px * x2 + m.oblique_tangential_px * along) * along
    to_position = (m.astigmatism_px + m.astigmatism4_px * f2 + m.oblique_tangential_px * x2) * along
    to_position += (coma + m.coma_zonal_px * x2) * x2 + m.coma_elliptical_px * along**2
    out = np.empty((len(channels), len(points), 2))
    for channel, moved in zip(channels, out, strict=True):
        axial = (m.axial_red_px, 0.0, m.axial_blue_px)[channel]
        lateral = (m.lateral_red_px, 0.0, m.lateral_blue_px)[channel]
        lateral3 = (m.lateral3_red_px, 0.0, m.lateral3_blue_px)[channel]
        spherical = m.spherical_px + (m.spherical_red_px, 0.0, m.spherical_blue_px)[channel] + m.oblique_px * f2
        curvature = m.curvature_px + (m.curvature_red_px, 0.0, m.curvature_blue_px)[channel]
        defocus = m.infinity_px - m.scale_px_mm * inverse_mm + axial + (curvature + m.curvature4_px * f2) * f2
        to_pupil = defocus + (spherical + fifth) * x2
        to_pupil += odd
        to_side = to_position + (lateral + lateral3 * f2)
        for k in (0, 1):
            np.multiply(to_pupil, points[:, k], out=moved[:, k])
            moved[:, k] += to_side * position[k]
    return out


def rims(model: BlurModel, points: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Compute the transmission of the front and rear rims at pupil points; (N,) float64 in [0, 1]."""

    def transmission(radius: float, shift: np.ndarray) -> np.ndarray:
        inside = radius - np.hypot(*(points - shift).T)
        return np.clip(inside / _RIM_SOFTNESS + 0.5, 0, 1)

    front = transmission(model.front_rim_radius, model.front_rim_shift * position)
    return front * transmission(model.rear_rim_radius, -model.rear_rim_shift * position)


def splat(points_px: np.ndarray, weights: np.ndarray, out: np.ndarray) -> None:
    """Add weighted points (x, y) to the four pixels around them, with periodic borders; as `splat_kernels.splat`."""
    size = len(out)
    corner = np.floor(points_px).astype(int)
    tx, ty = (points_px - corner).T
    for dx, wx in ((0, 1 - tx), (1, tx)):
        for dy, wy in ((0, 1 - ty), (1, ty)):
            pixel = (corner[:, 1] + dy) % size * size + (corner[:, 0] + dx) % size
            out += np.bincount(pixel, weights * wx * wy, size * size).reshape(size, size)


def point_transforms(points_px: np.ndarray, weights: np.ndarray, size: int, samples: int) -> np.ndarray:
    """Fourier transform of weighted points in a periodic square, low frequencies only; as `splat_kernels`."""
    pictures = np.zeros((len(points_px), size, size), np.float32)
    for points, weight, picture in zip(points_px, weights, pictures, strict=True):
        splat(points, weight, picture)
    return low_frequencies(scipy.fft.rfft2(pictures), samples)


def low_frequencies(spectrum: np.ndarray, samples: int) -> np.ndarray:
    """Keep the frequencies of a spectrum (..., n, n // 2 + 1) that fewer samples have; (..., m, m // 2 + 1)."""
    if samples == spectrum.shape[-2]:
        return spectrum
    half = (samples + 1) // 2  # of an even number the highest is left out: its sign is not known
    kept = np.zeros((*spectrum.shape[:-2], samples, samples // 2 + 1), np.complex64)
    kept[..., :half, :half] = spectrum[..., :half, :half]
    kept[..., samples - half + 1 :, :half] = spectrum[..., spectrum.shape[-2] - half + 1 :, :half]
    return kept


@dataclass(frozen=True)
class LensBlur:
    """Blur of one camera, lens and film together, over the frame."""

    model: BlurModel
    pupil: PupilSamples
    width_px: int
    height_px: int

    def frame_position(self, x_px: float, y_px: float) -> np.ndarray:
        """Return the position in the frame from its centre, in half widths; (2,) float64."""
        half = self.width_px / 2
        return np.array([(x_px - (self.width_px - 1) / 2) / half, (y_px - (self.height_px - 1) / 2) / half])

    def transfer(self, x_px: float, y_px: float, inverse_mm: float, size_px: int) -> np.ndarray:
        """Compute the optical transfer functions of R, G and B at an image position; see `transfer_of`."""
        return self.transfer_of(self.rays(x_px, y_px), inverse_mm, size_px)

    def rays(self, x_px: float, y_px: float, channels: tuple[int, ...] = (0, 1, 2)) -> Rays:
        """Trace the rays of channels at an image position; they hold for every distance."""
        position = self.frame_position(x_px, y_px)
        at_infinity = displacements(self.model, self.pupil.points, position, 0.0, channels)
        return Rays(at_infinity, self.ray_weights(position, channels))

    def ray_weights(self, position: np.ndarray, channels: tuple[int, ...] = (0, 1, 2)) -> np.ndarray:
        """Return the weights of the rays at a frame position, behind film and rims; (C, N), of unit sum."""
        light = self.light_at(position)[list(channels)] * rims(self.model, self.pupil.points, position)
        return np.asarray(light / light.sum(axis=1, keepdims=True))

    @property
    def least_light(self) -> float:
        """Light of the darkest corner of the frame in any channel, as a share of the same channel's in the middle."""
        ends = (0, self.width_px - 1), (0, self.height_px - 1)
        middle, *corners = (
            (self.light_at(position) * rims(self.model, self.pupil.points, position)).sum(axis=1)
            for position in (np.zeros(2), *(self.frame_position(x, y) for x in ends[0] for y in ends[1]))
        )
        return float((np.stack(corners) / middle).min())

    def light_at(self, position: np.ndarray) -> np.ndarray:
        """Return the light of the pupil's points at a frame position, (3, N)."""
        light = self.pupil.light
        if self.model.contrast_fall == 0:
            return light
        mean = light.mean(axis=1, keepdims=True)
        ramp = _RAMP * np.abs(self.pupil.points[:, 0]) / (1 + (self.model.contrast_fall * position[0]) ** 2)
        return np.asarray(mean + (light - mean) * ramp)

    def transfer_of(
        self,
        rays: Rays,
        inverse_mm: float,
        size_px: int,
        *,
        samples: int | None = None,
        transform: PointTransforms | None = None,
    ) -> np.ndarray:
        """Compute the optical transfer functions of rays at a distance.

        ``inverse_mm`` float, 1/mm: 1 / z, z from the entrance pupil; ``size_px``: side of the tile to filter; the PSF
        wraps around in it; ``samples``: along the side of a tile that is sampled more coarsely: the frequencies beyond
        its are left out; ``transform``: has the signature of `point_transforms`; the compiled one when absent. Returns
        (C, n, n // 2 + 1) complex64, 1 at zero frequency; n is ``samples``, or else ``size_px``.
        """
        if transform is None:
            from chromaperture.optics import splat_kernels  # compiling starts here, not at import

            transform = splat_kernels.point_transforms
        return transform(rays.at_infinity_px - self.defocus_px(inverse_mm), rays.light, size_px, samples or size_px)

    def defocus_px(self, inverse_mm: float) -> np.ndarray:
        """How far a distance moves the rays of the pupil's points, against infinity; (N, 2) float64."""
        return self.model.scale_px_mm * inverse_mm * self.pupil.points

    @cached_property
    def separations(self) -> dict[tuple[int, int], float]:
        """Distance of the pupil centroids of every pair of channels, over that of the widest pair, which is first."""
        light = self.pupil.light
        centres = (light @ self.pupil.points) / light.sum(axis=1, keepdims=True)
        apart = {(a, b): float(np.hypot(*(centres[a] - centres[b]))) for a, b in ((0, 2), (0, 1), (1, 2))}
        widest = max(apart.values())
        if widest < _MIN_SEPARATION:
            raise InputError("the aperture shows every channel the same view: near and far blur look alike")
        return {pair: apart[pair] / widest for pair in sorted(apart, key=lambda p: -apart[p])}

    @cached_property
    def pairs(self) -> tuple[tuple[int, int], ...]:
        """Primary pairs of channels, of the widest separations and so the best for depth; the widest first."""
        return tuple(pair for pair, apart in self.separations.items() if apart >= _WIDE)

    @cached_property
    def other_pairs(self) -> tuple[tuple[int, int], ...]:
        """Secondary pairs, of smaller separation: for surfaces that are dark in a channel of the primary pairs."""
        return tuple(pair for pair, apart in self.separations.items() if _NARROW <= apart < _WIDE)

    @cached_property
    def axis(self) -> np.ndarray:
        """Direction in the pupil from the second to the first view of the widest pair; (2,) float64 unit vector."""
        a, b = self.pairs[0]
        light = self.pupil.light
        apart = (light[a] @ self.pupil.points) / light[a].sum() - (light[b] @ self.pupil.points) / light[b].sum()
        return np.asarray(apart / np.hypot(*apart))

    def half_disparity(self, x_px: float, y_px: float) -> tuple[float, float]:
        """Return a, b: half the distance, px, of the widest pair's centroids on the sensor is a - b / z."""
        position = self.frame_position(x_px, y_px)
        rim = rims(self.model, self.pupil.points, position)
        light = self.light_at(position)
        steps = []
        for inverse_mm in (0.0, 1e-3):  # linear in 1 / z: two distances determine it
            centre = []
            for k in self.pairs[0]:
                weight = light[k] * rim
                moved = displacement(self.model, self.pupil.points, position, inverse_mm, k)
                centre.append(weight @ moved / weight.sum())
            steps.append(float((centre[0] - centre[1]) @ self.axis / 2))
        return steps[0], (steps[0] - steps[1]) / 1e-3

    @cached_property
    def reference(self) -> tuple[float, float]:
        """(A0, B0), px and px mm: the half disparity at the frame's centre, in which layers are counted."""
        return self.half_disparity((self.width_px - 1) / 2, (self.height_px - 1) / 2)

    @property
    def reach(self) -> float:
        """Half disparity per px by which defocus displaces the pupil's edge."""
        return self.reference[1] / self.model.scale_px_mm


_MARGIN_PX = 8  # around a kernel, for the ringing of the cut-off at the sampling rate; chosen by hand, not tuned
_LEAST_LIGHT = 1e-3  # of the brightest ray: weaker ones are left out, to save time


class ChannelRays(NamedTuple):
    """Sensor positions of one channel's rays, (N, 2) px, and their weights, (N,), of unit sum."""

    points_px: np.ndarray
    weights: np.ndarray


def traced(blur: LensBlur, image_px: tuple[float, float], inverse_mm: float) -> list[ChannelRays]:
    """Trace the rays of an object point to the sensor, for R, G and B; ``inverse_mm`` is 1 / z from the entrance pupil.

    Positions are relative to the chief ray, less the mean displacement of the open pupil's light by aberrations: what
    all channels have in common, such as coma's, cancels in their differences, and a fit to those does not determine it.
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
    """Compute the transfer function on a lattice of frequencies, (2 count + 1, count + 1), 1 at 0."""
    # Powers of the first frequency's phase factors: one multiplication each instead of one exponential.
    factors = np.empty((2, count + 1, len(rays.weights)), np.complex128)
    factors[:, 0] = 1
    factors[:, 1:] = np.exp((-2j * np.pi * step) * rays.points_px.T)[:, None]
    columns, up = np.cumprod(factors, axis=1, out=factors).astype(np.complex64)
    rows = np.concatenate([up[:0:-1].conj(), up]) * rays.weights.astype(np.float32)
    return np.asarray(rows @ columns.T)


def lens_kernels(blur: LensBlur, image_px: tuple[float, float], inverse_mm: float) -> np.ndarray:
    """Compute the channels' point spreads, (3, s, s) of unit sum about the centre view, at a distance."""
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

    As in `depth_error_bound.py`, for two channels with the transfer functions h1 and h2, equal white noise, and a
    texture of 1/f amplitudes, a frequency f holds about the disparity the information

        |h2' h1 - h1' h2|^2 / (|h1|^2 + |h2|^2) / f^2,       ' = d / d disparity.

    Means over pixels of side s multiply the light by sinc(s fx) sinc(s fy), leave the noise a frequency as it is, and
    end the frequencies at 1 / 2s. The standard deviation of the disparity is the root of one over the sum.

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
