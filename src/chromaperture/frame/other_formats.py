"""One frame in the formats of other programs: what each is given of the frame and its camera."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from chromaperture.color.srgb import linear_to_srgb_bytes
from chromaperture.depth.error_limit import within_error
from chromaperture.frame.depth_frame import DepthFrame
from chromaperture.system.errors import InputError


def write_format(name: str, path: Path, frame: DepthFrame, *, max_relative_sigma: float) -> None:
    """Write ``gdepth``, ``dynamic-depth``, ``exr``, ``glb`` or ``usdz`` of a frame.

    ``name``: of `OUTPUTS`; ``frame``: of a calibrated camera; ``max_relative_sigma``: largest sigma / depth of all but
    ``exr``, which is whole. Raises InputError: the frame has no depth in mm, or nothing is left within the limit.
    Raises MissingDependencyError: the format's extra is not installed.
    """
    if frame.calibration is None or frame.config is None or not frame.calibration.is_calibrated:
        raise InputError(f"{name} needs a frame of a calibrated camera; make one with 'chromaperture calibrate'")
    lens = frame.calibration.lens
    matrix, to_pupil_mm = lens.camera_matrix, frame.calibration.depth[frame.config.quality].sensor_to_pupil_mm
    if name == "exr":
        from chromaperture.files.depth_exr import write_exr

        write_exr(
            path, color=frame.color, depth_mm=frame.depth_mm, sigma_mm=frame.sigma_mm, confidence=frame.confidence,
            camera_matrix=matrix, sensor_to_pupil_mm=to_pupil_mm,
        )  # fmt: skip
        return
    z_mm = within_error(frame.depth_mm, frame.sigma_mm, max_relative_sigma) - np.float32(to_pupil_mm)
    color = linear_to_srgb_bytes(frame.color)
    if name in ("gdepth", "dynamic-depth"):
        from chromaperture.files.depth_photo import dynamic_depth_jpeg, encode_depth, gdepth_jpeg

        encoded = encode_depth(z_mm, frame.confidence)
        is_gdepth = name == "gdepth"
        path.write_bytes(
            gdepth_jpeg(color, encoded) if is_gdepth else dynamic_depth_jpeg(color, encoded, camera_matrix=matrix)
        )
        return
    from chromaperture.files.textured_mesh import textured_mesh

    mesh = textured_mesh(z_mm, color, camera_matrix=matrix, distortion=lens.distortion)
    if name == "glb":
        from chromaperture.files.depth_glb import glb_bytes

        path.write_bytes(glb_bytes(mesh))
    else:
        from chromaperture.files.depth_usdz import write_usdz

        write_usdz(path, mesh)
