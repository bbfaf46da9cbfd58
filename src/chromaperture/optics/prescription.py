"""Lens prescriptions: surfaces, glasses and apertures as data, shipped or from a user's TOML file."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from chromaperture.system.errors import InputError
from chromaperture.system.validation import Finite, Name, Number, Positive, Table, checked, quoted, read_text, read_toml

_LINE_F, _LINE_D, _LINE_C = 0.4861, 0.5876, 0.6563  # um, Fraunhofer lines that define the Abbe number
_WAVELENGTHS_UM = (0.605, 0.540, 0.465)  # R, G, B: about the peaks of a Bayer sensor; chosen by hand, not tuned
# Of a lens file: zoom lenses have some 40 surfaces, aspheres of smartphones some 10 coefficients.
_MOST_SURFACES, _MOST_COEFFICIENTS = 200, 32
_MOST_JSON_BYTES = 1_000_000
# Of what light passes: a micron, a kilometre, more than germanium (4). Beyond, paraxial matrices overflow.
_SMALLEST_MM, _LARGEST_MM, _LARGEST_INDEX = 1e-3, 1e6, 10.0


@dataclass(frozen=True)
class Surface:
    """One surface and the medium behind it; all lengths in mm, light travels towards +z, to the sensor."""

    radius_mm: float = math.inf  # radius of curvature, + with the centre towards the sensor, inf for a plane
    thickness_mm: float = 0.0  # distance to the next surface
    index_d: float = 1.0  # refractive index of the medium behind at 587.6 nm
    abbe: float = math.inf  # its Abbe number, inf without dispersion
    semi_diameter_mm: float = math.inf  # half the clear diameter; inf when unlimited
    conic: float = 0.0  # 0 sphere, -1 paraboloid
    coefficients: tuple[float, ...] = ()  # even asphere: factors of r^4, r^6, ... in mm
    role: str = ""  # "", "stop", or "filter" for a plane that only holds the colour filters

    def index(self, wavelength_um: float) -> float:
        """Compute the refractive index by Cauchy's two terms from ``index_d`` and ``abbe``."""
        if math.isinf(self.abbe):
            return self.index_d
        slope = (self.index_d - 1) / self.abbe / (_LINE_F**-2 - _LINE_C**-2)
        return self.index_d + slope * (wavelength_um**-2 - _LINE_D**-2)


@dataclass(frozen=True)
class Prescription:
    """A lens in front of a sensor."""

    name: str  # identifier
    title: str  # for people
    source: str  # of the figures
    surfaces: tuple[Surface, ...]  # in order from the scene to the sensor
    sensor_gap_mm: float  # last vertex to sensor: the focus setting
    wavelengths_um: tuple[float, float, float]  # one wavelength each for R, G, B

    @property
    def vertices_mm(self) -> np.ndarray:
        """(N,) float64: vertex of each surface on the axis, from the first one."""
        return np.concatenate([[0.0], np.cumsum([s.thickness_mm for s in self.surfaces[:-1]])])

    @property
    def first_vertex_to_sensor_mm(self) -> float:
        """Distance of the first vertex from the sensor plane."""
        return float(self.vertices_mm[-1]) + self.sensor_gap_mm

    @property
    def stop_index(self) -> int:
        """Index of the surface that is the stop."""
        return next(i for i, s in enumerate(self.surfaces) if s.role == "stop")

    @property
    def filter_index(self) -> int:
        """Index of the surface with the colour filters: a separate filter plane, or else the stop."""
        return next((i for i, s in enumerate(self.surfaces) if s.role == "filter"), self.stop_index)

    def indices(self, wavelength_um: float) -> np.ndarray:
        """(N + 1,) float64: refractive index before the first and behind every surface."""
        return np.array([1.0] + [s.index(wavelength_um) for s in self.surfaces])


def lens_names() -> list[str]:
    """List the prescriptions that come with the package."""
    folder = resources.files("chromaperture.optics") / "prescriptions"
    return sorted(item.name.removesuffix(".toml") for item in folder.iterdir() if item.name.endswith(".toml"))


def load_lens(name_or_path: str | Path) -> Prescription:
    """Load a lens of the package by its name, or a user's from a TOML file, see `lens_from_dict`, or a JSON file."""
    name = str(name_or_path)
    if name.endswith(".json"):
        return _lens_of_json(Path(name))
    if not name.endswith(".toml"):
        if name not in lens_names():
            raise InputError(f"unknown lens {name!r}: choose one of {', '.join(lens_names())}, or give a .toml file")
        path: Any = resources.files("chromaperture.optics") / "prescriptions" / f"{name}.toml"
    else:
        path = Path(name)
        if not os.path.lexists(path):
            raise InputError(f"no lens file {quoted(path)}: give a file, or one of {', '.join(lens_names())}")
    with resources.as_file(path) as file:
        return lens_from_dict(read_toml(file), name=file.name.removesuffix(".toml"))


class _SurfaceTable(Table):
    """``[[surface]]`` of a lens file; lengths in mm."""

    radius_mm: Number = math.inf
    thickness_mm: Finite = 0.0
    index_d: Finite = 1.0
    abbe: Number = math.inf
    clear_diameter_mm: Number = math.inf
    conic: Finite = 0.0
    coefficients: Annotated[tuple[Finite, ...], Field(max_length=_MOST_COEFFICIENTS)] = ()
    stop: bool = False


