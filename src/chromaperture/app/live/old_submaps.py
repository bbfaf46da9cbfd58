"""Bound the memory of submaps that no longer grow: a camera that is lost often begins one after another."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from chromaperture.reconstruction.fusion import Reconstruction, Submap
from chromaperture.reconstruction.tracking import Keyframe
from chromaperture.reconstruction.volume import Mesh


def forget_old(model: Reconstruction, most_bytes: int, *, listener: Callable[[str], None] = lambda line: None) -> None:
    """Empty the oldest submaps until meshes and keyframes of those that no longer grow fit into the memory.

    Their numbers stay, so that no other submap changes its own.

    Parameters
    ----------
    model : Reconstruction
        Changed.
    most_bytes : int
    listener : callable, optional
        Receives a line when a submap is emptied.
    """
    left = most_bytes
    for number in reversed(range(len(model.submaps) - 1)):
        submap = model.submaps[number]
        left -= _bytes_of(submap)
        if left < 0 and submap.keyframes:
            submap.keyframes = []
            submap.mesh = Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32), np.zeros((0, 3), np.uint8))
            listener(f"submap {number} is forgotten: older submaps take more than --memory-mb")


def _bytes_of(submap: Submap) -> int:
    mesh = submap.mesh
    vertices = 0 if mesh is None else mesh.vertices_mm.nbytes + mesh.triangles.nbytes + mesh.colors.nbytes
    return vertices + sum(_keyframe_bytes(key) for key in submap.keyframes)


def _keyframe_bytes(key: Keyframe) -> int:
    return sum(array.nbytes for array in (key.thumbnail, key.grey, key.z_mm, key.sigma_mm))
