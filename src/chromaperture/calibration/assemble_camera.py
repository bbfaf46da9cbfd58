"""The camera that a session's steps amount to."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from chromaperture.calibration.calibration_config import CalibrationConfig
from chromaperture.calibration.chessboard import Intrinsics
from chromaperture.calibration.session import Session
from chromaperture.calibration.white_sheets import WhiteSheets
from chromaperture.color.unmixing import mixes_three_views, view_reach
from chromaperture.depth.conversion import DepthModel, PaperParameters, model_to_paper, paper_to_model
from chromaperture.depth.field import DepthField
from chromaperture.model.camera_file import Calibration
from chromaperture.model.camera_parts import Board, Lens
from chromaperture.optics.aperture import design_named
from chromaperture.optics.lens_blur import BlurModel
from chromaperture.optics.pinhole import centered_pinhole
from chromaperture.settings.methods import Quality
from chromaperture.system.errors import InputError


def curve_without_blur(design: str) -> Quality:
    """Return the quality whose depth curve serves ``accurate`` without a lens blur: that which matches the same views.

    A curve fitted to boards read by ``accurate`` itself was no different.
    """
    return "real-time" if mixes_three_views(design_named(design)) else "paper"


def nominal_depth_model(session: Session) -> DepthModel:
    """Return the thin-lens curve of the engraved focal length and f-number, for search ranges and start values."""
    f = session.nominal_focal_length_mm
    z_focus = session.focused_at_about_mm - f  # from the pupil, about
    if z_focus <= f:
        raise InputError(f"focused_at_about_mm = {session.focused_at_about_mm:g} lies inside the focal length")
    image_distance = f / (1 - f / z_focus)  # f for a lens focused at infinity
    parameters = PaperParameters(
        in_focus_mm=z_focus + image_distance,
        baseline_mm=view_reach(design_named(session.design)) * f / session.nominal_f_number,  # b = 2 r_c
        sensor_to_pupil_mm=image_distance,
        focal_length_mm=f,
    )
    return paper_to_model(parameters, pixel_pitch_mm=session.sensor.pixel_pitch_mm)


def assemble_camera(
    session: Session,
    sheets: WhiteSheets,
    intrinsics: Intrinsics | None,
    depth: Mapping[Quality, DepthField],
    config: CalibrationConfig,
    *,
    blur: BlurModel | None = None,
    channel_moves_px: np.ndarray | None = None,
    provenance: Mapping[str, Any] | None = None,
) -> Calibration:
    """Put the results of the steps together; without intrinsics the pinhole is the nominal one."""
    sensor = sheets.sensor
    if intrinsics is None:
        focal_px = float(nominal_depth_model(session).sensor_to_pupil_mm) / sensor.pixel_pitch_mm
        intrinsics = Intrinsics(centered_pinhole(focal_px, (sensor.width_px, sensor.height_px)), np.zeros(5), 0.0)
    on_axis = model_to_paper(
        depth["real-time"].on_axis(sensor.width_px, sensor.height_px),
        image_distance_mm=float(intrinsics.camera_matrix[0, 0]) * sensor.pixel_pitch_mm,
        pixel_pitch_mm=sensor.pixel_pitch_mm,
    )
    rulers = list(session.boards.values()) or [session.focused_at_about_mm]
    return Calibration(
        design=session.design,
        sensor=sensor,
        lens=Lens(
            focal_length_mm=float(on_axis.focal_length_mm),
            camera_matrix=intrinsics.camera_matrix,
            distortion=intrinsics.distortion,
            f_number=session.nominal_f_number,
        ),
        film=sheets.film,
        depth=depth,
        near_mm=min(rulers) * config.range_margin[0],
        far_mm=max(rulers) * config.range_margin[1],
        provenance=provenance or {},
        blur=blur,
        channel_moves_px=channel_moves_px,
        board=Board(session.inner_corners, session.square_mm),
    )
