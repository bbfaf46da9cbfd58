"""``chromaperture depth``."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from concurrent.futures import Future
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from chromaperture.cli.options import (
    BlackLevel,
    CameraOrDesign,
    Design,
    Json,
    MaxRelativeSigma,
    Quality,
    Quiet,
    WhiteLevel,
)
from chromaperture.depth.error_limit import MAX_RELATIVE_SIGMA
from chromaperture.errors import CaptureWarning, ChromapertureError, InputError

if TYPE_CHECKING:
    import numpy as np

    from chromaperture.camera import CodedApertureCamera
    from chromaperture.camera_file import Calibration


def depth(
    images: Annotated[
        list[Path], typer.Argument(help="Photographs through the colour-coded aperture.", metavar="IMAGE...")
    ],
    camera: CameraOrDesign = None,
    design: Design = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Folder for the results; default beside the image.")
    ] = None,
    quality: Quality = "real-time",
    black_level: BlackLevel = None,
    white_level: WhiteLevel = None,
    max_relative_sigma: MaxRelativeSigma = MAX_RELATIVE_SIGMA,
    write: Annotated[
        str | None,
        typer.Option(
            help="Files to write: depth, sigma, disparity, depth-png, color, ply, preview, json; default all.",
            metavar="NAME,...",
        ),
    ] = None,
    config: Annotated[
        Path | None,
        # Escaped: rich would take the names of the tables for markup.
        typer.Option(help="TOML file of settings, tables \\[matcher] and \\[depth]; docs/settings.md lists them."),
    ] = None,
    anyway: Annotated[
        bool, typer.Option("--anyway", help="Measure even through a film that is not the camera's.")
    ] = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Measure depth in millimetres for every pixel of one or more photographs.

    chromaperture depth photo.png --camera camera.asdf --out results

    chromaperture depth photo.jpg --design rgb_squares        (no calibration: disparity in px)
    """
    from chromaperture.cli.console import (
        announce_compilation,
        announce_duration,
        print_json,
        print_reports,
        progress,
        say_error,
    )
    from chromaperture.frame.frame_files import chosen_outputs
    from chromaperture.products.measure_file import Written, measure_first
    from chromaperture.threads import beside

    if len({(out or image.parent, image.stem) for image in images}) < len(images):
        raise InputError("two images would write the same files; measure them into different --out folders")
    chosen_outputs(write, is_calibrated=camera is not None)  # before the work
    camera_of = cameras(images[0], camera, design, quality=quality, config=config)
    announce_compilation(quiet=quiet)
    reports: list[Written] = []
    with progress(quiet=quiet) as update, beside() as begin:
        writing: Future[Written] | None = None  # the files of the image before, beside the measurement of this one

        def finish() -> None:
            """Wait for the files, of one image at a time: no more than two measurements are in memory."""
            try:
                if writing is not None:
                    reports.append(writing.result())
            except ChromapertureError as error:
                say_error(error)

        for i, image in enumerate(images):

            def show(stage: str, i: int = i, name: str = image.name) -> None:
                update(f"{name}: {stage}", i, len(images))

            levels: dict[str, Any] = {"black_level": black_level, "white_level": white_level}
            try:
                eye = camera_of(image)
                announce_duration(eye, len(images) if i == 0 else 0, quiet=quiet)
                check = partial(check_film, eye.calibration, name=image.name, refuse=not anyway)
                options = {"max_relative_sigma": max_relative_sigma, "write": write, **levels}
                measured = measure_first(image, eye, out=out, listener=show, inspect=check, **options)
            except ChromapertureError as error:
                finish()
                writing = None
                say_error(error)
            else:
                finish()
                writing = begin(measured.write)
                show("write")
        finish()
    if json:
        print_json([report.summary for report in reports])
    elif reports and not quiet:
        note = "No calibration: disparity in px only. Depth in mm needs a camera file (--camera)."
        print_reports(reports, note=note if camera is None else "")
    if len(reports) < len(images):
        raise typer.Exit(2)


def check_film(calibration: Calibration, image: np.ndarray, *, name: str, refuse: bool = True) -> None:
    """Warn of a photograph that is unlikely to be taken through the camera's film; refuse one that cannot be.

    Raises
    ------
    InputError
        The film is certainly another one, and ``refuse``.
    """
    from chromaperture.evaluation.health import film_match

    if not calibration.is_calibrated or image.shape[:2] != (calibration.sensor.height_px, calibration.sensor.width_px):
        return  # without a film to compare with; the size is refused later
    match = film_match(image, calibration)
    if not match.doubts:
        return
    title = calibration.aperture.title
    if match.is_wrong and refuse:
        raise InputError(
            f"{name} was not taken through this camera's film ({title}): {' and '.join(match.findings)}; give the "
            "camera file of the film that was in the lens, or --anyway"
        )
    sure = "was not" if match.is_wrong else "may not have been"
    warnings.warn(
        f"{name} {sure} taken through this camera's film ({title}): {' and '.join(match.findings)}; with another film "
        "every distance is wrong. Strongly coloured light looks similar",
        CaptureWarning,
        stacklevel=2,
    )


def cameras(
    first: Path, camera: Path | None, design: str | None, *, quality: str, config: Path | None
) -> Callable[[Path], CodedApertureCamera]:
    """Return the function from an image to its camera: the file's, read once, or one for each size for a design."""
    from chromaperture.capture.files import image_size
    from chromaperture.cli.setup import camera_for

    if design is None or camera is not None:
        same = camera_for(first, camera, design, quality=quality, config=config)
        return lambda image: same
    of_sizes: dict[tuple[int, int], CodedApertureCamera] = {}

    def of_size(image: Path) -> CodedApertureCamera:
        size = image_size(image)
        if size not in of_sizes:
            of_sizes[size] = camera_for(image, None, design, quality=quality, config=config)
        return of_sizes[size]

    return of_size
