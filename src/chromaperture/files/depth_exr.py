"""Depth, error bar and confidence beside the colour, as OpenEXR; needs the extra ``exr``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from chromaperture.system.errors import InputError, needed

# Blender's compositor offers the layers of a render alone: VIEW.PASS.CHANNEL, of one channel V or, of depth, Z.
_LAYERS = {"R": "V.Combined.R", "G": "V.Combined.G", "B": "V.Combined.B", "Z": "V.Depth.Z"}
_LAYERS |= {name: f"V.{name}.V" for name in ("sigma_mm", "confidence")}


def openexr() -> Any:
    """Import OpenEXR; raises MissingDependencyError naming the extra."""
    return needed("OpenEXR", "OpenEXR files need the extra: pip install 'chromaperture[exr]'")


def write_exr(
    path: str | Path,
    *,
    color: np.ndarray,
    depth_mm: np.ndarray,
    sigma_mm: np.ndarray,
    confidence: np.ndarray,
    camera_matrix: np.ndarray,
    sensor_to_pupil_mm: float,
    layers: bool = False,
) -> None:
    """Write linear colour, Z from the pupil, its error bar (mm) and confidence as 32-bit floats, NaN unknown.

    ``layers``: by the names of a render's layers, in place of R, G, B, Z, sigma_mm and confidence.
    """
    exr = openexr()
    channels = {name: color[..., i] for i, name in enumerate("RGB")}
    channels |= {"Z": depth_mm - np.float32(sensor_to_pupil_mm), "sigma_mm": sigma_mm, "confidence": confidence}
    # OpenEXR takes no account of strides: findings/openexr_strides.sh.
    channels = {name: np.ascontiguousarray(values, np.float32) for name, values in channels.items()}
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
    if layers:
        channels = {_LAYERS[name]: values for name, values in channels.items()}
    exr.File(header, channels).write(str(path))


def read_exr(path: str | Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Read depth from the sensor plane, error bar and confidence, (H, W) each, of a file of `write_exr`."""
    exr, path = openexr(), Path(path)
    try:
        with exr.File(str(path), separate_channels=True) as file:
            to_pupil_mm = float(file.header()["sensor_to_pupil_mm"])
            stored = file.channels()
            z, sigma, confidence = (
                np.array(stored[name if name in stored else _LAYERS[name]].pixels, np.float32)
                for name in ("Z", "sigma_mm", "confidence")
            )
    except Exception:  # OpenEXR raises anything on a damaged file
        raise InputError(f"{path.name} is damaged or was not written by chromaperture; write it again") from None
    return z + np.float32(to_pupil_mm), sigma, confidence
