"""What a camera file has of a camera: sensor, lens, film, and the board that it was calibrated with.

The types carry the limits of what a file may hold.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import AfterValidator, ConfigDict, Field, GetCoreSchemaHandler, GetPydanticSchema

from chromaperture.color.color_space import TRANSFERS
from chromaperture.color.encoding import Encoding, Halves, Pattern, ResponseCurve, Siting, StatedFacts
from chromaperture.system.validation import LARGEST_SIDE, Finite, Name, NotNegative, Positive


def stored_as(kind: Any, made: Callable[[Any], Any] = np.array) -> GetPydanticSchema:
    """Return the annotation of a field that a file holds as plain values of a type, of which ``made`` makes it."""
    return GetPydanticSchema(lambda _, handler: handler.generate_schema(Annotated[kind, AfterValidator(made)]))


class CameraPart:
    """A table of the camera file; newer versions may have added keys."""

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(strict=True, extra="ignore")

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> Any:
        schema: Any = handler(source)
        schema["strict"] = False  # of the table, which is a mapping in the file; its values stay strict
        return schema


Side = Annotated[int, Field(gt=0, le=LARGEST_SIDE)]
Exponent = Annotated[Finite, Field(gt=0, le=100)]
Corners = Annotated[int, Field(gt=2, le=1000)]
_Triple = tuple[Finite, Finite, Finite]
Color = Annotated[np.ndarray, stored_as(_Triple)]  # (3,) float64, R, G, B
White = Annotated[np.ndarray, stored_as(tuple[Positive, Positive, Positive])]  # (3,) float64, R, G, B


@dataclass(frozen=True)
class CameraSensor(CameraPart):
    """The sensor, and how its files are decoded, see `Encoding`; electrons are None where unknown."""

    width_px: Side
    height_px: Side
    pixel_pitch_mm: Positive
    black_level: Finite
    white_level: Finite
    full_well_electrons: Positive | None = None
    read_noise_electrons: NotNegative | None = None
    curve: Annotated[str, stored_as(Literal[TRANSFERS], str)] = "linear"  # see `Transfer`
    curve_parameters: Annotated[tuple[Finite, ...], Field(max_length=65536)] = ()
    #: Exponents of a `ResponseCurve`; None: values are light.
    response: Annotated[tuple[Exponent, ...], Field(min_length=2, max_length=100)] | None = None
    mosaic: Pattern | None = None  # what a person said of its files, see `StatedFacts`
    siting: Siting | None = None
    primaries: Literal["srgb"] | None = None
    dual_pixel: Halves | None = None

    @property
    def encoding(self) -> Encoding:
        """How the photographs that the camera was calibrated on are decoded."""
        response = None if self.response is None else ResponseCurve(self.response)
        stated = StatedFacts(self.siting, self.primaries, self.mosaic, self.dual_pixel)
        levels = self.black_level, self.white_level
        return Encoding(*levels, self.curve, response=response, curve_parameters=self.curve_parameters, stated=stated)


@dataclass(frozen=True)
class Lens(CameraPart):
    """The lens as a pinhole at the centre of the entrance pupil."""

    focal_length_mm: Positive  # effective focal length
    camera_matrix: Annotated[np.ndarray, stored_as(tuple[_Triple, _Triple, _Triple])]  # (3, 3) float64, px
    #: (5,) float64, OpenCV's k1, k2, p1, p2, k3.
    distortion: Annotated[np.ndarray, stored_as(tuple[Finite, Finite, Finite, Finite, Finite])]
    f_number: Positive | None = None


@dataclass(frozen=True)
class Film(CameraPart):
    """Colours of white light on the sensor: R, G, B, 1 = white level."""

    filters: Annotated[Mapping[Name, Color], Field(max_length=100)]  # through a whole pupil of each filter
    clear: White  # through the open pupil, at the same exposure
    aperture: White  # through the coded aperture: the camera's white

    def transmissions(self) -> dict[str, np.ndarray]:
        """Return the transmission of each filter in R, G, B; dict of str to (3,)."""
        return {name: color / self.clear for name, color in self.filters.items()}


@dataclass(frozen=True)
class Board(CameraPart):
    """A chessboard: inner corners (columns, rows) and side of a square, mm."""

    inner_corners: tuple[Corners, Corners]
    square_mm: Positive
