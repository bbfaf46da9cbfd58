"""Calibrate a dual-pixel camera from its lens's prescription as its maker would: trace a session, and calibrate it.

Only what no board can tell is given: how the sensor's contrast falls towards its sides.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from chromaperture.calibration.calibrate_session import calibrate_session
from chromaperture.depth.field import DepthField
from chromaperture.model.camera_file import Calibration
from chromaperture.optics.aperture import DESIGNS, Aperture
from chromaperture.optics.dual_pixel_rays import HalfPixels, half_pixel_rays
from chromaperture.optics.lens_blur import BlurModel
from chromaperture.optics.pinhole import centered_pinhole, focused_at, paraxial, pupil_camera
from chromaperture.optics.prescription import Prescription
from chromaperture.optics.ray_table import RayTable, lens_rays
from chromaperture.optics.simulator.sensor import SensorModel
from chromaperture.optics.simulator.session import SessionPlan, write_session
from chromaperture_paper.dual_pixel import FOCUS_ERROR_PER_M

# Even in 1 / z, from the nearest that the lens focuses to where parallax changes by .02 px
BOARDS_MM = tuple(float(round(1 / inverse)) for inverse in np.linspace(1 / 450, 1 / 5000, 12))
TILTS = 8
# Boards hardly noisier than the photographs, whose noise is that of 8 bits
SENSOR = SensorModel(full_well_electrons=160_000.0, read_noise_electrons=20.0, black_level=256, white_level=64256,
                     bits=16)  # fmt: skip
_CELLS = 12  # rays across the pupil
_SHEETS = {"sheet_c": "cyan", "sheet_y": "yellow"}
_START_RIM = {"front_rim_radius": 1.2, "front_rim_shift": 0.2, "rear_rim_radius": 1.2, "rear_rim_shift": 0.2}


def write_lens_session(
    folder: Path, lens: Prescription, halves: HalfPixels, *, focus_mm: float, size: dict[str, Any]
) -> None:
    """Photograph a calibration session through a lens of known prescription and half pixels, ray by ray.

    ``lens``: at any focus; ``focus_mm``: from the sensor, to which the lens is focused; ``size``: ``width_px``,
    ``height_px``, ``pixel_pitch_mm``.
    """
    optics = focused_at(lens, focus_mm)
    camera = pupil_camera(optics, **size)
    open_rays = lens_rays(optics, DESIGNS["open"], **size, cells=_CELLS)
    halved = half_pixel_rays(open_rays, halves, pupil_radius_mm=camera.pupil_radius_mm)
    film = halves.film()

    def rays(aperture: Aperture) -> RayTable:
        if aperture.name == "cy_halves":
            return halved
        colour = np.array(film[_SHEETS[aperture.name]] if aperture.name in _SHEETS else np.ones(3), np.float32)
        return replace(open_rays, weight=open_rays.weight * colour[:, None, None, None])

    write_session(
        folder, aperture=DESIGNS["cy_halves"], camera=camera, rays=rays, scenes={},
        plan=SessionPlan(distances_mm=BOARDS_MM, tilts=TILTS, sensor=SENSOR),
    )  # fmt: skip


def calibrated_by_session(
    folder: Path,
    lens: Prescription,
    halves: HalfPixels,
    draft: Calibration,
    *,
    focus_mm: float,
    keep_in: Path | None = None,
) -> Calibration:
    """Calibrate a session of `write_lens_session` as the lens's maker would; distances count from the sensor plane.

    The fit of the blur starts from a thin lens at the focus of the design, with the sensor's fall of contrast.

    ``draft``: its sensor, with the photographs' noise, and its working range are kept; ``focus_mm``: from the sensor;
    ``keep_in``: of what is measured on every photograph, for a run that is interrupted.
    """
    sensor = draft.sensor
    size: dict[str, Any] = {
        "width_px": sensor.width_px, "height_px": sensor.height_px, "pixel_pitch_mm": sensor.pixel_pitch_mm,
    }  # fmt: skip
    optics = focused_at(lens, focus_mm)
    pupil = pupil_camera(optics, **size)
    scale = pupil.focal_px * pupil.pupil_radius_mm
    pupil_mm = paraxial(optics).sensor_to_entrance_pupil_mm
    from_pupil_mm = focus_mm - pupil_mm
    thin = BlurModel(
        scale / from_pupil_mm, scale, **_START_RIM, contrast_fall=sensor.width_px / 2 / halves.half_slope_px
    )
    matrix = centered_pinhole(pupil.focal_px, (sensor.width_px, sensor.height_px))
    known = replace(draft, blur=thin, lens=replace(draft.lens, camera_matrix=matrix))
    found = calibrate_session(folder, lens_from=known, keep_in=keep_in).camera
    depth = {quality: _with_focus_error(field) for quality, field in found.depth.items()}
    return replace(found, sensor=sensor, depth=depth, near_mm=draft.near_mm, far_mm=draft.far_mm)


def _with_focus_error(field: DepthField) -> DepthField:
    """Add the error of a focus that is set anew to the covariance of A."""
    covariance = field.covariance.copy()
    covariance[0, 0] += (FOCUS_ERROR_PER_M / 1000 * float(field.scale_px_mm[0])) ** 2
    return replace(field, covariance=covariance)
