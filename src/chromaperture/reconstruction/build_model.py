"""Reconstruct a model from frames and write its files."""

from __future__ import annotations

import itertools
import time
from collections import Counter
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from chromaperture.camera.camera import CodedApertureCamera
from chromaperture.capture.source import Frame
from chromaperture.color.srgb import srgb_to_linear
from chromaperture.depth.pointcloud import ply_header, ply_vertices
from chromaperture.files.textured_mesh import glb_file
from chromaperture.products.rectified import View, of_stream, undistorter
from chromaperture.reconstruction.fusion import Placed, Reconstruction
from chromaperture.reconstruction.settings import ReconstructionConfig
from chromaperture.reconstruction.volume import Mesh, open3d
from chromaperture.system.errors import InputError
from chromaperture.system.storage import staged, write_json


def reconstruct(
    frames: Iterable[Frame],
    camera: CodedApertureCamera,
    *,
    config: ReconstructionConfig | None = None,
    listener: Callable[[str], None] = lambda line: None,
    progress: Callable[[Placed], None] = lambda placed: None,
) -> Reconstruction:
    """Measure, track and fuse frames until they end, or until Ctrl-C: then return the model so far."""
    open3d()
    camera, frames = of_stream(camera, frames)
    to_view = undistorter(camera)
    model = Reconstruction(camera.calibration.lens.camera_matrix, config, listener=listener)
    try:
        for frame in frames:
            progress(model.add(to_view(camera.measure(frame.image), frame.time_s, frame.index)))
    except KeyboardInterrupt:
        listener(f"interrupted after {len(model.placed)} frames; writing the model of these")
    if not model.placed:
        raise InputError("the source held no frame; there is nothing to reconstruct")
    if not any(frame.pose is not None for frame in model.placed):
        raise InputError(f"no frame could be used: {model.placed[-1].note.removeprefix('lost: ')}")
    return model


def write_model(
    folder: str | Path, model: Reconstruction, *, facts: dict[str, Any] | None = None
) -> tuple[dict[str, Any], list[Path]]:
    """Write meshes (PLY, GLB), ``trajectory.txt`` and ``report.json``; returns the report and the files."""
    folder, began = Path(folder), time.perf_counter()
    report = (facts or {}) | summary(model)
    sizes = []
    with staged(folder) as stage:
        for number, mesh in zip(model.roots, model.meshes(), strict=True):
            sizes.append({"submap": number, "vertices": len(mesh.vertices_mm), "triangles": len(mesh.triangles)})
            if len(mesh.triangles) == 0:
                continue
            name = f"mesh_{number}" if number else "mesh"
            write_mesh_ply(stage.path(f"{name}.ply"), mesh)
            stage.path(f"{name}.glb").write_bytes(glb(mesh))
        write_trajectory(stage.path("trajectory.txt"), [model.in_root(frame) for frame in model.placed])
        report |= {"meshes": sizes, "seconds_to_write": round(time.perf_counter() - began, 3)}
        write_json(stage.path("report.json"), report)
        files = [folder / name for name in stage.names]
    return report, files


def summary(model: Reconstruction) -> dict[str, Any]:
    """Collect the figures of a reconstruction, units in the names."""
    tracked = [frame for frame in model.placed if frame.pose is not None]
    path_mm = sum(
        float(np.linalg.norm(b.pose[:3, 3] - a.pose[:3, 3]))
        for a, b in itertools.pairwise(tracked)
        if a.submap == b.submap and a.pose is not None and b.pose is not None
    )
    volume = model.current.volume if model.current else None
    return {
        "frames": len(model.placed),
        "frames_tracked": len(tracked),
        "frames_lost": len(model.placed) - len(tracked),
        "submaps": len(model.submaps),
        "submaps_joined": sum(submap.root != number for number, submap in enumerate(model.submaps)),
        "path_mm": path_mm,
        "voxel_mm": volume.voxel_mm if volume else None,
        "blocks": volume.blocks if volume else 0,
        "blocks_capacity": volume.capacity if volume else 0,
        "volume_full": bool(volume and volume.full),
        "median_overlap": float(np.median([p.overlap for p in tracked])) if tracked else None,
        "median_likeness": float(np.median([p.correlation for p in tracked])) if tracked else None,
        "per_frame": [
            {"index": p.index, "time_s": p.time_s, "submap": p.submap, "overlap": p.overlap, "note": p.note}
            for p in model.placed
        ],
    }


