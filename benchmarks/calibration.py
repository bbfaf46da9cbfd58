"""Score a calibration by its boards, each measured by a camera calibrated without it.

    python benchmarks/calibration.py --data FOLDER [--designs ...] [--quality paper real-time accurate] [--json]

FOLDER holds a session folder for each design, white/, and, where the lens is known, truth/lens.json. Fractions are of
all pixels of the frame; a bias is the median over the frame of measured minus true distance. "True" is ruler and pose
together; the bias against the ruler alone is printed beside it (a ruler error of 3 mm is 0.3 % at 1 m).
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np

from chromaperture.calibration.calibrate_session import CalibrationResult, calibrate_session, leave_one_out
from chromaperture.camera.camera import CodedApertureCamera
from chromaperture.camera.method import default_config
from chromaperture.depth.conversion import disparity_to_depth
from chromaperture.depth.field import DepthField
from chromaperture.model.camera_file import Calibration
from chromaperture.settings.methods import Quality

FLAT_MM = 2500.0  # board whose flatness is measured: beyond the focus, inside the range


def leave_one_out_table(result: CalibrationResult, quality: Quality, *, only: int | None = None) -> list[dict]:
    """Bias and fractions within 1 and 2 % of every board, whole frame, by a camera calibrated without it."""
    session, rows = result.session, []
    distances = result.evidence.from_sensor_mm
    for i, path in enumerate(session.boards):
        if only is not None and i % only:
            continue
        calibration = leave_one_out(result, i, [quality])
        camera = CodedApertureCamera(calibration, default_config(calibration, quality))
        depth = camera.measure(session.read(path)).depth_mm.astype(float)
        error = (depth - distances[i]) / distances[i]
        ruler = session.boards[path]
        rows.append(
            {
                "board": path.name,
                "ruler_mm": ruler,
                "bias_percent": 100 * float(np.nanmedian(error)),
                "bias_against_ruler_percent": 100 * float(np.nanmedian((depth - ruler) / ruler)),
                "within_1_percent": float((np.abs(error) < 0.01).mean()),
                "within_2_percent": float((np.abs(error) < 0.02).mean()),
                "fill": float(np.isfinite(depth).mean()),
            }
        )
    return rows


def flatness(result: CalibrationResult, quality: Quality) -> dict[str, float]:
    """RMS about a plane of the board nearest to 2.5 m, with fields over the frame and with one curve for all of it.

    Depth of both is smoothed by a median of 25 px, so that the lens is compared and not the noise of single pixels.
    """
    session = result.session
    rulers = np.array([*session.boards.values()])
    board = int(np.argmin(np.abs(rulers - FLAT_MM)))
    path = list(session.boards)[board]
    calibration = leave_one_out(result, board, [quality])
    axis = calibration.on_axis(quality)
    camera = CodedApertureCamera(calibration, default_config(calibration, quality))
    frame = camera.measure(session.read(path))
    model = DepthField.constant(axis).model(calibration.sensor.width_px, calibration.sensor.height_px)
    flat, _ = disparity_to_depth(frame.disparity_px, model)

    def rms(depth: np.ndarray) -> float:
        depth = cv2.blur(np.nan_to_num(depth, nan=float(np.nanmedian(depth))).astype(np.float32), (25, 25))
        y, x = np.mgrid[: depth.shape[0], : depth.shape[1]]
        rows = np.stack([x.ravel(), y.ravel(), np.ones(depth.size)], 1)[::7]
        values = depth.ravel()[::7].astype(float)
        good = np.abs(values - np.median(values)) < 0.3 * np.median(values)
        solution = np.linalg.lstsq(rows[good], values[good], rcond=None)[0]
        return float(np.sqrt(np.mean((values[good] - rows[good] @ solution) ** 2)))

    corrected, uncorrected = rms(frame.depth_mm), rms(flat)
    return {"corrected_mm": corrected, "uncorrected_mm": uncorrected, "ratio": corrected / uncorrected}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--designs", nargs="+", default=["cy_halves"])
    parser.add_argument("--quality", nargs="+", default=["paper", "real-time"])
    parser.add_argument("--only", type=int, help="every n-th board only")
    parser.add_argument("--keep", type=Path, help="folder for what is measured in each photograph, for the next run")
    parser.add_argument("--lens-from", type=Path, help="camera file of the lens, for designs without tilted boards")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    lens = Calibration.load(args.lens_from) if args.lens_from else None
    table = []
    with tempfile.TemporaryDirectory() as scratch:
        for design in args.designs:
            start = time.perf_counter()
            result = calibrate_session(args.data / design, lens_from=lens, keep_in=args.keep or scratch)
            lens = lens or result.calibration
            figures = {"design": design, "seconds": time.perf_counter() - start, **geometry(result, args.data)}
            if not args.json:
                print(" ".join(f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v}" for k, v in figures.items()))
            for note in result.notes:
                print(f"note: {note}")
            for quality in args.quality:
                rows = leave_one_out_table(result, quality, only=args.only)
                summary = {
                    "quality": quality,
                    "worst_bias_percent": max(abs(r["bias_percent"]) for r in rows),
                    "worst_bias_against_ruler_percent": max(abs(r["bias_against_ruler_percent"]) for r in rows),
                    "least_within_2_percent": min(r["within_2_percent"] for r in rows),
                    "boards": rows,
                    "flat": flatness(result, quality),
                }
                table.append(figures | summary)
                if not args.json:
                    for row in rows:
                        print("  " + " ".join(f"{k} {v:.3f}" if isinstance(v, float) else v for k, v in row.items()))
                    print({k: v for k, v in summary.items() if k != "boards"}, flush=True)
    if args.json:
        print(json.dumps(table, indent=1))


def geometry(result: CalibrationResult, data: Path) -> dict[str, float]:
    """Fitted lens, and its errors where the truth is known."""
    found = result.calibration.summary()
    figures = {name: float(found[name]) for name in ("focal_length_mm", "sensor_to_pupil_mm", "in_focus_mm")}
    figures["sensor_to_pupil_sigma_mm"] = result.evidence.distances.sigma_mm
    truth = data / "truth" / "lens.json"
    if truth.is_file():
        lens = json.loads(truth.read_text())
        f, delta = lens["effective_focal_length_mm"], lens["sensor_to_entrance_pupil_mm"]
        figures["focal_length_error_percent"] = 100 * (figures["focal_length_mm"] / f - 1)
        figures["sensor_to_pupil_error_mm"] = figures["sensor_to_pupil_mm"] - delta
    return figures


if __name__ == "__main__":
    main()
