"""Write the files of a reconstruction: mesh as PLY and GLB, trajectory in the TUM format."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from chromaperture.color.srgb import srgb_to_linear
from chromaperture.reconstruction.fusion import Placed
from chromaperture.reconstruction.volume import Mesh


def write_mesh_ply(path: Path, mesh: Mesh) -> None:
    """Write a binary PLY in mm: vertices with 8-bit colours, and triangles."""
    vertices = np.empty(len(mesh.vertices_mm), dtype=[("xyz", "<f4", 3), ("rgb", "u1", 3)])
    vertices["xyz"], vertices["rgb"] = mesh.vertices_mm, mesh.colors
    faces = np.empty(len(mesh.triangles), dtype=[("n", "u1"), ("corners", "<i4", 3)])
    faces["n"], faces["corners"] = 3, mesh.triangles
    lines = [
        "ply",
        "format binary_little_endian 1.0",
        "comment unit: mm; axes of the first camera: x right, y down, z forward",
        f"element vertex {len(vertices)}",
        *(f"property float {n}" for n in "xyz"),
        *(f"property uchar {n}" for n in ("red", "green", "blue")),
        f"element face {len(faces)}",
        "property list uchar int vertex_indices",
        "end_header\n",
    ]
    path.write_bytes("\n".join(lines).encode("ascii") + vertices.tobytes() + faces.tobytes())


def glb(mesh: Mesh) -> bytes:
    """Return the content of a binary glTF 2.0 file: metres, y up, z backward, linear colours, as it requires."""
    positions = (mesh.vertices_mm * np.array([1, -1, -1], np.float32) / 1000).astype("<f4")
    colors = np.full((len(positions), 4), 65535, "<u2")
    levels = np.rint(srgb_to_linear(np.arange(256, dtype=np.float32) / 255) * 65535)
    colors[:, :3] = levels.astype("<u2")[mesh.colors]
    indices = mesh.triangles.astype("<u4").ravel()
    parts, views, at = (positions, colors, indices), [], 0  # each a multiple of four bytes, as the format requires
    for data, target in zip(parts, (34962, 34962, 34963), strict=True):  # vertex data, vertex data, indices
        views.append({"buffer": 0, "byteOffset": at, "byteLength": data.nbytes, "target": target})
        at += data.nbytes
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
        "bufferViews": views,
        "buffers": [{"byteLength": at}],
    }
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    header = struct.pack("<4sII", b"glTF", 2, 12 + 8 + len(text) + 8 + at)
    texts = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", at, b"BIN\0")
    return b"".join([header, texts, *(part.data for part in parts)])  # one copy: a model has many megabytes


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
