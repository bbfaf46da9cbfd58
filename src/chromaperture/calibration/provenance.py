"""Record of how a camera file was made."""

from __future__ import annotations

import datetime
import hashlib
import os
from collections.abc import Iterable
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

import cv2
import numba
import numpy as np

from chromaperture.calibration.calibration_config import CalibrationConfig
from chromaperture.capture.exif import read_model
from chromaperture.capture.picture_format import PictureFormat, described
from chromaperture.capture.shots import is_photograph
from chromaperture.model.camera_file import Calibration


def origin(
    folder: Path,
    files: Iterable[Path],
    config: CalibrationConfig,
    *,
    command: str | None,
    lens_from: Calibration | None,
    form: PictureFormat | None = None,
    developed: bool | None = None,
) -> dict[str, Any]:
    """Record what a calibration was made from.

    Parameters
    ----------
    folder : Path
        Of the session; the files' names are relative to it.
    files : iterable of Path
        Everything that was read.
    config : CalibrationConfig
    command : str, optional
        Command line, if there was one.
    lens_from : Calibration, optional
        The camera that the lens was taken from.
    form : PictureFormat, optional
        Of the photographs.
    developed : bool, optional
        Whether a colour matrix was applied to the photographs.

    Returns
    -------
    dict of str to plain values
        ``command`` is absent without one, ``camera_model`` where no photograph names it, ``developed`` where nothing
        tells; ``files`` are SHA-256 hashes by name.
    """
    made: dict[str, Any] = described(form) | ({} if command is None else {"command": command})
    lens = None
    if lens_from is not None:
        lens = {"design": lens_from.design, "date": lens_from.provenance.get("date"),
                "focal_length_mm": lens_from.lens.focal_length_mm}  # fmt: skip
    files = list(files)
    model = next(filter(None, map(read_model, filter(is_photograph, files))), None)
    if model is not None:
        made["camera_model"] = model
    if developed is not None:
        made["developed"] = developed
    return made | {
        "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
        "versions": {
            "chromaperture": version("chromaperture"),
            "numpy": np.__version__,
            "numba": numba.__version__,
            "opencv": cv2.__version__,
        },
        "options": asdict(config),
        "lens_from": lens,
        "files": {
            Path(os.path.relpath(path, folder)).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
            for path in files
        },
    }
