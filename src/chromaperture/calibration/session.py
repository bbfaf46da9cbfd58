"""A calibration session: a folder of photographs, ``session.toml`` and ``distances.csv``.

``docs/calibration-session.md`` shows the layout.
"""

from __future__ import annotations

import contextlib
import csv
import math
import os
import re
import warnings
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from chromaperture.capture.dual_pixel import pairs
from chromaperture.capture.exif import read_exif
from chromaperture.capture.files import format_of, read_light
from chromaperture.capture.picture_format import PictureFormat
from chromaperture.capture.shots import counted, photographs
from chromaperture.color.encoding import Halves, Pattern, Siting, StatedFacts
from chromaperture.color.image import is_saturated
from chromaperture.color.unmixing import view_reach
from chromaperture.depth.conversion import DepthModel, PaperParameters, paper_to_model
from chromaperture.matching.working_scale import reduced
from chromaperture.model.camera_parts import CameraSensor
from chromaperture.model.scale import LEAST_SIDE_PX, SCALES, reduced_size, resized_sensor
from chromaperture.optics.aperture import DESIGNS, design_named
from chromaperture.system.errors import CaptureWarning, InputError
from chromaperture.system.memory import available_bytes
from chromaperture.system.validation import (
    LARGEST_SIDE,
    Name,
    NotNegative,
    Positive,
    Table,
    as_text,
    checked,
    quoted,
    read_bytes,
    read_toml,
)

# Px of a reduced photograph by which the widest blur of the boards displaces the pupil's edge, at least: bench50's
# boards, which are not reduced, have 11.6. Their lens on 24 megapixels gets 1/8, as from `working_scale`.
_WIDEST_PX = 10.0
_OF_RAMPS = 3 * np.pi / 16  # of the reach of halves of the pupil: that of ramps across it from 0 to 2
_KEPT_BYTES = 300e6  # of decoded boards: 66 of 24 megapixels at their working scale; chosen by hand
_MOST_CSV_BYTES = 1_000_000  # of distances.csv: 20,000 boards

PAIR_DESIGN = "cy_halves"  # what a dual-pixel sensor sees: the right of the pupil is red, the left blue
# Name of the white sheet through a whole pupil of one filter; film without a name has none.
SHEETS = {"cyan": "sheet_c", "yellow": "sheet_y", "magenta": "sheet_m", "red": "sheet_r", "green": "sheet_g",
          "blue": "sheet_b"}  # fmt: skip
_UNITS = {"cm": 10.0, "m": 1000.0, "inches": 25.4, "feet": 304.8}  # mm
_SAME_LENS = 0.01  # relative; files round to a digit or two
_OTHER_UNIT = 5.0  # ratio of expected to given distance from which the unit is wrong: half that of cm


