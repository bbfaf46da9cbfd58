"""Write MCAP files with ROS 2 messages, for Foxglove, RViz (ros2 bag) and RTAB-Map."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from chromaperture.depth.error_limit import MAX_RELATIVE_SIGMA, within_error
from chromaperture.products.rectified import View
from chromaperture.system.errors import InputError, needed
from chromaperture.system.storage import staged

_FRAME = "camera_optical_frame"
_HEADER = """
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
_IMAGE = (
    """std_msgs/Header header
uint32 height
uint32 width
string encoding
uint8 is_bigendian
uint32 step
uint8[] data"""
    + _HEADER
)
_CAMERA_INFO = (
    """std_msgs/Header header
uint32 height
uint32 width
string distortion_model
float64[] d
float64[9] k
float64[9] r
float64[12] p
uint32 binning_x
uint32 binning_y
sensor_msgs/RegionOfInterest roi"""
    + _HEADER
    + """
================================================================================
MSG: sensor_msgs/RegionOfInterest
uint32 x_offset
uint32 y_offset
uint32 height
uint32 width
bool do_rectify
"""
)


def write_mcap(
    path: str | Path,
    frames: Iterable[View],
    *,
    camera_matrix: np.ndarray,
    max_relative_sigma: float = MAX_RELATIVE_SIGMA,
) -> int:
    """Write image_rect and camera_info of /camera/color (rgb8), depth (16UC1, mm), sigma and confidence (32FC1).

    Sigma is in metres, as floats are by REP 118.

    Parameters
    ----------
    path : str or Path
    frames : iterable of View
    camera_matrix : (3, 3) float, px
    max_relative_sigma : float
        Largest sigma / depth of the depth, see `within_error`; sigma is whole.

    Returns
    -------
    int
        Frames written.

    Raises
    ------
    MissingDependencyError
        The extra ``ros`` is not installed.
    InputError
        The file cannot be written, the disk is full, or there was no frame.
    """
    writing = needed("mcap_ros2.writer", "MCAP files need the extra: pip install 'chromaperture[ros]'")
    path, count = Path(path), 0
    with staged(path.parent) as stage, stage.path(path.name).open("wb") as file:
        writer = writing.Writer(file)
        image = writer.register_msgdef("sensor_msgs/msg/Image", _IMAGE)
        info = writer.register_msgdef("sensor_msgs/msg/CameraInfo", _CAMERA_INFO)
        for frame in frames:
            sec, nanosec = divmod(frame.time_ns, 10**9)
            header = {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": _FRAME}
            z_mm = within_error(frame.z_mm, frame.sigma_mm, max_relative_sigma)
            size = {"header": header, "height": z_mm.shape[0], "width": z_mm.shape[1]}
            for part, (encoding, pixels) in frame.ros_pictures("16UC1", z_mm).items():
                messages = (
                    ("image_rect", image, size | _image(encoding, pixels)),
                    ("camera_info", info, size | _info(camera_matrix)),
                )
                for name, schema, message in messages:
                    topic = f"/camera/{part}/{name}"
                    writer.write_message(
                        topic, schema, message, log_time=frame.time_ns, publish_time=frame.time_ns, sequence=count
                    )
            count += 1
        writer.finish()
        if not count:
            raise InputError("the source held no frame; nothing was written")
    return count


def _image(encoding: str, pixels: np.ndarray) -> dict[str, Any]:
    step = pixels.shape[1] * pixels.itemsize * (pixels.shape[2] if pixels.ndim == 3 else 1)
    return {"encoding": encoding, "is_bigendian": 0, "step": step, "data": pixels.tobytes()}


def _info(camera_matrix: np.ndarray) -> dict[str, Any]:
    k = [float(v) for v in np.asarray(camera_matrix).ravel()]
    roi = {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False}
    straight = {"distortion_model": "plumb_bob", "d": [0.0] * 5, "k": k, "r": [float(v) for v in np.eye(3).ravel()]}
    p = [*k[:3], 0.0, *k[3:6], 0.0, *k[6:9], 0.0]
    return straight | {"p": p, "binning_x": 0, "binning_y": 0, "roi": roi}
