"""Where a moving camera should be by now: as it went before, for as long as passed."""

from __future__ import annotations

import cv2
import numpy as np

_LONGEST = 3.0  # times the interval that the speed was measured over: farther on, nobody moves steadily


class Speed:
    """Speed of a camera between its last two places.

    Parameters
    ----------
    pose : (4, 4) float
        Camera to world, mm, at first; at rest.
    time_s : float
    """

    def __init__(self, pose: np.ndarray, time_s: float) -> None:
        self._pose, self._time_s, self._interval_s = pose.copy(), time_s, 0.0
        self._step = np.zeros(6)  # rotation vector, translation, in the camera's frame

    def ahead(self, time_s: float) -> np.ndarray:
        """Give the pose that it comes to; frames without times count as evenly spaced."""
        passed = time_s - self._time_s
        share = min(passed / self._interval_s, _LONGEST) if passed > 0 and self._interval_s > 0 else 1.0
        moved = np.eye(4)
        moved[:3, :3] = cv2.Rodrigues(share * self._step[:3])[0]
        moved[:3, 3] = share * self._step[3:]
        return self._pose @ moved

    def met(self, pose: np.ndarray, time_s: float) -> None:
        """Take note of where it is."""
        moved = np.linalg.inv(self._pose) @ pose
        self._step = np.concatenate([cv2.Rodrigues(moved[:3, :3])[0][:, 0], moved[:3, 3]])
        self._pose, self._interval_s, self._time_s = pose.copy(), time_s - self._time_s, time_s
