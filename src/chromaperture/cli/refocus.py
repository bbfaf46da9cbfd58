"""``chromaperture refocus``."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from chromaperture.errors import InputError

if TYPE_CHECKING:
    from chromaperture.camera import CodedApertureCamera
    from chromaperture.effects.restore import SharpPicture


def refocus(
    photo: Annotated[Path, typer.Argument(help="Photograph through the colour-coded aperture.", metavar="PHOTO")],
    camera: Annotated[
        Path | None,
        typer.Option("--camera", "-c", help="Camera file from 'chromaperture calibrate'.", metavar="CAMERA.asdf"),
    ] = None,
    design: Annotated[str | None, typer.Option(help="Without a camera file: name of the aperture design.")] = None,
    focus: Annotated[
        str | None, typer.Option(help="Distance from the sensor to focus on, as 1500mm or 1.5m.", metavar="DISTANCE")
    ] = None,
    point: Annotated[
        str | None, typer.Option(help="Pixel to focus on, from the top-left corner.", metavar="X,Y")
    ] = None,
    sweep: Annotated[bool, typer.Option("--sweep", help="Focus from near to far, as GIF or MP4.")] = False,
    f_number: Annotated[float | None, typer.Option(help="f-number of the new lens; default the camera's.")] = None,
    strength: Annotated[
        float | None, typer.Option(help="Instead of --f-number: size of the new pupil, 1 = the camera's, 0 = pinhole.")
    ] = None,
    bokeh: Annotated[str, typer.Option(help="disc, hex, or a picture of the pupil.")] = "disc",
    background: Annotated[str, typer.Option(help="keep, desaturate or blur what lies behind the focus.")] = "keep",
    sharpness: Annotated[
        str, typer.Option(help="How to restore the picture first: aligned, fast or full.")
    ] = "full",
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Picture to write; default PHOTO.refocus.png.", metavar="FILE")
    ] = None,
    quality: Annotated[str, typer.Option(help="Of the depth: paper, real-time or accurate.")] = "accurate",
    black_level: Annotated[float | None, typer.Option(help="Counts of no light; default the camera file's.")] = None,
    white_level: Annotated[float | None, typer.Option(help="Counts of a full well; default the camera file's.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but warnings and errors.")] = False,
) -> None:
    """Restore the colour picture and focus it elsewhere, with another f-number or pupil.

    chromaperture refocus photo.png --camera camera.asdf --focus 1500mm --f-number 1.4

    chromaperture refocus photo.png --camera camera.asdf --point 320,240 --bokeh hex

    chromaperture refocus photo.png --camera camera.asdf --strength 0      (everything in focus)
    """
    from chromaperture.cli.console import announce_compilation, print_files, print_json, progress
    from chromaperture.cli.setup import camera_for
    from chromaperture.effects.background import BACKGROUND_EFFECTS, apply_background
    from chromaperture.effects.bokeh import bokeh_mask
    from chromaperture.effects.focus_sweep import SUFFIXES, write_sweep
    from chromaperture.effects.focus_sweep import sweep as focus_sweep
    from chromaperture.effects.refocusing import Focus
    from chromaperture.effects.restore import SHARPNESS, restore
    from chromaperture.products.measure_file import read_capture
    from chromaperture.storage import staged, write_color_png

    # Everything that can be wrong with the options, before the minute of work.
    if [focus is not None, point is not None, sweep].count(True) > 1:
        raise InputError("choose one of --focus, --point and --sweep")
    if f_number is not None and strength is not None:
        raise InputError("choose one of --f-number and --strength")
    for name, value, known in (("background", background, BACKGROUND_EFFECTS), ("sharpness", sharpness, SHARPNESS)):
        if value not in known:
            raise InputError(f"unknown --{name} {value!r}: choose {', '.join(known)}")
    bokeh_mask(bokeh)
    distance_mm = None if focus is None else parse_distance(focus)
    pixel = None if point is None else parse_point(point)
    target = out or photo.with_name(f"{photo.stem}.{'sweep.gif' if sweep else 'refocus.png'}")
    allowed = SUFFIXES if sweep else (".png",)
    if target.suffix.lower() not in allowed:
        raise InputError(f"--out {target.name} must end in {' or '.join(allowed)}")
    eye = camera_for(photo, camera, design, quality=with_optimiser(quality, camera), config=None)
    pupil = pupil_strength(eye, f_number, strength)
    announce_compilation(quiet=quiet or json)
    with progress(quiet=quiet or json) as update:
        update(f"{photo.name}: depth", 0, 3)
        image = read_capture(photo, eye, black_level=black_level, white_level=white_level)
        frame = eye.measure(image)
        update(f"{photo.name}: restoration", 1, 3)
        picture = restore(
            image, frame.disparity_px, eye, sigma_px=frame.disparity_sigma_px, sharpness=sharpness  # type: ignore[arg-type]
        )
        update(f"{photo.name}: focus", 2, 3)
        radius = 0.0 if sweep else chosen_radius(eye, picture, distance_mm, pixel)
        lens = Focus(radius, pupil, bokeh)
        with staged(target.parent) as stage:
            exposed = picture.color * exposure(picture.color)
            if sweep:
                write_sweep(stage.path(target.name), focus_sweep(exposed, picture.radius_px, lens))
            else:
                shown = apply_background(exposed, picture.radius_px, lens, background)  # type: ignore[arg-type]
                write_color_png(stage.path(target.name), shown)
    if json:
        print_json(
            {
                "image": photo.name,
                "file": str(target),
                "focus_radius_px": None if sweep else radius,
                "strength": pupil,
                "radius_range_px": [float(picture.radius_px.min()), float(picture.radius_px.max())],
                "bokeh": bokeh,
                "background": background,
                "sharpness": sharpness,
            }
        )
    elif not quiet:
        print_files([target])


def parse_distance(text: str) -> float:
    """Read a distance such as 1500mm, 150cm, 1.5m or 1500, which is mm; raises InputError."""
    units = {"mm": 1.0, "cm": 10.0, "m": 1000.0}
    number = text.strip().lower()
    unit = next((u for u in units if number.endswith(u)), "")  # "mm" is tried before "m"
    try:
        value = float(number.removesuffix(unit)) * units.get(unit, 1.0)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value > 0):
        raise InputError(f"--focus needs a distance such as 1500mm or 1.5m, got {text!r}")
    return value


def parse_point(text: str) -> tuple[int, int]:
    """Read X,Y; raises InputError."""
    try:
        x, y = (int(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"--point needs two whole numbers X,Y such as 320,240, got {text!r}") from None
    return x, y


def with_optimiser(quality: str, camera: Path | None) -> str:
    """Give the quality that can be had: the accurate one needs a calibrated camera."""
    return "real-time" if quality == "accurate" and camera is None else quality


def pupil_strength(camera: CodedApertureCamera, f_number: float | None, strength: float | None) -> float:
    """Size of the new pupil in units of the camera's; raises InputError."""
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
        raise InputError("the camera file does not know the lens's f-number; give --strength instead of --f-number")
    return own / f_number


def chosen_radius(
    camera: CodedApertureCamera, picture: SharpPicture, distance_mm: float | None, pixel: tuple[int, int] | None
) -> float:
    """Blur radius of the surface to focus on; that of the capture's own focus when nothing is chosen."""
    import numpy as np

    from chromaperture.effects.restore import focus_radius

    if distance_mm is not None:
        return focus_radius(camera, distance_mm)
    if pixel is None:
        return 0.0
    x, y = pixel
    height, width = picture.radius_px.shape
    if not (0 <= x < width and 0 <= y < height):
        raise InputError(f"--point {x},{y} lies outside the picture of {width}x{height} px")
    return float(np.median(picture.radius_px[max(y - 3, 0) : y + 4, max(x - 3, 0) : x + 4]))


def exposure(color: object) -> float:
    """Gain that brings the brightest of the picture just below white."""
    import numpy as np

    return float(0.95 / max(np.percentile(np.asarray(color), 99.8), 1e-6))
