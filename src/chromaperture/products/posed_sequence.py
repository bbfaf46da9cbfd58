"""Sequences as folders: with the pose of every frame for COLMAP and Nerfstudio, RGB-D of Open3D and TUM's benchmark.

Pictures are undistorted views of a pinhole in the entrance pupil, as `undistorter` makes them; lengths are in metres,
as those programs and viewers have them, and stand so in every file. TUM's folders (rgb/, depth/, rgb.txt, depth.txt,
associations.txt) hold sigma/ and confidence/ in the same manner, which readers of the format ignore.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from chromaperture.depth.error_limit import MAX_RELATIVE_SIGMA, within_error
from chromaperture.depth.pointcloud import ply_header, ply_vertices
from chromaperture.files.pictures import write_depth_png, write_png
from chromaperture.products.rectified import View
from chromaperture.system.errors import InputError
from chromaperture.system.storage import staged
from chromaperture.system.validation import read_bytes

_COUNTS_PER_MM = 5.0  # 5000 a metre, fixed by the TUM format


def write_tum(
    folder: str | Path,
    frames: Iterable[View],
    *,
    camera_matrix: np.ndarray,
    max_relative_sigma: float = MAX_RELATIVE_SIGMA,
) -> int:
    """Write a sequence; the folder appears when it is complete.

    Parameters
    ----------
    folder : str or Path
        Must not exist.
    frames : iterable of View
    camera_matrix : (3, 3) float, px
    max_relative_sigma : float
        Largest sigma / depth in depth/, see `within_error`; sigma/ is whole.

    Returns
    -------
    int
        Frames written.

    Raises
    ------
    InputError
        The folder exists or cannot be written, or the disk is full.
    """
    folder = Path(folder)
    if folder.exists():
        raise InputError(f"{folder} exists already; choose another name")
    rows: dict[str, list[str]] = {"rgb": [], "depth": [], "sigma": [], "confidence": []}
    with staged(folder.parent) as stage:
        private = stage.path(folder.name)
        for part in rows:
            (private / part).mkdir(parents=True)
        for frame in frames:
            stamp = f"{frame.time_s:.6f}"
            z_mm = within_error(frame.z_mm, frame.sigma_mm, max_relative_sigma)
            pictures = {"rgb": frame.color[..., ::-1], "depth": tum_depth(z_mm), "sigma": tum_sigma(frame.sigma_mm)}
            if frame.confidence is not None:
                pictures["confidence"] = np.rint(255 * np.nan_to_num(frame.confidence)).astype(np.uint8)
            for part, picture in pictures.items():
                name = f"{part}/{stamp}.png"
                if (private / name).exists():
                    raise InputError(f"two frames have the same time, {stamp} s; record the sequence again")
                (private / name).write_bytes(cv2.imencode(".png", picture)[1].tobytes())
                rows[part].append(f"{stamp} {name}")
        for part, lines in rows.items():
            text = f"# {part} images\n# timestamp filename\n" + "".join(f"{line}\n" for line in lines)
            (private / f"{part}.txt").write_text(text, encoding="ascii")
        pairs = zip(rows["rgb"], rows["depth"], strict=True)
        (private / "associations.txt").write_text("".join(f"{a} {b}\n" for a, b in pairs), encoding="ascii")
        m = camera_matrix
        intrinsics = f"{m[0, 0]:.4f} {m[1, 1]:.4f} {m[0, 2]:.4f} {m[1, 2]:.4f}\n"
        (private / "calibration.txt").write_text("# fx fy cx cy (px), no distortion\n" + intrinsics, encoding="ascii")
        if not rows["rgb"]:
            raise InputError("the source held no frame; nothing was written")
    return len(rows["rgb"])


def tum_depth(z_mm: np.ndarray) -> np.ndarray:
    """Encode depth, 5000 counts a metre; (H, W) uint16, 0 unknown or beyond 13.1 m."""
    counts = np.rint(np.nan_to_num(z_mm, nan=0.0, posinf=0.0, neginf=0.0).astype(np.float64) * _COUNTS_PER_MM)
    return np.where((counts > 0) & (counts <= 65535), counts, 0).astype(np.uint16)


def tum_sigma(sigma_mm: np.ndarray) -> np.ndarray:
    """Encode standard deviations like depth; (H, W) uint16, 0 unknown, 65535 for 13.1 m and more, never 0 if known."""
    known = ~np.isnan(sigma_mm)
    counts = np.clip(np.rint(np.where(known, sigma_mm, 1).astype(np.float64) * _COUNTS_PER_MM), 1, 65535)
    return np.where(known, counts, 0).astype(np.uint16)


Form = Literal["colmap", "nerfstudio", "open3d"]
Poses = Mapping[int, np.ndarray]
_POINTS_A_FRAME = 2000  # in the cloud that begins a reconstruction or splats; chosen by hand
_HALF_PIXEL = 0.5  # COLMAP and Nerfstudio: the centre of the first pixel is at 0.5; here at 0
_MOST_TRAJECTORY_BYTES = 50_000_000  # half a million frames
POSE_LIMIT_S = 0.02  # between a frame and a pose; that of the tools of TUM's benchmark
_ROUNDED_S = 1e-6  # times in a trajectory file have six digits


@dataclass(frozen=True)
class _Kept:
    """What is needed of a frame once its pictures are written."""

    index: int
    name: str
    time_s: float
    pixels: np.ndarray  # (N, 2) float64, px, the centre of the first pixel is 0
    points_mm: np.ndarray  # (N, 3) float64, camera frame
    colors: np.ndarray  # (N, 3) uint8


def write_posed(
    folder: str | Path,
    frames: Iterable[View],
    *,
    form: Form,
    camera_matrix: np.ndarray,
    poses: Callable[[list[tuple[int, float]]], Poses] | None = None,
    max_relative_sigma: float = MAX_RELATIVE_SIGMA,
) -> int:
    """Write a sequence; the folder appears when it is complete.

    ``folder``: must not exist; ``form`` {"colmap", "nerfstudio", "open3d"}: ``colmap``: images/, depth_mm/ and the text
    model sparse/0; ``nerfstudio``: images/, depth_mm/, transforms.json and points_m.ply; ``open3d``: color/, depth/ and
    camera_intrinsic.json, for which no poses are needed; ``camera_matrix`` (3, 3) float, px; ``poses``: called when all
    frames have been seen, with their (index, time_s); returns the (4, 4) pose of each, camera to world, mm, by its
    index. Frames without one are left out; ``max_relative_sigma``: largest sigma / depth of the depth and the points;
    see `within_error`. Returns frames written. Raises InputError: the folder exists or cannot be written, the disk is
    full, or no frame has a pose.
    """
    folder = Path(folder)
    if folder.exists():
        raise InputError(f"{folder} exists already; choose another name")
    parts = ("color", "depth") if form == "open3d" else ("images", "depth_mm")
    kept: list[_Kept] = []
    size = (0, 0)
    with staged(folder.parent) as stage:
        private = stage.path(folder.name)
        for part in parts:
            (private / part).mkdir(parents=True)
        for frame in frames:
            name = f"{len(kept):06d}.png"
            z_mm = within_error(frame.z_mm, frame.sigma_mm, max_relative_sigma)
            write_png(private / parts[0] / name, frame.color)
            write_depth_png(private / parts[1] / name, z_mm)
            kept.append(_kept(frame, z_mm, name, camera_matrix))
            size = (z_mm.shape[1], z_mm.shape[0])
        if not kept:
            raise InputError("the source held no frame; nothing was written")
        if form == "open3d":
            _write_open3d(private, size, camera_matrix)
            return len(kept)
        found = poses([(frame.index, frame.time_s) for frame in kept]) if poses is not None else {}
        placed = [(frame, found[frame.index]) for frame in kept if frame.index in found]
        if not placed:
            raise InputError("no frame has a pose; give a trajectory of this sequence with --trajectory")
        for lost in kept:
            if lost.index not in found:
                for part in parts:
                    (private / part / lost.name).unlink()
        (_write_colmap if form == "colmap" else _write_nerfstudio)(private, placed, size, camera_matrix)
    return len(placed)


def _kept(frame: View, z_mm: np.ndarray, name: str, matrix: np.ndarray) -> _Kept:
    """Choose points of a frame, evenly over its known pixels."""
    v, u = np.nonzero(np.isfinite(z_mm) & (z_mm > 0))
    some = np.linspace(0, len(v) - 1, min(_POINTS_A_FRAME, len(v))).astype(int)
    v, u = v[some], u[some]
    z = z_mm[v, u].astype(np.float64)
    points = np.stack([(u - matrix[0, 2]) / matrix[0, 0] * z, (v - matrix[1, 2]) / matrix[1, 1] * z, z], axis=1)
    pixels = np.stack([u, v], axis=1).astype(np.float64)
    return _Kept(frame.index, name, frame.time_s, pixels, points, frame.color[v, u])


def _world_m(frame: _Kept, pose: np.ndarray) -> np.ndarray:
    return np.asarray((frame.points_mm @ pose[:3, :3].T + pose[:3, 3]) / 1000)


def _write_colmap(
    folder: Path, placed: list[tuple[_Kept, np.ndarray]], size: tuple[int, int], matrix: np.ndarray
) -> None:
    """Write the text model: cameras, images with the pixels of their points, points."""
    model = folder / "sparse" / "0"
    model.mkdir(parents=True)
    fx, fy, cx, cy = matrix[0, 0], matrix[1, 1], matrix[0, 2] + _HALF_PIXEL, matrix[1, 2] + _HALF_PIXEL
    (model / "cameras.txt").write_text(
        "# CAMERA_ID MODEL WIDTH HEIGHT fx fy cx cy (px)\n"
        f"1 PINHOLE {size[0]} {size[1]} {fx:.6f} {fy:.6f} {cx:.6f} {cy:.6f}\n",
        encoding="ascii",
    )
    images = [
        "# IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME (world to camera, m); then POINTS2D[] as (X, Y, POINT3D_ID)"
    ]
    points = [
        "# POINT3D_ID X Y Z (m) R G B ERROR TRACK[] as (IMAGE_ID, POINT2D_IDX); depth of one view each, not matched"
    ]
    number = 1
    for image, (frame, pose) in enumerate(placed, start=1):
        to_camera = np.linalg.inv(pose)
        x, y, z, w = Rotation.from_matrix(to_camera[:3, :3]).as_quat()
        numbers = " ".join(f"{value:.9f}" for value in (w, x, y, z, *(to_camera[:3, 3] / 1000)))
        images.append(f"{image} {numbers} 1 {frame.name}")
        seen = []
        for i, (at, pixel, rgb) in enumerate(zip(_world_m(frame, pose), frame.pixels, frame.colors, strict=True)):
            seen.append(f"{pixel[0] + _HALF_PIXEL:g} {pixel[1] + _HALF_PIXEL:g} {number}")
            place = " ".join(f"{value:.6f}" for value in at)
            points.append(f"{number} {place} {rgb[0]} {rgb[1]} {rgb[2]} 0 {image} {i}")
            number += 1
        images.append(" ".join(seen))
    (model / "images.txt").write_text("\n".join(images) + "\n", encoding="ascii")
    (model / "points3D.txt").write_text("\n".join(points) + "\n", encoding="ascii")


def _write_nerfstudio(
    folder: Path, placed: list[tuple[_Kept, np.ndarray]], size: tuple[int, int], matrix: np.ndarray
) -> None:
    """Write transforms.json: poses camera to world, x right, y up, z backward, m; depth pictures in mm."""
    flip = np.diag([1.0, -1.0, -1.0, 1.0])
    frames = []
    for frame, pose in placed:
        transform = pose @ flip
        transform[:3, 3] /= 1000
        frames.append({
            "file_path": f"images/{frame.name}",
            "depth_file_path": f"depth_mm/{frame.name}",
            "transform_matrix": transform.tolist(),
        })  # fmt: skip
    tree = {
        "camera_model": "OPENCV",
        "w": size[0],
        "h": size[1],
        "fl_x": float(matrix[0, 0]),
        "fl_y": float(matrix[1, 1]),
        "cx": float(matrix[0, 2]) + _HALF_PIXEL,
        "cy": float(matrix[1, 2]) + _HALF_PIXEL,
        **dict.fromkeys(("k1", "k2", "p1", "p2"), 0.0),
        "depth_unit_scale_factor": 0.001,
        "ply_file_path": "points_m.ply",
        "frames": frames,
    }
    (folder / "transforms.json").write_text(json.dumps(tree, indent=1) + "\n", encoding="ascii")
    points = np.concatenate([_world_m(frame, pose) for frame, pose in placed])
    colors = np.concatenate([frame.colors for frame, _ in placed])
    header = ply_header(len(points), "m; world of transforms.json")
    (folder / "points_m.ply").write_bytes(header + ply_vertices(points, colors).tobytes())


def _write_open3d(folder: Path, size: tuple[int, int], matrix: np.ndarray) -> None:
    """Write the pinhole as Open3D reads it: the matrix column by column; depth pictures are in mm, its default."""
    tree = {"width": size[0], "height": size[1], "intrinsic_matrix": np.asarray(matrix, float).T.ravel().tolist()}
    (folder / "camera_intrinsic.json").write_text(json.dumps(tree, indent=1) + "\n", encoding="ascii")


def read_trajectory(
    path: str | Path, *, limit_s: float = POSE_LIMIT_S, listener: Callable[[str], None] = lambda line: None
) -> Callable[[list[tuple[int, float]]], dict[int, np.ndarray]]:
    """Read the first submap of a TUM trajectory; returns poses (4, 4), mm, of (index, time_s) for `write_posed`.

    A frame lies between its two neighbours (slerp, straight line) where both are within ``limit_s``, and has the pose
    of one that is alone; ``listener`` hears how many frames have none.
    """
    path = Path(path)
    if not limit_s >= 0:
        raise InputError(f"--trajectory-limit-s must be 0 or more, got {limit_s:g}")
    rows: dict[float, list[float]] = {}
    for number, line in enumerate(
        read_bytes(path, most_bytes=_MOST_TRAJECTORY_BYTES).decode("ascii", "replace").splitlines(), 1
    ):
        if line.startswith("# submap"):
            break
        if line.startswith("#") or not line.strip():
            continue
        try:
            values = [float(word) for word in line.split()]
            if len(values) != 8 or not np.abs(values).max() < 1e12 or np.linalg.norm(values[4:]) < 1e-6:
                raise ValueError
        except ValueError:
            raise InputError(
                f"{path.name}, line {number}: a pose is time tx ty tz qx qy qz qw; give a trajectory in the TUM format"
            ) from None
        rows[values[0]] = values
    if not rows:
        raise InputError(f"{path.name} holds no pose; give a trajectory in the TUM format")
    table = np.array([rows[time] for time in sorted(rows)])
    times, places_mm = table[:, 0], 1000 * table[:, 1:4]
    turns = Rotation.from_quat(table[:, 4:])

    def pose(time_s: float) -> np.ndarray | None:
        after = int(np.searchsorted(times, time_s))
        near = [i for i in (after - 1, after) if 0 <= i < len(times) and abs(times[i] - time_s) <= limit_s + _ROUNDED_S]
        if not near:
            return None
        at = np.clip(time_s, times[near[0]], times[near[-1]])
        found = np.eye(4)
        found[:3, :3] = (Slerp(times[near], turns[near])(at) if len(near) > 1 else turns[near[0]]).as_matrix()
        found[:3, 3] = [np.interp(at, times[near], places_mm[near, axis]) for axis in range(3)]
        return found

    def poses(frames: list[tuple[int, float]]) -> dict[int, np.ndarray]:
        found = {index: placed for index, time_s in frames if (placed := pose(time_s)) is not None}
        lost = len(frames) - len(found)
        if lost:
            line = f"{lost} of {len(frames)} frames have no pose within {limit_s:g} s in {path.name}"
            if not found:
                raise InputError(
                    f"{line}: poses from {times[0]:.3f} to {times[-1]:.3f} s, frames from {frames[0][1]:.3f} to "
                    f"{frames[-1][1]:.3f} s; give the trajectory of this sequence"
                )
            listener(f"{line}: left out")
        return found

    return poses
