"""What a camera file has of a camera: sensor, lens, film, and the board that it was calibrated with."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from chromaperture.color.encoding import Encoding, Pattern, ResponseCurve, Siting, StatedFacts


@dataclass(frozen=True)
class CameraSensor:
    """The sensor, and how its files are decoded, see `Encoding`; electrons are None where unknown."""

    width_px: int
    height_px: int
    pixel_pitch_mm: float
    black_level: float = 0.0
    white_level: float = 65535.0
    full_well_electrons: float | None = None
    read_noise_electrons: float | None = None
    curve: str = "linear"  # see `Transfer`
    curve_parameters: tuple[float, ...] = ()
    response: tuple[float, ...] | None = None  # exponents of a `ResponseCurve`; None: values are light
    mosaic: Pattern | None = None  # what a person said of its files, see `StatedFacts`
    siting: Siting | None = None
    primaries: Literal["srgb"] | None = None

    @property
    def encoding(self) -> Encoding:
        """How the photographs that the camera was calibrated on are decoded."""
        response = None if self.response is None else ResponseCurve(self.response)
        stated = StatedFacts(self.siting, self.primaries, self.mosaic)
        levels = self.black_level, self.white_level
        return Encoding(*levels, self.curve, response=response, curve_parameters=self.curve_parameters, stated=stated)


@dataclass(frozen=True)
class Lens:
    """The lens as a pinhole at the centre of the entrance pupil."""

    focal_length_mm: float  # effective focal length
    camera_matrix: np.ndarray  # (3, 3) float64, px
    distortion: np.ndarray = field(default_factory=lambda: np.zeros(5))  # (5,) float64, OpenCV's k1, k2, p1, p2, k3
    f_number: float | None = None


@dataclass(frozen=True)
class Film:
    """Colours of white light on the sensor: R, G, B, 1 = white level."""

    filters: Mapping[str, np.ndarray]  # (3,) float64; through a whole pupil of each filter
    clear: np.ndarray  # (3,) float64; through the open pupil, at the same exposure
    aperture: np.ndarray  # (3,) float64; through the coded aperture: the camera's white

    def transmissions(self) -> dict[str, np.ndarray]:
        """Return the transmission of each filter in R, G, B; dict of str to (3,)."""
        return {name: color / self.clear for name, color in self.filters.items()}


@dataclass(frozen=True)
class Board:
    """A chessboard: inner corners (columns, rows) and side of a square, mm."""

    inner_corners: tuple[int, int]
    square_mm: float
