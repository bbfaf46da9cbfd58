"""A simulated calibration session, in the folder layout that ``calibrate`` reads."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import cast

import cv2
import numpy as np

from chromaperture.optics.aperture import CYAN, DESIGNS, OPAQUE, YELLOW, Aperture, Disc, Filter, SubAperture
from chromaperture.optics.pinhole import PupilCamera
from chromaperture.optics.ray_table import RayTable
from chromaperture.optics.simulator import textures
from chromaperture.optics.simulator.render import render, render_depth
from chromaperture.optics.simulator.scene import Plane, plane
from chromaperture.optics.simulator.sensor import SensorModel, expose
from chromaperture.system.errors import InputError

_WHITE_LEVEL = 0.9  # of white paper in the brightest channel: its noise does not clip
_CORNERS, _SQUARE_MM = (9, 6), 30.0  # the side where the frame has room for it: that of an A3 page
_BOARD_SQUARES = (_CORNERS[0] + 3, _CORNERS[1] + 3)  # with the white margin of one square, which allows for the ruler
_RULER_ERROR = 0.003  # of the nearest distance, at most 3 mm: a short distance is measured with a finer ruler
_PAPER_MM = 0.1  # thickness of the board


@dataclass(frozen=True)
class SessionPlan:
    """Content of a session."""

    # Board distances from the sensor plane.
    distances_mm: tuple[float, ...] = tuple(float(d) for d in range(1000, 4001, 100))
    tilts: int = 12  # tilted views of the board
    # Largest difference between the board's true distance and the recorded one; None: 3 mm, less below 1 m.
    ruler_error_mm: float | None = None
    seed: int = 0
    sensor: SensorModel = field(default_factory=SensorModel)
    # Side of the chessboard's squares; None: 30 mm, or less where the nearest board would leave the frame.
    square_mm: float | None = None

    def for_camera(self, camera: PupilCamera) -> SessionPlan:
        """Return the plan with the ruler error and the square that the nearest board allows."""
        nearest = min(self.distances_mm)
        ruler_error = min(3.0, _RULER_ERROR * nearest) if self.ruler_error_mm is None else self.ruler_error_mm
        square = self.square_mm
        if square is None:
            room = _largest_square(camera, nearest)
            # Whole millimetres, but tenths where there are few of them.
            square = min(_SQUARE_MM, math.floor(room) if room >= 5 else math.floor(10 * room) / 10)
        if not square > 0:
            raise InputError(f"no chessboard fits the frame at {nearest:g} mm: raise --nearest-mm, or give --square-mm")
        if not square <= (room := _largest_square(camera, max(self.distances_mm))):
            raise InputError(f"squares of {square:g} mm leave the frame at every distance; at most {room:.1f} mm fit")
        return replace(self, ruler_error_mm=ruler_error, square_mm=square)


def write_session(
    folder: Path,
    *,
    aperture: Aperture,
    camera: PupilCamera,
    rays: Callable[[Aperture], RayTable],
    scenes: dict[str, Sequence[Plane]],
    plan: SessionPlan,
    report: Callable[[str], None] = lambda note: None,
    progress: Callable[[str, int, int], None] = lambda what, done, total: None,
) -> bool:
    """Render and write a session, ``white`` and ``truth`` too, into ``folder``; raises InputError.

    Returns whether it is whole: Ctrl-C ends it with what is finished, once there is a board.
    """
    if not plan.distances_mm:
        raise InputError("a session needs at least one board distance")
    plan = plan.for_camera(camera)
    ruler_error_mm, square_mm = cast(float, plan.ruler_error_mm), cast(float, plan.square_mm)
    done, total = 0, 2 + len(_sheets(aperture)) + len(plan.distances_mm) + plan.tilts + len(scenes)
    progress("simulated photographs", done, total)
    table, open_table = rays(aperture), rays(DESIGNS["open"])
    sheet = [plane(np.ones((2, 2, 3), np.float32), center_mm=(0, 0, 500.0), width_mm=4000)]
    white, open_white = render(table, sheet), render(open_table, sheet)
    for_scene = _WHITE_LEVEL / float(white.max())
    for_white = _WHITE_LEVEL / float(open_white.max())
    rng = np.random.default_rng(plan.seed)

    def photograph(path: Path, picture: np.ndarray, exposure: float) -> None:
        nonlocal done
        counts = expose(picture, plan.sensor, seed=int(rng.integers(2**31)), exposure=exposure)
        _write_png(path, counts[..., ::-1])
        done += 1
        progress("simulated photographs", done, total)

    whites = folder / "white"
    photograph(whites / f"{aperture.name}.png", white, for_white)
    photograph(whites / "open.png", open_white, for_white)
    for part_name, sheet_filter in _sheets(aperture).items():
        full = Aperture(part_name, part_name, (SubAperture(Disc(radius=2.0), sheet_filter),), OPAQUE, ())
        photograph(whites / f"{part_name}.png", render(rays(full), sheet), for_white)

    truth = folder / "truth"
    lines = ["file,ruler_mm"]
    stood = {}

    def take_all() -> None:
        nonlocal total
        for distance in plan.distances_mm:
            true_mm = distance + float(rng.uniform(-ruler_error_mm, ruler_error_mm))
            name = f"board/{distance:04.0f}.png"
            photograph(folder / name, render(table, wall(camera, (0, 0, true_mm), (0, 0, 0), square_mm)), for_scene)
            lines.append(f"{name},{distance:.0f}")
            stood[name] = true_mm
        for i in range(plan.tilts):
            pose = _in_frame(camera, *_tilted_pose(i / max(plan.tilts, 1), camera, rng), square_mm)
            if pose is None:
                report(f"no tilt {i:02d}: the board would leave the frame")
                total -= 1
                continue
            photograph(folder / f"tilt/{i:02d}.png", render(table, wall(camera, *pose, square_mm)), for_scene)
        for name, planes in scenes.items():
            photograph(folder / f"scene/{name}.png", render(table, planes), for_scene)
            depth = render_depth(table, planes)
            tenths = np.nan_to_num(np.rint(10 * depth)).clip(0, 65535).astype("u2")
            _write_png(truth / f"{name}.depth_0.1mm.png", tenths)

    is_whole = True
    try:
        take_all()
    except KeyboardInterrupt:
        if not stood:
            raise
        is_whole = False
    (folder / "distances.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    (folder / "session.toml").write_text(_session_toml(aperture, camera, plan, for_scene / for_white), "utf-8")
    truth.mkdir(parents=True, exist_ok=True)
    (truth / "camera.json").write_text(json.dumps(_truth(camera, aperture, stood), indent=1) + "\n", "utf-8")
    return is_whole


def _tilted_pose(
    turn: float, camera: PupilCamera, rng: np.random.Generator
) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Choose centre (mm) and tilt (degrees) of a board that leans round by turns; figures chosen by hand."""
    around = 2 * math.pi * turn
    tilt = (18 * math.sin(around), 22 * math.cos(around), float(rng.uniform(-8, 8)))
    distance = float(rng.uniform(0.85, 1.25)) * (2000 if math.isinf(camera.focus_mm) else camera.focus_mm)
    side = 0.15 * distance * camera.width_px / camera.focal_px
    return (side * math.cos(1.7 * around), 0.6 * side * math.sin(around), distance), tilt


