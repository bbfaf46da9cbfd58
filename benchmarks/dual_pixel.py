"""Depth of real photographs by a dual-pixel sensor against known depth: python benchmarks/dual_pixel.py --data FOLDER

FOLDER holds NAME_left.png and NAME_right.png (8-bit RGB), NAME_depth_mm.png (0 unknown), a board at two distances
(flat_DDDD_f4_left.png ...) and the lens's prescription. The camera is calibrated by the boards (``boards``), by the
prescription with the sensor's crosstalk and the focus (``prescription``) or with the crosstalk alone (``uncorrected``),
or by `calibrate` on a session that is traced through it (``session``). Shares are of all pixels of known truth.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
from dual_pixel_session import calibrated_by_session, write_lens_session

from chromaperture.model.camera_file import Calibration
from chromaperture.optics.pinhole import focused_at, paraxial
from chromaperture.optics.prescription import Prescription
from chromaperture_paper.dual_pixel import BOARDS_MM, correction_sentence, means, measured
from chromaperture_paper.dual_pixel_camera import (
    FOCUS_MM,
    Corrections,
    calibrated_by_boards,
    calibrated_by_prescription,
    capture,
    lens_of_json,
)

LINES = ("boards", "prescription", "uncorrected", "session")


def board_images(data: Path) -> dict[float, np.ndarray]:
    return {mm: capture(data, f"flat_{mm:04.0f}_f4") for mm in BOARDS_MM}


def figures(data: Path, quality: str, *, spoil: Callable[[np.ndarray], np.ndarray] = lambda image: image) -> list:
    """Score every scene, calibrated by the boards; ``spoil`` changes the photographs."""
    boards = {mm: spoil(image) for mm, image in board_images(data).items()}
    return measured("boards", calibrated_by_boards(boards, quality), quality, data, spoil=spoil)


def session_camera(lens: Prescription, draft: Calibration, found: Corrections, folder: Path) -> Calibration:
    """Trace a session into a folder that has none yet, and calibrate it."""
    sensor = draft.sensor
    size = {"width_px": sensor.width_px, "height_px": sensor.height_px, "pixel_pitch_mm": sensor.pixel_pitch_mm}
    pupil_mm = paraxial(focused_at(lens, FOCUS_MM)).sensor_to_entrance_pupil_mm
    focus_mm = found.focus_mm + pupil_mm
    if not (folder / "distances.csv").exists():
        write_lens_session(folder, lens, found.halves, focus_mm=focus_mm, size=size)
    return calibrated_by_session(folder, lens, found.halves, draft, focus_mm=focus_mm, keep_in=folder / "measured")


def line(name: str, data: Path, qualities: list[str], camera_out: Path | None, session: Path) -> list:
    if name == "boards":
        return [scene for quality in qualities for scene in figures(data, quality)]
    lens = lens_of_json(data / "rf50mm_prescription.json")
    camera, found = calibrated_by_prescription(lens, board_images(data), corrected=name != "uncorrected")
    print(correction_sentence(found))
    if name == "session":
        camera = session_camera(lens, camera, found, session)
    if camera_out:
        camera.save(camera_out)
    return measured(name, camera, "accurate", data)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--line", nargs="+", choices=LINES, default=["boards", "prescription"])
    parser.add_argument("--quality", nargs="+", default=["paper", "real-time", "accurate"], help="of the line boards")
    parser.add_argument("--camera-out", type=Path, help="camera file of the line prescription to write")
    parser.add_argument("--session", type=Path, default=Path("traced_session"), help="folder of the line session")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    scenes = [
        scene for name in args.line for scene in line(name, args.data, args.quality, args.camera_out, args.session)
    ]
    if args.json:
        rows = [{"line": s.line, "quality": s.quality, "scene": s.name, **s.scores} for s in scenes]
        found = [{"line": a, "quality": q, "scenes": kind, **v} for (a, q, kind), v in means(scenes).items()]
        print(json.dumps({"rows": rows, "means": found}, indent=1))
        return
    for scene in scenes:
        print(scene.line, scene.quality, scene.name, " ".join(f"{k} {v:.3f}" for k, v in scene.scores.items()))
    for key, values in means(scenes).items():
        print("mean", *key, " ".join(f"{k} {v:.3f}" for k, v in values.items()))


if __name__ == "__main__":
    main()
