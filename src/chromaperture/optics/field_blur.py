"""How a real lens blurs each colour at every place of the frame: a geometric point-spread function of a few numbers.

A ray through the pupil point xi (stop radii) of a point at the place f of the frame (half widths) and the distance z
from the pupil meets the sensor, away from the chief ray, at::

    X = (A - B/z) xi + (aberrations of the third and fifth order in xi and f),         px

so the point's image in channel k is the film's transmission T_k(xi), cut by two round rims that move with f, carried
over by X. Every number of it is fitted to photographs of boards (``blur_fit.py``); none is asked of a user.

References
----------
W. Welford: Aberrations of Optical Systems (1986), for the terms; the derivation is in ``docs/equations.md``.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy.fft

from chromaperture.errors import InputError
from chromaperture.optics.aperture import Aperture

_POINTS = 1500  # of the pupil: the transfer functions change by 1e-3 against ten times as many
_RIM_SOFTNESS = 0.06  # pupil radii over which a rim fades; a rim is no image of the stop and is never sharp
_WIDE = 0.7  # pairs of channels this far apart, of the widest pair's distance, are matched
_NEAR = 0.3  # and those closer than that are not
_MIN_SEPARATION = 0.05  # pupil radii


@dataclass(frozen=True)
class BlurModel:
    """Aberrations and rims of a lens, in px of displacement on the sensor at the pupil's edge and the frame's side.

    Attributes
    ----------
    infinity_px, scale_px_mm : float
        A and B: the pupil's edge is displaced by A - B / z, + beyond the focus surface.
    axial_red_px, axial_blue_px : float
        Axial colour, against green.
    curvature_px, curvature4_px : float
        Field curvature, of second and fourth order in the field.
    spherical_px, spherical5_px : float
        Spherical aberration, of third and fifth order in the pupil.
    oblique_px, oblique_tangential_px : float
        Oblique spherical aberration.
    astigmatism_px, astigmatism4_px : float
    coma_px, coma4_px, coma_zonal_px, coma_elliptical_px : float
    lateral_red_px, lateral_blue_px, lateral3_red_px, lateral3_blue_px : float
        Lateral colour, against green, of first and third order in the field.
    spherical_red_px, spherical_blue_px, curvature_red_px, curvature_blue_px : float
        What red and blue have more of than green.
    front_rim_radius, front_rim_shift, rear_rim_radius, rear_rim_shift : float, pupil radii
        Vignetting: a rim's radius in the pupil and how far its centre moves from the middle to the frame's side.
    """

    infinity_px: float
    scale_px_mm: float
    axial_red_px: float = 0.0
    axial_blue_px: float = 0.0
    curvature_px: float = 0.0
    curvature4_px: float = 0.0
    spherical_px: float = 0.0
    spherical5_px: float = 0.0
    oblique_px: float = 0.0
    oblique_tangential_px: float = 0.0
    astigmatism_px: float = 0.0
    astigmatism4_px: float = 0.0
    coma_px: float = 0.0
    coma4_px: float = 0.0
    coma_zonal_px: float = 0.0
    coma_elliptical_px: float = 0.0
    lateral_red_px: float = 0.0
    lateral_blue_px: float = 0.0
    lateral3_red_px: float = 0.0
    lateral3_blue_px: float = 0.0
    spherical_red_px: float = 0.0
    spherical_blue_px: float = 0.0
    curvature_red_px: float = 0.0
    curvature_blue_px: float = 0.0
    front_rim_radius: float = 1.1
    front_rim_shift: float = 0.0
    rear_rim_radius: float = 1.1
    rear_rim_shift: float = 0.0


class PupilSamples(NamedTuple):
    """Points (N, 2) of equal area in the pupil, in its radii, and the film's light (3, N) there in R, G, B."""

    points: np.ndarray
    light: np.ndarray


class Rays(NamedTuple):
    """Where rays through the pupil's points meet the sensor for a point at infinity, (C, N, 2) px, and their light."""

    at_infinity_px: np.ndarray
    light: np.ndarray


