"""``chromaperture refocus``."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from chromaperture.cli.console import announce_duration, compile_kernels, print_files, print_json, progress
from chromaperture.cli.options import (
    Anyway,
    BlackLevel,
    CameraOrDesign,
    Design,
    Device,
    Json,
    PhotographQuality,
    Quiet,
    WhiteLevel,
    check_film,
    check_output,
)
from chromaperture.system.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from chromaperture.camera.camera import CodedApertureCamera
    from chromaperture.effects.refocusing import Focus
    from chromaperture.effects.restore import SharpPicture

_focus, _lens, _effect = (partial(typer.Option, rich_help_panel=p) for p in ("Where to focus", "New lens", "Picture"))


@dataclass(frozen=True)
class _Request:
    """Checked options: distance in mm or pixel to focus on, or a sweep; pupil; effects; the file to write."""

    distance_mm: float | None
    pixel: tuple[int, int] | None
    sweep: bool
    f_number: float | None
    strength: float | None
    bokeh: str
    background: Any  # one of BACKGROUND_EFFECTS
    sharpness: Any  # one of SHARPNESS
    target: Path


def refocus(
    photo: Annotated[Path, typer.Argument(help="Photograph through the colour-coded aperture.", metavar="PHOTO")],
    camera: CameraOrDesign = None,
    design: Design = None,
    focus_mm: Annotated[float | None, _focus(help="Distance from the sensor to focus on, mm.")] = None,
    point: Annotated[str | None, _focus(help="Pixel to focus on, from the top-left corner.", metavar="X,Y")] = None,
    sweep: Annotated[bool, _focus("--sweep", help="Focus from near to far, as GIF or MP4.")] = False,
    f_number: Annotated[float | None, _lens(help="f-number of the new lens; default the camera's.")] = None,
    strength: Annotated[
        float | None, _lens(help="Instead of --f-number: size of the new pupil, 1 = the camera's, 0 = pinhole.")
    ] = None,
    bokeh: Annotated[str, _lens(help="disc, hex, or a picture of the pupil.")] = "disc",
    background: Annotated[str, _effect(help="keep, desaturate or blur what lies behind the focus.")] = "keep",
    sharpness: Annotated[str, _effect(help="How to restore the picture first: aligned, fast or full.")] = "full",
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Picture to write; default PHOTO.refocus.png.", metavar="FILE")
    ] = None,
    quality: PhotographQuality = None,
    device: Device = "auto",
    anyway: Anyway = False,
    black_level: BlackLevel = None,
    white_level: WhiteLevel = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Restore the colour picture and focus it elsewhere, with another f-number or pupil.

    chromaperture refocus photo.png --camera camera.asdf --focus-mm 1500 --f-number 1.4

    chromaperture refocus photo.png --camera camera.asdf --point 320,240 --bokeh hex

    chromaperture refocus photo.png --camera camera.asdf --strength 0      (everything in focus)
    """
    from chromaperture.capture.files import image_size
    from chromaperture.cli.setup import camera_for
    from chromaperture.effects.refocusing import Focus

    pixel = None if point is None else parse_point(point)
    target = out or photo.with_name(f"{photo.stem}.{'sweep.gif' if sweep else 'refocus.png'}")
    request = _Request(focus_mm, pixel, sweep, f_number, strength, bokeh, background, sharpness, target)
    _check(request)  # before the minute of work
    check_output(target, inputs=[photo, camera, Path(bokeh)])
    eye = camera_for(photo, camera, design, quality=quality, config=None, device=device)
    if eye.shows_frame_at(size := image_size(photo)):  # also of another size than the calibration's
        eye = eye.at_size(*size)
    pupil = pupil_strength(eye, f_number, strength)
    _check_focus(eye, focus_mm, pixel)
    compile_kernels(eye.config.quality, quiet=quiet)
    announce_duration(eye, 1, quiet=quiet)
    with progress(quiet=quiet) as update:
        update(f"{photo.name}: depth", 0, 3)
        image = eye.read(photo, black_level=black_level, white_level=white_level)
        check_film(eye, image, photo.name, refuse=not anyway)
        picture = _restored(image, eye, request, lambda: update(f"{photo.name}: restoration", 1, 3))
        update(f"{photo.name}: focus", 2, 3)
        lens = Focus(0.0 if sweep else chosen_radius(eye, picture, focus_mm, pixel), pupil, bokeh)
        _write(picture, lens, request, eye)
    if json:
        print_json(_summary(photo, picture, lens, request))
    elif not quiet:
        print_files([target])


