"""Reconstruct a model from frames and write its files."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from chromaperture.camera.camera import CodedApertureCamera
from chromaperture.capture.source import Frame
from chromaperture.products.rectified import of_stream, undistorter
from chromaperture.reconstruction.fusion import Placed, Reconstruction
from chromaperture.reconstruction.model_files import glb, write_mesh_ply, write_trajectory
from chromaperture.reconstruction.settings import ReconstructionConfig
from chromaperture.reconstruction.volume import open3d
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
    """Measure, track and fuse frames until they end, or until Ctrl-C: then return the model so far.

    ``camera``: calibrated; ``listener``: receives messages for the user, one line each; ``progress``: receives the
    result of every frame. Raises MissingDependencyError: the extra ``reconstruct`` is not installed. Raises InputError:
    a camera that was never calibrated, no frame, or none with depth.
    """
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
    """Write ``mesh.ply`` and ``.glb`` (``mesh_N.*`` of submaps not joined), ``trajectory.txt`` and ``report.json``.

    Returns the report and the files; raises InputError when the folder cannot be written to.
    """
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
