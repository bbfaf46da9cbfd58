"""``chromaperture live``."""

from __future__ import annotations

import contextlib
import math
import socket
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from chromaperture.app.free_space import RESERVE_BYTES
from chromaperture.app.live.watchdog import WATCHDOG_S, Watchdog
from chromaperture.cli.console import compile_kernels, other_quality, print_json, say_warning
from chromaperture.cli.options import (
    BlackLevel,
    Camera,
    Device,
    Json,
    MaxRelativeSigma,
    MemoryMb,
    Quality,
    Quiet,
    Seconds,
    VoxelMm,
    WhiteLevel,
)
from chromaperture.depth.error_limit import MAX_RELATIVE_SIGMA

if TYPE_CHECKING:
    from chromaperture.app.live.loop import LiveLoop
    from chromaperture.app.live.page import LivePage
    from chromaperture.camera.camera import CodedApertureCamera
    from chromaperture.products.foxglove_stream import FoxgloveStream


def live(
    source: Annotated[str, typer.Argument(help="webcam:0, pylon:SERIAL, 'replay:FOLDER?speed=1&loop=1', ...")],
    camera: Camera,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of snapshots and recordings.")] = Path("live"),
    quality: Quality = "real-time",
    device: Device = "auto",
    host: Annotated[
        str,
        typer.Option(
            help="Address to listen on; 127.0.0.1 is this machine only, 0.0.0.0 all its addresses. Whoever has the "
            "whole address that is printed controls the page; it travels unencrypted."
        ),
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(help="Port; the next free one is taken.")] = 8080,
    page: Annotated[bool, typer.Option("--page/--no-page", help="Serve the page; without it, only measure.")] = True,
    stream: Annotated[
        str | None,
        typer.Option(
            help="Stream to robotics tools (Foxglove's protocol) from HOST:PORT, such as 127.0.0.1:8765, or into a new "
            "file NAME.mcap. Whoever reaches the address sees the pictures: it has no token.",
            metavar="ADDRESS",
        ),
    ] = None,
    stream_depth: Annotated[
        str, typer.Option(help="Depth in the stream, by REP 118: 16UC1 in mm, or 32FC1 in m.")
    ] = "16UC1",
    model: Annotated[bool, typer.Option("--model/--no-model", help="Track the camera and build a 3D model.")] = True,
    seconds: Seconds = None,
    voxel_mm: VoxelMm = None,
    memory_mb: MemoryMb = 512,
    black_level: BlackLevel = None,
    white_level: WhiteLevel = None,
    max_relative_sigma: MaxRelativeSigma = MAX_RELATIVE_SIGMA,
    keep_free_gb: Annotated[
        float, typer.Option(min=0, help="GiB of the disk that recordings and snapshots leave free.")
    ] = RESERVE_BYTES / 2**30,
    watchdog_seconds: Annotated[
        float, typer.Option(help="Name a stage that has not finished for so long, and go on; inf: never.")
    ] = WATCHDOG_S,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Show depth, colour and a growing 3D model of a running camera, in the browser, until Ctrl-C.

    Example: chromaperture live "webcam:0?exposure_us=5000" --camera camera.asdf
    """
    from chromaperture.app.gate import is_every_address
    from chromaperture.app.listening import require_extra
    from chromaperture.app.live.loop import FUSE_EVERY, LiveLoop
    from chromaperture.app.live.page import LivePage
    from chromaperture.cli.options import film_doubts
    from chromaperture.cli.setup import camera_for, open_stream
    from chromaperture.reconstruction.settings import ReconstructionConfig

    if page:
        require_extra()  # before the work: it may be missing
    config = ReconstructionConfig(voxel_mm=voxel_mm, memory_mb=memory_mb, fuse_every=FUSE_EVERY)
    eye = camera_for(out, camera, None, quality=quality, config=None, device=device)
    compile_kernels(quality, quiet=quiet)
    began = time.monotonic()
    levels = {"black_level": black_level, "white_level": white_level}
    loops: list[LiveLoop] = []  # none while the source is being opened

    def say(line: str) -> None:
        (loops[0].say_rarely if loops else say_warning)(line)

    stream_to: Any = None if stream is None else _foxglove(stream, eye, stream_depth, max_relative_sigma)
    frames = open_stream(source, calibration=eye.calibration, say=say, **levels)
    watchdog = Watchdog(watchdog_seconds, listener=say)
    with watchdog, contextlib.ExitStack() as opened:
        with watchdog.stage("source"):  # a driver may hang at once
            opened.enter_context(frames)
        loop = LiveLoop(
            frames,
            eye,
            track=model,
            config=config,
            listener=say_warning,
            reserve_bytes=int(keep_free_gb * 2**30),
            watchdog=watchdog,
            on_first=lambda frame: film_doubts(eye, frame.image, "the first frame"),
        )
        loops.append(loop)
        limits = {"max_relative_sigma": max_relative_sigma}
        shown = LivePage(loop, host=host, port=port, out=out, **limits) if page else None
        if shown is not None:  # with --quiet too: without its token nobody can open the page
            typer.echo(f"Look at this address; Ctrl-C ends it:\n\n    {shown.url}\n", err=json or quiet)
            if not (json or quiet):
                typer.echo(f"Quality {quality}. {other_quality(eye, per='frame')}".rstrip())
            if is_every_address(host):
                elsewhere = shown.access.url(shown.port, host=socket.gethostname())
                typer.echo(f"From other machines: {elsewhere}", err=json or quiet)
        if stream_to is not None:
            from chromaperture.app.live.loop import Streaming

            opened.enter_context(stream_to)
            opened.enter_context(Streaming(loop, stream_to))
            typer.echo(f"Streaming to {stream_to.url}", err=json or quiet)
        _run(loop, shown, began + (math.inf if seconds is None else seconds))
    if loop.failure is not None:
        raise loop.failure
    if json:
        print_json({"seconds": time.monotonic() - began, "stages": loop.figures()})
    elif not quiet:
        _print_stages(loop.figures())


def _foxglove(target: str, eye: CodedApertureCamera, depth: str, max_relative_sigma: float) -> FoxgloveStream:
    """Open a stream; what is missing or wrong is said before the work."""
    from chromaperture.products.foxglove_stream import FoxgloveStream

    return FoxgloveStream(
        target,
        camera_matrix=eye.calibration.lens.camera_matrix,
        depth_encoding=cast(Any, depth),
        max_relative_sigma=max_relative_sigma,
    )


def _run(loop: LiveLoop, page: LivePage | None, end: float) -> None:
    """Run until the source ends, a stage fails, the monotonic clock shows ``end``, or Ctrl-C."""

    def over() -> bool:
        return time.monotonic() >= end

    try:
        with loop:
            if page is not None:
                page.run(until=over)
            while not loop.over.wait(0.1) and not over() and loop.failure is None:
                pass
            if page is not None and loop.failure is None and not over():
                typer.echo("That was the last frame; the page stays open until Ctrl-C", err=True)
                while not over():
                    time.sleep(0.1)
    except KeyboardInterrupt:
        pass  # the usual way to stop
    finally:
        if page is not None:
            page.close()


def _print_stages(figures: dict[str, Any]) -> None:
    for name, stage in figures.items():
        typer.echo(
            f"{name:9} {stage['frames']:6} frames  {stage['per_second']:6.1f}/s  {stage['milliseconds']:6.0f} ms  "
            f"{stage['latency_ms']:6.0f} ms behind  {stage['dropped']} dropped"
        )