def _check(request: _Request) -> None:
    """Raise InputError for options that contradict each other or are unknown."""
    from chromaperture.effects.refocusing import BACKGROUND_EFFECTS, SUFFIXES, bokeh_mask
    from chromaperture.effects.restore import SHARPNESS

    if [request.distance_mm is not None, request.pixel is not None, request.sweep].count(True) > 1:
        raise InputError("choose one of --focus-mm, --point and --sweep")
    if request.distance_mm is not None and not (math.isfinite(request.distance_mm) and request.distance_mm > 0):
        raise InputError(f"--focus-mm must be a positive number of mm, got {request.distance_mm:g}")
    if request.f_number is not None and request.strength is not None:
        raise InputError("choose one of --f-number and --strength")
    for name, known in (("background", BACKGROUND_EFFECTS), ("sharpness", SHARPNESS)):
        if getattr(request, name) not in known:
            raise InputError(f"unknown --{name} {getattr(request, name)!r}: choose {', '.join(known)}")
    bokeh_mask(request.bokeh)
    allowed = SUFFIXES if request.sweep else (".png",)
    check_output(request.target, *allowed)


def _check_focus(camera: CodedApertureCamera, focus_mm: float | None, pixel: tuple[int, int] | None) -> None:
    """Raise InputError for a focus inside the lens or a pixel outside the picture."""
    from chromaperture.effects.restore import focus_radius

    sensor = camera.calibration.sensor
    if focus_mm is not None and not camera.calibration.is_calibrated:
        raise InputError(
            "--focus-mm needs distances, so the file of a calibrated camera (--camera); with --design give --point X,Y"
        )
    if focus_mm is not None:
        focus_radius(camera, focus_mm)
    if pixel is not None and not (0 <= pixel[0] < sensor.width_px and 0 <= pixel[1] < sensor.height_px):
        x, y = pixel
        raise InputError(f"--point {x},{y} lies outside the picture of {sensor.width_px}x{sensor.height_px} px")


def _restored(
    image: np.ndarray, camera: CodedApertureCamera, request: _Request, measured: Callable[[], None]
) -> SharpPicture:
    """Measure and restore, scaled so that the picture's brightest lies just below white."""
    from chromaperture.effects.restore import brightened, restore

    frame = camera.measure(image)
    measured()
    sigma_px = frame.disparity_sigma_px
    return brightened(restore(image, frame.disparity_px, camera, sigma_px=sigma_px, sharpness=request.sharpness))


def _write(picture: SharpPicture, lens: Focus, request: _Request, camera: CodedApertureCamera) -> None:
    from chromaperture.effects.refocusing import apply_background, compositor_of, sweep, write_sweep
    from chromaperture.files.pictures import write_color_png
    from chromaperture.system.storage import staged

    on, color, radius = compositor_of(camera), picture.color, picture.radius_px
    with staged(request.target.parent) as stage:
        path = stage.path(request.target.name)
        if request.sweep:
            write_sweep(path, sweep(color, radius, lens, compositor=on))
        else:
            write_color_png(path, apply_background(color, radius, lens, request.background, compositor=on))


def _summary(photo: Path, picture: SharpPicture, lens: Focus, request: _Request) -> dict[str, Any]:
    return {
        "image": photo.name,
        "file": str(request.target),
        "focus_radius_px": None if request.sweep else lens.radius_px,
        "strength": lens.strength,
        "radius_range_px": [float(picture.radius_px.min()), float(picture.radius_px.max())],
        "bokeh": lens.bokeh,
        "background": request.background,
        "sharpness": request.sharpness,
    }


def parse_point(text: str) -> tuple[int, int]:
    """Read X,Y; raises InputError."""
    try:
        x, y = (int(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"--point needs two whole numbers X,Y such as 320,240, got {text!r}") from None
    return x, y


def pupil_strength(camera: CodedApertureCamera, f_number: float | None, strength: float | None) -> float:
    """Return the size of the new pupil in units of the camera's; raises InputError."""
    if strength is not None:
        if not (math.isfinite(strength) and strength >= 0):
            raise InputError(f"--strength must be a number >= 0, got {strength:g}")
        return strength
    if f_number is None:
        return 1.0
    if not (math.isfinite(f_number) and f_number > 0):
        raise InputError(f"--f-number must be positive, got {f_number:g}")
    own = camera.calibration.lens.f_number
    if not own:
        raise InputError("the camera file lacks the lens's f-number; give --strength instead of --f-number")
    return own / f_number


def chosen_radius(
    camera: CodedApertureCamera, picture: SharpPicture, distance_mm: float | None, pixel: tuple[int, int] | None
) -> float:
    """Return the blur radius of the surface to focus on; 0, the capture's own focus, when none is chosen."""
    from chromaperture.effects.restore import focus_radius, radius_at

    if distance_mm is not None:
        return focus_radius(camera, distance_mm)
    return 0.0 if pixel is None else radius_at(picture, *pixel)
