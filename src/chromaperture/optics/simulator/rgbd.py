"""RGB-D pictures from files: a colour picture and a 16-bit depth map of the same size."""

from __future__ import annotations

import os
from pathlib import Path

import cv2
import numpy as np

from chromaperture.optics.simulator.textures import srgb_to_linear
from chromaperture.system.errors import InputError
from chromaperture.system.storage import natural

_UNKNOWN = (0, 65535)  # counts of unknown depth, as depth cameras write it


def read_rgbd(
    color_path: Path, depth_path: Path, *, depth_unit_mm: float = 1.0, sensor_to_pupil_mm: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Read a colour picture and its depth.

    ``color_path``: 8-bit sRGB picture, or 16-bit linear; ``depth_path``: one channel of 16 bits; 0 and 65535 are
    unknown; ``depth_unit_mm``: millimetres a count; ``sensor_to_pupil_mm``: added to the depth: depth cameras measure
    from their pinhole, this package from the sensor plane. Returns ``color`` (H, W, 3) float32, linear, 1.0 = white;
    ``depth_mm`` (H, W) float32, from the sensor plane, NaN unknown. Raises InputError: a file that cannot be read,
    depth that is not 16 bit, sizes that differ.
    """
    color = _read(color_path, cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH)
    depth = _read(depth_path, cv2.IMREAD_UNCHANGED)
    if depth.ndim != 2 or depth.dtype != np.uint16:
        raise InputError(f"{depth_path} must hold one channel of 16 bits (mm by default), got {depth.dtype}")
    if color.shape[:2] != depth.shape:
        raise InputError(f"colour {color.shape[:2]} and depth {depth.shape} differ in size: register them first")
    white = 255.0 if color.dtype == np.uint8 else 65535.0
    value = color[..., ::-1].astype(np.float32) / np.float32(white)
    if color.dtype == np.uint8:
        value = srgb_to_linear(value)
    known = ~np.isin(depth, _UNKNOWN)
    depth_mm = np.where(known, depth * np.float32(depth_unit_mm) + np.float32(sensor_to_pupil_mm), np.nan)
    return np.ascontiguousarray(value, np.float32), depth_mm.astype(np.float32)


def _read(path: Path, flags: int) -> np.ndarray:
    picture = cv2.imread(str(path), flags) if path.is_file() else None
    if picture is None:
        raise InputError(f"cannot read {path} as a picture")
    return np.asarray(picture)


def rgbd_pairs(folder: Path) -> list[tuple[Path, Path]]:
    """Find colour pictures and their depth: NAME.color.* with NAME.depth.png, or rgb/ and depth/ in equal order."""
    if not os.path.isdir(folder):
        raise InputError(f"no RGB-D sequence or scene file at {folder}")
    if (folder / "rgb").is_dir() and (folder / "depth").is_dir():
        colors, depths = (sorted((folder / part).iterdir(), key=natural) for part in ("rgb", "depth"))
        if len(colors) != len(depths):
            raise InputError(f"{folder} holds {len(colors)} pictures in rgb/ and {len(depths)} in depth/")
        pairs = list(zip(colors, depths, strict=True))
    else:
        found = ((p, folder / f"{p.name.split('.color.')[0]}.depth.png") for p in folder.glob("*.color.*"))
        pairs = sorted(((c, d) for c, d in found if d.is_file()), key=lambda pair: natural(pair[0]))
    if not pairs:
        raise InputError(f"{folder} holds no NAME.color.* with NAME.depth.png, nor rgb/ and depth/")
    return pairs
