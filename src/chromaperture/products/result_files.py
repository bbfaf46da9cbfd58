"""Read what ``chromaperture depth`` wrote, and depth maps of other programs, for comparison and for viewing."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from chromaperture.capture.files import read_samples
from chromaperture.depth.pointcloud import PointCloud
from chromaperture.files.depth_exr import read_exr
from chromaperture.frame.frame_files import EXR, OUTPUTS
from chromaperture.system.errors import InputError
from chromaperture.system.validation import MOST_PIXELS, read_bytes

_MOST_BYTES = 4_000_000_000  # of a cloud or an array's file: 250 megapixels of 15 bytes
_MOST_POINTS = MOST_PIXELS
_HEADER_BYTES = 65_536  # of a PLY file: ours have 400
_PLY_TYPES = {"char": "i1", "uchar": "u1", "short": "<i2", "ushort": "<u2", "int": "<i4", "uint": "<u4",
              "float": "<f4", "double": "<f8", "int8": "i1", "uint8": "u1", "int16": "<i2", "uint16": "<u2",
              "int32": "<i4", "uint32": "<u4", "float32": "<f4", "float64": "<f8"}  # fmt: skip
_UNIT = re.compile(r"(?:^|[._-])depth_(\d+(?:\.\d+)?)?(mm|cm|m)$")  # that a file's name states: "x.depth_0.1mm.png"
_UNITS_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0}


@dataclass(frozen=True)
class StoredDepth:
    """A depth map as a file holds it, and its error bar, where that is beside it."""

    name: str
    depth_mm: np.ndarray  # (H, W) float32, mm, NaN unknown
    sigma_mm: np.ndarray | None = None  # (H, W) float32, mm, one standard deviation; None where there is no file of it


@dataclass(frozen=True)
class StoredResult:
    """The results that lie beside each other under one name; what is missing is None."""

    name: str
    # Dict of str to (H, W) float32: by their names in `OUTPUTS` (``depth``, ``sigma``, ``disparity``), ``confidence``
    # of an EXR file, or ``map`` of a file of another name.
    maps: dict[str, np.ndarray] = field(default_factory=dict)
    picture: np.ndarray | None = None  # (H, W, 3) uint8: sRGB
    cloud: PointCloud | None = None
    summary: Path | None = None  # the JSON file


def stem_and_output(path: Path) -> tuple[str, str | None]:
    """Split a file's name into that of the photograph and the name of the output, None where it is none of ours."""
    for name, output in OUTPUTS.items():  # "a.depth.png" before "a.png": suffixes of ours are the longer ones
        if output.suffix.count(".") > 1 and path.name.endswith(output.suffix):
            return path.name.removesuffix(output.suffix), name
    for name, output in OUTPUTS.items():
        if output.suffix.count(".") == 1 and path.name.endswith(output.suffix):
            return path.name.removesuffix(output.suffix), name
    return path.stem, None


def read_depth(path: str | Path, *, name: str | None = None) -> StoredDepth:
    """Read a depth map (TIFF, PNG, .npy, EXR), named for messages, with the error bar beside it.

    It is in mm, or in the unit that the file's name states before its suffix: ``depth_0.1mm``, ``depth_m``.
    """
    path = Path(path)
    stem, output = stem_and_output(path)
    if output in EXR:
        values, bar, _ = read_exr(path)
        return StoredDepth(name or path.name, values, bar)
    if output not in (None, "depth", "depth-png"):
        path = path.with_name(stem + OUTPUTS["depth"].suffix)
    depth = _map(path)
    sigma_file = path.with_name(stem + OUTPUTS["sigma"].suffix)
    sigma = _map(sigma_file) if output is not None and sigma_file.is_file() else None
    if sigma is not None and sigma.shape != depth.shape:
        raise InputError(f"{sigma_file.name} has another size than {path.name}; measure the photograph again")
    if not (np.isfinite(depth) & (depth > 0)).any():
        raise InputError(f"{path.name} holds no depth: all of its pixels are unknown")
    return StoredDepth(name or path.name, depth, sigma)


def picture_beside(path: Path) -> np.ndarray | None:
    """Return the colour picture beside a result of ``chromaperture depth``, (H, W, 3) uint8 sRGB; None without one."""
    stem, output = stem_and_output(path)
    file = path.with_name(stem + OUTPUTS["color"].suffix)
    return _picture(file) if output is not None and file.is_file() else None


