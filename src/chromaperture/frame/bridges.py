"""Hand a frame to other libraries."""

from __future__ import annotations

from typing import Any

import numpy as np

from chromaperture.depth.pointcloud import PointCloud
from chromaperture.frame.depth_frame import DepthFrame
from chromaperture.system.errors import MissingDependencyError


def to_open3d(cloud: PointCloud) -> Any:
    """Convert points to ``open3d.geometry.PointCloud``: metres, colours 0 to 1; x right, y down, z forward.

    Raises MissingDependencyError: the extra ``reconstruct`` is not installed.
    """
    try:
        import open3d
    except ImportError:
        raise MissingDependencyError("Open3D needs the extra: pip install 'chromaperture[reconstruct]'") from None
    made = open3d.geometry.PointCloud()
    made.points = open3d.utility.Vector3dVector(cloud.points_mm.astype(np.float64) / 1000)
    made.colors = open3d.utility.Vector3dVector(cloud.colors.astype(np.float64) / 255)
    return made


def to_xarray(frame: DepthFrame) -> Any:
    """Return the maps of a frame as ``xarray.Dataset``, which holds the arrays themselves, not copies.

    Raises MissingDependencyError: the extra ``xarray`` is not installed.
    """
    try:
        import xarray
    except ImportError:
        raise MissingDependencyError("datasets need the extra: pip install 'chromaperture[xarray]'") from None
    height, width = frame.disparity_px.shape
    maps = {
        "depth_mm": (frame.depth_mm, "mm", "distance from the sensor plane along the optical axis"),
        "sigma_mm": (frame.sigma_mm, "mm", "standard deviation of the depth"),
        "disparity_px": (frame.disparity_px, "px", "half disparity, 0 in focus, + beyond the focus surface"),
        "disparity_sigma_px": (frame.disparity_sigma_px, "px", "standard deviation of the half disparity"),
        "confidence": (frame.confidence, "1", "confidence, 0 to 1"),
    }
    data = {
        name: (("y", "x"), values, {"units": unit, "long_name": meaning})
        for name, (values, unit, meaning) in maps.items()
    }
    picture = {"units": "1", "long_name": "linear RGB, channels aligned, white balanced"}
    pixels = {
        "y": ("y", np.arange(height), {"units": "px", "long_name": "row, 0 is the centre of the topmost pixel"}),
        "x": ("x", np.arange(width), {"units": "px", "long_name": "column, 0 is the centre of the leftmost pixel"}),
    }
    about = {}
    if frame.calibration is not None and frame.config is not None:
        about = {"design": frame.calibration.design, "quality": frame.config.quality}
    return xarray.Dataset(
        data | {"color": (("y", "x", "channel"), frame.color, picture)},
        coords=pixels | {"channel": ["R", "G", "B"]},
        attrs=about,
    )
