"""Depth quality of a camera: flat walls at known distances, by distance and by position in the frame."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import astuple, dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from chromaperture.calibration.calibrate_session import leave_one_out
from chromaperture.calibration.session import Session, read_session
from chromaperture.camera.camera import CodedApertureCamera
from chromaperture.camera.method import default_config
from chromaperture.color.color_maps import DIFFERENCE, ERROR, OTHER
from chromaperture.evaluation.figures import BLUE, GREY, ORANGE, new_figure, show_image, style_axes
from chromaperture.model.camera_file import Calibration
from chromaperture.settings.methods import Quality
from chromaperture.system.errors import InputError
from chromaperture.system.robust import robust_sigma
from chromaperture_paper import world
from chromaperture_paper.context import Context
from chromaperture_paper.registry import Chart, Content, CsvTable

_MOST_QUICK = 6  # boards of a quick run
_MAP_CELLS = (6, 9)  # rows, columns
_COLORS: dict[Quality, str] = {"real-time": BLUE, "accurate": ORANGE}
_NAMES = ("fill", "Z accuracy", "plane-fit RMS", "sub-pixel RMS, px", "outliers")


@dataclass(frozen=True)
class Wall:
    """A photographed wall, its distance from the sensor, and the camera to measure it with."""

    image: np.ndarray
    truth_mm: float
    calibration: Calibration


@dataclass(frozen=True)
class QualityRow:
    """Depth quality of one wall: whole, in nine zones, and in the cells of a map."""

    truth_mm: float
    whole: PlaneQuality
    zones: list[PlaneQuality]
    map: list[PlaneQuality]


def quality(context: Context) -> Content:
    """Measure all walls."""
    source, count, walls = _walls(context)
    qualities: tuple[Quality, ...] = ("real-time",) if context.quick else ("real-time", "accurate")
    measured: dict[Quality, list[QualityRow]] = {quality: [] for quality in qualities}
    for number, wall in enumerate(walls):
        for k, quality in enumerate(qualities):
            what = f"quality {quality} of the wall at {wall.truth_mm:.0f} mm"
            context.progress(what, len(qualities) * number + k, len(qualities) * count)
            measured[quality].append(measure(wall, quality))
    for found in measured.values():
        found.sort(key=lambda m: m.truth_mm)
    return _content(source, measured)


def measure(wall: Wall, quality: Quality) -> QualityRow:
    """Measure a wall and compute its depth quality."""
    camera = CodedApertureCamera(wall.calibration, default_config(wall.calibration, quality))
    depth = np.asarray(camera.measure(wall.image).depth_mm, float)
    model = wall.calibration.depth_model(quality)
    delta, scale = float(np.mean(model.sensor_to_pupil_mm)), np.asarray(model.scale_px_mm, float)

    def cut(rows: int, columns: int) -> list[PlaneQuality]:
        return by_cell(depth, wall.truth_mm, sensor_to_pupil_mm=delta, scale_px_mm=scale, rows=rows, columns=columns)

    return QualityRow(wall.truth_mm, cut(1, 1)[0], cut(3, 3), cut(*_MAP_CELLS))


def _walls(context: Context) -> tuple[str, int, Iterator[Wall]]:
    """Return source, number and walls: a session's boards, or simulated walls that the camera was not calibrated on."""
    if context.data is None:
        result, source = context.calibrated()
        source += " Other walls are photographed by the same simulated lens."
        return source, len(_simulated_mm(context)), _simulated(context, result.calibration)
    if context.cameras:
        cameras = {c.design: c for c in (Calibration.load(path) for path in context.cameras)}
        session = read_session(session_folder(context.data, tuple(cameras)))
        calibration = cameras.get(session.design)
        if calibration is None:
            raise InputError(f"--camera is of {', '.join(cameras)}, {session.folder} of {session.design}")
        session = session.decoded_as(calibration.sensor)
        boards = chosen_boards(session, quick=context.quick)
        known = {str(b.get("file")) for b in calibration.provenance.get("boards", ())}
        seen = sum(path.name in known for path in boards)
        source = f"{len(boards)} boards of {session.folder.name}, measured with {calibration.design}'s camera file."
        if seen:
            source += f" {seen} of them have names that it was calibrated on: others are better evidence."
        return source, len(boards), (Wall(session.read(path), mm, calibration) for path, mm in boards.items())
    result, source = context.calibrated()
    boards = chosen_boards(result.session, quick=context.quick)
    number = {path: i for i, path in enumerate(result.session.boards)}
    return (
        f"{source} Each board is measured by a camera whose depth curve was fitted without it.",
        len(boards),
        (Wall(result.session.read(path), mm, leave_one_out(result, number[path])) for path, mm in boards.items()),
    )


def session_folder(data: Path, designs: tuple[str, ...] = ("cy_halves",)) -> Path:
    """Find the session: the data folder itself, or a folder in it with the name of a design."""
    for folder in (data, *(data / design for design in designs)):
        if (folder / "session.toml").is_file():
            return folder
    raise InputError(f"{data} has no session.toml, nor has {' or '.join(designs)} in it: give a session's folder")


