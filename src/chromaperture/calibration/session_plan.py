"""Plan a calibration session: what to photograph, and the files of its folder before the first photograph."""

from __future__ import annotations

import math
from dataclasses import dataclass

from chromaperture.calibration.session import SHEETS
from chromaperture.optics.aperture import design_named
from chromaperture.system.errors import InputError

FOLDERS = ("board", "tilt", "white", "scene")
# A lean of the board, and its place in the frame: what determines the pinhole; chosen by hand.
_LEANS = ("its left edge towards you", "its right edge towards you", "its top towards you", "its bottom towards you")
_PLACES = ("in the middle", "left of the middle", "right of the middle", "above the middle", "below the middle")
_ROUND_MM = 10  # distances that are easy to mark on the floor
_UNKNOWN = '"?"'  # reading it back is an error that names the entry


@dataclass(frozen=True)
class PlannedSession:
    """What is known before the session; None is left for the user to fill in.

    Raises InputError where the distances do not enclose a finite focus, or the boards are fewer than two.
    """

    design: str
    # Of the boards and of the focus, from the sensor plane; the focus is inf for a lens focused at infinity
    nearest_mm: float
    farthest_mm: float
    focus_mm: float
    distances: int = 12  # photographs of the board square to the axis
    tilts: int = 12  # and leaning
    inner_corners: tuple[int, int] = (9, 6)  # columns and rows
    square_mm: float = 30.0
    suffix: str = ".png"
    size_px: tuple[int, int] | None = None  # width and height of a photograph as it is read
    sensor_width_mm: float | None = None
    focal_length_mm: float | None = None
    f_number: float | None = None
    black_level: float | None = None  # counts of no light
    white_level: float | None = None  # and of a full pixel
    mosaic: str | None = None  # Bayer pattern of grey files
    # Of the exponent by which decoded values grow with light, if two exposures showed it
    tone_error: float | None = None

    def __post_init__(self) -> None:
        beyond = self.focus_mm < self.farthest_mm or math.isinf(self.focus_mm)
        if not (0 < self.nearest_mm < min(self.focus_mm, self.farthest_mm) < math.inf and beyond):
            raise InputError(
                f"boards from {self.nearest_mm:g} to {self.farthest_mm:g} mm must lie on both sides of the focus at "
                f"{self.focus_mm:g} mm: change --nearest-mm, --farthest-mm or --focus-mm (inf: a lens at infinity)"
            )
        if self.distances < 2:
            raise InputError(f"--distances must be at least 2, got {self.distances}; a dozen is good")

    @property
    def distances_mm(self) -> list[int]:
        """Distances of the boards, even in disparity, that is in 1 / distance; in steps of a centimetre."""
        near, far = 1 / self.nearest_mm, 1 / self.farthest_mm
        steps = (near + (far - near) * i / (self.distances - 1) for i in range(self.distances))
        return sorted({_ROUND_MM * round(1 / inverse / _ROUND_MM) for inverse in steps})

    @property
    def white_sheets(self) -> dict[str, str]:
        """Name of each white sheet's file, and what it is photographed through."""
        colours = dict.fromkeys(part.filter.name for part in design_named(self.design).parts)
        films = {SHEETS[c]: f"a whole piece of the {c} film over the iris" for c in colours if c in SHEETS}
        return {self.design: "the coded aperture", "open": "the open lens, without film"} | films


def plan_files(plan: PlannedSession) -> dict[str, str]:
    """Return the text of the files of a new session by name."""
    return {"session.toml": _settings(plan), "distances.csv": _distances(plan), "shots.md": _shots(plan)}


