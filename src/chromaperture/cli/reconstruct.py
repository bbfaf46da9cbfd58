"""``chromaperture reconstruct``."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from chromaperture.cli.console import Update, compile_kernels, print_files, print_json, progress, say_warning
from chromaperture.cli.options import (
    Anyway,
    BlackLevel,
    Camera,
    Device,
    Frames,
    Json,
    MemoryMb,
    Quiet,
    VoxelMm,
    WhiteLevel,
    film_checked,
)
from chromaperture.system.errors import InputError

if TYPE_CHECKING:
    from chromaperture.capture.source import Frame


def reconstruct(
    source: Annotated[
        str, typer.Argument(help="replay:FOLDER, a folder, a glob, a video, or a camera.", metavar="SOURCE")
    ],
    camera: Camera,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for mesh, trajectory and report.")] = Path("model"),
    quality: Annotated[
        str | None, typer.Option(help="paper, real-time or accurate; default accurate where the camera file has it.")
    ] = None,
    device: Device = "auto",
    frames: Frames = None,
    voxel_mm: VoxelMm = None,
    memory_mb: MemoryMb = 512,
    max_distance_mm: Annotated[float, typer.Option(help="Leave out what is farther away.")] = 6000.0,
    max_relative_sigma: Annotated[float, typer.Option(help="Leave out pixels with a wider error bar.")] = 0.08,
    anyway: Anyway = False,
    black_level: BlackLevel = None,
    white_level: WhiteLevel = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Make a 3D model of what a moving camera sees; Ctrl-C ends the sequence and writes the model so far.

    Example: chromaperture reconstruct replay:session/walk --camera camera.asdf --out model
    """
    from chromaperture.cli.setup import camera_for, open_stream
    from chromaperture.model.camera_file import Calibration
    from chromaperture.reconstruction.build_model import reconstruct as build
    from chromaperture.reconstruction.build_model import write_model
    from chromaperture.reconstruction.settings import ReconstructionConfig
    from chromaperture.reconstruction.volume import open3d

    config = ReconstructionConfig(
        voxel_mm=voxel_mm, memory_mb=memory_mb, max_distance_mm=max_distance_mm, max_relative_sigma=max_relative_sigma
    )
    open3d()  # before the work: the extra may be missing
    calibration = Calibration.load(camera)
    if not calibration.is_calibrated:
        raise InputError("a 3D model needs a calibrated camera; make one with 'chromaperture calibrate'")
    quality = quality or ("accurate" if "accurate" in calibration.depth else "real-time")
    eye = camera_for(out, camera, None, quality=quality, config=None, device=device)
    compile_kernels(quality, quiet=quiet)
    stream = open_stream(source, calibration=eye.calibration, black_level=black_level, white_level=white_level)
    with stream, progress(quiet=quiet) as update:
        checked = film_checked(stream, eye, refuse=not anyway)
        total = min(filter(None, (frames, getattr(stream, "total", 0))), default=0)
        announced = _announced(itertools.islice(checked, frames), update, total)
        model = build(announced, eye, config=config, listener=say_warning)
        update("writing the model", 0, 1)
        report, files = write_model(out, model, facts={"source": source, "camera": str(camera), "quality": quality})
    if json:
        print_json(report)
    elif not quiet:
        _print_summary(report)
        print_files(files)


def _announced(frames: Iterable[Frame], update: Update, total: int) -> Iterator[Frame]:
    """Pass frames on, and say what is waited for: the source, or the work on a frame."""
    update("waiting for a frame", 0, total)
    for done, frame in enumerate(frames):
        update(f"measuring and tracking frame {frame.index}", done, total)
        yield frame
        update("waiting for a frame", done + 1, total)


def _print_summary(report: dict[str, Any]) -> None:
    lost = f", {report['frames_lost']} lost" if report["frames_lost"] else ""
    parts = f", {report['submaps']} submaps" if report["submaps"] > 1 else ""
    typer.echo(
        f"{report['frames_tracked']} frames tracked over {report['path_mm']:.0f} mm{lost}{parts}; "
        f"{report['meshes'][0]['triangles']} triangles, voxels of {report['voxel_mm']:.1f} mm"
    )