def chosen_boards(session: Session, *, quick: bool) -> dict[Path, float]:
    """Return all boards, or a few evenly spaced ones, with their distances in mm."""
    paths = sorted(session.boards, key=lambda path: session.boards[path])
    if not paths:
        raise InputError(f"{session.folder} has no boards: depth quality needs walls at known distances")
    if quick:
        paths = [paths[i] for i in np.unique(np.linspace(0, len(paths) - 1, _MOST_QUICK).round().astype(int))]
    return {path: session.boards[path] for path in paths}


def _simulated_mm(context: Context) -> list[float]:
    return [float(mm) for mm in np.linspace(1150, 3750, 4 if context.quick else 9)]


def _simulated(context: Context, calibration: Calibration) -> Iterator[Wall]:
    for seed, distance in enumerate(_simulated_mm(context), 500):
        planes = world.board(context.session_camera, distance, seed=seed)
        yield Wall(context.session_capture(planes, seed=seed).image, distance, calibration)


def _content(source: str, measured: dict[Quality, list[QualityRow]]) -> Content:
    first: Quality = next(reversed(measured))
    by_distance = [
        (quality, f"{m.truth_mm:.0f}", *_cells(m.whole)) for quality, found in measured.items() for m in found
    ]
    zones = [(zone, *_cells(_median([m.zones[i] for m in measured[first]]))) for i, zone in enumerate(ZONES)]
    lines = []
    for quality, found in measured.items():
        q = _median([m.whole for m in found])
        size = _median([replace(m.whole, accuracy=abs(m.whole.accuracy)) for m in found])
        lines.append(
            f"Quality {quality}, median over the walls: {q.fill:.1%} filled, {size.accuracy:.2%} of Z accuracy "
            f"(its size), {q.plane_rms:.2%} of plane-fit RMS, {q.subpixel_rms_px:.3f} px of sub-pixel RMS."
        )
    return Content(
        source=source,
        charts=[
            Chart("distance", _distance_figure(measured), "Flat walls over the whole frame. Sub-pixel RMS should be "
                  "level; plane-fit RMS grows with the distance, as in every triangulating camera."),
            Chart("frame", _frame_figure(measured[first]), f"Over the frame, quality {first}, median over the walls."),
        ],
        tables=[
            CsvTable("distance", "By distance", ("quality", "distance, mm", *_NAMES), by_distance),
            CsvTable("position", f"By position in the frame, quality {first}, median over the walls, each zone "
                     "against its own plane", ("zone", *_NAMES), zones),
        ],
        lines=[*lines,
               "Z accuracy is the median of (measured - true) / true; the RMS figures are taken from the best plane, "
               "without pixels farther than four robust standard deviations from it, which are the outliers."],
    )  # fmt: skip


def _distance_figure(measured: dict[Quality, list[QualityRow]]) -> Figure:
    figure = new_figure(height=4.8)
    panels = figure.subplots(2, 2).ravel()
    quantities = (("fill, %", 100), ("Z accuracy, %", 100), ("plane-fit RMS, %", 100), ("sub-pixel RMS, px", 1))
    for k, (axes, (title, scale)) in enumerate(zip(panels, quantities, strict=True)):
        for quality, found in measured.items():
            values = [scale * astuple(m.whole)[k] for m in found]
            distances = [m.truth_mm for m in found]
            axes.plot(distances, values, "o-", color=_COLORS[quality], markersize=4, label=quality)
        axes.axhline(0, color=GREY, linewidth=0.8)
        style_axes(axes, xlabel="distance, mm", ylabel=title)
    panels[0].set_ylim(0, 105)
    panels[0].legend(frameon=False, fontsize=8)
    return figure


def _frame_figure(found: list[QualityRow]) -> Figure:
    figure = new_figure(height=2.4)
    cells = np.array([astuple(_median([m.map[i] for m in found])) for i in range(_MAP_CELLS[0] * _MAP_CELLS[1])])
    fill, accuracy, rms = (100 * cells[:, k].reshape(_MAP_CELLS) for k in range(3))
    most = max(float(np.nanmax(np.abs(accuracy))), 0.5)  # no narrower scale, so that an accurate camera looks even
    fill_axes, accuracy_axes, rms_axes = figure.subplots(1, 3)
    show_image(fill_axes, fill, "fill, %", bar="", colors=OTHER, vmin=min(80.0, float(fill.min())), vmax=100)
    show_image(accuracy_axes, accuracy, "Z accuracy, %", bar="", colors=DIFFERENCE, vmin=-most, vmax=most)
    show_image(rms_axes, rms, "plane-fit RMS, %", bar="", colors=ERROR, vmin=0)
    return figure


