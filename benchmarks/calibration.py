"""Calibration against truth: python benchmarks/calibration.py boards --data FOLDER

``boards``: every board of a session (FOLDER/DESIGN), measured by a camera that is calibrated without it, and the lens
against FOLDER/truth/lens.json. ``covariance``: stated standard deviations of the parameters over their scatter among
simulated sessions (1 is right). ``chessboards``: our intrinsics of OpenCV's left*.jpg against the published ones.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from chromaperture.calibration.calibrate_session import CalibrationResult, calibrate_session, leave_one_out
from chromaperture.calibration.chessboard import find_corners, fit_intrinsics
from chromaperture.calibration.options import CalibrationConfig
from chromaperture.camera.camera import CodedApertureCamera
from chromaperture.camera.method import default_config
from chromaperture.depth.conversion import DepthModel, depth_to_disparity, disparity_to_depth
from chromaperture.depth.field import DepthField
from chromaperture.model.camera_file import Calibration
from chromaperture.optics.aperture import DESIGNS, made_of
from chromaperture.optics.pinhole import focused_at, pupil_camera
from chromaperture.optics.prescription import load_lens
from chromaperture.optics.ray_table import lens_rays
from chromaperture.optics.simulator.session import SessionPlan, write_session
from chromaperture.settings.methods import Quality
from chromaperture.system.errors import InputError

FLAT_MM = 2500.0  # board whose flatness is measured: beyond the focus, inside the range
SENSOR_MM, FOCUS_MM, CELLS = 22.3, 2000.0, 8
NEAR_MM, FAR_MM, JITTER_MM = 1000.0, 4000.0, 10.0
PROBES_MM = (1200.0, 2200.0, 3600.0)
# By OpenCV, with all distortions free and corners of another detector.
PUBLISHED = {"focal_px": 535.916, "center_x_px": 342.283, "center_y_px": 235.571, "rms_px": 0.3926}
INNER_CORNERS, GAMMA = (9, 6), 2.2


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


def boards(args: argparse.Namespace) -> None:
    lens = Calibration.load(args.lens_from) if args.lens_from else None
    with tempfile.TemporaryDirectory() as scratch:
        for design in args.designs:
            start = time.perf_counter()
            result = calibrate_session(args.data / design, lens_from=lens, keep_in=args.keep or scratch)
            lens = lens or result.calibration
            figures = {"design": design, "seconds": time.perf_counter() - start, **geometry(result, args.data)}
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
                    "flat": flatness(result, quality),
                }
                for row in rows:
                    print("  " + " ".join(f"{k} {v:.3f}" if isinstance(v, float) else v for k, v in row.items()))
                print(summary, flush=True)


def render(folder: Path, seed: int, width: int, boards: int) -> None:
    height, pitch = width * 2 // 3, SENSOR_MM / width
    lens = focused_at(load_lens("double_gauss_50"), FOCUS_MM)
    camera = pupil_camera(lens, width_px=width, height_px=height, pixel_pitch_mm=pitch)

    def rays(coded):
        return lens_rays(lens, coded, width_px=width, height_px=height, pixel_pitch_mm=pitch, cells=CELLS)

    # Distances are random within equal intervals of 1 / z, so that misfits of the curve differ between sessions. The
    # nearest and the farthest are fixed: A and B depend on the range.
    rng = np.random.default_rng(seed)
    fraction = np.r_[0, (np.arange(boards - 2) + rng.random(boards - 2)) / (boards - 2), 1]
    stand = 1 / (1 / NEAR_MM + fraction * (1 / FAR_MM - 1 / NEAR_MM)) + rng.uniform(-JITTER_MM, JITTER_MM, boards)
    plan = replace(SessionPlan(), distances_mm=tuple(np.round(stand)), tilts=8, seed=seed)
    write_session(
        folder, aperture=made_of(DESIGNS["cy_halves"], "real"), camera=camera, rays=rays, scenes={}, plan=plan,
        report=lambda name: None,
    )  # fmt: skip


def parameters(model: DepthModel, true: DepthModel | None) -> tuple[dict[str, float], dict[str, float]]:
    """Values and stated standard deviations; depths are taken at the disparities that ``true`` has at the probes."""
    a, b, delta = (float(v) for v in (model.infinity_disparity_px, model.scale_px_mm, model.sensor_to_pupil_mm))
    covariance = np.asarray(model.covariance, float)
    found = {"A_px": a, "B_px_mm": b, "delta_mm": delta, "in_focus_mm": b / a + delta}
    slopes = {"A_px": (1, 0, 0), "B_px_mm": (0, 1, 0), "delta_mm": (0, 0, 1), "in_focus_mm": (-b / a**2, 1 / a, 1)}
    stated = {name: float(np.sqrt(np.array(s) @ covariance @ np.array(s))) for name, s in slopes.items()}
    for probe in PROBES_MM:
        d = np.array([depth_to_disparity(probe, true or model)])
        depth, sigma = disparity_to_depth(d, model, sigma_px=np.zeros(1))
        found[f"depth_at_{probe:.0f}_mm"] = float(depth[0])
        stated[f"depth_at_{probe:.0f}_mm"] = float(sigma[0])
    return found, stated


def rows_of(models: list[DepthModel]) -> list[tuple[dict[str, float], dict[str, float]]]:
    """Parameters of every session; depths are those at the disparities that the median curve has at the probes."""
    names = ("infinity_disparity_px", "scale_px_mm", "sensor_to_pupil_mm")
    middle = replace(models[0], **{name: float(np.median([getattr(m, name) for m in models])) for name in names})
    return [parameters(model, middle) for model in models]


def ratios(rows: list[tuple[dict[str, float], dict[str, float]]]) -> dict[str, dict[str, float]]:
    """Median, scatter, stated standard deviation and their ratio, of every parameter."""
    report = {}
    for name in rows[0][0]:
        values, sigmas = np.array([r[0][name] for r in rows]), np.array([r[1][name] for r in rows])
        scatter, stated = float(values.std(ddof=1)), float(np.sqrt(np.mean(sigmas**2)))
        median = float(np.median(values))
        report[name] = {"median": median, "scatter": scatter, "stated": stated, "ratio": stated / scatter}
    return report


def covariance(args: argparse.Namespace) -> None:
    models: dict[str, list[DepthModel]] = {quality: [] for quality in args.quality}
    for seed in range(args.first, args.first + args.sessions):
        with tempfile.TemporaryDirectory() as scratch:
            session = Path(scratch) / "cy_halves"
            try:
                render(session, seed, args.width, args.boards)
                calibration = calibrate_session(session, CalibrationConfig(lens_blur=False)).calibration
            except InputError as error:
                print(f"session {seed}: {error}", file=sys.stderr, flush=True)
                continue
        for quality, found in models.items():
            found.append(calibration.on_axis(quality))
    for quality, found in models.items():
        print(f"{quality}, {len(found)} sessions")
        for name, row in ratios(rows_of(found)).items():
            print(f"  {name:20}" + "  ".join(f"{key} {value:.4g}" for key, value in row.items()))


def chessboards(args: argparse.Namespace) -> None:
    pictures = [cv2.imread(str(p), cv2.IMREAD_GRAYSCALE) for p in sorted(args.data.glob("*.jpg"))]
    corners = [find_corners((picture / 255.0) ** GAMMA, INNER_CORNERS) for picture in pictures]
    height, width = pictures[0].shape
    found = fit_intrinsics([c for c in corners if c is not None], (width, height), INNER_CORNERS, square_mm=1.0)
    ours = {
        "focal_px": found.camera_matrix[0, 0],
        "center_x_px": found.camera_matrix[0, 2],
        "center_y_px": found.camera_matrix[1, 2],
        "rms_px": found.rms_px,
    }
    rows = {name: {"ours": round(float(ours[name]), 3), "published": PUBLISHED[name]} for name in ours}
    print(json.dumps({"boards": sum(c is not None for c in corners), **rows}, indent=1))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True)
    one = commands.add_parser("boards")
    one.add_argument("--data", type=Path, required=True)
    one.add_argument("--designs", nargs="+", default=["cy_halves"])
    one.add_argument("--quality", nargs="+", default=["paper", "real-time"])
    one.add_argument("--only", type=int, help="every n-th board only")
    one.add_argument("--keep", type=Path, help="folder for what is measured in each photograph, for the next run")
    one.add_argument("--lens-from", type=Path, help="camera file of the lens, for designs without tilted boards")
    one.set_defaults(run=boards)
    one = commands.add_parser("covariance")
    one.add_argument("--sessions", type=int, default=30)
    one.add_argument("--first", type=int, default=0, help="seed of the first session")
    one.add_argument("--width", type=int, default=360)
    one.add_argument("--boards", type=int, default=10)
    one.add_argument("--quality", nargs="+", choices=("paper", "real-time"), default=("paper", "real-time"))
    one.set_defaults(run=covariance)
    one = commands.add_parser("chessboards")
    one.add_argument("--data", type=Path, required=True)
    one.set_defaults(run=chessboards)
    args = parser.parse_args()
    args.run(args)


if __name__ == "__main__":
    main()
