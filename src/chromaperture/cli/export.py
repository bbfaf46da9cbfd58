"""``chromaperture export``."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from chromaperture.cli.console import compile_kernels, other_quality, progress, say_warning
from chromaperture.cli.options import (
    Anyway,
    BlackLevel,
    Camera,
    Device,
    MaxRelativeSigma,
    Quality,
    Quiet,
    WhiteLevel,
    check_film,
)
from chromaperture.depth.error_limit import MAX_RELATIVE_SIGMA
from chromaperture.system.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from chromaperture.products.rectified import View

_FORMATS = ("tum", "mcap", "colmap", "nerfstudio", "open3d")
_POSED = ("colmap", "nerfstudio")


def export(
    source: Annotated[
        str, typer.Argument(help="replay:FOLDER, a folder, a glob, or another source that ends.", metavar="SOURCE")
    ],
    out: Annotated[
        Path, typer.Argument(help="NAME.mcap for ROS 2, else a new folder in the TUM RGB-D layout.", metavar="OUT")
    ],
    camera: Camera,
    format: Annotated[
        str | None,
        typer.Option(
            help="tum, mcap, open3d (RGB-D folder), colmap or nerfstudio (with poses); default by the name OUT.",
            autocompletion=lambda: list(_FORMATS),
        ),
    ] = None,
    trajectory: Annotated[
        Path | None,
        typer.Option(help="Poses for colmap and nerfstudio, TUM format; default: tracked, as 'reconstruct' does."),
    ] = None,
    trajectory_limit_s: Annotated[
        float, typer.Option(help="Most seconds between a frame and the poses of --trajectory around it.")
    ] = 0.02,  # `POSE_LIMIT_S`
    quality: Quality = "real-time",
    device: Device = "auto",
    anyway: Anyway = False,
    black_level: BlackLevel = None,
    white_level: WhiteLevel = None,
    max_relative_sigma: MaxRelativeSigma = MAX_RELATIVE_SIGMA,
    quiet: Quiet = False,
) -> None:
    """Measure a sequence and write colour, depth, its error bar and confidence, undistorted, for other programs.

    chromaperture export replay:session/walk walk.mcap --camera camera.asdf

    chromaperture export replay:session/walk walk --camera camera.asdf --format nerfstudio
    """
    from chromaperture.cli.setup import camera_for, open_stream
    from chromaperture.products.rectified import of_stream, undistorter

    chosen = format or ("mcap" if out.suffix == ".mcap" else "tum")
    if chosen not in _FORMATS:
        raise InputError(f"unknown format {chosen!r}: choose {', '.join(_FORMATS)}")
    if trajectory is not None and chosen not in _POSED:
        raise InputError(f"{chosen} holds no poses; give --trajectory with {' or '.join(_POSED)}")
    eye = camera_for(out, camera, None, quality=quality, config=None, device=device)
    undistorter(eye)  # refuses a camera that was never calibrated before anything is compiled
    _writer(chosen, eye.calibration.lens.camera_matrix, trajectory, trajectory_limit_s)
    compile_kernels(quality, quiet=quiet)
    stream = open_stream(source, calibration=eye.calibration, black_level=black_level, white_level=white_level)
    with stream, progress(quiet=quiet) as update:
        eye, frames = of_stream(eye, stream)
        matrix = eye.calibration.lens.camera_matrix
        write, see = _writer(chosen, matrix, trajectory, trajectory_limit_s)
        to_view = undistorter(eye)

        def views() -> Iterator[View]:
            written = 0
            for frame in frames:
                try:
                    measured = eye.measure(frame.image)
                except InputError as error:
                    if not written:
                        raise
                    say_warning(f"frame {frame.index} is left out: {error}")
                    continue
                if not written:
                    check_film(eye, frame.image, "the first frame", refuse=not anyway)
                view = to_view(measured, frame.time_s, frame.index)
                see(view)
                yield view
                written += 1
                update(f"frame {frame.index}", written, 0)

        count = write(out, views(), camera_matrix=matrix, max_relative_sigma=max_relative_sigma)
    if not quiet:
        typer.echo(f"Wrote {count} frames to {out} at quality {quality}. {other_quality(eye, per='frame')}".rstrip())
        if chosen == "open3d":
            typer.echo(
                "Fuse them with Open3D's VoxelBlockGrid (ScalableTSDFVolume of 0.20 fuses nothing); depth_max is 3 m"
            )


def _writer(
    chosen: str, matrix: np.ndarray, trajectory: Path | None, limit_s: float
) -> tuple[Callable[..., int], Callable[[View], None]]:
    """Return the function that writes a format, and what sees every view before; missing extras are said here."""
    if chosen == "tum":
        from chromaperture.products.posed_sequence import write_tum

        return write_tum, lambda view: None
    if chosen == "mcap":
        from chromaperture.products.mcap import write_mcap

        return write_mcap, lambda view: None
    from chromaperture.products.posed_sequence import read_trajectory, write_posed

    form: Any = chosen
    if chosen == "open3d":
        return partial(write_posed, form=form), lambda view: None
    if trajectory is not None:
        poses = read_trajectory(trajectory, limit_s=limit_s, listener=say_warning)
        return partial(write_posed, form=form, poses=poses), lambda view: None
    from chromaperture.reconstruction.build_model import Tracker

    tracker = Tracker(matrix, listener=say_warning)
    return partial(write_posed, form=form, poses=tracker.poses), tracker.see