def _cells(quality: PlaneQuality) -> tuple[str, ...]:
    fill, accuracy, plane, pixel, outliers = astuple(quality)
    return f"{fill:.1%}", f"{accuracy:+.2%}", f"{plane:.2%}", f"{pixel:.3f}", f"{outliers:.1%}"


def _median(found: list[PlaneQuality]) -> PlaneQuality:
    table = np.array([astuple(q) for q in found])
    known = np.isfinite(table).any(axis=0)
    middle = np.full(table.shape[1], np.nan)
    middle[known] = np.nanmedian(table[:, known], axis=0)
    return PlaneQuality(*(float(v) for v in middle))


ZONES = ("top left", "top", "top right", "left", "middle", "right", "bottom left", "bottom", "bottom right")
_OUTLIER_SIGMAS = 4.0  # from the plane: matching errors, counted separately; a Gaussian has 0.006 % beyond
_ROUNDS = 5  # fits, each without the outliers of the one before; chosen by hand
_LEAST_PIXELS = 12  # for a fit of three parameters; chosen by hand


@dataclass(frozen=True)
class PlaneQuality:
    """Quality of the measured depth of a piece of a flat wall."""

    fill: float  # fraction of the pixels with a depth
    accuracy: float  # Z accuracy: median of (measured - true) / true; signed
    plane_rms: float  # root mean square distance from the best plane, relative to the distance; without outliers
    subpixel_rms_px: float  # the same in px of half disparity, which does not grow with distance
    outliers: float  # fraction of the pixels with a depth more than four robust standard deviations off the plane


def plane_quality(
    depth_mm: np.ndarray, truth_mm: float, *, sensor_to_pupil_mm: float, scale_px_mm: np.ndarray | float
) -> PlaneQuality:
    """Measure the quality of the depth of a flat wall perpendicular to the axis.

    ``depth_mm`` (H, W) float: from the sensor plane; NaN unknown; ``truth_mm``: its distance from the sensor plane;
    ``sensor_to_pupil_mm``: delta; ``scale_px_mm`` float or (H, W): B of ``d = A - B / (depth - delta)``. Returns NaN
    where fewer than 12 pixels are known.
    """
    known = np.isfinite(depth_mm)
    fill = float(known.mean())
    if known.sum() < _LEAST_PIXELS:
        return PlaneQuality(fill, np.nan, np.nan, np.nan, np.nan)
    depth = np.asarray(depth_mm, float)[known]
    inverse = 1 / (depth - sensor_to_pupil_mm)
    y, x = np.mgrid[-1 : 1 : depth_mm.shape[0] * 1j, -1 : 1 : depth_mm.shape[1] * 1j]
    # A plane in space, of any tilt, is a plane in inverse depth over the picture of a pinhole.
    basis = np.stack([np.ones(len(inverse)), x[known], y[known]], axis=1)
    keep: np.ndarray = np.ones(len(inverse), bool)
    residual = np.zeros(len(inverse))
    for _ in range(_ROUNDS):
        solution, *_ = np.linalg.lstsq(basis[keep], inverse[keep], rcond=None)
        residual = inverse - basis @ solution
        centred = residual - np.median(residual[keep])  # outliers pull the first fit away from an exact plane
        keep = np.abs(centred) <= _OUTLIER_SIGMAS * robust_sigma(centred) + 1e-12  # 1/mm; keeps all of an exact plane
    scale = np.broadcast_to(np.asarray(scale_px_mm, float), depth_mm.shape)[known]
    z = truth_mm - sensor_to_pupil_mm
    return PlaneQuality(
        fill,
        float(np.median(depth) / truth_mm - 1),
        float(np.sqrt(np.mean(residual[keep] ** 2)) * z**2 / truth_mm),  # |d depth| = z^2 |d (1 / z)|
        float(np.sqrt(np.mean((scale * residual)[keep] ** 2))),
        float(1 - keep.mean()),
    )


def cells(height: int, width: int, rows: int, columns: int) -> list[tuple[slice, slice]]:
    """Divide a frame into cells; returns their (rows, columns), row by row."""
    down, across = (np.linspace(0, n, count + 1).round().astype(int) for n, count in ((height, rows), (width, columns)))
    return [(slice(int(a), int(b)), slice(int(c), int(d))) for a, b in pairwise(down) for c, d in pairwise(across)]


def by_cell(
    depth_mm: np.ndarray, truth_mm: float, sensor_to_pupil_mm: float, scale_px_mm: np.ndarray, rows: int, columns: int
) -> list[PlaneQuality]:
    """Apply `plane_quality` to every cell of the frame, each with its own plane; row by row."""
    scale = np.broadcast_to(scale_px_mm, depth_mm.shape)
    return [
        plane_quality(depth_mm[cell], truth_mm, sensor_to_pupil_mm=sensor_to_pupil_mm, scale_px_mm=scale[cell])
        for cell in cells(depth_mm.shape[0], depth_mm.shape[1], rows, columns)
    ]
