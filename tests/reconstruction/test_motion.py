"""A camera that moves steadily is where it was predicted."""

from __future__ import annotations

import numpy as np

from chromaperture.reconstruction.fusion import ConstantVelocity


def test_a_steady_camera_is_predicted_whenever_the_next_frame_comes():
    turned = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])
    start = np.block([[turned, np.array([[10.0], [20.0], [30.0]])], [np.zeros((1, 3)), np.ones((1, 1))]])

    def place(time_s: float) -> np.ndarray:
        """A screw: every step from any of its places is the same in the camera's own frame."""
        angle = 0.3 * time_s
        pose = np.eye(4)
        pose[:3, :3] = [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
        pose[2, 3] = 500 * time_s
        return start @ pose

    motion = ConstantVelocity(place(0.0), 0.0)
    np.testing.assert_allclose(motion.predict(5.0), place(0.0), atol=1e-9)  # rounding; at rest at first
    for seen, then in ((0.1, 0.2), (0.3, 0.35), (0.4, 0.7)):
        motion.update(place(seen), seen)
        np.testing.assert_allclose(motion.predict(then), place(then), atol=1e-9)  # rounding
    np.testing.assert_array_equal(motion.predict(9.0), motion.predict(90.0))  # nobody goes on for ever
    still = ConstantVelocity(place(0.0), 0.0)
    still.update(place(0.1), 0.0)
    np.testing.assert_allclose(still.predict(0.0), place(0.2), atol=1e-9)  # frames without times
