"""Predict the pose of a moving camera at constant velocity."""

from __future__ import annotations

import cv2
import numpy as np

_MAX_RATIO = 3.0  # of the predicted interval to the one that the velocity was measured over; chosen by hand


class ConstantVelocity:
    """Motion of a camera between its last two poses.

    ``pose`` (4, 4) float: first pose, camera to world, mm; at rest.
    """

    def __init__(self, pose: np.ndarray, time_s: float) -> None:
        self._pose, self._time_s, self._interval_s = pose.copy(), time_s, 0.0
        self._step = np.zeros(6)  # rotation vector, translation, in the camera's frame

    def predict(self, time_s: float) -> np.ndarray:
        """Return the pose at a time; frames without times count as evenly spaced."""
        passed = time_s - self._time_s
        ratio = min(passed / self._interval_s, _MAX_RATIO) if passed > 0 and self._interval_s > 0 else 1.0
        moved = np.eye(4)
        moved[:3, :3] = cv2.Rodrigues(ratio * self._step[:3])[0]
        moved[:3, 3] = ratio * self._step[3:]
        return self._pose @ moved

    def update(self, pose: np.ndarray, time_s: float) -> None:
        """Add a measured pose."""
        moved = np.linalg.inv(self._pose) @ pose
        self._step = np.concatenate([cv2.Rodrigues(moved[:3, :3])[0][:, 0], moved[:3, 3]])
        self._pose, self._interval_s, self._time_s = pose.copy(), time_s - self._time_s, time_s
