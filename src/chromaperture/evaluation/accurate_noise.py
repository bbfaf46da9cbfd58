"""Noise of a pixel at quality accurate, measured on a few boards for the calibration report."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from chromaperture.calibration.calibrate_session import CalibrationResult
from chromaperture.calibration.options import Progress, reported, silent
from chromaperture.calibration.read_boards import pixel_sigma
from chromaperture.camera.camera import CodedApertureCamera
from chromaperture.camera.method import default_config
from chromaperture.depth.conversion import depth_to_disparity
from chromaperture.system.errors import InputError

# Of all boards together: 16 s at 8 s a megapixel (README), which is less than the calibration itself takes.
MOST_MEGAPIXELS = 2.0


def chosen_boards(result: CalibrationResult) -> list[int]:
    """Return the nearest, the sharpest and the farthest board; none where ``accurate`` has no curve of its own.

    Noise in px grows with the blur, so that it can be interpolated between these three.
    """
    if result.layers is None:
        return []
    used, distance = np.flatnonzero(result.evidence.used), result.evidence.from_sensor_mm
    blurred = np.abs(depth_to_disparity(distance, result.calibration.on_axis("accurate")))
    found = (used[np.argmin(distance[used])], used[np.argmin(blurred[used])], used[np.argmax(distance[used])])
    return sorted({int(i) for i in found})


def with_accurate_noise(
    result: CalibrationResult, *, most_megapixels: float = MOST_MEGAPIXELS, progress: Progress = silent
) -> CalibrationResult:
    """Measure a few boards at quality ``accurate``.

    ``most_megapixels``: larger photographs, all boards together, are left out: they would take minutes. Returns with
    ``pixel_sigma_px["accurate"]``, NaN for the other boards and those that cannot be measured; or unchanged.
    """
    calibration = result.calibration
    width, height = calibration.sensor.width_px, calibration.sensor.height_px
    boards = chosen_boards(result)
    if not boards or len(boards) * width * height > 1e6 * most_megapixels:
        return result
    # A board is a plane, but nothing explains it as one: the plate follows the evidence of a board as of any surface.
    camera = CodedApertureCamera(calibration, default_config(calibration, "accurate"))
    x, y = np.meshgrid(result.grid_x_px, result.grid_y_px)
    model = calibration.depth["accurate"].at(x, y, width, height)
    rows, columns = result.grid_y_px.astype(int), result.grid_x_px.astype(int)
    paths, sigma = list(result.session.boards), np.full(len(result.boards), np.nan)
    for i in reported(boards, "boards at quality accurate", progress):
        try:
            measured = camera.measure(result.session.read(paths[i])).disparity_px[np.ix_(rows, columns)]
        except InputError:  # as a saturated board; the calibration itself does not depend on it
            continue
        residual = measured - depth_to_disparity(float(result.evidence.from_sensor_mm[i]), model)
        sigma[i] = pixel_sigma(residual[None])[0]
    return replace(result, pixel_sigma_px={**result.pixel_sigma_px, "accurate": sigma})
