"""ROS 2 messages of a view as dictionaries of their fields: one text for MCAP files and for nodes; needs no ROS."""

from __future__ import annotations

from typing import Any

import numpy as np

from chromaperture.depth.error_limit import MAX_RELATIVE_SIGMA, within_error
from chromaperture.products.rectified import CAMERA_FRAME, DepthEncoding, View

IMAGE, CAMERA_INFO = "sensor_msgs/msg/Image", "sensor_msgs/msg/CameraInfo"
_SEEN = ("color", "depth")  # what is seen by the camera, and has its camera_info
Messages = dict[str, tuple[str, dict[str, Any]]]


def ros_messages(
    view: View,
    *,
    camera_matrix: np.ndarray,
    depth_encoding: DepthEncoding = "16UC1",
    max_relative_sigma: float = MAX_RELATIVE_SIGMA,
) -> Messages:
    """
    Return the messages of a view by their topics.

    Sigma and confidence have neither ``camera_info`` nor a frame: viewers project every picture of one channel that
    has either, and show error bars as a second surface.

    Parameters
    ----------
    view : View
    camera_matrix : (3, 3) float, px
    depth_encoding : {"16UC1", "32FC1"}
        mm, 0 unknown, or m, NaN unknown (REP 118). Sigma is 32FC1, m.
    max_relative_sigma : float
        Largest sigma / depth of the depth, see `within_error`; sigma is whole.

    Returns
    -------
    dict
        From ``/camera/{color,depth,sigma,confidence}/image_rect`` and ``/camera/{color,depth}/camera_info`` to the
        type's name and its fields, nested dictionaries with all fields of the type.
    """
    stamp = dict(zip(("sec", "nanosec"), divmod(view.time_ns, 10**9), strict=True))
    z_mm = within_error(view.z_mm, view.sigma_mm, max_relative_sigma)
    messages: Messages = {}
    for part, (encoding, pixels) in view.ros_pictures(depth_encoding, z_mm).items():
        head = {"header": {"stamp": stamp, "frame_id": CAMERA_FRAME if part in _SEEN else ""}}
        head |= {"height": pixels.shape[0], "width": pixels.shape[1]}
        image = {"encoding": encoding, "is_bigendian": 0, "step": pixels[0].nbytes, "data": pixels.tobytes()}
        messages[f"/camera/{part}/image_rect"] = (IMAGE, head | image)
        if part in _SEEN:
            messages[f"/camera/{part}/camera_info"] = (CAMERA_INFO, head | _pinhole(camera_matrix))
    return messages


def _pinhole(camera_matrix: np.ndarray) -> dict[str, Any]:
    """Return the fields of a camera without distortion."""
    k = np.asarray(camera_matrix, float).ravel().tolist()
    straight = {"distortion_model": "plumb_bob", "d": [0.0] * 5, "k": k, "r": np.eye(3).ravel().tolist()}
    p = [*k[:3], 0.0, *k[3:6], 0.0, *k[6:9], 0.0]
    roi = {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False}
    return straight | {"p": p, "binning_x": 0, "binning_y": 0, "roi": roi}
