"""Scenes for the renderer: textured planes in the camera frame, made in code or read from a short TOML file."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from chromaperture.errors import InputError
from chromaperture.optics import textures


@dataclass(frozen=True)
class Plane:
    """A textured rectangle."""

    texture: np.ndarray  # (h, w, 4) float32; linear R, G, B reflectance and coverage (opaque where >= 0.5)
    center_mm: np.ndarray  # (3,) float64; camera frame: x right, y down, z forward from the sensor plane
    right: np.ndarray  # (3,) float64; unit vector along the texture's rows
    down: np.ndarray  # and along its columns
    texel_mm: float


def plane(
    texture: np.ndarray, *, center_mm: Sequence[float], width_mm: float, tilt_deg: Sequence[float] = (0.0, 0.0, 0.0)
) -> Plane:
    """Place a picture in the scene.

    Parameters
    ----------
    texture : (h, w, 3) or (h, w, 4) float
        Linear; a fourth channel is coverage.
    center_mm : (3,)
        Camera frame, z from the sensor plane.
    width_mm : float
    tilt_deg : (3,)
        Turns about x, then y, then z.

    Raises
    ------
    InputError
        Wrong shape, or a width that is not positive.
    """
    texture = np.asarray(texture, np.float32)
    if texture.ndim != 3 or texture.shape[2] not in (3, 4) or min(texture.shape[:2]) < 2:
        raise InputError(f"a texture needs the shape (height, width, 3 or 4), got {texture.shape}")
    if not width_mm > 0 or len(center_mm) != 3 or len(tilt_deg) != 3:
        raise InputError("a plane needs a positive width_mm, center_mm = [x, y, z] and tilt_deg = [x, y, z]")
    if texture.shape[2] == 3:
        texture = np.dstack([texture, np.ones(texture.shape[:2], np.float32)])
    rotation = np.eye(3)
    for axis, angle in enumerate(tilt_deg):
        vector = np.zeros(3)
        vector[axis] = math.radians(angle)
        rotation = cv2.Rodrigues(vector)[0] @ rotation
    return Plane(
        texture=np.ascontiguousarray(texture),
        center_mm=np.asarray(center_mm, float),
        right=rotation[:, 0],
        down=rotation[:, 1],
        texel_mm=width_mm / texture.shape[1],
    )


def load_scene(path: str | Path) -> list[Plane]:
    """Read a scene file.

    Raises
    ------
    InputError
        Missing or malformed file, unknown texture, a plane behind the camera.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"no scene file {path}")
    try:
        return scene_from_dict(tomllib.loads(path.read_text(encoding="utf-8")), folder=path.parent)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path} is not valid TOML: {error}") from None


def scene_from_dict(data: Mapping[str, Any], *, folder: Path | None = None) -> list[Plane]:
    """Build a scene from ``[[plane]]`` tables.

    Each has ``center_mm`` and ``width_mm``, optional ``height_mm``, ``tilt_deg``, ``color``, ``seed``,
    ``texel_mm``, and a ``texture``: ``plain``, ``speckle``, ``clouds``, ``chessboard``, or the name of a
    picture beside the scene file.

    Raises
    ------
    InputError
        See `load_scene`.
    """
    planes = []
    for number, table in enumerate(data.get("plane", ()), start=1):
        try:
            center, width = [float(v) for v in table["center_mm"]], float(table["width_mm"])
        except (KeyError, TypeError, ValueError):
            raise InputError(f"plane {number} of the scene needs center_mm = [x, y, z] and width_mm") from None
        if not (len(center) == 3 and center[2] > 0):
            raise InputError(f"plane {number} of the scene lies behind the camera: z in center_mm must be positive")
        picture = textures.named(
            str(table.get("texture", "speckle")),
            width_mm=width,
            height_mm=float(table.get("height_mm", width)),
            texel_mm=float(table.get("texel_mm", width / 1024)),
            color=tuple(table.get("color", (0.6, 0.6, 0.6))),
            seed=int(table.get("seed", number)),
            folder=folder,
        )
        planes.append(plane(picture, center_mm=center, width_mm=width, tilt_deg=table.get("tilt_deg", (0.0, 0.0, 0.0))))
    if not planes:
        raise InputError("the scene has no [[plane]]")
    return planes
