"""The same camera with fewer pixels: what a picture is that has been reduced by area averages.

A pixel of the reduced picture is the mean of ``s x s`` pixels. Everything in px is divided by s; pixel positions count
from the centre of the top-left pixel, so that x becomes (x + 1/2) / s - 1/2; a reduced pixel holds s^2 times as many
electrons, and its read noise is that of s^2 pixels, s times as large.
"""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np

from chromaperture.capture.picture_header import same_frame
from chromaperture.depth.field import resized_field
from chromaperture.model.camera_file import Calibration
from chromaperture.model.camera_parts import CameraSensor
from chromaperture.optics.lens_blur import BlurModel, mean_bars
from chromaperture.system.errors import InputError

MATCHED_SIZE = "matched_size_px"  # in a camera file's provenance: width and height at which its boards were matched
SAME_SCALE = 0.02  # relative difference of scales that are one: sides are rounded to whole px; chosen by hand
SCALES = (1, 2, 3, 4, 6, 8, 12, 16)  # that `auto` chooses from
# Most that `auto` lets the mean of the error bar over the working range grow, against light that no pixels divide. For
# bench50's own pixels it grows 1.05 to 1.09 times, for pixels twice as wide 1.17 to 1.35 times (four designs;
# docs/working-scale.md).
MOST_GROWTH = 1.09
LEAST_SIDE_PX = 320  # of a reduced picture: windows, planes and borders count pixels; chosen by hand
_DISTANCES = 7  # of the working range, evenly spaced in 1 / z; 15 change the growth by 0.01
# Px by which the widest blur displaces the pupil's edge, in a reduced picture: no design of bench50 allows fewer, so
# that scales below need no computation.
_LEAST_RADIUS_PX = 8.0
# The same in the picture that quality accurate matches, where it chooses between whole scales: its time and memory grow
# with the third power. Bench50's pictures of 720 x 480 px, whose pixels suffice, have 14.4, a larger camera's 12.6 px.
MOST_RADIUS_PX = 13.5
# From this factor on pixels are divided by no whole number: less would cost as much detail, and gain less.
_LEAST_FACTOR = 1.125


def reduced_size(size_px: tuple[int, int], scale: float) -> tuple[int, int]:
    """Return width and height, px, of a picture reduced to 1 / scale; sides that it does not divide are rounded."""
    width, height = (max(1, round(side / scale)) for side in size_px)
    return width, height


def at_scale(calibration: Calibration, scale: float) -> Calibration:
    """Return the camera of pictures reduced to 1 / scale by area averages; raises InputError for a scale below 1."""
    if scale < 1:
        raise InputError(f"a working scale is 1, 1/2, 1/3 ...; got 1/{scale:g}")
    sensor = calibration.sensor
    return resized(calibration, *reduced_size((sensor.width_px, sensor.height_px), scale))


def resized(calibration: Calibration, width_px: int, height_px: int) -> Calibration:
    """Return the same camera for the whole frame at another size of the same aspect, px are of the width."""
    sensor, lens = calibration.sensor, calibration.lens
    before, after = (sensor.width_px, sensor.height_px), (int(width_px), int(height_px))
    if before == after:
        return calibration
    if not same_frame(before, after):
        raise InputError(
            f"a camera of {before[0]}x{before[1]} px does not show the same frame at {after[0]}x{after[1]} px"
        )
    across, down = (b / a for b, a in zip(before, after, strict=True))
    return replace(
        calibration,
        sensor=resized_sensor(sensor, *after),
        lens=replace(lens, camera_matrix=_camera_matrix(lens.camera_matrix, across, down)),
        depth={quality: resized_field(field, before, after) for quality, field in calibration.depth.items()},
        blur=None if calibration.blur is None else resized_blur(calibration.blur, across),
        channel_moves_px=None if calibration.channel_moves_px is None else calibration.channel_moves_px / across,
    )


