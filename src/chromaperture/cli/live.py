"""``chromaperture live``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer


def live(
    source: Annotated[str, typer.Argument(help="webcam:0, aravis:SERIAL, 'replay:FOLDER?speed=1&loop=1', ...")],
    camera: Annotated[Path, typer.Option("--camera", "-c", help="Camera file.", metavar="CAMERA.asdf")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of snapshots and recordings.")] = Path("live"),
    quality: Annotated[str, typer.Option(help="paper, real-time or accurate.")] = "real-time",
    host: Annotated[str, typer.Option(help="Address to listen on; 127.0.0.1 is this machine only.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(help="Port; the next free one is taken.")] = 8080,
    page: Annotated[bool, typer.Option("--page/--no-page", help="Serve the page; without it, only measure.")] = True,
    model: Annotated[bool, typer.Option("--model/--no-model", help="Track the camera and build a 3D model.")] = True,
    seconds: Annotated[float | None, typer.Option(min=0.0, help="Stop after so long.")] = None,
    voxel_mm: Annotated[float | None, typer.Option(help="Edge of a voxel; default 1/200 of the distance.")] = None,
    memory_mb: Annotated[int, typer.Option(help="Memory of the volume.")] = 512,
    black_level: Annotated[float | None, typer.Option(help="Counts of no light; default the camera file's.")] = None,
    white_level: Annotated[float | None, typer.Option(help="Counts of a full well; default the camera file's.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON at the end.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but warnings and errors.")] = False,
) -> None:
    """Depth, colour and a growing 3D model of a running camera, in the browser, until Ctrl-C.

    Example: chromaperture live "webcam:0?exposure_us=5000" --camera camera.asdf
    """
    import time

    from chromaperture.capture.open import open_source
    from chromaperture.capture.source import Event
    from chromaperture.cli.console import announce_compilation, print_json, say_warning
    from chromaperture.cli.setup import camera_for
    from chromaperture.reconstruction.settings import ReconstructionConfig
    from chromaperture.viewer.loop import LiveLoop
    from chromaperture.viewer.page import LivePage, viser

    if page:
        viser()
    config = ReconstructionConfig(voxel_mm=voxel_mm, memory_mb=memory_mb)
    levels = {"black_level": black_level, "white_level": white_level}
    settings: dict[str, Any] = {name: value for name, value in levels.items() if value is not None}
    eye = camera_for(out, camera, None, quality=quality, config=None)
    own = (eye.calibration.sensor.black_level, eye.calibration.sensor.white_level)

    def said(event: Event) -> None:
        say_warning(event.message)

    announce_compilation(quiet=quiet or json)
    began = time.monotonic()

    def enough() -> bool:
        return seconds is not None and time.monotonic() - began >= seconds

    with open_source(source, listener=said, camera_levels=own, **settings) as stream:
        loop = LiveLoop(stream, eye, track=model, config=config, listener=say_warning)
        shown = LivePage(loop, host=host, port=port, out=out, say=say_warning) if page else None
        try:
            with loop:
                if shown is not None:
                    if not quiet and not json:
                        typer.echo(f"Look at {shown.url}; Ctrl-C ends it")
                    shown.run(until=enough)
                while not loop.over.wait(0.1) and not enough() and loop.failure is None:
                    pass
        except KeyboardInterrupt:
            pass  # the usual way to stop
        finally:
            if shown is not None:
                shown.close()
    if loop.failure is not None:
        raise loop.failure
    figures = loop.figures()
    if json:
        print_json({"seconds": time.monotonic() - began, "stages": figures})
    elif not quiet:
        for name, stage in figures.items():
            typer.echo(
                f"{name:9} {stage['frames']:6} frames  {stage['per_second']:6.1f}/s  {stage['milliseconds']:6.0f} ms  "
                f"{stage['latency_ms']:6.0f} ms behind  {stage['dropped']} dropped"
            )
