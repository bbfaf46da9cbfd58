"""Trajectory from our depth and from a depth sensor: an RGB-D sequence is photographed through a coded aperture.

python benchmarks/rgbd_walk.py --data DATA/real/seven_scenes --work FOLDER [--quality accurate] [--frames 60]

FOLDER stores the simulated calibration session, its camera file and the measured frames, which are not made again.
Errors of position are compared after rigid alignment without scale. The sensor's run uses its sharp pictures.
"""

from __future__ import annotations

import argparse
import itertools
import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from reconstruct import trajectory_errors

from chromaperture.calibration.calibrate_session import calibrate_session
from chromaperture.camera.camera import DepthFrame, load_camera
from chromaperture.capture.simulated import SimulatedSource
from chromaperture.optics.aperture import DESIGNS, made_of
from chromaperture.optics.pinhole import PupilCamera
from chromaperture.optics.ray_table import pinhole_rays
from chromaperture.optics.simulator.session import SessionPlan, write_session
from chromaperture.products.rectified import View, undistorter
from chromaperture.reconstruction.fusion import Reconstruction
from chromaperture.reconstruction.settings import ReconstructionConfig

FOCAL_PX, RADIUS_MM, FOCUS_MM, DELTA_MM = 585.0, 20.0, 2000.0, 50.0  # of 7-Scenes; the simulated lens
SIGMA = 0.002  # the sensor's error bar, relative, at 1 m; proportional to the distance; chosen by hand
SIZE = (640, 480)


def camera_file(work: Path) -> Path:
    """Photograph boards with the simulated camera and calibrate it from them."""
    path, session = work / "camera.asdf", work / "cy_halves"
    if not path.exists():
        camera = PupilCamera(*SIZE, FOCAL_PX, RADIUS_MM, FOCUS_MM, DELTA_MM, 0.02)
        write_session(
            session,
            aperture=made_of(DESIGNS["cy_halves"], "real"),
            camera=camera,
            rays=lambda coded: pinhole_rays(camera, coded, cells=12),
            scenes={},
            plan=replace(SessionPlan(), distances_mm=tuple(float(d) for d in range(700, 3801, 200))),
        )
        calibrate_session(session).calibration.save(path)
    return path


def our_views(args: argparse.Namespace) -> list[View]:
    camera = load_camera(camera_file(args.work), quality=args.quality)
    to_view = undistorter(camera)
    source = SimulatedSource(
        str(args.data), focal_px=FOCAL_PX, pupil_radius_mm=RADIUS_MM, focus_mm=FOCUS_MM, sensor_to_pupil_mm=DELTA_MM,
        count=args.frames,
    )  # fmt: skip
    views = []
    frames = iter(source.__enter__()) if args.frames else iter(())
    for index in range(args.frames):
        kept = args.work / f"{args.quality}_{index:03d}.npz"
        if not kept.exists():
            while (frame := next(frames)).index < index:
                pass
            made = camera.measure(frame.image)
            np.savez(kept, depth=made.depth_mm, sigma=made.sigma_mm, color=made.color)
        stored = np.load(kept)
        depth = stored["depth"]
        made = DepthFrame(depth, stored["sigma"], depth, depth, np.isfinite(depth), stored["color"])
        views.append(to_view(made, index / 30, index))
    return views


def sensor_views(args: argparse.Namespace) -> list[View]:
    views = []
    for index, path in enumerate(sorted(args.data.glob("*.color.jpg"))[: args.frames]):
        z = cv2.imread(str(path).replace("color.jpg", "depth.png"), cv2.IMREAD_UNCHANGED).astype(np.float32)
        z[(z == 0) | (z == 65535)] = np.nan
        color = np.ascontiguousarray(cv2.imread(str(path))[..., ::-1])
        views.append(View(color, z, SIGMA * z * np.maximum(z / 1000, 1), index / 30, index))
    return views


def score(views: list[View], matrix: np.ndarray, poses: list[np.ndarray], truth: list[View]) -> dict[str, object]:
    messages: list[str] = []
    model = Reconstruction(matrix, ReconstructionConfig(), listener=messages.append)
    placed = [place for place in map(model.add, views) if place.pose is not None and place.submap == 0]
    found = np.array([place.pose[:3, 3] for place in placed])
    true = np.array([poses[place.index][:3, 3] for place in placed])
    errors = trajectory_errors(found, true)
    relative = np.concatenate([(np.abs(v.z_mm - t.z_mm) / t.z_mm).ravel() for v, t in zip(views, truth, strict=True)])
    return {
        "ate_rms_mm": float(np.sqrt((errors**2).mean())),
        "ate_max_mm": float(errors.max()),
        "tracked": len(placed),
        "keyframes": len(model.submaps[0].keyframes),
        "said": messages,
        "depth_median_percent": 100 * float(np.nanmedian(relative)),
        "vertices": len(model.mesh(0).vertices_mm),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--quality", default="accurate")
    parser.add_argument("--frames", type=int, default=60)
    args = parser.parse_args()
    args.work.mkdir(parents=True, exist_ok=True)

    sensor = sensor_views(args)
    poses = [np.loadtxt(path) for path in sorted(args.data.glob("*.pose.txt"))]
    for pose in poses:
        pose[:3, 3] *= 1000
    matrix = np.array([[FOCAL_PX, 0, 319.5], [0, FOCAL_PX, 239.5], [0, 0, 1]])
    theirs = score(sensor, matrix, poses, sensor)
    measured = our_views(args)
    lens = load_camera(camera_file(args.work), quality=args.quality).calibration.lens
    ours = score(measured, lens.camera_matrix, poses, sensor)
    path_mm = float(sum(np.linalg.norm(b[:3, 3] - a[:3, 3]) for a, b in itertools.pairwise(poses)))
    ratio = ours["ate_rms_mm"] / theirs["ate_rms_mm"]
    print(json.dumps({"ratio": ratio, "path_mm": path_mm, "ours": ours, "sensor": theirs}, indent=1))


if __name__ == "__main__":
    main()