def resized_sensor(sensor: CameraSensor, width_px: int, height_px: int) -> CameraSensor:
    """Return a sensor in other pixels, as `resized` does."""
    across = sensor.width_px / width_px
    binned = across * sensor.height_px / height_px  # pixels in a pixel
    full_well, read_noise = sensor.full_well_electrons, sensor.read_noise_electrons
    return replace(
        sensor,
        width_px=width_px,
        height_px=height_px,
        pixel_pitch_mm=sensor.pixel_pitch_mm * across,
        full_well_electrons=None if full_well is None else full_well * binned,
        read_noise_electrons=None if read_noise is None else read_noise * binned**0.5,
    )


def resized_blur(blur: BlurModel, factor: float) -> BlurModel:
    """Return a blur in pixels that are ``factor`` times as wide; pupil radii and frame positions have no px."""
    lengths = [f.name for f in fields(BlurModel) if f.name.endswith(("_px", "_px_mm"))]
    return replace(blur, **{name: getattr(blur, name) / factor for name in lengths})


def _camera_matrix(matrix: np.ndarray, across: float, down: float) -> np.ndarray:
    """Return the pinhole of pixels that are so many times as wide and high."""
    found = np.array(matrix, float)
    found[0, :2] /= across
    found[1, :2] /= down
    found[0, 2] = (matrix[0, 2] + 0.5) / across - 0.5
    found[1, 2] = (matrix[1, 2] + 0.5) / down - 0.5
    return found


def working_scale(calibration: Calibration) -> int:
    """Return the scale at which the boards were matched, else the coarsest of `SCALES` that blur allows."""
    matched = calibration.provenance.get(MATCHED_SIZE)
    if isinstance(matched, list | tuple) and len(matched) == 2 and isinstance(matched[0], int) and matched[0] > 0:
        scale = calibration.sensor.width_px / matched[0]
        if round(scale) >= 1 and abs(scale / round(scale) - 1) < SAME_SCALE:
            return round(scale)
    blur, sensor = calibration.field_blur(), calibration.sensor
    if blur is None or not calibration.is_calibrated:
        return 1
    inverse_mm = _inverse_distances(calibration)
    widest = _widest_px(blur.model, inverse_mm)
    side = min(sensor.width_px, sensor.height_px)
    possible = [s for s in SCALES if s * _LEAST_RADIUS_PX <= widest and side >= s * LEAST_SIDE_PX]
    if not possible[1:]:
        return 1
    undivided, *bars = mean_bars(blur, inverse_mm, [0, *possible])
    return max(s for s, bar in zip(possible, bars, strict=True) if s == 1 or bar <= MOST_GROWTH * undivided)


def accurate_scale(calibration: Calibration) -> float:
    """Return the scale of quality accurate: `working_scale`, or more where blur is wider than it needs."""
    scale, blur, sensor = working_scale(calibration), calibration.field_blur(), calibration.sensor
    if blur is None or not calibration.is_calibrated:
        return scale
    needed = _widest_px(blur.model, _inverse_distances(calibration)) / MOST_RADIUS_PX
    needed = min(needed, min(sensor.width_px, sensor.height_px) / LEAST_SIDE_PX)
    return needed if needed >= _LEAST_FACTOR * scale else scale


def _inverse_distances(calibration: Calibration) -> np.ndarray:
    """Return distances of the working range, from the entrance pupil, evenly spaced in 1 / z; 1/mm."""
    pupil_mm = float(calibration.on_axis("accurate").sensor_to_pupil_mm)
    nearest, farthest = 1 / (calibration.near_mm - pupil_mm), 1 / (calibration.far_mm - pupil_mm)
    return np.linspace(nearest, farthest, _DISTANCES)


def _widest_px(model: BlurModel, inverse_mm: np.ndarray) -> float:
    """Return the largest displacement of the pupil's edge."""
    return float(np.abs(model.infinity_px - model.scale_px_mm * inverse_mm).max())
