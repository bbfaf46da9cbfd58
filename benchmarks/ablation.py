"""What each ingredient of a quality costs and gains.

    python benchmarks/ablation.py --data FOLDER [--quality real-time]
    python benchmarks/ablation.py --data FOLDER --quality accurate --camera CAMERA.asdf
    python benchmarks/ablation.py --quality accurate --camera V.asdf --pictures pictures/*.npz

FOLDER as for bench50.py. Pictures are scenes by the same camera, as ``world_scenes.py draw`` writes them:
steps, room and desk are few, and move by chance. For real-time the camera is calibrated anew for every variant, because
the depth curve belongs to the matcher's settings; the layers of accurate name distances whatever the settings, and only
shifted views need another calibration, and with it ``--data``. Times are of the whole measurement, the fastest of five
(accurate: of one), beside StereoSGBM 3WAY on an equally large picture.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from unittest import mock

import cv2
import numpy as np
from bench50 import score
from matcher import peers
from timing import fastest_ms

from chromaperture.calibration import read_boards
from chromaperture.calibration.calibrate_session import calibrate_session
from chromaperture.calibration.options import CalibrationConfig
from chromaperture.camera.camera import CodedApertureCamera
from chromaperture.camera.method import default_config
from chromaperture.depth.field import DepthField
from chromaperture.matching import accurate
from chromaperture.matching.labels import IDENTITY
from chromaperture.matching.planes import block_surface
from chromaperture.matching.real_time import RealTimeMethod
from chromaperture.model.camera_file import Calibration
from chromaperture.settings.methods import AccurateConfig, MatcherConfig, PaperConfig, RealTimeConfig
from chromaperture.settings.stages import (
    BilateralConfig,
    CorrelationConfig,
    CrossFilterConfig,
    FourPathsConfig,
    ViewsConfig,
)

REAL_TIME = RealTimeConfig()
VARIANTS: dict[str, MatcherConfig] = {
    "everything": REAL_TIME,
    "no field over the frame": REAL_TIME,
    "unmixed views": dataclasses.replace(REAL_TIME, space="unmixed"),
    "pure channels, else unmixed views": dataclasses.replace(REAL_TIME, space="pure"),
    "views read by Catmull and Rom's cubic": dataclasses.replace(
        REAL_TIME,
        views=ViewsConfig(presmooth_sigma_px=0.6, guide_range=0.15),
        correlation=CorrelationConfig(cell_px=2),
    ),
    "a score a pixel": dataclasses.replace(
        REAL_TIME, correlation=dataclasses.replace(REAL_TIME.correlation, cell_px=1)
    ),
    "no average between layers": dataclasses.replace(REAL_TIME, smoothing_sigma_px=0.0),
    "average broken by the guide's texture": dataclasses.replace(REAL_TIME, smoothing_edge_range=1.0),
    "penalties not led by the guide": dataclasses.replace(REAL_TIME, paths=FourPathsConfig(edge_floor=1.0)),
    "rows and columns apart": dataclasses.replace(REAL_TIME, paths=FourPathsConfig(row_share=0.0)),
    "penalties a tenth": dataclasses.replace(REAL_TIME, paths=FourPathsConfig(jump_penalty=1.0)),
    "window of .70": dataclasses.replace(
        REAL_TIME, correlation=CorrelationConfig(window_decay=0.7, sampling="b-spline")
    ),
    "full resolution, best layer of a bilateral filter": PaperConfig(
        space="pure",
        correlation=CorrelationConfig(noise_debiasing=True),
        bilateral=BilateralConfig(texture_weighting=True),
    ),
}


ACCURATE = ("everything", "shifted views", "walls not placed between layers", "widest pair of channels only",
            "one octave", "three octaves", "window of 8 px", "pairs of channels alone", "level planes only",
            "planes alone", "the paths' surface alone", "blocks never keep their own surface",
            "losses of blocks not bounded", "borders cost twice as much", "blocks beside likely edges count fully",
            "pixels known by their posterior alone", "plate four times as stiff", "error bar not learned", "four paths",
            "penalties a tenth", "penalties not led by the guide", "one curve for the frame")  # fmt: skip

ACCURATE_WITHOUT_SESSION = tuple(name for name in ACCURATE if name != "shifted views")


def accurate_camera(name: str, camera_file: Path, session: Path) -> CodedApertureCamera:
    """A calibrated camera with one ingredient of quality accurate changed or taken away."""
    if name == "shifted views":
        plain = calibrate_session(session, CalibrationConfig(lens_blur=False)).calibration
        return CodedApertureCamera(plain, default_config(plain, "accurate"))
    calibration = Calibration.load(camera_file)
    if name == "one curve for the frame":
        constant = DepthField.constant(calibration.on_axis("accurate"))
        calibration = dataclasses.replace(calibration, depth={**calibration.depth, "accurate": constant})
    config = default_config(calibration, "accurate")
    assert isinstance(config.matcher, AccurateConfig)
    evidence, surface = config.matcher.evidence, config.matcher.surface
    assert isinstance(evidence, CrossFilterConfig)
    octaves = {"bands_px": ((0.6, 1.4), (1.4, 3.2), (3.2, 7.0)), "band_weights": (1.0, 0.5, 0.25)}
    changes = {
        "widest pair of channels only": {"evidence": dataclasses.replace(evidence, fallback_weight=0.0)},
        "one octave": {"evidence": dataclasses.replace(evidence, bands_px=((0.6, 1.4),), band_weights=(1.0,))},
        "three octaves": {"evidence": dataclasses.replace(evidence, **octaves)},
        "window of 8 px": {"evidence": dataclasses.replace(evidence, window_sigma_px=8.0)},
        "four paths": {"surface": dataclasses.replace(surface, paths=4)},
        "penalties a tenth": {
            "surface": dataclasses.replace(surface, slope_penalty=surface.slope_penalty / 10, jump_penalty=2.5)
        },
        "penalties not led by the guide": {"surface": dataclasses.replace(surface, edge_floor=1.0)},
    }
    planes, plate = config.matcher.planes, config.matcher.plate
    changes |= {
        "pairs of channels alone": {"spectral": dataclasses.replace(config.matcher.spectral, gain=0.0)},
        "blocks never keep their own surface": {"plate": dataclasses.replace(plate, own_evidence_nats=1e9)},
        "losses of blocks not bounded": {"planes": dataclasses.replace(planes, max_block_nats=0.0)},
        "blocks beside likely edges count fully": {
            "planes": dataclasses.replace(planes, edge_block_weight=1.0),
            "plate": dataclasses.replace(plate, edge_block_weight=1.0),
        },
        "pixels known by their posterior alone": {"planes": dataclasses.replace(planes, known_from_nats=1e9)},
        "borders cost twice as much": {"planes": dataclasses.replace(planes, border_nats=2 * planes.border_nats)},
        "plate four times as stiff": {"plate": dataclasses.replace(plate, bend_penalty=4 * plate.bend_penalty)},
        "error bar not learned": {"surface": dataclasses.replace(surface, learned_error_bar="none")},
    }
    matcher = dataclasses.replace(config.matcher, **changes.get(name, {}))
    return CodedApertureCamera(calibration, dataclasses.replace(config, matcher=matcher))


def measure_accurate(name: str, args: argparse.Namespace) -> dict:
    camera = accurate_camera(name, args.camera, (args.data or Path()) / args.design)
    replaced = {
        "walls not placed between layers": (
            accurate, "between_layers", lambda disparity_px, *volume, sigma_px: disparity_px
        ),
        "level planes only": (block_surface, "plane_proposals", lambda *surface, run: np.zeros((0, 3))),
        "planes alone": (block_surface, "thin_plate", lambda nats, start, *edges, config: start),
        "the paths' surface alone": (
            block_surface, "speaks_against", lambda nats, own, label, config: np.ones(own.shape, bool)
        ),
    }  # fmt: skip
    with mock.patch.object(*replaced[name]) if name in replaced else contextlib.nullcontext():
        return figures_of(camera, scenes_of(camera, args), rounds=1)


def measure(name: str, args: argparse.Namespace) -> dict:
    matcher = VARIANTS[name]
    with mock.patch.object(read_boards, "RealTimeConfig", return_value=matcher):
        camera_file = calibrate_session(args.data / args.design).calibration
    config = default_config(camera_file)
    matcher = matcher.with_range(*camera_file.disparity_range_px("real-time"))
    camera = CodedApertureCamera(camera_file, dataclasses.replace(config, matcher=matcher))
    if name == "no field over the frame":
        assert isinstance(camera.method, RealTimeMethod)
        camera.method = dataclasses.replace(camera.method, label_map=IDENTITY)
    return figures_of(camera, scenes_of(camera, args), rounds=5)


def scenes_of(camera: CodedApertureCamera, args: argparse.Namespace) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Read photographs and their true distances, mm, NaN unknown."""
    for path in args.pictures:
        with np.load(path) as picture:
            yield picture["image"], picture["truth_mm"]
    for scene in [] if args.pictures else args.scenes:
        stored = cv2.imread(str(args.data / "truth" / f"{scene}.depth_0.1mm.png"), cv2.IMREAD_UNCHANGED)
        truth = np.where(stored > 0, stored / 10.0, np.nan)
        yield camera.read(args.data / args.design / "scene" / f"{scene}.png"), truth


