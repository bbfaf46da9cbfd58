"""``chromaperture record``."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated, Any

import typer


def record(
    source: Annotated[str, typer.Argument(help="webcam:0, aravis:SERIAL, gphoto2, a folder, 'a glob' or a video.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the recording; must not hold one yet.")],
    frames: Annotated[int | None, typer.Option(min=1, help="Stop after so many frames.")] = None,
    seconds: Annotated[float | None, typer.Option(min=0.0, help="Stop after so long.")] = None,
    black_level: Annotated[float | None, typer.Option(help="Counts of no light, for files.")] = None,
    white_level: Annotated[float | None, typer.Option(help="Counts of a full well, for files.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but warnings and errors.")] = False,
) -> None:
    """Record frames without loss until the source ends or Ctrl-C; what is counted is on the disk.

    Example: chromaperture record "webcam:0?exposure_us=5000" --out session/walk
    """
    from chromaperture.capture.open import open_source
    from chromaperture.capture.recording import Recorder
    from chromaperture.capture.source import Event
    from chromaperture.cli.console import print_json, progress, say_warning

    levels = {"black_level": black_level, "white_level": white_level}
    settings: dict[str, Any] = {name: value for name, value in levels.items() if value is not None}

    def said(event: Event) -> None:
        say_warning(event.message)

    began, count, dropped = time.monotonic(), 0, 0
    with (
        open_source(source, listener=said, **settings) as stream,
        Recorder(out, source=source) as recorder,
        progress(quiet=quiet or json) as update,
    ):
        try:
            for frame in stream:
                recorder.write(frame)
                update(f"frame {frame.index}", recorder.count, frames or 0)
                if recorder.count == frames or (seconds is not None and time.monotonic() - began >= seconds):
                    break
        except KeyboardInterrupt:
            pass  # the usual way to stop
        count, dropped = recorder.count, stream.dropped
    if json:
        print_json({"frames": count, "dropped": dropped, "seconds": time.monotonic() - began, "folder": str(out)})
    elif not quiet:
        lost = f", {dropped} came too fast for the disk" if dropped else ""
        typer.echo(f"Recorded {count} frames{lost} to {out}; open it with replay:{out}")
