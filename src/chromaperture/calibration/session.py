"""A calibration session: a folder of photographs, ``session.toml`` and ``distances.csv``.

``docs/calibration-session.md`` shows the layout.
"""

from __future__ import annotations

import csv
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from chromaperture.calibration.board_distances import check_units
from chromaperture.camera_file import CameraSensor
from chromaperture.capture.files import decode, linearise, photographs
from chromaperture.errors import InputError
from chromaperture.optics.aperture import DESIGNS, design_named

# Name of the white sheet through a whole pupil of one filter; film without a name has none.
SHEETS = {"cyan": "sheet_c", "yellow": "sheet_y", "magenta": "sheet_m", "red": "sheet_r", "green": "sheet_g",
          "blue": "sheet_b"}  # fmt: skip


@dataclass(frozen=True)
class Session:
    """The checked contents of a session folder."""

    folder: Path
    design: str
    sensor: CameraSensor
    nominal_focal_length_mm: float
    nominal_f_number: float
    focused_at_about_mm: float
    inner_corners: tuple[int, int]  # (columns, rows)
    square_mm: float
    ruler_error_mm: float
    # Photograph of the board square to the axis, and its distance from the sensor plane by ruler, mm.
    boards: dict[Path, float]
    tilts: tuple[Path, ...]  # tilted boards, for the intrinsics

    def read(self, path: Path) -> np.ndarray:
        """Read one photograph of the session as linear light; (H, W, 3) float32."""
        # As `depth` reads: 8 bits, which cannot hold the levels of a sensor, are decoded from the sRGB curve.
        levels = (self.sensor.black_level, self.sensor.white_level)
        image = linearise(decode(path), camera_levels=levels)
        expected = (self.sensor.height_px, self.sensor.width_px)
        if image.shape[:2] != expected:
            raise InputError(
                f"{path.name} is {image.shape[1]}x{image.shape[0]} px but session.toml says "
                f"{expected[1]}x{expected[0]}; correct session.toml or the photograph"
            )
        return image

    @property
    def sheets(self) -> dict[str, Path]:
        """Photographs of white sheets by name; those in the session's folder replace those beside it."""
        folders = (self.folder.parent / "white", self.folder / "white")
        names = {"open", *DESIGNS, *SHEETS.values()}
        return {path.stem: path for folder in folders for path in photographs(folder) if path.stem in names}

    def white(self, name: str) -> np.ndarray | None:
        """Return the mean colour of the middle of a white sheet; (3,) float64, None where there is no photograph."""
        if name not in self.sheets:
            return None
        image = self.read(self.sheets[name])
        rows, columns = (slice(n * 2 // 5, n * 3 // 5) for n in image.shape[:2])  # vignetting spares the middle fifth
        return image[rows, columns].reshape(-1, 3).mean(axis=0).astype(float)


def read_session(folder: str | Path) -> Session:
    """Read and check a session folder.

    Raises
    ------
    InputError
        A file or an entry is missing or invalid; the message names it.
    """
    folder = Path(folder)
    settings = folder / "session.toml"
    try:
        text = settings.read_text(encoding="utf-8")
    except OSError as error:
        raise InputError(f"cannot read {settings}: {error.strerror or error}; is this a session folder?") from None
    try:
        tree = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{settings}: {error}") from None

    def number(section: str, key: str, default: float | None = None) -> float:
        value = _entry(tree, section).get(key, default)
        if not isinstance(value, int | float) or not np.isfinite(value) or value < 0:
            raise InputError(f"{settings}: {key} in [{section}] must be a number >= 0, is {value!r}")
        return float(value)

    corners = _entry(tree, "board").get("inner_corners", [9, 6])
    if not (isinstance(corners, list) and len(corners) == 2 and all(isinstance(c, int) and c > 2 for c in corners)):
        raise InputError(f"{settings}: inner_corners in [board] must be two whole numbers, such as [9, 6]")

    def electrons(key: str) -> float | None:
        return number("sensor", key) if key in _entry(tree, "sensor") else None

    boards = _distances(folder)
    rulers = np.array([*boards.values()])
    check_units(rulers, number("lens", "focused_at_about_mm"), where=str(folder / "distances.csv"))
    return Session(
        folder=folder,
        design=design_named(str(tree.get("design"))).name,
        sensor=CameraSensor(
            width_px=int(number("sensor", "width_px")),
            height_px=int(number("sensor", "height_px")),
            pixel_pitch_mm=number("sensor", "pixel_pitch_mm"),
            black_level=number("sensor", "black_level", 0.0),
            white_level=number("sensor", "white_level", 65535.0),
            full_well_electrons=electrons("full_well_electrons"),
            read_noise_electrons=electrons("read_noise_electrons"),
        ),
        nominal_focal_length_mm=number("lens", "nominal_focal_length_mm"),
        nominal_f_number=number("lens", "nominal_f_number"),
        focused_at_about_mm=number("lens", "focused_at_about_mm"),
        inner_corners=(corners[0], corners[1]),
        square_mm=number("board", "square_mm"),
        ruler_error_mm=number("board", "ruler_error_mm", 3.0),
        boards=boards,
        tilts=tuple(photographs(folder / "tilt")),
    )


def _entry(tree: Mapping[str, Any], section: str) -> Mapping[str, Any]:
    entry = tree.get(section)
    if not isinstance(entry, dict):
        raise InputError(f"session.toml has no [{section}] section")
    return entry


def _distances(folder: Path) -> dict[Path, float]:
    table = folder / "distances.csv"
    try:
        rows = list(csv.DictReader(table.read_text(encoding="utf-8").splitlines()))
        boards = {folder / row["file"]: float(row["ruler_mm"]) for row in rows}
    except OSError as error:
        raise InputError(f"cannot read {table}: {error.strerror or error}") from None
    except (KeyError, TypeError, ValueError):
        raise InputError(f"{table} must have the columns file,ruler_mm with distances in mm") from None
    missing = [path.name for path in boards if not path.is_file()]
    if missing:
        raise InputError(f"{table} names photographs that are not there: {', '.join(missing[:5])}")
    return boards