def figures_of(
    camera: CodedApertureCamera, scenes: Iterable[tuple[np.ndarray, np.ndarray]], *, rounds: int
) -> dict[str, float]:
    figures = []
    for image, truth in scenes:
        frame = camera.measure(image)
        figures.append(score(frame.depth_mm.astype(float), frame.sigma_mm.astype(float), truth))
    mean = {key: round(float(np.mean([f[key] for f in figures])), 3) for key in figures[0]}
    pair = [np.ascontiguousarray(image[..., channel]) for channel in (0, 2)]
    work = {"measure": lambda: camera.measure(image), "sgbm": peers(pair)["sgbm_3way"]}
    best = fastest_ms(work, threads=2, rounds=rounds)
    return {**mean, "ms": round(best["measure"], 1), "ratio_to_sgbm_3way": round(best["measure"] / best["sgbm"], 2)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path)
    parser.add_argument("--pictures", type=Path, nargs="+", default=[], help="KIND_NUMBER.npz in place of --scenes")
    parser.add_argument("--design", default="cy_halves")
    parser.add_argument("--scenes", nargs="+", default=["steps", "room", "desk"])
    parser.add_argument("--quality", choices=["real-time", "accurate"], default="real-time")
    parser.add_argument("--camera", type=Path, help="camera file with a blur, for accurate")
    parser.add_argument("--variants", nargs="+")
    args = parser.parse_args()
    if args.quality == "accurate" and args.camera is None:
        parser.error("--quality accurate needs --camera")
    if args.data is None and (not args.pictures or args.quality == "real-time"):
        parser.error("give --data, or --pictures with --quality accurate")
    known = VARIANTS if args.quality == "real-time" else ACCURATE if args.data else ACCURATE_WITHOUT_SESSION
    for name in args.variants or known:
        found = measure(name, args) if args.quality == "real-time" else measure_accurate(name, args)
        print(json.dumps({name: found}), flush=True)


if __name__ == "__main__":
    main()