def _largest_square(camera: PupilCamera, distance_mm: float) -> float:
    """Return the side, mm, of the squares with which a board square to the axis fills the frame."""
    footprint_mm = (distance_mm - camera.sensor_to_pupil_mm) / camera.focal_px
    sides = zip((camera.width_px, camera.height_px), _BOARD_SQUARES, strict=True)
    return footprint_mm * min(pixels / squares for pixels, squares in sides)


def _in_frame(
    camera: PupilCamera, center: tuple[float, float, float], tilt_deg: tuple[float, float, float], square_mm: float
) -> tuple[tuple[float, float, float], tuple[float, float, float]] | None:
    """Move a tilted board towards the axis until it is inside the frame; None where it never is."""
    flat = np.ones((2, 2, 3), np.float32)
    width, height = (n * square_mm for n in _BOARD_SQUARES)
    for off_axis in (1.0, 0.5, 0.0):
        x, y, z = off_axis * center[0], off_axis * center[1], center[2]
        board = plane(flat, center_mm=(x, y, z), width_mm=width, tilt_deg=tilt_deg)
        corners = np.array([
            board.center_mm + sx * width / 2 * board.right + sy * height / 2 * board.down
            for sx in (-1, 1) for sy in (-1, 1)
        ])  # fmt: skip
        depth = corners[:, 2:] - camera.sensor_to_pupil_mm
        if depth.min() <= 0:
            continue
        image = np.abs(corners[:, :2] / depth * camera.focal_px)
        if (image < 0.5 * np.array([camera.width_px, camera.height_px])).all():
            return (x, y, z), tilt_deg
    return None


