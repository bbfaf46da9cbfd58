"""What commands ask of their files before the work: outputs that replace no input, and photographs through the film."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from chromaperture.system.errors import CaptureWarning, InputError

if TYPE_CHECKING:
    import numpy as np

    from chromaperture.camera.camera import CodedApertureCamera
    from chromaperture.capture.source import Frame


def check_output(path: Path, *suffixes: str, inputs: Iterable[Path | None] = (), option: str = "--out") -> None:
    """Refuse a file to write that has another suffix, or that is one of the inputs.

    Raises InputError: with the option to change.
    """
    if suffixes and path.suffix.lower() not in suffixes:
        raise InputError(f"{option} {path.name} must end in {' or '.join(suffixes)}")
    for given in inputs:
        if given is not None and path.exists() and given.exists() and os.path.samefile(path, given):
            raise InputError(f"{option} {path.name} would replace an input, {given.name}; choose another name")


def check_film(camera: CodedApertureCamera, image: np.ndarray, name: str, *, refuse: bool = True) -> None:
    """Warn of a photograph that is unlikely to be taken through the camera's film; refuse one that cannot be.

    Raises InputError: the film is certainly another one, and ``refuse``.
    """
    if line := film_doubts(camera, image, name, refuse=refuse):
        warnings.warn(line, CaptureWarning, stacklevel=2)


def film_checked(frames: Iterable[Frame], camera: CodedApertureCamera, *, refuse: bool = True) -> Iterator[Frame]:
    """Pass frames on; the first is checked, see `check_film`."""
    for number, frame in enumerate(frames):
        if not number:
            check_film(camera, frame.image, "the first frame", refuse=refuse)
        yield frame


def film_doubts(camera: CodedApertureCamera, image: np.ndarray, name: str, *, refuse: bool = False) -> str:
    """Return what speaks against the camera's film in a photograph, one line; empty where nothing does.

    Raises InputError: as `check_film`.
    """
    from chromaperture.evaluation.health import film_match
    from chromaperture.matching.working_scale import reduced
    from chromaperture.model.scale import at_scale

    if not camera.shows_frame_at(image.shape[1::-1]):
        return ""  # without a film to compare with; the size is refused later
    camera = camera.at_size(*image.shape[1::-1])
    calibration = camera.calibration
    working = at_scale(calibration, camera.config.scale)
    if working is not calibration:
        image = reduced(image, (working.sensor.width_px, working.sensor.height_px))
    match = film_match(image, working)
    if not match.doubts:
        return ""
    title = calibration.aperture.title
    if match.is_wrong and refuse:
        raise InputError(
            f"{name} was not taken through this camera's film ({title}): {' and '.join(match.findings)}; give the "
            "camera file of the film that was in the lens, or --anyway"
        )
    sure = "was not" if match.is_wrong else "may not have been"
    return (
        f"{name} {sure} taken through this camera's film ({title}): {' and '.join(match.findings)}; with another film "
        "every distance is wrong. Strongly coloured light looks similar"
    )
