"""From command-line options to a camera."""

from __future__ import annotations

import dataclasses
import tomllib
from pathlib import Path
from typing import Any, cast

from chromaperture.camera import CodedApertureCamera, default_config
from chromaperture.camera_file import Calibration
from chromaperture.capture.files import image_size
from chromaperture.config import Config, Quality
from chromaperture.errors import InputError


def camera_for(
    image: Path, camera: Path | None, design: str | None, *, quality: str, config: Path | None
) -> CodedApertureCamera:
    """Open the camera file, or make an uncalibrated camera of the image's size for a design."""
    if (camera is None) == (design is None):
        raise InputError("give either --camera CAMERA.asdf, or --design NAME for disparity without calibration")
    if camera is not None:
        calibration = Calibration.load(camera)
    else:
        width, height = image_size(image)
        calibration = Calibration.uncalibrated(cast(str, design), width_px=width, height_px=height)
    settings = default_config(calibration, cast(Quality, quality))
    return CodedApertureCamera(calibration, settings if config is None else with_file(settings, config))


def with_file(settings: Config, path: Path) -> Config:
    """Replace settings by those of a TOML file; raises InputError naming what it does not know."""
    try:
        tree = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"cannot read settings {path}: {error}") from None
    changes: dict[str, Any] = {}
    for section, values in tree.items():
        part = getattr(settings, section, None)
        if part is None or not isinstance(values, dict):
            raise InputError(f"{path.name}: unknown section [{section}]; known: [matcher], [depth]")
        known = {f.name: f for f in dataclasses.fields(part)}
        for name, value in values.items():
            if name not in known:
                raise InputError(f"{path.name}: unknown setting {name!r} in [{section}]; known: {', '.join(known)}")
            current = getattr(part, name)
            fits = isinstance(value, bool) if isinstance(current, bool) else isinstance(value, int | float | str)
            if not fits or (isinstance(value, str) != isinstance(current, str)):
                raise InputError(f"{path.name}: {name} must be like {current!r}, is {value!r}")
        changes[section] = dataclasses.replace(part, **values)
    return dataclasses.replace(settings, **changes)