def wall(
    camera: PupilCamera,
    center: Sequence[float],
    tilt_deg: Sequence[float],
    square_mm: float = _SQUARE_MM,
    reach_mm: float = 400.0,
) -> list[Plane]:
    """Build a wall of speckle that fills the picture, with a chessboard, and recedes by at most ``reach_mm``."""
    far = center[2] + reach_mm
    # Half a pixel's footprint, but no finer than print at 100 dpi.
    texel = max(0.25, 0.5 * (center[2] - camera.sensor_to_pupil_mm) / camera.focal_px)
    width = 2.0 * far * camera.width_px / camera.focal_px
    shape = (round(width * camera.height_px / camera.width_px / texel), round(width / texel))
    grey = textures.noise(shape, exponent=0.8, seed=11, mean=0.42, contrast=0.16)
    board_texel = min(texel, 1.0)
    board = textures.chessboard(_CORNERS, square_mm, board_texel)
    pieces = (grey, width), (board, board.shape[1] * board_texel)
    made = [
        plane(np.repeat(p[..., None], 3, axis=2), center_mm=center, width_mm=w, tilt_deg=tilt_deg) for p, w in pieces
    ]
    normal = np.cross(made[1].right, made[1].down)
    front = made[1]
    lifted = Plane(front.texture, front.center_mm - _PAPER_MM * normal, front.right, front.down, front.texel_mm)
    return [made[0], lifted]


def _sheets(aperture: Aperture) -> dict[str, Filter]:
    """List the sheets of film of two-filter designs, photographed for the unmixing."""
    names = {CYAN.name: "sheet_c", YELLOW.name: "sheet_y"}
    return {names[p.filter.name]: p.filter for p in aperture.parts if p.filter.name in names}


def _session_toml(aperture: Aperture, camera: PupilCamera, plan: SessionPlan, relative: float) -> str:
    focused = "inf" if math.isinf(camera.focus_mm) else f"{round(camera.focus_mm, -2):.0f}"
    return f"""# Facts known without the images; nothing here was measured from them.
design = "{aperture.name}"            # {aperture.title}
[sensor]
width_px = {camera.width_px}
height_px = {camera.height_px}
pixel_pitch_mm = {camera.pixel_pitch_mm:g}
black_level = {plan.sensor.black_level}
white_level = {plan.sensor.white_level}
full_well_electrons = {plan.sensor.full_well_electrons:g}
read_noise_electrons = {plan.sensor.read_noise_electrons:.1f}
linear = true
[lens]
nominal_focal_length_mm = {camera.image_distance_mm:.1f}
nominal_f_number = {camera.f_number:.1f}
focused_at_about_mm = {focused}    # from the sensor plane
[board]
inner_corners = [{_CORNERS[0]}, {_CORNERS[1]}]
square_mm = {plan.square_mm:.1f}
ruler_error_mm = {plan.ruler_error_mm:g}
[exposure]
relative_to_open = {relative:.4f}
"""


def _truth(camera: PupilCamera, aperture: Aperture, stood: dict[str, float]) -> dict[str, object]:
    return {
        "focal_px": camera.focal_px,
        "sensor_to_entrance_pupil_mm": camera.sensor_to_pupil_mm,
        "entrance_pupil_radius_mm": camera.pupil_radius_mm,
        "in_focus_mm": camera.focus_mm if math.isfinite(camera.focus_mm) else None,
        "filters": {p.filter.name: p.filter.transmission for p in aperture.parts},
        "board_mm": stood,
    }


def _write_png(path: Path, array: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    ok, encoded = cv2.imencode(".png", array)
    if not ok:
        raise InputError(f"cannot encode {path.name}")
    try:
        path.write_bytes(encoded.data)  # unlike `cv2.imwrite`, raises when the disk is full
    except BaseException:
        path.unlink(missing_ok=True)  # interrupted: half a photograph is none
        raise
