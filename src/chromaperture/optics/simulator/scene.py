"""Scenes for the renderer: textured planes in the camera frame, made in code or read from a short TOML file."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
from pydantic import Field

from chromaperture.optics.simulator import textures
from chromaperture.system.errors import InputError
from chromaperture.system.validation import Name, Table, checked, quoted, read_toml

LARGEST_MM = 1e7  # of a scene: 10 km
_MOST_PLANES = 200  # of a scene file; each is a picture of a megapixel


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
    """Place a linear picture, a fourth channel is coverage, in the scene, turned about x, then y, then z."""
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
    """Read a scene file; raises InputError."""
    path = Path(path)
    if not os.path.lexists(path):
        raise InputError(f"no scene file {quoted(path)}")
    return scene_from_dict(read_toml(path), folder=path.parent)


_Place = Annotated[float, Field(ge=-LARGEST_MM, le=LARGEST_MM)]
_Length = Annotated[float, Field(gt=0, le=LARGEST_MM)]
_Angle = Annotated[float, Field(ge=-360, le=360)]
_Fraction = Annotated[float, Field(ge=0, le=1)]


class _PlaneTable(Table):
    """``[[plane]]`` of a scene file."""

    center_mm: tuple[_Place, _Place, _Length]  # z in front of the camera
    width_mm: _Length
    height_mm: _Length | None = None
    tilt_deg: tuple[_Angle, _Angle, _Angle] = (0.0, 0.0, 0.0)
    texture: Name = "speckle"
    texel_mm: _Length | None = None
    color: tuple[_Fraction, _Fraction, _Fraction] = (0.6, 0.6, 0.6)
    seed: Annotated[int, Field(ge=0, lt=2**63)] | None = None


class _SceneTable(Table):
    """A scene file."""

    plane: Annotated[tuple[_PlaneTable, ...], Field(max_length=_MOST_PLANES)] = ()


def scene_from_dict(data: Mapping[str, Any], *, folder: Path | None = None) -> list[Plane]:
    """Build a scene from ``[[plane]]`` tables.

    Each has ``center_mm`` and ``width_mm``, optional ``height_mm``, ``tilt_deg``, ``color``, ``seed``,
    ``texel_mm``, and a ``texture``: ``plain``, ``speckle``, ``clouds``, ``chessboard``, or the name of a
    picture beside the scene file.

    Raises InputError: see `load_scene`.
    """
    planes = []
    for number, table in enumerate(checked(_SceneTable, dict(data), where="the scene").plane, start=1):
        picture = textures.named(
            table.texture,
            width_mm=table.width_mm,
            height_mm=table.width_mm if table.height_mm is None else table.height_mm,
            texel_mm=table.width_mm / 1024 if table.texel_mm is None else table.texel_mm,
            color=table.color,
            seed=number if table.seed is None else table.seed,
            folder=folder,
        )
        planes.append(plane(picture, center_mm=table.center_mm, width_mm=table.width_mm, tilt_deg=table.tilt_deg))
    if not planes:
        raise InputError("the scene has no [[plane]]")
    return planes
