"""Methods and designs on ray-traced or real captures with known depth: needs ``--data``."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from chromaperture.calibrate import calibrate_session
from chromaperture.calibration import Calibration
from chromaperture.camera import CodedApertureCamera, default_config
from chromaperture.config import Quality
from chromaperture.errors import InputError
from chromaperture.evaluation.paper import methods
from chromaperture.evaluation.paper.context import Context
from chromaperture.evaluation.paper.exhibit import Listed, Made
from chromaperture.evaluation.tables import Table
from chromaperture.pipeline import read_capture

DESIGNS_READ = ("cy_halves", "cy_open", "rgb_squares", "cmy_circles")
SCENES = ("steps", "room", "desk")


def make(context: Context) -> Made:
    """Calibrate each design's session, measure its scenes."""
    if context.data is None:
        raise InputError("bench needs photographs: give their folder with --data")
    lens: Calibration | None = None
    rows = []
    qualities: tuple[Quality, ...] = ("real-time",) if context.quick else ("paper", "real-time", "accurate")
    for design in DESIGNS_READ:
        kept = context.work / f"calibrating-data-{design}"
        folder = context.data / design
        calibration = calibrate_session(folder, lens_from=lens, lens_blur=not context.quick, keep_in=kept).calibration
        lens = lens or calibration  # designs without tilted boards share the first one's lens
        for quality in qualities:
            camera = CodedApertureCamera(calibration, default_config(calibration, quality))
            for scene in SCENES:
                photo = folder / "scene" / f"{scene}.png"
                if not photo.is_file():
                    continue
                frame = camera.measure(read_capture(photo, camera))
                judged = methods.scores(np.asarray(frame.depth_mm, float), truth_mm(context.data, scene))
                shares = (f"{judged[key]:.1%}" for key in ("fill", "within_2", "within_5", "within_10"))
                rows.append((f"ours, {quality}", design, scene, *shares))
    head = ("method", "design", "scene", "fill", "within 2 %", "within 5 %", "within 10 %")
    table = Table("Shares of ALL pixels with known truth", head, rows)
    return Made(f"From {len(DESIGNS_READ)} sessions in --data.", (), [Listed("bench", table)],
                lines=["Prior methods run on simulated captures: see prior-art."])  # fmt: skip


def truth_mm(data: Path, scene: str) -> np.ndarray:
    """Read a scene's true depth; (H, W) float64, mm, NaN unknown."""
    stored = cv2.imread(str(data / "truth" / f"{scene}.depth_0.1mm.png"), cv2.IMREAD_UNCHANGED)
    if stored is None:
        raise InputError(f"cannot read {data / 'truth' / f'{scene}.depth_0.1mm.png'}")
    return np.where(stored > 0, stored / 10.0, np.nan)
