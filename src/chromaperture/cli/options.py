"""Options of several subcommands, declared once, and what they ask of files before the work."""

from __future__ import annotations

import os
import re
import warnings
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from typer.core import TyperCommand, TyperGroup

from chromaperture.depth.error_limit import checked_limit
from chromaperture.system.errors import CaptureWarning, InputError

if TYPE_CHECKING:
    import numpy as np

    from chromaperture.camera.camera import CodedApertureCamera
    from chromaperture.capture.source import Frame


class _PlainSwitches:
    """Switches show no type in the help: they take no value."""

    def get_params(self, ctx: Any) -> list[Any]:
        """Return the parameters."""
        parameters: list[Any] = super().get_params(ctx)  # type: ignore[misc]
        for parameter in parameters:
            if getattr(parameter, "is_flag", False):
                parameter.metavar = ""
        return parameters


class Command(_PlainSwitches, TyperCommand):
    """A command."""


class Commands(_PlainSwitches, TyperGroup):
    """A group of commands."""


Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but warnings and errors.")]
Anyway = Annotated[bool, typer.Option("--anyway", help="Measure even through a film that is not the camera's.")]
Verbose = Annotated[bool, typer.Option("--verbose", help="Print the time of every stage, too.")]
Json = Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")]


def _may_be_camera(path: Path | None) -> Path | None:
    """Refuse what is no camera file, before the libraries that read one are loaded."""
    from chromaperture.model.file_kind import camera_file_at

    return None if path is None else camera_file_at(path)


_FILE: dict[str, Any] = {"metavar": "CAMERA.asdf", "callback": _may_be_camera}
Camera = Annotated[Path, typer.Option("--camera", "-c", help="Camera file.", **_FILE)]
CameraOrDesign = Annotated[
    Path | None, typer.Option("--camera", "-c", help="Camera file from 'chromaperture calibrate'.", **_FILE)
]


def _design_names() -> list[str]:
    from chromaperture.optics.aperture import DESIGNS

    return list(DESIGNS)


Design = Annotated[
    str | None,
    typer.Option(
        help="Without a camera file: name of the aperture design; disparity without depth in mm.",
        autocompletion=_design_names,
    ),
]
_QUALITY = typer.Option(
    help="accurate, the default of photographs, which takes seconds of each; real-time, that of streams; or paper.",
    autocompletion=lambda: ["paper", "real-time", "accurate"],
)
Quality = Annotated[str, _QUALITY]
PhotographQuality = Annotated[str | None, _QUALITY]  # None: the best that the camera was calibrated for
Device = Annotated[
    str,
    typer.Option(
        help="auto, a GPU where there is one; cpu; gpu; or gpu:NAME, of 'chromaperture info --devices'.",
        autocompletion=lambda: ["auto", "cpu", "gpu"],
    ),
]
Scale = Annotated[
    str,
    typer.Option(
        help="Working scale: auto, what the blur allows; or 1, 1/2, 1/4 ... of the photograph's pixels.",
        autocompletion=lambda: ["auto", "1", "1/2", "1/4", "1/8"],
    ),
]
CropOrigin = Annotated[
    str | None,
    typer.Option(
        help="Photographs show a part of the sensor: column and row of its first pixel in the camera file's frame.",
        metavar="X,Y",
    ),
]
# One sentence for all commands: without a camera file, as in `transparency`, the format's levels are what is left.
_LEVEL_DEFAULT = "default the camera file's, else the file format's"
BlackLevel = Annotated[float | None, typer.Option(help=f"Counts of no light; {_LEVEL_DEFAULT}.")]
WhiteLevel = Annotated[float | None, typer.Option(help=f"Counts of a full well; {_LEVEL_DEFAULT}.")]
Mosaic = Annotated[
    str | None,
    typer.Option(
        help="Grey files are the mosaic of a Bayer sensor: RGGB, BGGR, GRBG or GBRG.",
        autocompletion=lambda: ["RGGB", "BGGR", "GRBG", "GBRG"],
    ),
]
ChromaSiting = Annotated[
    str | None,
    typer.Option(
        "--siting",
        help="Where subsampled chroma lies among luma: centre, left or top-left; default centre, of video left.",
        autocompletion=lambda: ["centre", "left", "top-left"],
    ),
]
Primaries = Annotated[
    str | None, typer.Option(help="srgb: the files' primaries, where their tag is wrong; default the tag's.")
]
Left = Annotated[
    Path | None, typer.Option(help="Of a dual-pixel camera: the left picture of one exposure.", metavar="PICTURE")
]
Right = Annotated[Path | None, typer.Option(help="The right one, where names do not pair them.", metavar="PICTURE")]
MaxRelativeSigma = Annotated[
    float,
    typer.Option(
        help="Largest sigma/depth in what carries no error bar (points, PNG, TUM, MCAP); inf keeps all.",
        callback=checked_limit,  # before the work
    ),
]

Frames = Annotated[int | None, typer.Option(min=1, help="Stop after so many frames.")]
Seconds = Annotated[float | None, typer.Option(min=0.0, help="Stop after so long.")]
VoxelMm = Annotated[float | None, typer.Option(help="Edge of a voxel; default 1/200 of the distance.")]
MemoryMb = Annotated[int, typer.Option(help="Memory of the volume; bounds what can be reconstructed.")]

