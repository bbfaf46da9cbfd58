"""Store the camera's path for the page, in bounded memory."""

from __future__ import annotations

import numpy as np

_MAX_POINTS = 2000


class Trail:
    """Positions of a camera, evenly thinned: when there are too many, every second is kept, then every fourth.

    Attributes
    ----------
    points_mm : list of (3,) float64
        A new list after every change, so that another thread may read it.
    """

    def __init__(self, most: int = _MAX_POINTS) -> None:
        self.points_mm: list[np.ndarray] = []
        self._most, self._step, self._count = most, 1, 0

    def add(self, point_mm: np.ndarray) -> None:
        """Add a position, unless it is thinned out."""
        if self._count % self._step == 0:
            points = [*self.points_mm, point_mm.copy()]
            if len(points) > self._most:
                points, self._step = points[::2], 2 * self._step
            self.points_mm = points
        self._count += 1
