"""``chromaperture reconstruct``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer


def reconstruct(
    source: Annotated[str, typer.Argument(help="replay:FOLDER, a folder, a glob, a video, or a camera.")],
    camera: Annotated[Path, typer.Option("--camera", "-c", help="Camera file.", metavar="CAMERA.asdf")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for mesh, trajectory and report.")] = Path("model"),
    quality: Annotated[
        str | None, typer.Option(help="paper, real-time or accurate; default accurate where the camera file has it.")
    ] = None,
    frames: Annotated[int | None, typer.Option(min=1, help="Stop after so many frames.")] = None,
    voxel_mm: Annotated[float | None, typer.Option(help="Edge of a voxel; default 1/200 of the distance.")] = None,
    memory_mb: Annotated[int, typer.Option(help="Memory of the volume; bounds what can be reconstructed.")] = 512,
    max_distance_mm: Annotated[float, typer.Option(help="Leave out what is farther away.")] = 6000.0,
    max_relative_sigma: Annotated[float, typer.Option(help="Leave out pixels with a wider error bar.")] = 0.08,
    black_level: Annotated[float | None, typer.Option(help="Counts of no light; default the camera file's.")] = None,
    white_level: Annotated[float | None, typer.Option(help="Counts of a full well; default the camera file's.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but warnings and errors.")] = False,
) -> None:
    """Make a 3D model of what a moving camera sees; Ctrl-C ends the sequence and writes the model so far.

    Example: chromaperture reconstruct replay:session/walk --camera camera.asdf --out model
    """
    import itertools

    from chromaperture.camera_file import Calibration
    from chromaperture.capture.open import open_source
    from chromaperture.capture.source import Event
    from chromaperture.cli.console import announce_compilation, print_files, print_json, progress, say_warning
    from chromaperture.cli.setup import camera_for
    from chromaperture.errors import InputError
    from chromaperture.reconstruction.build_model import reconstruct as build
    from chromaperture.reconstruction.build_model import write_model
    from chromaperture.reconstruction.fusion import Placed
    from chromaperture.reconstruction.settings import ReconstructionConfig
    from chromaperture.reconstruction.volume import open3d

    config = ReconstructionConfig(
        voxel_mm=voxel_mm,
        memory_mb=memory_mb,
        max_distance_mm=max_distance_mm,
        max_relative_sigma=max_relative_sigma,
    )
    open3d()
    calibration = Calibration.load(camera)
    if not calibration.is_calibrated:
        raise InputError("a 3D model needs a calibrated camera; make one with 'chromaperture calibrate'")
    quality = quality or ("accurate" if "accurate" in calibration.depth else "real-time")
    levels = {"black_level": black_level, "white_level": white_level}
    settings: dict[str, Any] = {name: value for name, value in levels.items() if value is not None}
    eye = camera_for(out, camera, None, quality=quality, config=None)
    sensor = calibration.sensor

    def said(event: Event) -> None:
        say_warning(event.message)

    announce_compilation(quiet=quiet or json)
    own = (sensor.black_level, sensor.white_level)
    with (
        open_source(source, listener=said, camera_levels=own, **settings) as stream,
        progress(quiet=quiet or json) as update,
    ):
        done = 0

        def placed(place: Placed) -> None:
            nonlocal done
            done += 1
            update(f"frame {place.index}: {place.note or 'tracked'}"[:60], done, frames or 0)

        taken = itertools.islice(stream, frames)
        model = build(taken, eye, config=config, listener=say_warning, progress=placed)
    facts = {"source": source, "camera": str(camera), "quality": quality}
    report, files = write_model(out, model, facts=facts)
    if json:
        print_json(report)
    elif not quiet:
        lost = f", {report['frames_lost']} lost" if report["frames_lost"] else ""
        parts = f", {report['submaps']} submaps" if report["submaps"] > 1 else ""
        typer.echo(
            f"{report['frames_tracked']} frames tracked over {report['path_mm']:.0f} mm{lost}{parts}; "
            f"{report['meshes'][0]['triangles']} triangles, voxels of {report['voxel_mm']:.1f} mm"
        )
        print_files(files)
