"""The camera that a session's steps amount to."""

from __future__ import annotations

import datetime
import hashlib
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

import cv2
import numba
import numpy as np

from chromaperture.calibration.chessboard import Intrinsics
from chromaperture.calibration.options import CalibrationConfig
from chromaperture.calibration.session import Session, nominal_depth_model
from chromaperture.calibration.white_sheets import WhiteSheets
from chromaperture.capture.dual_pixel import files_of
from chromaperture.capture.exif import read_model
from chromaperture.capture.picture_format import described
from chromaperture.capture.shots import is_photograph
from chromaperture.depth.conversion import model_to_paper
from chromaperture.depth.field import DepthField
from chromaperture.model.camera_file import Calibration
from chromaperture.model.camera_parts import Board, Lens
from chromaperture.optics.lens_blur import BlurModel
from chromaperture.optics.pinhole import centered_pinhole
from chromaperture.settings.methods import Quality


def assemble_camera(
    session: Session,
    sheets: WhiteSheets,
    intrinsics: Intrinsics | None,
    depth: Mapping[Quality, DepthField],
    config: CalibrationConfig,
    *,
    blur: BlurModel | None = None,
    channel_moves_px: np.ndarray | None = None,
    rulers_mm: Sequence[float] = (),
) -> Calibration:
    """Put the results of the steps together; without intrinsics the pinhole is the nominal one.

    ``rulers_mm``: of the boards that were used, for the working range; all that the session states when absent.
    """
    sensor = sheets.sensor
    if intrinsics is None:
        focal_px = float(nominal_depth_model(session).sensor_to_pupil_mm) / sensor.pixel_pitch_mm
        intrinsics = Intrinsics(centered_pinhole(focal_px, (sensor.width_px, sensor.height_px)), np.zeros(5), 0.0)
    on_axis = model_to_paper(
        depth["real-time"].on_axis(sensor.width_px, sensor.height_px),
        image_distance_mm=float(intrinsics.camera_matrix[0, 0]) * sensor.pixel_pitch_mm,
        pixel_pitch_mm=sensor.pixel_pitch_mm,
    )
    rulers = list(rulers_mm) or list(session.boards.values()) or [session.focused_at_about_mm]
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
        provenance={},
        blur=blur,
        channel_moves_px=channel_moves_px,
        board=Board(session.inner_corners, session.square_mm) if session.square_mm else None,
    )


def origin(
    session: Session,
    sheets: WhiteSheets,
    config: CalibrationConfig,
    *,
    command: str | None,
    lens_from: Calibration | None,
) -> dict[str, Any]:
    """Record what a calibration was made from: the command line, if any, versions, options, and SHA-256 of all files.

    ``camera_model`` is absent where no photograph names it, ``developed`` where nothing tells.
    """
    made: dict[str, Any] = described(session.form) | ({} if command is None else {"command": command})
    lens = None
    if lens_from is not None:
        lens = {"design": lens_from.design, "date": lens_from.provenance.get("date"),
                "focal_length_mm": lens_from.lens.focal_length_mm}  # fmt: skip
    texts = (session.folder / name for name in ("session.toml", "distances.csv"))
    photographs = [*session.boards, *session.tilts, *sheets.files]
    if session.sensor.dual_pixel is not None:
        photographs = [file for path in photographs for file in files_of(path)]
    files = (*texts, *photographs)
    model = next(filter(None, map(read_model, filter(is_photograph, files))), None)
    if model is not None:
        made["camera_model"] = model
    if sheets.developed is not None:
        made["developed"] = sheets.developed
    return made | {
        "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
        "versions": {
            "chromaperture": version("chromaperture"),
            "numpy": np.__version__,
            "numba": numba.__version__,
            "opencv": cv2.__version__,
        },
        "options": asdict(config),
        "lens_from": lens,
        "files": {
            Path(os.path.relpath(path, session.folder)).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
            for path in files
        },
    }
