"""Covariance of the calibrated parameters against their scatter over simulated sessions.

    python benchmarks/covariance.py [--sessions 30] [--first 0] [--width 360] [--boards 10] [--quality paper real-time]
        [--out sessions.png] [--json]

Every session is rendered with its own board distances, so that textures fall on other pixels and the curve is fitted at
other distances, and its own noise and ruler errors. Parameters are those of the middle of the frame, A, B, delta,
the in-focus distance, and depth by the whole curve at three disparities. The ratio is the stated standard deviation
over that among sessions: 1 is right, below 1 the stated one is too small.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from chromaperture.calibration.calibrate_session import calibrate_session
from chromaperture.calibration.options import CalibrationConfig
from chromaperture.depth.conversion import DepthModel, depth_to_disparity, disparity_to_depth
from chromaperture.optics.aperture import DESIGNS, made_of
from chromaperture.optics.paraxial import focused_at
from chromaperture.optics.pinhole import pupil_camera
from chromaperture.optics.prescription import load_lens
from chromaperture.optics.ray_table import lens_rays
from chromaperture.optics.simulator.session import SessionPlan, write_session
from chromaperture.system.errors import InputError

SENSOR_MM, FOCUS_MM, CELLS = 22.3, 2000.0, 8
NEAR_MM, FAR_MM, JITTER_MM = 1000.0, 4000.0, 10.0
PROBES_MM = (1200.0, 2200.0, 3600.0)


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


def draw(rows: dict[str, list[tuple[dict[str, float], dict[str, float]]]], out: Path) -> None:
    """Draw every session's values with error bars: qualities in columns, parameters in rows."""
    names = list(next(iter(rows.values()))[0][0])
    figure, axes = plt.subplots(len(names), len(rows), figsize=(6 * len(rows), 1.6 * len(names)), squeeze=False)
    for column, (quality, found) in zip(axes.T, rows.items(), strict=True):
        for axis, name in zip(column, names, strict=True):
            axis.errorbar(range(len(found)), [r[0][name] for r in found], [r[1][name] for r in found], fmt=".")
            axis.set_ylabel(name, fontsize=7)
        column[0].set_title(quality, fontsize=9)
        column[-1].set_xlabel("session")
    figure.tight_layout()
    figure.savefig(out, dpi=110)
    plt.close(figure)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sessions", type=int, default=30)
    parser.add_argument("--first", type=int, default=0, help="seed of the first session")
    parser.add_argument("--width", type=int, default=360)
    parser.add_argument("--boards", type=int, default=10)
    parser.add_argument("--quality", nargs="+", choices=("paper", "real-time"), default=("paper", "real-time"))
    parser.add_argument("--out", type=Path, help="picture of the sessions' values with their error bars")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    models: dict[str, list[DepthModel]] = {quality: [] for quality in args.quality}
    for seed in range(args.first, args.first + args.sessions):
        scratch = Path(tempfile.mkdtemp())
        try:
            render(scratch / "cy_halves", seed, args.width, args.boards)
            calibration = calibrate_session(scratch / "cy_halves", CalibrationConfig(lens_blur=False)).calibration
            for quality, found in models.items():
                found.append(calibration.on_axis(quality))
            print(f"session {seed} calibrated", file=sys.stderr, flush=True)
        except InputError as error:
            print(f"session {seed}: {error}", file=sys.stderr, flush=True)
        finally:
            shutil.rmtree(scratch)
    rows = {quality: rows_of(found) for quality, found in models.items()}
    report = {quality: ratios(found) for quality, found in rows.items()}
    if args.out:
        draw(rows, args.out)
    if args.json:
        print(json.dumps(report, indent=1))
        return
    for quality, ratio_of in report.items():
        print(f"{quality}, {len(models[quality])} sessions")
        for name, row in ratio_of.items():
            print(f"  {name:20}" + "  ".join(f"{key} {value:.4g}" for key, value in row.items()))


if __name__ == "__main__":
    main()
