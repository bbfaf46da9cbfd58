"""From a source on the command line to a stream of frames."""

from __future__ import annotations

from collections.abc import Callable

from chromaperture.capture.open import open_source
from chromaperture.capture.source import Source
from chromaperture.cli.console import say_warning
from chromaperture.model.camera_file import Calibration


def open_stream(
    source: str,
    *,
    calibration: Calibration | None = None,
    black_level: float | None = None,
    white_level: float | None = None,
    say: Callable[[str], None] = say_warning,
) -> Source:
    """Create a source whose events are printed as warnings; levels override those of the camera and of the file.

    ``say`` receives the events instead, from the thread of the source.
    """
    return open_source(
        source,
        listener=lambda event: say(event.message),
        camera_encoding=None if calibration is None else calibration.sensor.encoding,
        black_level=black_level,
        white_level=white_level,
    )
