"""From a source on the command line to a stream of frames."""

from __future__ import annotations

from chromaperture.camera import CodedApertureCamera
from chromaperture.capture.open import open_source
from chromaperture.capture.source import Source
from chromaperture.cli.console import say_warning


def open_stream(
    source: str,
    *,
    camera: CodedApertureCamera | None = None,
    black_level: float | None = None,
    white_level: float | None = None,
) -> Source:
    """Create a source whose events are printed as warnings; levels override those of the camera and of the file."""
    levels = {"black_level": black_level, "white_level": white_level}
    given = {name: value for name, value in levels.items() if value is not None}
    sensor = None if camera is None else camera.calibration.sensor
    own = None if sensor is None else (sensor.black_level, sensor.white_level)
    return open_source(source, listener=lambda event: say_warning(event.message), camera_levels=own, **given)