def sample_pupil(aperture: Aperture, count: int = _POINTS) -> PupilSamples:
    """Spread points evenly over the pupil, on a sunflower's spiral: a lattice would beat with the pixels."""
    i = np.arange(count) + 0.5
    radius, angle = np.sqrt(i / count), np.pi * (1 + np.sqrt(5)) * i
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)
    return PupilSamples(points, aperture.transmission_map(points[:, 0], points[:, 1]).T.copy())


def displacement(
    model: BlurModel, points: np.ndarray, field: np.ndarray, inverse_mm: float, channel: int
) -> np.ndarray:
    """Where rays through pupil points meet the sensor, from the chief ray of green.

    Parameters
    ----------
    model : BlurModel
    points : (N, 2) float, pupil radii
    field : (2,) float
        Place in the frame from its middle, in half widths.
    inverse_mm : float, 1/mm
        1 / z, z from the entrance pupil.
    channel : {0, 1, 2}

    Returns
    -------
    (N, 2) float64, px
    """
    m = model
    x2 = np.einsum("ij,ij->i", points, points)
    along = points @ field
    f2 = float(field @ field)
    axial = (m.axial_red_px, 0.0, m.axial_blue_px)[channel]
    lateral = (m.lateral_red_px, 0.0, m.lateral_blue_px)[channel]
    lateral3 = (m.lateral3_red_px, 0.0, m.lateral3_blue_px)[channel]
    spherical = m.spherical_px + (m.spherical_red_px, 0.0, m.spherical_blue_px)[channel] + m.oblique_px * f2
    curvature = m.curvature_px + (m.curvature_red_px, 0.0, m.curvature_blue_px)[channel]
    coma = m.coma_px + m.coma4_px * f2

    # Gradients of the wave aberration: of its even terms along the pupil vector, of its odd ones along the field too.
    to_pupil = m.infinity_px - m.scale_px_mm * inverse_mm + axial + (curvature + m.curvature4_px * f2) * f2
    to_pupil = to_pupil + (spherical + m.spherical5_px * x2) * x2
    to_pupil += (2 * coma + 4 * m.coma_zonal_px * x2 + m.oblique_tangential_px * along) * along
    to_field = (m.astigmatism_px + m.astigmatism4_px * f2 + m.oblique_tangential_px * x2) * along
    to_field += (coma + m.coma_zonal_px * x2) * x2 + m.coma_elliptical_px * along**2
    to_field += lateral + lateral3 * f2
    return np.asarray(to_pupil[:, None] * points + to_field[:, None] * field)


def rims(model: BlurModel, points: np.ndarray, field: np.ndarray) -> np.ndarray:
    """Share of the light that the rims of the front and the rear lens let through; (N,) float64 in [0, 1]."""

    def open_share(radius: float, shift: np.ndarray) -> np.ndarray:
        inside = radius - np.hypot(*(points - shift).T)
        return np.clip(inside / _RIM_SOFTNESS + 0.5, 0, 1)

    return open_share(model.front_rim_radius, model.front_rim_shift * field) * open_share(
        model.rear_rim_radius, -model.rear_rim_shift * field
    )