@dataclass(frozen=True)
class Session:
    """The checked contents of a session folder.

    Photographs of more pixels than the lens's blur needs are reduced as they are read, and `sensor` is that of the
    reduced ones: boards are matched at the working scale at which the camera will match (docs/working-scale.md).
    """

    folder: Path
    design: str
    sensor: CameraSensor  # of what `read` returns; photographs of 8 bits that hold no such levels are sRGB
    nominal_focal_length_mm: float
    nominal_f_number: float
    focused_at_about_mm: float
    inner_corners: tuple[int, int]  # (columns, rows)
    square_mm: float  # 0: the boards are flat texture without a chessboard, see `flat_boards.py`
    ruler_error_mm: float
    # Photograph of the board square to the axis, and its distance from the sensor plane by ruler, mm.
    boards: dict[Path, float]
    tilts: tuple[Path, ...]  # tilted boards, for the intrinsics
    full_size_px: tuple[int, int] | None = None  # width and height of the photographs; None: those of ``sensor``
    tone_error: float = 0.0  # of the exponent by which decoded values grow with light, see `tone_curve`
    form: PictureFormat | None = None  # of the first board's file
    prescription: str | None = None  # of the lens: a name, or a file beside session.toml
    from_pupil: bool = False  # distances of flat boards count from the entrance pupil
    range_mm: tuple[float, float] | None = None  # of depth, from the sensor plane; None: about that of the boards
    focus_error_per_m: float = 0.0  # standard deviation of the focus of photographs from the boards', 1/m
    _kept: dict[Path, np.ndarray] = field(default_factory=dict, init=False, repr=False, compare=False)  # see `read`

    @property
    def focuses_at_infinity(self) -> bool:
        """Whether the lens is focused at infinity, beyond which no board can stand."""
        return math.isinf(self.focused_at_about_mm)

    @property
    def photograph_size_px(self) -> tuple[int, int]:
        """Width and height of the photographs."""
        return self.full_size_px or (self.sensor.width_px, self.sensor.height_px)

    def read(self, path: Path) -> np.ndarray:
        """Read one photograph of the session as linear light, at the size of `sensor`; (H, W, 3) float32.

        Boards, which every step reads again, are kept as far as `_KEPT_BYTES` go; they are not to be written to.
        """
        if path in self._kept:
            return self._kept[path]
        image = self._decoded(path)
        kept = sum(other.nbytes for other in self._kept.values())
        if path in self.boards and kept + image.nbytes <= min(_KEPT_BYTES, available_bytes() / 4):
            self._kept[path] = image
        return image

    def _decoded(self, path: Path) -> np.ndarray:
        expected = self.photograph_size_px
        width, height = format_of(path, self.sensor.encoding.stated).read_size_px
        if (width, height) != expected:
            raise InputError(
                f"{path.name} is read at {width}x{height} px, but the session's boards at "
                f"{expected[0]}x{expected[1]}; correct session.toml or the photograph"
            )
        # As `depth` reads.
        image = read_light(
            path, size_px=expected, camera_encoding=self.sensor.encoding, stated=self.sensor.encoding.stated
        ).image
        working = (self.sensor.width_px, self.sensor.height_px)
        if working == expected:
            return image
        # Corners and white sheets need a number everywhere: what is cut off counts as saturated.
        return np.nan_to_num(reduced(image, working), nan=1.0)

    def with_halves(self, order: Halves) -> Session:
        """Return the session with the halves of its photographs in another order."""
        return replace(self, sensor=replace(self.sensor, dual_pixel=order))

    def decoded_as(self, sensor: CameraSensor) -> Session:
        """Return the session with its photographs decoded as those that a camera was calibrated on."""
        decoding = {
            name: getattr(sensor, name)
            for name in ("black_level", "white_level", "curve", "curve_parameters", "response")
        }
        return replace(self, sensor=replace(self.sensor, **decoding))

    @property
    def sheets(self) -> dict[str, Path]:
        """Photographs of white sheets by name; those in the session's folder replace those beside it."""
        folders = (self.folder.parent / "white", self.folder / "white")
        names = {"open", *DESIGNS, *SHEETS.values()}
        kind = _kind(self.boards)
        return {path.stem: path for folder in folders for path in photographs(folder, kind)[0] if path.stem in names}

    def white(self, name: str) -> np.ndarray | None:
        """Return the mean colour of the middle of a white sheet; (3,) float64, None where there is no photograph.

        Raises InputError where the middle is saturated.
        """
        if name not in self.sheets:
            return None
        image = self.read(self.sheets[name])
        rows, columns = (slice(n * 2 // 5, n * 3 // 5) for n in image.shape[:2])  # vignetting spares the middle fifth
        middle = image[rows, columns].reshape(-1, 3)
        if is_saturated(middle):
            file = quoted(self.sheets[name])
            raise InputError(f"{file} is saturated: photograph all white sheets again at one shorter exposure")
        return middle.mean(axis=0).astype(float)


def read_session(folder: str | Path) -> Session:
    """Read and check a session folder; raises InputError that names what is missing or invalid."""
    folder = Path(folder)
    settings = folder / "session.toml"
    if not os.path.isfile(settings):
        raise InputError(f"cannot read {quoted(settings)}: there is no such file; is this a session folder?")
    table = checked(_SessionTable, read_toml(settings), where=quoted(settings))
    _check_kind(table, quoted(settings))
    boards = _distances(folder)
    full = CameraSensor(**table.sensor.model_dump(exclude={"linear", "tone_error"}))
    form = _format_of_first(boards, full.encoding.stated)
    if form is not None and form.is_encoded and full.white_level > 255:  # encoded values have no such levels
        encoding = form.encoding(255.0)
        decoding = {"curve": encoding.curve, "curve_parameters": encoding.curve_parameters}
        full = replace(full, black_level=0.0, white_level=255.0, **decoding)  # type: ignore[arg-type]
    if form is not None and form.mosaic is not None and form.bits == 8 and full.white_level > 255:
        full = replace(full, white_level=255.0)
    size = (full.width_px, full.height_px)
    if form is not None and size == form.size_px:  # as stored: chroma is subsampled
        size = form.read_size_px
        full = resized_sensor(full, *size)
    sensor = resized_sensor(full, *reduced_size(size, _scale(full, table.lens, boards)))
    tilts, left_out = photographs(folder / "tilt", _kind(boards))
    left_out |= photographs(folder / "white", _kind(boards))[1]
    if full.dual_pixel is not None:
        tilts = pairs(tilts, left_out)
    if left_out:
        warnings.warn(
            f"left out of tilt/ and white/, as distances.csv names {_kind(boards)} files: {counted(left_out)}",
            CaptureWarning,
            stacklevel=2,
        )
    _check_one_lens([*boards, *tilts])
    check_units(np.array([*boards.values()]), table.lens.focused_at_about_mm, where=str(folder / "distances.csv"))
    return Session(
        folder=folder,
        design=design_named(table.design or PAIR_DESIGN).name,
        sensor=sensor,
        nominal_focal_length_mm=table.lens.nominal_focal_length_mm,
        nominal_f_number=table.lens.nominal_f_number,
        focused_at_about_mm=table.lens.focused_at_about_mm,
        inner_corners=table.board.inner_corners,
        square_mm=table.board.square_mm or 0.0,
        ruler_error_mm=table.board.ruler_error_mm,
        boards=boards,
        tilts=tuple(tilts),
        full_size_px=size,
        tone_error=table.sensor.tone_error,
        form=form,
        prescription=table.lens.prescription,
        from_pupil=table.board.measured_from == "pupil",
        range_mm=None if table.depth is None else (table.depth.near_mm, table.depth.far_mm),
        focus_error_per_m=table.lens.focus_error_per_m,
    )


def _check_kind(table: _SessionTable, where: str) -> None:
    """Raise InputError where film and a dual-pixel sensor, or a chessboard and flat boards, are mixed up."""
    is_pair, board = table.sensor.dual_pixel is not None, table.board
    if is_pair == bool(table.design):
        raise InputError(f"{where}: give either design, the name of the film, or dual_pixel below [sensor]")
    if board.flat == (board.square_mm is not None):
        raise InputError(f"{where}: give either square_mm of the chessboard or flat = true below [board]")
    if not is_pair and (board.flat or table.lens.prescription):
        raise InputError(f"{where}: flat boards and a lens's prescription calibrate a dual-pixel sensor only")
    if not board.flat and (table.lens.prescription or board.measured_from == "pupil"):
        raise InputError(f'{where}: a prescription and measured_from = "pupil" need flat = true below [board]')
    if table.depth is not None and not table.depth.near_mm < table.depth.far_mm:
        raise InputError(f"{where}: near_mm must be below far_mm")


def _check_one_lens(paths: Iterable[Path]) -> None:
    """Raise InputError where photographs state another focal length or f-number than the first that states one."""
    first: dict[str, tuple[Path, float]] = {}
    for path in paths:
        exif = read_exif(path)
        for what, value in (("focal length, mm,", exif.focal_length_mm), ("f-number", exif.f_number)):
            if value is None:
                continue
            other, stated = first.setdefault(what, (path, value))
            if abs(value / stated - 1) > _SAME_LENS:
                raise InputError(
                    f"the {what} of {quoted(path.name)} is {value:g}, that of {quoted(other.name)} {stated:g}: a phone "
                    "that changes its lens, or a zoom or iris that was touched; photograph all with one, locked"
                )


def _format_of_first(boards: Mapping[Path, float], stated: StatedFacts) -> PictureFormat | None:
    """Return what the file of the first board is; None without one that can be read, which reading it says."""
    with contextlib.suppress(InputError):
        return format_of(next(iter(boards)), stated) if boards else None
    return None


def _kind(boards: Iterable[Path]) -> str:
    """Return the suffix of the photographs of a session."""
    return next((path.suffix.lower() for path in boards), "")


def _scale(sensor: CameraSensor, lens: _LensTable, boards: Mapping[Path, float]) -> int:
    """Return the working scale by the engraved focal length and f-number, as `camera_scale.working_scale` by the blur.

    The widest blur displaces the pupil's edge by r = F R / mu |1 / z_f - 1 / z| (`optics/pinhole.py`).
    """
    f = lens.nominal_focal_length_mm
    focus = lens.focused_at_about_mm - f  # from the pupil, about
    nearer = [ruler - f for ruler in boards.values() if ruler > f]
    if focus <= f or not nearer:
        return 1
    radius_px = f / (1 - f / focus) * f / (2 * lens.nominal_f_number) / sensor.pixel_pitch_mm
    widest = radius_px * max(abs(1 / focus - 1 / z) for z in nearer)
    side = min(sensor.width_px, sensor.height_px)
    return max(s for s in SCALES if s == 1 or (s * _WIDEST_PX <= widest and s * LEAST_SIDE_PX <= side))


_Length = Annotated[float, Field(gt=0, le=1e9)]  # mm; a thousand km, beyond every unit that was mistaken for mm
_Corners = Annotated[int, Field(gt=2, le=1000)]  # of a side; OpenCV's chessboards begin at 3


class _SensorTable(Table):
    """``[sensor]``."""

    width_px: Annotated[int, Field(gt=0, le=LARGEST_SIDE)]
    height_px: Annotated[int, Field(gt=0, le=LARGEST_SIDE)]
    pixel_pitch_mm: _Length
    black_level: NotNegative = 0.0
    white_level: NotNegative = 65535.0
    mosaic: Pattern | None = None
    full_well_electrons: Positive | None = None
    read_noise_electrons: NotNegative | None = None
    linear: bool = True  # for people; counts are always taken as linear
    tone_error: Annotated[float, Field(ge=0, lt=1)] = 0.0
    siting: Siting | None = None
    primaries: Literal["srgb"] | None = None
    dual_pixel: Halves | None = None


class _LensTable(Table):
    """``[lens]``."""

    nominal_focal_length_mm: _Length
    nominal_f_number: _Length
    focused_at_about_mm: Annotated[float, Field(gt=0)]  # inf is a lens focused at infinity; NaN is not > 0
    prescription: Name | None = None
    focus_error_per_m: NotNegative = 0.0


class _BoardTable(Table):
    """``[board]``."""

    inner_corners: tuple[_Corners, _Corners] = (9, 6)
    square_mm: _Length | None = None
    ruler_error_mm: NotNegative = 3.0
    flat: bool = False  # texture without a chessboard
    measured_from: Literal["sensor", "pupil"] = "sensor"


class _ExposureTable(Table):
    """``[exposure]``: for people; the white sheets show it."""

    relative_to_open: Positive = 1.0


class _DepthTable(Table):
    """``[depth]``: the working range."""

    near_mm: _Length
    far_mm: _Length


class _SessionTable(Table):
    """A ``session.toml``."""

    design: Name = ""
    sensor: _SensorTable
    lens: _LensTable
    board: _BoardTable
    exposure: _ExposureTable = _ExposureTable()
    depth: _DepthTable | None = None


def _distances(folder: Path) -> dict[Path, float]:
    """Read ``distances.csv``: photographs of boards and their distances by ruler, mm."""
    table = folder / "distances.csv"
    lines = as_text(read_bytes(table, most_bytes=_MOST_CSV_BYTES), table, or_utf16=True).splitlines()
    separator = next((mark for mark in ";\t" if lines and mark in lines[0]), ",")  # spreadsheets write either
    rows = csv.DictReader(lines, delimiter=separator, skipinitialspace=True)
    boards: dict[Path, float] = {}
    try:
        for row in rows:
            if None in row:
                where = f"{table}: line {rows.line_num}"
                raise InputError(f"{where} has more values than columns; write 1000.5, not 1000,5")
            boards[folder / row["file"]] = _ruler_mm(row["ruler_mm"], f"{table}: line {rows.line_num}")
    except (KeyError, TypeError, AttributeError, csv.Error):
        raise InputError(f"{table} must have the columns file{separator}ruler_mm with distances in mm") from None
    for path, ruler_mm in boards.items():
        if not 0 < ruler_mm < math.inf:
            raise InputError(f"{table}: the distance of {quoted(path.name)} must be positive, in mm, is {ruler_mm:g}")
    missing = [quoted(path.name) for path in boards if not os.path.isfile(path)]
    if missing:
        raise InputError(f"{table} names photographs that are not there: {', '.join(missing[:5])}")
    return boards


def _ruler_mm(text: str, where: str) -> float:
    """Convert a distance, whose decimal mark may be a comma."""
    if re.fullmatch(r"\s*\d{1,3}[,']\d{3}\s*", text):  # 1,250 is 1250 to some and 1.25 to others
        raise InputError(f"{where}: write {text.strip()!r} without a mark between the digits")
    try:
        return float(text.replace(",", "."))
    except ValueError:
        raise InputError(f"{where}: {text.strip()!r} is no distance in mm") from None


def check_units(ruler_mm: np.ndarray, expected_mm: np.ndarray | float, *, where: str) -> None:
    """Raise InputError that names the unit of the distances in ``where``, if it is not mm.

    ``expected_mm`` are rough distances from poses or from the focus; NaN is left out.
    """
    ratios = np.asarray(expected_mm, float) / np.asarray(ruler_mm, float)
    ratios = ratios[np.isfinite(ratios)]
    ratio = float(np.median(ratios)) if ratios.size else 1.0
    if ratio < _OTHER_UNIT:
        return
    unit = min(_UNITS, key=lambda name: abs(np.log(_UNITS[name] / ratio)))
    raise InputError(
        f"{where}: the distances look like {unit}, they are {ratio:.0f} times too small for mm; write them in mm"
    )


def nominal_depth_model(session: Session) -> DepthModel:
    """Return the thin-lens curve of the engraved focal length and f-number, for search ranges and start values."""
    f = session.nominal_focal_length_mm
    z_focus = session.focused_at_about_mm - f  # from the pupil, about
    if z_focus <= f:
        raise InputError(f"focused_at_about_mm = {session.focused_at_about_mm:g} lies inside the focal length")
    image_distance = f / (1 - f / z_focus)  # f for a lens focused at infinity
    reach = view_reach(design_named(session.design)) * (1.0 if session.sensor.dual_pixel is None else _OF_RAMPS)
    parameters = PaperParameters(
        in_focus_mm=z_focus + image_distance,
        baseline_mm=reach * f / session.nominal_f_number,  # b = 2 r_c
        sensor_to_pupil_mm=image_distance,
        focal_length_mm=f,
    )
    return paper_to_model(parameters, pixel_pitch_mm=session.sensor.pixel_pitch_mm)
