"""``chromaperture export``."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from chromaperture.cli.options import BlackLevel, Camera, Device, MaxRelativeSigma, Quality, Quiet, WhiteLevel
from chromaperture.depth.error_limit import MAX_RELATIVE_SIGMA

if TYPE_CHECKING:
    from chromaperture.products.rectified import View


def export(
    source: Annotated[
        str, typer.Argument(help="replay:FOLDER, a folder, a glob, or another source that ends.", metavar="SOURCE")
    ],
    out: Annotated[
        Path, typer.Argument(help="NAME.mcap for ROS 2, else a new folder in the TUM RGB-D layout.", metavar="OUT")
    ],
    camera: Camera,
    quality: Quality = "real-time",
    device: Device = "auto",
    black_level: BlackLevel = None,
    white_level: WhiteLevel = None,
    max_relative_sigma: MaxRelativeSigma = MAX_RELATIVE_SIGMA,
    quiet: Quiet = False,
) -> None:
    """Measure a sequence and write colour, depth, its error bar and confidence, undistorted, for other programs.

    Example: chromaperture export replay:session/walk walk.mcap --camera camera.asdf
    """
    from chromaperture.cli.console import compile_kernels, progress
    from chromaperture.cli.setup import camera_for
    from chromaperture.cli.streams import open_stream
    from chromaperture.products.mcap import write_mcap
    from chromaperture.products.rectified import undistorter
    from chromaperture.products.tum import write_tum

    eye = camera_for(out, camera, None, quality=quality, config=None, device=device)
    to_view = undistorter(eye)
    compile_kernels(quality, quiet=quiet)
    stream = open_stream(source, calibration=eye.calibration, black_level=black_level, white_level=white_level)
    with stream, progress(quiet=quiet) as update:

        def views() -> Iterator[View]:
            for number, frame in enumerate(stream):
                yield to_view(eye.measure(frame.image), frame.time_s, frame.index)
                update(f"frame {frame.index}", number + 1, 0)

        write = write_mcap if out.suffix == ".mcap" else write_tum
        matrix = eye.calibration.lens.camera_matrix
        count = write(out, views(), camera_matrix=matrix, max_relative_sigma=max_relative_sigma)
    if not quiet:
        typer.echo(f"Wrote {count} frames to {out}")