@dataclass(frozen=True)
class FieldBlur:
    """The blur of one camera: lens and film together, over a frame.

    Attributes
    ----------
    model : BlurModel
    pupil : PupilSamples
    width_px, height_px : int
    """

    model: BlurModel
    pupil: PupilSamples
    width_px: int
    height_px: int

    def field(self, x_px: float, y_px: float) -> np.ndarray:
        """Place in the frame from its middle, in half widths; (2,) float64."""
        half = self.width_px / 2
        return np.array([(x_px - (self.width_px - 1) / 2) / half, (y_px - (self.height_px - 1) / 2) / half])

    def transfer(
        self, x_px: float, y_px: float, inverse_mm: float, size_px: int, channels: tuple[int, ...] = (0, 1, 2)
    ) -> np.ndarray:
        """Give the optical transfer functions of channels at a place and distance.

        Parameters
        ----------
        x_px, y_px : float
        inverse_mm : float, 1/mm
            1 / z, z from the entrance pupil.
        size_px : int
            Side of the tile that will be filtered; the PSF wraps around in it.
        channels : tuple of int

        Returns
        -------
        (C, size, size // 2 + 1) complex64, 1 at zero frequency
        """
        return self.transfer_of(self.rays(x_px, y_px, channels), inverse_mm, size_px)

    def rays(self, x_px: float, y_px: float, channels: tuple[int, ...] = (0, 1, 2)) -> Rays:
        """Give the light of channels at a place, whatever the distance."""
        field = self.field(x_px, y_px)
        rim = rims(self.model, self.pupil.points, field)
        light = self.pupil.light[list(channels)] * rim
        at_infinity = [displacement(self.model, self.pupil.points, field, 0.0, k) for k in channels]
        return Rays(np.stack(at_infinity), light / light.sum(axis=1, keepdims=True))

    def transfer_of(self, rays: Rays, inverse_mm: float, size_px: int) -> np.ndarray:
        """Give the optical transfer functions of rays at a distance, see `transfer`."""
        from chromaperture.optics.splat_kernel import splat  # compiling starts here, not at import

        psf = np.zeros((len(rays.light), size_px, size_px), np.float32)
        nearer = self.model.scale_px_mm * inverse_mm * self.pupil.points
        for places, light, out in zip(rays.at_infinity_px, rays.light, psf, strict=True):
            splat(places - nearer, light, out)
        return scipy.fft.rfft2(psf)

    @cached_property
    def separations(self) -> dict[tuple[int, int], float]:
        """How far apart the views of every pair of channels are, of the widest pair, which comes first."""
        light = self.pupil.light
        centres = (light @ self.pupil.points) / light.sum(axis=1, keepdims=True)
        apart = {(a, b): float(np.hypot(*(centres[a] - centres[b]))) for a, b in ((0, 2), (0, 1), (1, 2))}
        widest = max(apart.values())
        if widest < _MIN_SEPARATION:
            raise InputError("the aperture shows every channel the same view: blur alone cannot tell near from far")
        return {pair: apart[pair] / widest for pair in sorted(apart, key=lambda p: -apart[p])}

    @cached_property
    def pairs(self) -> tuple[tuple[int, int], ...]:
        """Pairs of channels whose views are far apart, the widest first: those that tell depth best."""
        return tuple(pair for pair, apart in self.separations.items() if apart >= _WIDE)

    @cached_property
    def other_pairs(self) -> tuple[tuple[int, int], ...]:
        """Pairs that tell depth too, but worse: for surfaces of a colour that the wide pairs do not share."""
        return tuple(pair for pair, apart in self.separations.items() if _NEAR <= apart < _WIDE)

    @cached_property
    def axis(self) -> np.ndarray:
        """Direction from the second to the first view of the widest pair, in the pupil; (2,) float64 unit vector."""
        a, b = self.pairs[0]
        light = self.pupil.light
        apart = (light[a] @ self.pupil.points) / light[a].sum() - (light[b] @ self.pupil.points) / light[b].sum()
        return np.asarray(apart / np.hypot(*apart))

    def half_disparity(self, x_px: float, y_px: float) -> tuple[float, float]:
        """Half the distance of the widest pair's centroids: a - b / z.

        Returns
        -------
        a, b : float, px and px mm
        """
        field = self.field(x_px, y_px)
        rim = rims(self.model, self.pupil.points, field)
        steps = []
        for inverse_mm in (0.0, 1e-3):
            centre = []
            for k in self.pairs[0]:
                weight = self.pupil.light[k] * rim
                centre.append(weight @ displacement(self.model, self.pupil.points, field, inverse_mm, k) / weight.sum())
            steps.append(float((centre[0] - centre[1]) @ self.axis / 2))
        return steps[0], (steps[0] - steps[1]) / 1e-3

    @cached_property
    def reference(self) -> tuple[float, float]:
        """(A0, B0), px and px mm: the half disparity of the middle of the frame, which names the layers."""
        return self.half_disparity((self.width_px - 1) / 2, (self.height_px - 1) / 2)

    @property
    def reach(self) -> float:
        """Px of half disparity for a px by which defocus displaces the pupil's edge."""
        return self.reference[1] / self.model.scale_px_mm
