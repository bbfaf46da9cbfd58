"""``chromaperture record``."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from chromaperture.cli.console import print_json, progress
from chromaperture.cli.options import BlackLevel, Frames, Json, Quiet, Seconds, WhiteLevel

if TYPE_CHECKING:
    from chromaperture.capture.source import Source


def record(
    source: Annotated[
        str, typer.Argument(help="webcam:0, pylon:SERIAL, gphoto2, a folder, 'a glob' or a video.", metavar="SOURCE")
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the recording; must not hold one yet.")],
    camera: Annotated[
        Path | None,
        typer.Option("--camera", "-c", help="Camera file, for the levels to record.", metavar="CAMERA.asdf"),
    ] = None,
    frames: Frames = None,
    seconds: Seconds = None,
    black_level: BlackLevel = None,
    white_level: WhiteLevel = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Record frames without loss until the source ends or Ctrl-C; counted frames are on the disk.

    Example: chromaperture record "webcam:0?exposure_us=5000" --out session/walk
    """
    from chromaperture.capture.recording import Recorder
    from chromaperture.capture.source import FrameCounts
    from chromaperture.cli.setup import open_stream
    from chromaperture.model.camera_file import Calibration

    calibration = None if camera is None else Calibration.load(camera)
    began = time.monotonic()
    with (
        open_stream(source, calibration=calibration, black_level=black_level, white_level=white_level) as stream,
        Recorder(out, source=source) as recorder,
        progress(quiet=quiet) as update,
        _stopping(stream, seconds),
    ):
        try:
            for frame in stream:
                recorder.write(frame)
                update(f"frame {frame.index}", recorder.count, frames or 0)
                if recorder.count == frames or (seconds is not None and time.monotonic() - began >= seconds):
                    break
        except KeyboardInterrupt:
            pass  # the usual way to stop
    count, dropped, counts = recorder.count, stream.dropped, getattr(stream, "counts", FrameCounts())
    if json:
        missing = {"incomplete": counts.incomplete, "lost": counts.lost}
        took = {"seconds": time.monotonic() - began, "folder": str(out)}
        print_json({"frames": count, "dropped": dropped} | missing | took)
    elif not quiet:
        lost = f", {dropped} came too fast for the disk" if dropped else ""
        lost += f", {counts.incomplete} arrived incomplete" if counts.incomplete else ""
        lost += f", {counts.lost} did not arrive" if counts.lost else ""
        typer.echo(f"Recorded {count} frames{lost} to {out}; open it with replay:{out}")


@contextlib.contextmanager
def _stopping(stream: Source, seconds: float | None) -> Iterator[None]:
    """End a live stream at its time although no frame comes."""
    from chromaperture.capture.threaded_source import LiveSource

    if seconds is None or not isinstance(stream, LiveSource):
        yield
        return
    timer = threading.Timer(seconds, stream.stop)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
