"""Values of a camera file: types and ranges. Arrays are checked where they are used (`depth/field.py`)."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field

from chromaperture.system.validation import LARGEST_SIDE, Finite, Name, NotNegative, Positive, Table

Side = Annotated[int, Field(gt=0, le=LARGEST_SIDE)]
Triple = tuple[Finite, Finite, Finite]
Length = Field(min_length=2, max_length=100)  # of a table's side
Moved = Annotated[Finite, Field(ge=-100, le=100)]  # px, by the lens
Pair = tuple[Moved, Moved]
Moves = Annotated[tuple[Annotated[tuple[tuple[Pair, Pair, Pair], ...], Length], ...], Length]
Exponent = Annotated[Finite, Field(gt=0, le=100)]  # of a response curve
Corners = Annotated[int, Field(gt=2, le=1000)]  # of a side of the chessboard


class CameraTable(Table):
    """Newer versions may have added keys."""

    model_config = ConfigDict(strict=True, extra="ignore", frozen=True)


class SensorTable(CameraTable):
    """See `camera_file.CameraSensor`."""

    width_px: Side
    height_px: Side
    pixel_pitch_mm: Positive
    black_level: Finite
    white_level: Finite
    full_well_electrons: Positive | None
    read_noise_electrons: NotNegative | None
    curve: Literal["linear", "srgb", "bt709", "power", "parametric", "table", "hlg", "pq"] = "linear"
    curve_parameters: Annotated[tuple[Finite, ...], Field(max_length=65536)] = ()
    response: Annotated[tuple[Exponent, ...], Field(min_length=2, max_length=100)] | None = None
    mosaic: Literal["RGGB", "BGGR", "GRBG", "GBRG"] | None = None
    siting: Literal["centre", "left", "top-left"] | None = None
    primaries: Literal["srgb"] | None = None


class LensTable(CameraTable):
    """See `camera_file.Lens`."""

    focal_length_mm: Positive
    camera_matrix: tuple[Triple, Triple, Triple]
    distortion: tuple[Finite, Finite, Finite, Finite, Finite]
    f_number: Positive | None


class FilmTable(CameraTable):
    """See `camera_file.Film`."""

    filters: Annotated[dict[Name, Triple], Field(max_length=100)]
    clear: tuple[Positive, Positive, Positive]
    aperture: tuple[Positive, Positive, Positive]


class RangeTable(CameraTable):
    """The working range; see `camera_file.Calibration`."""

    near_mm: NotNegative
    far_mm: Positive


class BoardTable(CameraTable):
    """See `camera_file.Board`."""

    inner_corners: tuple[Corners, Corners]
    square_mm: Positive


class CameraTree(CameraTable):
    """A camera file, below its root."""

    format_version: Annotated[int, Field(ge=1)]
    design: Name
    working_range: RangeTable
    depth: dict[str, dict[str, Any]]  # see `field_from_tree`
    lens: LensTable
    sensor: SensorTable
    film: FilmTable
    provenance: dict[str, Any]
    blur: dict[str, Finite] | None = None
    board: BoardTable | None = None
    channel_moves_px: Moves | None = None
