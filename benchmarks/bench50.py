"""Score depth of ray-traced captures with known truth: python benchmarks/bench50.py --data FOLDER [--cameras FOLDER]

FOLDER holds a session folder for each design with scene/*.png, white/, and truth/SCENE.depth_0.1mm.png. Shares are of
all pixels with known truth; --order and --edges add what the error bars and the depth edges are worth.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from chromaperture.calibration.calibrate_session import calibrate_session
from chromaperture.camera.camera import CodedApertureCamera
from chromaperture.camera.method import default_config
from chromaperture.model.camera_file import Calibration

WRONG = 0.02  # of the depth: an error that the order of the error bars should tell
EDGE = 0.05  # step of the distance between neighbours, and error beside it that counts as wrong
MAX_BAND_PX = 40  # on either side of an edge


def truth_mm(data: Path, scene: str) -> np.ndarray:
    """True distance from the sensor; (H, W), mm, NaN unknown."""
    stored = cv2.imread(str(data / "truth" / f"{scene}.depth_0.1mm.png"), cv2.IMREAD_UNCHANGED)
    return np.where(stored > 0, stored / 10.0, np.nan)


def score(depth: np.ndarray, sigma: np.ndarray, truth: np.ndarray) -> dict[str, float]:
    """Shares of all known pixels within a relative error, and of the answered ones within one and two error bars."""
    known = np.isfinite(truth)
    answered = known & np.isfinite(depth)
    error = np.where(answered, np.abs(depth - truth) / truth, np.inf)[known]
    z = np.abs(depth - truth)[answered] / sigma[answered]
    trusted = np.argsort(sigma[answered])[: answered.sum() // 2]
    return {
        "fill": float(answered.sum() / known.sum()),
        **{f"within_{p}_percent": float((error < p / 100).mean()) for p in (1, 2, 5, 10)},
        "within_1_sigma": float((z < 1).mean()),
        "within_2_sigma": float((z < 2).mean()),
        "most_trusted_half_within_2_percent": float(((np.abs(depth - truth) / truth)[answered][trusted] < 0.02).mean()),
    }


def order(depth: np.ndarray, sigma: np.ndarray, truth: np.ndarray) -> dict[str, float]:
    """Area between the risk-coverage curves of sigma / depth and of the true error, and errors in bars by tenth.

    The risk at a coverage is the share of errors above `WRONG` among the pixels that are trusted most; an unknown depth
    comes last and is wrong. An area of 0 is a perfect order.
    """
    known = np.isfinite(truth)
    answered = known & np.isfinite(depth) & np.isfinite(sigma)
    error = np.where(answered, np.abs(depth - truth) / truth, np.inf)[known]
    trust = np.where(answered, sigma / depth, np.inf)[known]
    count = np.arange(1, len(error) + 1)
    by_bar, by_error = (np.cumsum(e > WRONG) / count for e in (error[np.argsort(trust, kind="stable")], np.sort(error)))
    z = (np.abs(depth - truth) / sigma)[answered][np.argsort((sigma / depth)[answered], kind="stable")]
    parts = list(enumerate(np.array_split(z, 10), start=1))
    found = {"risk_area": float(by_bar.mean()), "risk_excess": float((by_bar - by_error).mean())}
    return found | {f"tenth_{i}_within_{n}_sigma": float((part < n).mean()) for i, part in parts for n in (1, 2)}


def bands(wrong: np.ndarray, truth: np.ndarray) -> Iterator[int]:
    """Width of the wrong band beside every depth edge along the rows, both sides together; px."""
    edges = np.abs(np.diff(np.log(truth), axis=1)) > np.log1p(EDGE)
    for y in np.flatnonzero(edges.any(axis=1)):
        places = np.flatnonzero(edges[y])
        limits = np.concatenate([[-1], places, [edges.shape[1]]])
        for i, place in enumerate(places, start=1):
            before = wrong[y, max(limits[i - 1] + 1, place - MAX_BAND_PX + 1) : place + 1][::-1]
            behind = wrong[y, place + 1 : min(limits[i + 1], place + MAX_BAND_PX) + 1]
            yield sum(int(np.argmin(np.append(side, False))) for side in (before, behind))


def edges(depth: np.ndarray, truth: np.ndarray) -> dict[str, float]:
    """Median and mean of the wrong bands beside depth edges, along rows and columns; px."""
    wrong = np.where(np.isfinite(depth), np.abs(depth - truth) / truth, np.inf) > EDGE
    widths = [*bands(wrong, truth), *bands(wrong.T, truth.T)]
    return {"edge_band_median_px": float(np.median(widths)), "edge_band_mean_px": float(np.mean(widths))}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--designs", nargs="+", default=["cy_halves", "cy_open"])
    parser.add_argument("--scenes", nargs="+", default=["steps", "room", "desk"])
    parser.add_argument("--quality", nargs="+", default=["paper", "real-time"])
    parser.add_argument("--camera", type=Path, help="use this camera file instead of calibrating (one design)")
    parser.add_argument("--cameras", type=Path, help="folder of DESIGN.asdf, instead of calibrating")
    parser.add_argument("--order", action="store_true", help="do error bars rank errors, and do they hold by tenth?")
    parser.add_argument("--edges", action="store_true", help="how wide is the wrong band beside depth edges?")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()

    lens: Calibration | None = None
    table = []
    for design in args.designs:
        if args.camera or args.cameras:
            calibration = Calibration.load(args.camera or args.cameras / f"{design}.asdf")
        else:
            calibration = calibrate_session(args.data / design, lens_from=lens).calibration
        lens = lens or calibration  # designs without tilted boards share the first one's lens
        for quality in args.quality:
            camera = CodedApertureCamera(calibration, default_config(calibration, quality))
            for scene in args.scenes:
                frame = camera.measure(camera.read(args.data / design / "scene" / f"{scene}.png"))
                depth, sigma = frame.depth_mm.astype(float), frame.sigma_mm.astype(float)
                truth = truth_mm(args.data, scene)
                figures = score(depth, sigma, truth)
                figures |= order(depth, sigma, truth) if args.order else {}
                figures |= edges(depth, truth) if args.edges else {}
                table.append({"design": design, "quality": quality, "scene": scene, **figures})
                if not args.json:
                    words = " ".join(f"{k} {v:.3f}" for k, v in figures.items())
                    print(f"{design:11} {quality:9} {scene:6} {words}", flush=True)
    if args.json:
        print(json.dumps(table, indent=1))


if __name__ == "__main__":
    main()
