"""Depth, error bar and confidence beside the colour, as OpenEXR; needs the extra ``exr``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from chromaperture.system.errors import InputError, MissingDependencyError


def openexr() -> Any:
    """Import OpenEXR; raises MissingDependencyError naming the extra."""
    try:
        import OpenEXR
    except ImportError:
        raise MissingDependencyError("OpenEXR files need the extra: pip install 'chromaperture[exr]'") from None
    return OpenEXR


def write_exr(
    path: str | Path,
    *,
    color: np.ndarray,
    depth_mm: np.ndarray,
    sigma_mm: np.ndarray,
    confidence: np.ndarray,
    camera_matrix: np.ndarray,
    sensor_to_pupil_mm: float,
) -> None:
    """Write linear colour (R, G, B), depth (Z) and its error bar and confidence as 32-bit floats, NaN unknown.

    Z is in mm from the entrance pupil along the axis, as programs that composite take it; the units stand in the names
    of the other channels and in the header.

    ``color`` (H, W, 3) float, linear RGB; ``depth_mm``, ``sigma_mm`` (H, W) float, mm; depth from the sensor plane;
    ``confidence`` (H, W) float in [0, 1]; ``camera_matrix`` (3, 3) float, px. Raises MissingDependencyError: the extra
    ``exr`` is not installed.
    """
    exr = openexr()
    z_mm = np.asarray(depth_mm, np.float32) - np.float32(sensor_to_pupil_mm)
    channels = {name: np.ascontiguousarray(color[..., i], np.float32) for i, name in enumerate("RGB")}
    channels |= {"Z": z_mm, "sigma_mm": np.asarray(sigma_mm, np.float32),
                 "confidence": np.asarray(confidence, np.float32)}  # fmt: skip
    header = {
        "compression": exr.ZIP_COMPRESSION,
        "type": exr.scanlineimage,
        "comments": "Z, sigma_mm: mm from the entrance pupil along the optical axis; NaN unknown; colour: linear, sRGB "
        "primaries",
        "depth_unit": "mm",
        "sensor_to_pupil_mm": float(sensor_to_pupil_mm),
        "focal_length_x_px": float(camera_matrix[0, 0]),
        "focal_length_y_px": float(camera_matrix[1, 1]),
        "principal_point_x_px": float(camera_matrix[0, 2]),
        "principal_point_y_px": float(camera_matrix[1, 2]),
    }
    exr.File(header, channels).write(str(path))


def read_exr(path: str | Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Read depth from the sensor plane, its error bar (mm) and confidence of a file that `write_exr` wrote.

    Returns (H, W) float32 each, NaN unknown. Raises MissingDependencyError: the extra ``exr`` is not installed. Raises
    InputError: the file is damaged, or another program's.
    """
    exr, path = openexr(), Path(path)
    try:
        with exr.File(str(path), separate_channels=True) as file:
            to_pupil_mm = float(file.header()["sensor_to_pupil_mm"])
            z, sigma, confidence = (
                np.array(file.channels()[name].pixels, np.float32) for name in ("Z", "sigma_mm", "confidence")
            )
    except Exception:  # OpenEXR raises anything on a damaged file
        raise InputError(f"{path.name} is damaged or was not written by chromaperture; write it again") from None
    return z + np.float32(to_pupil_mm), sigma, confidence
