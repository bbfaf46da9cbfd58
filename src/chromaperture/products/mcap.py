"""Write MCAP files with ROS 2 messages, for Foxglove, RViz (ros2 bag) and RTAB-Map."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from chromaperture.depth.error_limit import MAX_RELATIVE_SIGMA
from chromaperture.products.rectified import View
from chromaperture.products.ros_messages import CAMERA_INFO, IMAGE, ros_messages
from chromaperture.system.errors import InputError, needed
from chromaperture.system.storage import staged

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
_DEFINITIONS = {
    IMAGE: """std_msgs/Header header
uint32 height
uint32 width
string encoding
uint8 is_bigendian
uint32 step
uint8[] data"""
    + _HEADER,
    CAMERA_INFO: """std_msgs/Header header
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
""",
}


def write_mcap(
    path: str | Path,
    frames: Iterable[View],
    *,
    camera_matrix: np.ndarray,
    max_relative_sigma: float = MAX_RELATIVE_SIGMA,
) -> int:
    """Write the messages of `ros_messages`, depth in whole mm.

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
        schemas = {kind: writer.register_msgdef(kind, text) for kind, text in _DEFINITIONS.items()}
        for frame in frames:
            at = {"log_time": frame.time_ns, "publish_time": frame.time_ns, "sequence": count}
            found = ros_messages(frame, camera_matrix=camera_matrix, max_relative_sigma=max_relative_sigma)
            for topic, (kind, message) in found.items():
                writer.write_message(topic, schemas[kind], message, **at)
            count += 1
        writer.finish()
        if not count:
            raise InputError("the source held no frame; nothing was written")
    return count
