"""Poses of a sequence whose views are seen one by one, for exports; the model itself is thrown away."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

import numpy as np

from chromaperture.products.rectified import View
from chromaperture.reconstruction.fusion import Reconstruction
from chromaperture.reconstruction.volume import open3d


class Tracker:
    """Track views; `poses` answers when all have been seen.

    Parameters
    ----------
    camera_matrix : (3, 3) float, px
    listener : callable, optional
        Receives messages for the user, one line each.

    Raises
    ------
    MissingDependencyError
        The extra ``reconstruct`` is not installed.
    """

    def __init__(self, camera_matrix: np.ndarray, *, listener: Callable[[str], None] = lambda line: None) -> None:
        open3d()
        self._model = Reconstruction(camera_matrix, None, listener=listener)
        self._listener = listener

    def see(self, view: View) -> None:
        """Track one more view."""
        self._model.add(view)

    def poses(self, frames: list[tuple[int, float]]) -> dict[int, np.ndarray]:
        """Return the poses of frames by their index: (4, 4), camera to world, mm.

        Only of the largest part of the sequence that has one world frame; the others are left out, with a message.
        """
        placed = [self._model.in_root(p) for p in self._model.placed]
        tracked = [p for p in placed if p.pose is not None]
        if not tracked:
            return {}
        root, _ = Counter(p.submap for p in tracked).most_common(1)[0]
        found = {p.index: p.pose for p in tracked if p.submap == root and p.pose is not None}
        if len(found) < len(frames):
            self._listener(f"{len(frames) - len(found)} of {len(frames)} frames have no pose with the others: left out")
        return found
