"""``chromaperture export``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer


def export(
    source: Annotated[str, typer.Argument(help="replay:FOLDER, a folder, a glob, or another source that ends.")],
    out: Annotated[Path, typer.Argument(help="NAME.mcap for ROS 2, else a new folder in the TUM RGB-D layout.")],
    camera: Annotated[Path, typer.Option("--camera", "-c", help="Camera file.", metavar="CAMERA.asdf")],
    quality: Annotated[str, typer.Option(help="paper, real-time or accurate.")] = "real-time",
    black_level: Annotated[float | None, typer.Option(help="Counts of no light; default the camera file's.")] = None,
    white_level: Annotated[float | None, typer.Option(help="Counts of a full well; default the camera file's.")] = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but warnings and errors.")] = False,
) -> None:
    """Measure a sequence and write colour and depth, undistorted, for other programs.

    Example: chromaperture export replay:session/walk walk.mcap --camera camera.asdf
    """
    from chromaperture.capture.open import open_source
    from chromaperture.capture.source import Event
    from chromaperture.cli.console import announce_compilation, progress, say_warning
    from chromaperture.cli.setup import camera_for
    from chromaperture.products.mcap import write_mcap
    from chromaperture.products.rectified import undistorter
    from chromaperture.products.tum import write_tum

    levels = {"black_level": black_level, "white_level": white_level}
    settings: dict[str, Any] = {name: value for name, value in levels.items() if value is not None}
    eye = camera_for(out, camera, None, quality=quality, config=None)
    matrix, sensor = eye.calibration.lens.camera_matrix, eye.calibration.sensor
    own = (sensor.black_level, sensor.white_level)
    write = write_mcap if out.suffix == ".mcap" else write_tum

    def said(event: Event) -> None:
        say_warning(event.message)

    to_view = undistorter(eye)
    announce_compilation(quiet=quiet)
    with open_source(source, listener=said, camera_levels=own, **settings) as stream, progress(quiet=quiet) as update:

        def frames() -> Any:
            for number, frame in enumerate(stream):
                yield to_view(eye.measure(frame.image), frame.time_s, frame.index)
                update(f"frame {frame.index}", number + 1, 0)

        count = write(out, frames(), camera_matrix=matrix)
    if not quiet:
        typer.echo(f"Wrote {count} frames to {out}")