class Tracker:
    """Poses of views that are seen one by one, for exports; raises MissingDependencyError without Open3D."""

    def __init__(self, camera_matrix: np.ndarray, *, listener: Callable[[str], None] = lambda line: None) -> None:
        open3d()
        self._model = Reconstruction(camera_matrix, None, listener=listener)
        self._listener = listener

    def see(self, view: View) -> None:
        """Track one more view."""
        self._model.add(view)

    def poses(self, frames: list[tuple[int, float]]) -> dict[int, np.ndarray]:
        """Return poses (4, 4), mm, by index, of the largest part of the frames that has one world."""
        placed = [self._model.in_root(p) for p in self._model.placed]
        tracked = [p for p in placed if p.pose is not None]
        if not tracked:
            return {}
        root, _ = Counter(p.submap for p in tracked).most_common(1)[0]
        found = {p.index: p.pose for p in tracked if p.submap == root and p.pose is not None}
        if len(found) < len(frames):
            self._listener(f"{len(frames) - len(found)} of {len(frames)} frames have no pose with the others: left out")
        return found


def write_mesh_ply(path: Path, mesh: Mesh) -> None:
    """Write a binary PLY in mm: vertices with 8-bit colours, and triangles."""
    vertices = ply_vertices(mesh.vertices_mm, mesh.colors)
    faces = np.empty(len(mesh.triangles), dtype=[("n", "u1"), ("corners", "<i4", 3)])
    faces["n"], faces["corners"] = 3, mesh.triangles
    unit = "mm; axes of the first camera: x right, y down, z forward"
    lists = f"element face {len(faces)}", "property list uchar int vertex_indices"
    path.write_bytes(ply_header(len(vertices), unit, *lists) + vertices.tobytes() + faces.tobytes())


def glb(mesh: Mesh) -> bytes:
    """Return the content of a binary glTF 2.0 file: metres, y up, z backward, linear colours, as it requires."""
    positions = (mesh.vertices_mm * np.array([1, -1, -1], np.float32) / 1000).astype("<f4")
    colors = np.full((len(positions), 4), 65535, "<u2")
    levels = np.rint(srgb_to_linear(np.arange(256, dtype=np.float32) / 255) * 65535)
    colors[:, :3] = levels.astype("<u2")[mesh.colors]
    indices = mesh.triangles.astype("<u4").ravel()
    corner = {"min": positions.min(axis=0).tolist(), "max": positions.max(axis=0).tolist()} if len(positions) else {}
    tree = {
        "asset": {"version": "2.0", "generator": "chromaperture"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "COLOR_0": 1}, "indices": 2, "material": 0}]}],
        "materials": [{"doubleSided": True, "pbrMetallicRoughness": {"metallicFactor": 0, "roughnessFactor": 1}}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": len(positions), "type": "VEC3", **corner},
            {"bufferView": 1, "componentType": 5123, "normalized": True, "count": len(colors), "type": "VEC4"},
            {"bufferView": 2, "componentType": 5125, "count": len(indices), "type": "SCALAR"},
        ],
    }
    return glb_file(tree, [positions, colors, indices])  # each a multiple of four bytes, as the format requires


def write_trajectory(path: Path, placed: Iterable[Placed]) -> None:
    """Write ``time tx ty tz qx qy qz qw`` in seconds and metres, camera (centre of the entrance pupil) to world."""
    lines = ["# time_s tx ty tz qx qy qz qw  (m, entrance pupil to world; lost frames are left out)"]
    submap = 0
    for frame in placed:
        if frame.submap != submap and frame.pose is not None:
            submap = frame.submap
            lines.append(f"# submap {submap}: a new origin")
        if frame.pose is not None:
            numbers = [*(frame.pose[:3, 3] / 1000), *quaternion(frame.pose[:3, :3])]
            lines.append(f"{frame.time_s:.6f} " + " ".join(f"{value:.7f}" for value in numbers))
    path.write_text("\n".join(lines) + "\n", encoding="ascii")


def quaternion(rotation: np.ndarray) -> np.ndarray:
    """Return (x, y, z, w) of a rotation matrix, w >= 0."""
    from scipy.spatial.transform import Rotation

    q = Rotation.from_matrix(rotation).as_quat()
    return q if q[3] >= 0 else -q
