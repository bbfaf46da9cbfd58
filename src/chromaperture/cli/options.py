"""Options of several subcommands, declared once."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but warnings and errors.")]
Json = Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")]
Camera = Annotated[Path, typer.Option("--camera", "-c", help="Camera file.", metavar="CAMERA.asdf")]
CameraOrDesign = Annotated[
    Path | None,
    typer.Option("--camera", "-c", help="Camera file from 'chromaperture calibrate'.", metavar="CAMERA.asdf"),
]
Design = Annotated[
    str | None, typer.Option(help="Without a camera file: name of the aperture design; disparity without depth in mm.")
]
Quality = Annotated[str, typer.Option(help="paper, real-time, or accurate, which takes about 40 s a megapixel.")]
BlackLevel = Annotated[float | None, typer.Option(help="Counts of no light; default the camera file's.")]
WhiteLevel = Annotated[float | None, typer.Option(help="Counts of a full well; default the camera file's.")]
MaxRelativeSigma = Annotated[
    float,
    typer.Option(help="Largest sigma/depth in what carries no error bar (points, PNG, TUM, MCAP); inf keeps all."),
]

Frames = Annotated[int | None, typer.Option(min=1, help="Stop after so many frames.")]
Seconds = Annotated[float | None, typer.Option(min=0.0, help="Stop after so long.")]
VoxelMm = Annotated[float | None, typer.Option(help="Edge of a voxel; default 1/200 of the distance.")]
MemoryMb = Annotated[int, typer.Option(help="Memory of the volume; bounds what can be reconstructed.")]

Aperture = Annotated[str, typer.Option(help="Design, or a .toml or .svg file of your own.")]
Film = Annotated[str, typer.Option(help="ideal, real or leaky; own files keep their film.")]
Lens = Annotated[str, typer.Option(help="Lens that comes with the package, or a .toml file.")]
FocusMm = Annotated[float, typer.Option(help="Focus distance from the sensor, mm; inf allowed.")]
Width = Annotated[int, typer.Option(help="Image width, px.")]
SensorWidthMm = Annotated[float, typer.Option(help="Width of the sensor, mm.")]
Seed = Annotated[int, typer.Option(help="Seed of the noise, and of the ruler errors of a session.")]