def _settings(plan: PlannedSession) -> str:
    width, height = (_UNKNOWN, _UNKNOWN) if plan.size_px is None else map(str, plan.size_px)
    pitch = None
    if plan.sensor_width_mm is not None and plan.size_px is not None:
        pitch = plan.sensor_width_mm / plan.size_px[0]
    columns, rows = plan.inner_corners
    films = ", ".join(plan.white_sheets)
    return f"""# What is known about the camera without its photographs. Replace every {_UNKNOWN}; lengths are in mm.
# docs/calibration-session.md describes every entry, shots.md lists what to photograph.

design = "{plan.design}"    # the aperture, as "chromaperture apertures" names it

[sensor]
# Of a photograph as it is read: half the camera's for RAW files, mosaics and 4:2:0 chroma (most JPEG).
width_px = {width}
height_px = {height}
pixel_pitch_mm = {_number(pitch)}    # width of the sensor in mm / width_px
# Counts without light and of a full pixel. Leave both lines out for files of 8 bits (JPEG), which are decoded from
# sRGB, and for 16-bit files that use all of 0 to 65535.
{_optional("black_level", plan.black_level, 512)}
{_optional("white_level", plan.white_level, 16383)}
# Grey files are the mosaic of a Bayer sensor that begins so: RGGB, BGGR, GRBG or GBRG.
{"# mosaic" if plan.mosaic is None else "mosaic"} = "{plan.mosaic or "RGGB"}"
# By how much the exponent by which values grow with light is off 1; the error bars allow for it.
{_optional("tone_error", plan.tone_error, 0.05)}

[lens]
nominal_focal_length_mm = {_number(plan.focal_length_mm)}    # as engraved
nominal_f_number = {_number(plan.f_number)}    # wide open
focused_at_about_mm = {plan.focus_mm:g}    # from the sensor plane, the mark ⏀ on the camera body, to 10 %

[board]
inner_corners = [{columns}, {rows}]    # columns and rows, one less than the squares each way
square_mm = {plan.square_mm:.1f}    # measure the print: the error of the squares is the error of every distance
ruler_error_mm = 3.0    # how far a distance in distances.csv may be off

# White sheets are files of white/, all at one exposure: {films}.
"""


def _distances(plan: PlannedSession) -> str:
    rows = (f"board/{distance:04d}{plan.suffix},{distance}" for distance in plan.distances_mm)
    return "\n".join(["file,ruler_mm", *rows]) + "\n"


def _shots(plan: PlannedSession) -> str:
    boards = "\n".join(f"- [ ] `board/{mm:04d}{plan.suffix}`: {mm} mm" for mm in plan.distances_mm)
    tilts = "\n".join(
        f"- [ ] `tilt/{i:02d}{plan.suffix}`: {_LEANS[i % len(_LEANS)]}, {_PLACES[i % len(_PLACES)]}"
        for i in range(plan.tilts)
    )
    sheets = "\n".join(f"- [ ] `white/{name}{plan.suffix}`: through {what}" for name, what in plan.white_sheets.items())
    columns, rows = plan.inner_corners
    at = "At any distance" if math.isinf(plan.focus_mm) else "At about the focus"
    return f"""# What to photograph

Files: RAW, or PNG, TIFF or JPEG without chroma subsampling, all of one kind, all of one size, none turned upright.
Manual exposure and white balance; focus and iris taped, and not touched until the last line. Nothing saturated.

## The board square to the camera: {len(plan.distances_mm)} distances (5 at the least)

The wall with speckle and the chessboard ({columns} x {rows} inner corners, {plan.square_mm:g} mm) in its middle.
Measure from the mark ⏀ on the camera body to the board, to 3 mm. Write into `distances.csv` what the ruler shows, not
what stands here.

{boards}

## The board leaning by 15 to 25 degrees: {plan.tilts} photographs (4 at the least)

{at}, nearer where the board is small in the frame; all of the board inside the frame.

{tilts}

## White sheets: {len(plan.white_sheets)} photographs, all at one exposure

Paper in even light that fills the frame, out of focus.

{sheets}

## What you like

- [ ] `scene/`: anything; not used for calibration

Then, in this folder: `chromaperture calibrate . --out camera.asdf`
"""


def _number(value: float | None) -> str:
    return _UNKNOWN if value is None else f"{value:.6g}"


def _optional(name: str, value: float | None, example: float) -> str:
    return f"# {name} = {example:g}" if value is None else f"{name} = {value:g}"