def read_result(path: str | Path) -> StoredResult:
    """Read all results that lie beside a file of ``chromaperture depth``; of another file, its map or its points."""
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path} is no file; give one of the files that 'chromaperture depth' wrote")
    stem, output = stem_and_output(path)
    if output is None:
        return StoredResult(path.name, {"map": _map(path)})
    found: dict[str, Path] = {}
    for name, other in OUTPUTS.items():
        beside = path.with_name(stem + other.suffix)
        if beside == path or beside.is_file():
            found[name] = beside
    maps: dict[str, np.ndarray] = {name: _map(found[name]) for name in ("depth", "sigma", "disparity") if name in found}
    if "depth" not in maps and "depth-png" in found:
        maps["depth"] = _map(found["depth-png"])
    if output in EXR and "depth" not in maps:
        maps["depth"], maps["sigma"], maps["confidence"] = read_exr(path)
    picture = _picture(found["color"]) if "color" in found else None
    cloud = read_ply(found["ply"]) if "ply" in found else None
    if not maps and picture is None and cloud is None:
        raise InputError(f"beside {path.name} lies no result that can be shown; write depth, disparity, color or ply")
    return StoredResult(stem, maps, picture, cloud, found.get("json"))


def _map(path: Path) -> np.ndarray:
    """Read a file of one value a pixel; (H, W) float32, NaN unknown."""
    if path.suffix.lower() == ".npy":
        values = _array(path)
    elif path.suffix.lower() in (".tif", ".tiff", ".png", ".pgm"):
        values = read_samples(path)
    else:
        raise InputError(f"{path.name} is no map: give a float TIFF, a 16-bit PNG in mm, or a NumPy array (.npy)")
    if values.ndim != 2 or values.size == 0:
        raise InputError(f"{path.name} holds an array of shape {values.shape}; a map has one value a pixel")
    if values.dtype.kind not in "uf":
        raise InputError(f"{path.name} holds {values.dtype} values; give float or 16-bit counts")
    stated = _UNIT.search(path.stem)
    unit_mm = float(stated[1] or 1) * _UNITS_MM[stated[2]] if stated else 1.0
    in_mm = values.astype(np.float32) * np.float32(unit_mm)
    if values.dtype.kind == "u":  # pictures of counts: 0 is unknown, as RealSense and TUM write it
        in_mm[values == 0] = np.nan
    return in_mm


def _array(path: Path) -> np.ndarray:
    """Read a NumPy file without running what is in it."""
    if not path.is_file():
        raise InputError(f"{path} is no file; give a map that 'numpy.save' wrote")
    try:  # mapped: a header that declares more than the file holds is refused before memory is taken
        return np.array(np.load(path, mmap_mode="r", allow_pickle=False))
    except Exception:  # NumPy raises anything on a damaged file
        raise InputError(f"{path.name} is damaged or no NumPy array; save it again with numpy.save") from None


def _picture(path: Path) -> np.ndarray:
    values = read_samples(path)
    if values.ndim != 3 or values.shape[2] < 3:
        raise InputError(f"{path.name} is no colour picture; measure the photograph again")
    return values[..., :3] if values.dtype == np.uint8 else (values[..., :3] >> 8).astype(np.uint8)


def read_ply(path: str | Path) -> PointCloud:
    """Read the points of a binary PLY in mm; faces are left out, points without colours are grey."""
    path = Path(path)
    data = read_bytes(path, most_bytes=_MOST_BYTES)
    head, mark, _ = data[:_HEADER_BYTES].partition(b"end_header\n")
    damaged = InputError(f"{path.name} is damaged or no binary PLY file of points; write it again")
    if not data.startswith(b"ply") or not mark or b"format binary_little_endian 1.0" not in head:
        raise damaged
    lines = head.decode("ascii", "replace").splitlines()
    count, fields = _vertices(lines, damaged)
    start = len(head) + len(mark)
    names = fields.names or ()
    if count > _MOST_POINTS or start + count * fields.itemsize > len(data) or not {"x", "y", "z"} <= set(names):
        raise damaged
    vertices = np.frombuffer(data, fields, count, start)
    points = np.stack([vertices[axis].astype(np.float32) for axis in "xyz"], axis=1)
    colors = np.full((count, 3), 160, np.uint8)
    for channel, name in enumerate(("red", "green", "blue")):
        if name in names and fields[name] == np.uint8:
            colors[:, channel] = vertices[name]
    return PointCloud(points, colors)


def _vertices(lines: list[str], damaged: InputError) -> tuple[int, np.dtype]:
    """Return how many vertices a PLY header declares first, and their fields."""
    count, fields, names = None, [], set[str]()
    for line in lines:
        element = re.fullmatch(r"element (\w+) (\d{1,12})", line.strip())
        if element and count is not None:
            break
        if element and element[1] == "vertex":
            count = int(element[2])
        elif element:
            break  # another element comes first: its lists would have to be read to find the vertices
        scalar = re.fullmatch(r"property (\w+) (\w+)", line.strip())
        if count is not None and scalar:
            if scalar[1] not in _PLY_TYPES or scalar[2] in names:
                break
            names.add(scalar[2])
            fields.append((scalar[2], _PLY_TYPES[scalar[1]]))
    if count is None or not fields:
        raise damaged
    return count, np.dtype(fields)
