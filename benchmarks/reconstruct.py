"""A walk's tracking and mesh against true poses and depth: python benchmarks/reconstruct.py --data FOLDER --camera FILE

FOLDER is bench50: cy_halves/walk/*.png, truth/walk/NNN.depth_0.1mm.png and poses_camera_to_world_mm.txt. Positions are
compared after rigid alignment without scale, vertices of the mesh with the true depth along the ray of the picture that
fits best. --work FOLDER keeps the measured frames: a new one for another camera or matcher.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from chromaperture.camera.camera import CodedApertureCamera, DepthFrame, load_camera
from chromaperture.capture.open import open_source
from chromaperture.products.rectified import View, undistorter
from chromaperture.reconstruction.build_model import summary
from chromaperture.reconstruction.fusion import Reconstruction


def trajectory_errors(found: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Distances of positions (N, 3) from the true ones after rigid alignment; (N,) float64, mm."""
    middle, true_middle = found.mean(axis=0), true.mean(axis=0)
    u, _, vt = np.linalg.svd((true - true_middle).T @ (found - middle))
    turn = u @ np.diag([1, 1, np.sign(np.linalg.det(u @ vt))]) @ vt
    return np.linalg.norm((found - middle) @ turn.T + true_middle - true, axis=1)


def off_surface(world: np.ndarray, poses: list[np.ndarray], truths: list[np.ndarray], cal, delta: float) -> np.ndarray:
    """Smallest |depth - truth| / truth of each vertex over all pictures; NaN where it is in none."""
    best = np.full(len(world), np.inf)
    for pose, truth in zip(poses, truths, strict=True):
        inside = (world - pose[:3, 3]) @ pose[:3, :3]
        lens = cal.lens
        pixels = cv2.projectPoints(inside[:, None], np.zeros(3), np.zeros(3), lens.camera_matrix, lens.distortion)[0]
        u, v = np.rint(pixels[:, 0]).astype(int).T
        ok = (inside[:, 2] > 0) & (u >= 0) & (u < truth.shape[1]) & (v >= 0) & (v < truth.shape[0])
        true = np.where(ok, truth[np.where(ok, v, 0), np.where(ok, u, 0)], 0)
        with np.errstate(divide="ignore", invalid="ignore"):
            error = np.abs(inside[:, 2] + delta - true) / true
        best = np.fmin(best, np.where(true > 0, error, np.inf))
    return np.where(np.isfinite(best), best, np.nan)


def measured(data: Path, camera: CodedApertureCamera, work: Path | None) -> Iterator[View]:
    """Views of the walk, from the folder of stored ones if there is one."""
    encoding, to_view = camera.calibration.sensor.encoding, undistorter(camera)
    with open_source(str(data / "cy_halves" / "walk"), camera_encoding=encoding) as source:
        for frame in source:
            kept = work / f"{camera.config.quality}_{frame.index:03d}.npz" if work else None
            if kept is None or not kept.exists():
                made = camera.measure(frame.image)
                if kept is not None:
                    np.savez(kept, depth=made.depth_mm, sigma=made.sigma_mm, color=made.color)
            else:
                depth, sigma, color = (np.load(kept)[name] for name in ("depth", "sigma", "color"))
                made = DepthFrame(depth, sigma, depth, depth, depth, color)
            yield to_view(made, frame.time_s, frame.index)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--camera", type=Path, required=True)
    parser.add_argument("--quality", default="accurate")
    parser.add_argument("--work", type=Path)
    args = parser.parse_args()
    if args.work:
        args.work.mkdir(parents=True, exist_ok=True)

    camera = load_camera(args.camera, quality=args.quality)
    cal = camera.calibration
    delta = float(cal.depth[args.quality].sensor_to_pupil_mm)
    folder, began = args.data / "truth" / "walk", time.perf_counter()
    model = Reconstruction(cal.lens.camera_matrix, listener=print)
    for view in measured(args.data, camera, args.work):
        model.add(view)
    pupil = np.eye(4)
    pupil[2, 3] = delta  # the truth's origin is on the sensor, ours in the pupil
    poses = [p @ pupil for p in np.loadtxt(folder / "poses_camera_to_world_mm.txt").reshape(-1, 4, 4)]
    placed = [place for place in model.placed if place.pose is not None and place.submap == 0]
    found = np.array([place.pose[:3, 3] for place in placed])
    errors = trajectory_errors(found, np.array([poses[place.index][:3, 3] for place in placed]))
    truths = [
        cv2.imread(str(folder / f"{i:03d}.depth_0.1mm.png"), cv2.IMREAD_UNCHANGED) / 10 for i in range(len(poses))
    ]
    vertices = model.meshes()[0].vertices_mm.astype(float)
    # The mesh is in the frame of the first camera, whose pose error is counted in the trajectory.
    world = vertices @ poses[placed[0].index][:3, :3].T + poses[placed[0].index][:3, 3]
    off = off_surface(world, poses, truths, cal, delta)
    figures = {
        "quality": args.quality,
        "ate_rms_mm": float(np.sqrt((errors**2).mean())),
        "ate_max_mm": float(errors.max()),
        "mesh_median_percent": float(np.nanmedian(off) * 100),
        "mesh_90_percent": float(np.nanquantile(off, 0.9) * 100),
        "vertices": len(vertices),
        "seconds": time.perf_counter() - began,
    }
    print(json.dumps(figures | {k: v for k, v in summary(model).items() if k != "per_frame"}, indent=1))


if __name__ == "__main__":
    main()