# Of simulated and planned cameras and sessions.
CAMERA_PANEL, BOARDS_PANEL, RAYS_PANEL = "Camera", "Boards", "Scenes, rays and noise"
SimulatedDesign = Annotated[
    str,
    typer.Option(
        help="Design, or a .toml or .svg file of your own.", rich_help_panel=CAMERA_PANEL, autocompletion=_design_names
    ),
]
Film = Annotated[
    str,
    typer.Option(
        help="ideal, lee, real, leaky, or gels: 141,768; own files keep theirs.", rich_help_panel=CAMERA_PANEL
    ),
]
Lens = Annotated[
    str, typer.Option(help="Lens that comes with the package, or a .toml file.", rich_help_panel=CAMERA_PANEL)
]
FocusMm = Annotated[
    float, typer.Option(help="Focus distance from the sensor, mm; inf allowed.", rich_help_panel=CAMERA_PANEL)
]
Width = Annotated[int, typer.Option(help="Image width, px.", rich_help_panel=CAMERA_PANEL)]
SensorWidthMm = Annotated[float, typer.Option(help="Width of the sensor, mm.", rich_help_panel=CAMERA_PANEL)]
Seed = Annotated[
    int, typer.Option(help="Seed of the noise, and of the ruler errors of a session.", rich_help_panel=RAYS_PANEL)
]
NearestMm = Annotated[float, typer.Option(help="First board distance, mm.", rich_help_panel=BOARDS_PANEL)]
FarthestMm = Annotated[float, typer.Option(help="Last board distance, mm.", rich_help_panel=BOARDS_PANEL)]


def working_scale(text: str) -> float | Literal["auto"]:
    """Read a working scale, ``auto`` or 1/N; raises InputError."""
    if text.strip() == "auto":
        return "auto"
    found = re.fullmatch(r"\s*1(?:\s*/\s*([1-9][0-9]{0,2}(?:\.[0-9]{1,4})?))?\s*", text)
    if not found:
        raise InputError(f"--scale {text!r} is not understood: give auto, 1, or a fraction such as 1/4")
    scale = float(found[1] or 1)
    return int(scale) if scale.is_integer() else scale


def left_of_pair(left: Path | None, right: Path | None, others: Iterable[object] = ()) -> Path:
    """Check that the halves of one photograph are given, and nothing else; returns the left one."""
    if left is None or right is None or any(others):
        raise InputError("give the left and the right picture of one exposure, --left A --right B, and no others")
    return left


def crop_origin(text: str | None) -> tuple[int, int] | None:
    """Read the column and row of a pixel, such as 1200,800; raises InputError."""
    if text is None:
        return None
    place = re.fullmatch(r"\s*(\d{1,6})\s*,\s*(\d{1,6})\s*", text)
    if not place:
        raise InputError(f"--crop-origin {text!r} is not understood: give column and row, such as 1200,800")
    return int(place[1]), int(place[2])


def inner_corners(text: str) -> tuple[int, int]:
    """Read the size of a chessboard, columns and rows of inner corners, such as 9x6; raises InputError."""
    corners = re.fullmatch(r"\s*(\d+)\s*[x×]\s*(\d+)\s*", text)
    if not corners or min(int(corners[1]), int(corners[2])) < 3:
        raise InputError(f"--board {text!r} is not understood: give the inner corners, such as 9x6")
    return int(corners[1]), int(corners[2])


def check_output(path: Path, *suffixes: str, inputs: Iterable[Path | None] = (), option: str = "--out") -> None:
    """Refuse a file to write that has another suffix, or that is one of the inputs."""
    if suffixes and path.suffix.lower() not in suffixes:
        raise InputError(f"{option} {path.name} must end in {' or '.join(suffixes)}")
    for given in inputs:
        if given is not None and path.exists() and given.exists() and os.path.samefile(path, given):
            raise InputError(f"{option} {path.name} would replace an input, {given.name}; choose another name")


def check_film(camera: CodedApertureCamera, image: np.ndarray, name: str, *, refuse: bool = True) -> None:
    """Warn of a photograph unlikely to be taken through the camera's film; ``refuse`` one that cannot be."""
    if line := film_doubts(camera, image, name, refuse=refuse):
        warnings.warn(line, CaptureWarning, stacklevel=2)


def film_checked(frames: Iterable[Frame], camera: CodedApertureCamera, *, refuse: bool = True) -> Iterator[Frame]:
    """Pass frames on; the first is checked, see `check_film`."""
    for number, frame in enumerate(frames):
        if not number:
            check_film(camera, frame.image, "the first frame", refuse=refuse)
        yield frame


def film_doubts(camera: CodedApertureCamera, image: np.ndarray, name: str, *, refuse: bool = False) -> str:
    """Return what speaks against the camera's film in a photograph, one line; empty where nothing does."""
    from chromaperture.evaluation.health import film_match
    from chromaperture.matching.working_scale import reduced
    from chromaperture.model.scale import at_scale

    if camera.calibration.sensor.dual_pixel is not None or not camera.shows_frame_at(image.shape[1::-1]):
        return ""  # without a film to compare with; the size is refused later
    camera = camera.at_size(*image.shape[1::-1])
    calibration = camera.calibration
    working = at_scale(calibration, camera.config.scale)
    if working is not calibration:
        image = reduced(image, (working.sensor.width_px, working.sensor.height_px))
    match = film_match(image, working)
    if not match.doubts:
        return ""
    title = calibration.pupil_title
    if match.is_wrong and refuse:
        raise InputError(
            f"{name} was not taken through this camera's film ({title}): {' and '.join(match.findings)}; give the "
            "camera file of the film that was in the lens, or --anyway"
        )
    sure = "was not" if match.is_wrong else "may not have been"
    return (
        f"{name} {sure} taken through this camera's film ({title}): {' and '.join(match.findings)}; with another film "
        "every distance is wrong. Strongly coloured light looks similar"
    )