class _LensTable(Table):
    """A lens file."""

    sensor_gap_mm: Positive
    title: Name | None = None
    source: str = ""
    wavelengths_um: tuple[Positive, Positive, Positive] = _WAVELENGTHS_UM
    surface: Annotated[tuple[_SurfaceTable, ...], Field(max_length=_MOST_SURFACES)] = ()


def lens_from_dict(data: Mapping[str, Any], *, name: str) -> Prescription:
    """Build a lens from the contents of its TOML file.

    ``data``: ``sensor_gap_mm``, optional ``title``, ``source``, ``wavelengths_um``, and a list ``surface`` of tables
    with ``radius_mm`` (absent: plane), ``thickness_mm``, ``index_d``, ``abbe``, ``clear_diameter_mm``, ``conic``,
    ``coefficients`` and ``stop = true`` on one of them. Raises InputError: unknown keys, values of another type, no
    surface, no stop or several, a stop without diameter, values that are not physical.
    """
    table = checked(_LensTable, dict(data), where=f"lens {quoted(name)}")
    surfaces = tuple(
        Surface(
            **row.model_dump(exclude={"clear_diameter_mm", "stop"}),
            semi_diameter_mm=row.clear_diameter_mm / 2,
            role="stop" if row.stop else "",
        )
        for row in table.surface
    )
    return checked_lens(
        Prescription(
            name=name,
            title=name if table.title is None else table.title,
            source=table.source,
            surfaces=surfaces,
            sensor_gap_mm=table.sensor_gap_mm,
            wavelengths_um=table.wavelengths_um,
        )
    )


def _lens_of_json(path: Path) -> Prescription:
    """Read a lens of a raytracer's JSON: ``roc`` radius, ``r`` semi-diameter, ``d_next`` thickness, index/Abbe."""
    try:
        table = json.loads(read_text(path, most_bytes=_MOST_JSON_BYTES))
        rows = [_surface(surface) for surface in table["surfaces"]]
        gap = rows[-1].pop("thickness_mm")
    except (ValueError, KeyError, TypeError, IndexError, AttributeError, RecursionError) as error:
        raise InputError(f"{path.name} is no lens prescription ({type(error).__name__}: {error})") from None
    return lens_from_dict({"sensor_gap_mm": gap, "surface": rows, "title": path.stem}, name=path.stem)


def _surface(surface: Mapping[str, Any]) -> dict[str, Any]:
    row: dict[str, Any] = {"thickness_mm": surface["d_next"], "clear_diameter_mm": 2 * surface["r"]}
    if surface["mat2"] != "air":
        row["index_d"], row["abbe"] = map(float, surface["mat2"].split("/"))
    if surface["type"] == "Stop":
        return row | {"stop": True}
    row["radius_mm"] = surface["roc"]
    if surface["type"] == "Aspheric":
        if surface["ai"][0]:
            raise ValueError("an asphere with a term of r^2")
        row |= {"conic": surface["k"], "coefficients": surface["ai"][1:]}
    return row


def checked_lens(lens: Prescription) -> Prescription:
    """Validate a prescription and return it; raises InputError like `lens_from_dict`."""
    stops = [s for s in lens.surfaces if s.role == "stop"]
    if len(stops) != 1:
        raise InputError(f"lens {lens.name!r} has {len(stops)} stops: mark exactly one surface with stop = true")
    if not math.isfinite(stops[0].semi_diameter_mm) or stops[0].semi_diameter_mm <= 0:
        raise InputError(f"lens {lens.name!r}: the stop needs a clear_diameter_mm")
    for number, s in enumerate(lens.surfaces, start=1):
        bad = s.thickness_mm < 0 or s.index_d < 1 or s.abbe <= 0 or s.semi_diameter_mm <= 0
        bad = bad or abs(s.radius_mm) < _SMALLEST_MM or s.thickness_mm > _LARGEST_MM or s.index_d > _LARGEST_INDEX
        if bad or math.isnan(s.radius_mm + s.thickness_mm + s.index_d + s.conic):
            raise InputError(
                f"lens {lens.name!r}, surface {number} is not physical: radius must not be 0, thickness "
                f"lie between 0 and {_LARGEST_MM:g} mm, index between 1 and {_LARGEST_INDEX:g}, Abbe number and "
                "diameter be positive"
            )
    if lens.surfaces[-1].index_d != 1:
        raise InputError(f"lens {lens.name!r}: behind the last surface must be air (index_d = 1)")
    if not (0 < lens.sensor_gap_mm <= _LARGEST_MM and min(lens.wavelengths_um) > 0.2):
        raise InputError(f"lens {lens.name!r}: sensor_gap_mm must be positive and wavelengths in um")
    return lens


def with_filter_at(lens: Prescription, offset_mm: float) -> Prescription:
    """Move the colour filters off the stop, + towards the sensor; they may lie in front of the lens."""
    z = float(lens.vertices_mm[lens.stop_index]) + offset_mm
    if z <= 0:
        return replace(lens, surfaces=(Surface(thickness_mm=-z, role="filter"), *lens.surfaces))
    after = int(np.searchsorted(lens.vertices_mm, z, side="right")) - 1
    host = lens.surfaces[after]
    if host.index_d != 1 or after == len(lens.surfaces) - 1:
        raise InputError(
            f"a filter {offset_mm:g} mm from the stop of {lens.name!r} lies inside or behind the glass: "
            "choose an air gap"
        )
    rest = float(lens.vertices_mm[after]) + host.thickness_mm - z
    split = (replace(host, thickness_mm=host.thickness_mm - rest), Surface(thickness_mm=rest, role="filter"))
    return replace(lens, surfaces=lens.surfaces[:after] + split + lens.surfaces[after + 1 :])
