"""What a traced lens does across its field: blur of each channel, surface of focus, vignetting."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from chromaperture.errors import InputError
from chromaperture.optics.aperture import DESIGNS, Aperture
from chromaperture.optics.paraxial import Paraxial, paraxial
from chromaperture.optics.prescription import Prescription
from chromaperture.optics.ray_table import chief_rays, lens_bundle, lens_light


@dataclass(frozen=True)
class FieldBlur:
    """Blur at image points, of object points seen there at one depth.

    Attributes
    ----------
    offset_mm : (3, P, S, 2) float64
        Where ray s meets the sensor, from the chief ray, upright picture, in R, G, B. NaN where no ray
        passes.
    light : (3, P, S) float64
        Light of the ray.
    centroid_mm : (3, P, 2) float64
        Light's mean offset.
    rms_mm : (3, P) float64
        Root mean square distance from the centroid.
    """

    offset_mm: np.ndarray
    light: np.ndarray
    centroid_mm: np.ndarray
    rms_mm: np.ndarray

    def psf(self, point: int, *, pixel_pitch_mm: float, size: int) -> np.ndarray:
        """Point-spread functions at one image point: light falling into pixels; (3, size, size)."""
        half = size * pixel_pitch_mm / 2
        edges = np.linspace(-half, half, size + 1)
        out = np.empty((3, size, size))
        for k in range(3):
            seen = self.light[k, point] > 0
            x, y = self.offset_mm[k, point][seen].T
            out[k] = np.histogram2d(y, x, bins=(edges, edges), weights=self.light[k, point][seen])[0]
            out[k] /= max(float(self.light[k, point].sum()), 1e-30)
        return out


def field_blur(
    lens: Prescription, aperture: Aperture, fields_mm: np.ndarray, *, depth_mm: float, cells: int = 40
) -> FieldBlur:
    """Trace the blur of object points at one distance.

    Rays run from each image point out to the plane of the object; by how much they miss the chief ray there
    is, scaled by the local magnification, by how much the object's rays miss the image point.

    Parameters
    ----------
    lens : Prescription
    aperture : Aperture
        In the plane of the stop, or of the filter (`with_filter_at`).
    fields_mm : (P, 2) float
        Image points from the image's centre, upright picture, mm on the sensor.
    depth_mm : float
        Distance of the object plane from the sensor.
    cells : int
        Rays across the pupil.

    Returns
    -------
    FieldBlur

    Raises
    ------
    InputError
        The plane lies behind the entrance pupil, or no light reaches an image point.
    """
    data = paraxial(lens)
    fields = np.atleast_2d(np.asarray(fields_mm, float))
    z = depth_mm - data.sensor_to_entrance_pupil_mm
    if not z > 0:
        raise InputError(f"an object at {depth_mm:g} mm lies behind the entrance pupil")
    light = lens_light(lens, aperture, fields, data=data, cells=cells)
    total = light.sum(axis=2)
    if not (total.max(axis=0) > 0).all():
        raise InputError(
            f"no light reaches some image points through lens {lens.name!r}: use points nearer the axis"
        )
    chief = chief_rays(lens, fields, data=data)
    target = chief[:, :2] + z * chief[:, 2:]
    back = _to_sensor(lens, data, fields, z)
    offset = np.empty((3, *light.shape[1:], 2))
    for k, wave in enumerate(lens.wavelengths_um):
        origin, slope = lens_bundle(lens, fields, wavelength_um=wave, data=data, cells=cells)
        missed = origin + z * slope - target[:, None]
        offset[k] = -np.einsum("pij,psj->psi", back, missed)
    weight = np.where(np.isfinite(offset).all(axis=-1), light, 0)[..., None]
    mass = np.maximum(weight.sum(axis=2), 1e-30)
    clean = np.nan_to_num(offset)
    centroid = (weight * clean).sum(axis=2) / mass
    spread = (weight * (clean - centroid[:, :, None]) ** 2).sum(axis=2) / mass
    return FieldBlur(offset, light, centroid, np.sqrt(spread.sum(axis=-1)))


def _to_sensor(lens: Prescription, data: Paraxial, fields: np.ndarray, z: float) -> np.ndarray:
    """Jacobian of the image point by the object point at distance z, along chief rays; (P, 2, 2)."""
    step = 1e-2

    def hit(points: np.ndarray) -> np.ndarray:
        rays = chief_rays(lens, points, data=data)
        return rays[:, :2] + z * rays[:, 2:]

    columns = [
        (hit(fields + d) - hit(fields - d)) / (2 * step) for d in (np.array([step, 0]), np.array([0, step]))
    ]
    return np.linalg.inv(np.stack(columns, axis=-1))


def in_focus_depth(
    lens: Prescription, aperture: Aperture, fields_mm: np.ndarray, *, channels: tuple[int, int] = (0, 2)
) -> np.ndarray:
    """Distance at which two channels show no disparity, at image points: the surface of focus a matcher sees.

    Parameters
    ----------
    lens : Prescription
    aperture : Aperture
        With parallax between the two channels.
    fields_mm : (P, 2) float
    channels : (int, int)

    Returns
    -------
    (P,) float64, mm from the sensor plane; inf or negative where the rays never meet in front of the camera

    Raises
    ------
    InputError
        The two channels see the same pupil.
    """
    data = paraxial(lens)
    fields = np.atleast_2d(np.asarray(fields_mm, float))
    light = lens_light(lens, aperture, fields, data=data, cells=40)
    means = []
    for k in channels:
        origin, slope = lens_bundle(lens, fields, wavelength_um=lens.wavelengths_um[k], data=data, cells=40)
        weight = np.where(np.isfinite(origin).all(axis=-1), light[k], 0)[..., None]
        mass = np.maximum(weight.sum(axis=1), 1e-30)
        means.append([(weight * np.nan_to_num(v)).sum(axis=1) / mass for v in (origin, slope)])
    apart, closing = means[0][0] - means[1][0], means[0][1] - means[1][1]
    if np.hypot(*apart.T).max() < 1e-3 * data.entrance_diameter_mm:
        raise InputError(
            f"{aperture.title} shifts no channel against another: it has no disparity to be in focus by"
        )
    # Both mean rays meet where apart + z closing is smallest.
    with np.errstate(divide="ignore"):
        z = -(apart * closing).sum(axis=1) / (closing**2).sum(axis=1)
    return z + data.sensor_to_entrance_pupil_mm


def vignetting(lens: Prescription, fields_mm: np.ndarray, *, aperture: Aperture | None = None) -> np.ndarray:
    """Irradiance at image points relative to the middle, per channel.

    Parameters
    ----------
    lens : Prescription
    fields_mm : (P, 2) float
    aperture : Aperture, optional
        Open pupil when absent.

    Returns
    -------
    (3, P) float64
    """
    fields = np.vstack([np.zeros((1, 2)), np.atleast_2d(np.asarray(fields_mm, float))])
    light = lens_light(lens, aperture or DESIGNS["open"], fields, cells=40).sum(axis=2)
    return light[:, 1:] / np.maximum(light[:, :1], 1e-30)
