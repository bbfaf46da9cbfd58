"""From command-line options to a camera and to a stream of frames."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Literal, cast

from chromaperture.camera.camera import CodedApertureCamera
from chromaperture.camera.method import default_config, photograph_quality
from chromaperture.capture.files import image_size
from chromaperture.capture.open import open_source
from chromaperture.capture.source import Source
from chromaperture.cli.console import say_warning
from chromaperture.color.encoding import NOTHING_STATED, StatedFacts
from chromaperture.model.camera_file import Calibration
from chromaperture.settings.methods import Quality
from chromaperture.settings.toml_file import with_file
from chromaperture.system.errors import InputError


def camera_for(
    image: Path,
    camera: Path | None,
    design: str | None,
    *,
    quality: str | None,
    config: Path | None,
    scale: int | Literal["auto"] = "auto",
    crop_origin_px: tuple[int, int] | None = None,
    device: str = "auto",
    stated: StatedFacts = NOTHING_STATED,
) -> CodedApertureCamera:
    """Open the camera file, or make an uncalibrated camera of the image's size for a design."""
    if (camera is None) == (design is None):
        raise InputError("give either --camera CAMERA.asdf, or --design NAME for disparity without calibration")
    if camera is not None:
        calibration = with_stated(Calibration.load(camera), stated)
    else:
        width, height = image_size(image, stated)
        uncalibrated = Calibration.uncalibrated(cast(str, design), width_px=width, height_px=height)
        calibration = with_stated(uncalibrated, stated)
    if crop_origin_px is not None and camera is None:
        raise InputError("--crop-origin is a place in the frame of a calibrated camera: give its file with --camera")
    chosen = cast(Quality, quality) if quality else photograph_quality(calibration)
    settings = replace(default_config(calibration, chosen, scale=scale), crop_origin_px=crop_origin_px)
    return CodedApertureCamera(calibration, settings if config is None else with_file(settings, config), device=device)


def stated_facts(siting: str | None, primaries: str | None, mosaic: str | None) -> StatedFacts:
    """Return what options say of files; raises InputError for a value that is none of the known."""
    return StatedFacts(cast(Any, siting), cast(Any, primaries), cast(Any, mosaic))


def with_stated(calibration: Calibration, stated: StatedFacts) -> Calibration:
    """Return a camera of whose files these facts are stated, too."""
    known = stated.or_else(calibration.sensor.encoding.stated)
    return replace(calibration, sensor=replace(calibration.sensor, **asdict(known)))


def open_stream(
    source: str,
    *,
    calibration: Calibration | None = None,
    black_level: float | None = None,
    white_level: float | None = None,
    say: Callable[[str], None] = say_warning,
) -> Source:
    """Create a source whose events go to ``say``, from its thread; levels override the camera's and the file's."""
    sensor = None if calibration is None else calibration.sensor
    return open_source(
        source,
        listener=lambda event: say(event.message),
        camera_encoding=None if sensor is None else sensor.encoding,
        camera_size_px=None if sensor is None else (sensor.width_px, sensor.height_px),
        black_level=black_level,
        white_level=white_level,
    )
