"""Depth of real photographs by a dual-pixel sensor against known depth: python benchmarks/dual_pixel.py --data FOLDER

FOLDER holds NAME_left.png and NAME_right.png (8-bit RGB), NAME_depth_mm.png (0 unknown), a board at two distances
(flat_DDDD_f4_left.png ...) and the lens's prescription. The camera is calibrated by the boards (``boards``), by the
prescription with the sensor's crosstalk and the focus (``prescription``, by the command line ``commands``) or with the
crosstalk alone (``uncorrected``), or by `calibrate` on a session that is traced through it (``session``). Shares are of
all pixels of known truth.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import tifffile
from dual_pixel_session import calibrated_by_session, write_lens_session

from chromaperture.calibration.flat_boards import Corrections
from chromaperture.model.camera_file import Calibration
from chromaperture.optics.pinhole import focused_at, paraxial
from chromaperture.optics.prescription import Prescription, load_lens
from chromaperture_paper.dual_pixel import (
    FOCUS_MM,
    PRESCRIPTION,
    calibrated,
    means,
    measured,
    scene_names,
    scored,
    write_session,
)

LINES = ("boards", "prescription", "commands", "uncorrected", "session")


def figures(data: Path, quality: str, *, spoil: Callable[[np.ndarray], np.ndarray] = lambda image: image) -> list:
    """Score every scene, calibrated by the boards; ``spoil`` changes the photographs."""
    return measured("boards", calibrated(data, quality).camera, quality, data, spoil=spoil)


def session_camera(lens: Prescription, draft: Calibration, found: Corrections, folder: Path) -> Calibration:
    """Trace a session into a folder that has none yet, and calibrate it."""
    sensor = draft.sensor
    size = {"width_px": sensor.width_px, "height_px": sensor.height_px, "pixel_pitch_mm": sensor.pixel_pitch_mm}
    pupil_mm = paraxial(focused_at(lens, FOCUS_MM)).sensor_to_entrance_pupil_mm
    focus_mm = found.focus_mm + pupil_mm
    if not (folder / "distances.csv").exists():
        write_lens_session(folder, lens, found.halves, focus_mm=focus_mm, size=size)
    return calibrated_by_session(folder, lens, found.halves, draft, focus_mm=focus_mm, keep_in=folder / "measured")


def by_commands(data: Path) -> list:
    """Score what `calibrate` and `depth` of the command line write."""
    with tempfile.TemporaryDirectory() as name:
        work, names = Path(name), scene_names(data)
        write_session(work, data)
        scenes = [str(data / f"{scene}_left.png") for scene in names]
        for command in (
            ["calibrate", ".", "--out", "halves.asdf"],
            ["depth", *scenes, "--camera", "halves.asdf", "--quality", "accurate", "--out", "."],
        ):  # fmt: skip
            subprocess.run([sys.executable, "-m", "chromaperture", *command, "--quiet"], cwd=work, check=True)
        pupil_mm = Calibration.load(work / "halves.asdf").depth["accurate"].sensor_to_pupil_mm
        maps = [[tifffile.imread(work / f"{scene}.{kind}.tiff") for kind in ("depth", "sigma")] for scene in names]
    return [
        scored("commands", "accurate", scene, data, depth.astype(float) - pupil_mm, sigma)
        for scene, (depth, sigma) in zip(names, maps, strict=True)
    ]


def line(name: str, data: Path, qualities: list[str], camera_out: Path | None, session: Path) -> list:
    if name == "boards":
        return [scene for quality in qualities for scene in figures(data, quality)]
    if name == "commands":
        return by_commands(data)
    known = calibrated(data, "accurate", PRESCRIPTION, corrected=name != "uncorrected")
    camera, found = known.camera, known.corrections
    print(found)
    if name == "session":
        camera = session_camera(load_lens(data / PRESCRIPTION), camera, found, session)
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
