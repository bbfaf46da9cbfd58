"""Check a photograph of a calibration session at once, while the board still stands there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from chromaperture.app.edge_blur import edge_blur, pupil_spread
from chromaperture.app.notes import heard
from chromaperture.calibration.assemble_camera import assemble_camera
from chromaperture.calibration.chessboard import board_points, find_corners
from chromaperture.calibration.options import DEFAULT
from chromaperture.calibration.read_boards import read_board
from chromaperture.calibration.session import Session, nominal_depth_model
from chromaperture.calibration.white_sheets import WhiteSheets
from chromaperture.color.film import completed_film
from chromaperture.color.image import SATURATION
from chromaperture.color.unmixing import view_reach
from chromaperture.depth.conversion import DepthModel
from chromaperture.depth.field import DepthField
from chromaperture.evaluation.health import Check
from chromaperture.model.camera_file import Calibration
from chromaperture.model.camera_parts import Film
from chromaperture.optics.aperture import channel_transmission, design_named, made_of
from chromaperture.optics.pinhole import centered_pinhole
from chromaperture.settings.methods import QUALITIES
from chromaperture.system.errors import ChromapertureError

# Limits, chosen by hand from the causes named.
_SATURATED, _DARK = 0.02, 0.05  # share of the pixels; 99th percentile, of the white level: as in `evaluation/health.py`
# Fitted spread over that of the pupil's light, and what the sharpest edge has: simulated boards in and out of focus.
_SPREAD, _SHARPEST_PX = 1.12, 0.55
_TOO_BLURRED, _BLUR_ALLOWANCE_PX = 1.3, 0.6  # a real lens is softer than the simulated one
_MOTION = 1.35  # spread along one direction over that along the other, each over what is expected
_SQUARE_TO_AXIS_DEG = 8.0  # 8 degrees change the distance over a board of 30 cm by 2 cm from side to side
_LEAST_TILT_DEG, _MOST_TILT_DEG = 10.0, 45.0  # less adds little to the pinhole; more, and corners are lost
_RULER, _SCALE = 0.12, 3.0  # ruler against pose by the engraved focal length: engravings are good to 5 %; another unit
_MOVED_PX, _MOVED_SIGMAS = 0.15, 4.0  # disparity against the curve of the earlier boards
_VISIBLE_PX = 0.5  # expected disparity from which film must show
_EDGE_PX = 4  # corners nearer to the frame's edge are probably cut off


@dataclass(frozen=True)
class Reading:
    """What one photograph of the board tells; px are those of `Session.sensor`.

    Attributes
    ----------
    ruler_mm : float or None
        None for a tilted board.
    width_px : int
        Of the pictures that px are of: `Session` reduces large photographs the more, the nearer its boards are.
    corners_px : (N, 2) float or None
    pose_mm : float
        Distance of the board's middle from the sensor plane by its corners and the engraved focal length.
    lean_deg : (float, float)
        How far its left edge, and its top, lean towards the camera.
    disparity_px, disparity_sigma_px : float
        Of the middle of the frame; NaN for a tilted board.
    pixel_sigma_px : float
        Scatter of single pixels of disparity.
    blur_px : (float, float)
        Along x and y.
    exposure : float or None
        Of a sheet at two exposures: ms as typed, or time, gain and f-number together as the file states them.
    is_exposure_typed : bool
    tone : tuple of (level, exponent)
        What it told together with another one, see `calibration.tone_curve.ToneCurve`; empty for the first one.
    """

    ruler_mm: float | None = None
    width_px: int = 0
    corners_px: np.ndarray | None = None
    pose_mm: float = float("nan")
    lean_deg: tuple[float, float] = (float("nan"), float("nan"))
    disparity_px: float = float("nan")
    disparity_sigma_px: float = float("nan")
    pixel_sigma_px: float = float("nan")
    blur_px: tuple[float, float] = (float("nan"), float("nan"))
    exposure: float | None = None
    is_exposure_typed: bool = False
    tone: tuple[tuple[float, float], ...] = ()

    def at_width(self, width_px: int) -> Reading:
        """Return the reading in px of pictures of another width."""
        if self.width_px in (0, width_px):
            return self
        k = width_px / self.width_px
        return replace(
            self, width_px=width_px, corners_px=None if self.corners_px is None else self.corners_px * k,
            disparity_px=k * self.disparity_px, disparity_sigma_px=k * self.disparity_sigma_px,
            pixel_sigma_px=k * self.pixel_sigma_px, blur_px=(k * self.blur_px[0], k * self.blur_px[1]),
        )  # fmt: skip


@dataclass(frozen=True)
class CheckedShot:
    """A photograph's reading and the checks of it, the most urgent first."""

    reading: Reading
    checks: list[Check] = field(default_factory=list)

    @property
    def is_usable(self) -> bool:
        """Whether it should be kept."""
        return all(check.verdict != "warn" for check in self.checks)


def check_board(
    image: np.ndarray,
    session: Session,
    *,
    ruler_mm: float,
    range_mm: tuple[float, float],
    notes: Sequence[str] = (),
    curve: DepthModel | None = None,
) -> CheckedShot:
    """Check a photograph of the board square to the axis.

    Parameters
    ----------
    image : (H, W, 3) float32
        From `Session.read`.
    session : Session
    ruler_mm : float
        From the sensor plane.
    range_mm : (near, far)
        Between which disparities are searched.
    notes : sequence of str
        What reading the file warned of.
    curve : DepthModel, optional
        Fitted to the earlier boards; the engraved lens's when there are too few.
    """
    checks = [_exposure(image), *_file(notes)]
    corners = find_corners(image[..., 1], session.inner_corners)
    if corners is None:
        return CheckedShot(Reading(ruler_mm), [_no_board(session), *checks])
    reading = _posed(image, session, corners, ruler_mm)
    model = curve or nominal_depth_model(session)
    reading = replace(reading, **_disparity(image, session, (min(ruler_mm, range_mm[0]), max(ruler_mm, range_mm[1]))))
    checks += [
        *_against_ruler(reading, session),
        _squareness(reading),
        *_blur(reading, session, model),
        *_film(reading, model, known=curve is not None, session=session),
        _inside(corners, session),
    ]
    return CheckedShot(reading, sorted(checks, key=lambda check: check.verdict != "warn"))


def check_tilt(image: np.ndarray, session: Session, *, notes: Sequence[str] = ()) -> CheckedShot:
    """Check a photograph of the leaning board; parameters as `check_board`."""
    checks = [_exposure(image), *_file(notes)]
    corners = find_corners(image[..., 1], session.inner_corners)
    if corners is None:
        return CheckedShot(Reading(), [_no_board(session), *checks])
    reading = _posed(image, session, corners, None)
    lean = float(np.hypot(*reading.lean_deg))
    figures = {"lean_deg": lean}
    if lean < _LEAST_TILT_DEG:
        advice = "lean the board more, by about 20 degrees"
        checks.append(Check("tilt", "warn", f"the board leans by {lean:.0f} degrees only", advice, figures))
    elif lean > _MOST_TILT_DEG:
        checks.append(Check("tilt", "warn", f"the board leans by {lean:.0f} degrees", "lean it less", figures))
    else:
        checks.append(Check("tilt", "ok", f"the board leans by {lean:.0f} degrees", "", figures))
    checks += [*_blur(reading, session, nominal_depth_model(session)), _inside(corners, session)]
    return CheckedShot(reading, sorted(checks, key=lambda check: check.verdict != "warn"))


# ---- what is measured


def _posed(image: np.ndarray, session: Session, corners: np.ndarray, ruler_mm: float | None) -> Reading:
    """Place the board by its corners, and measure its blur."""
    sensor, nominal = session.sensor, nominal_depth_model(session)
    delta = float(nominal.sensor_to_pupil_mm)
    matrix = centered_pinhole(delta / sensor.pixel_pitch_mm, (sensor.width_px, sensor.height_px))
    grid = board_points(session.inner_corners, session.square_mm)
    grid -= grid.mean(axis=0)
    _, rotation, translation = cv2.solvePnP(grid, corners, matrix, np.zeros(5))
    normal = cv2.Rodrigues(rotation)[0][:, 2]
    normal = normal * np.sign(normal[2] or 1.0)
    lean = (float(np.degrees(np.arctan2(-normal[0], normal[2]))), float(np.degrees(np.arctan2(-normal[1], normal[2]))))
    blur = edge_blur(np.ascontiguousarray(image[..., 1]), corners, session.inner_corners)
    return Reading(ruler_mm, sensor.width_px, corners, float(translation[2, 0]) + delta, lean, blur_px=blur)


def _disparity(image: np.ndarray, session: Session, range_mm: tuple[float, float]) -> dict[str, Any]:
    """Match a board with the engraved lens's range and usual film; NaN where it cannot be matched."""
    try:
        found = read_board(image, draft_camera(session, range_mm))
    except ChromapertureError:
        return {}
    middle, sigma = (float(v) for v in found["real-time middle"])
    grid = found["real-time"].astype(float)
    rows, columns = (slice(n // 3, n - n // 3) for n in grid.shape)
    residual = np.abs(grid[rows, columns] - middle)
    known = residual[np.isfinite(residual)]
    # of a normal distribution: 1.4826 times the median of the absolute deviations
    pixel = float(1.4826 * np.median(known)) if known.size else float("nan")
    return {"disparity_px": middle, "disparity_sigma_px": sigma, "pixel_sigma_px": pixel}


def draft_camera(session: Session, range_mm: tuple[float, float]) -> Calibration:
    """Return the camera of the engraved lens and usual film over a range, before anything is fitted."""
    session = replace(session, boards={Path(end): at for end, at in zip(("near", "far"), range_mm, strict=True)})
    aperture = made_of(design_named(session.design), "real")
    film = completed_film(aperture, {}, light=None)
    white = np.maximum(channel_transmission(aperture), 1e-3)
    sheets = WhiteSheets(Film({n: film[n] for n in aperture.views}, np.ones(3), white), session.sensor, (), ())
    nominal = dict.fromkeys(QUALITIES, DepthField.constant(nominal_depth_model(session)))
    return assemble_camera(session, sheets, None, nominal, DEFAULT)


# ---- what is judged


def _no_board(session: Session) -> Check:
    columns, rows = session.inner_corners
    return Check(
        "board", "warn", f"no board of {columns} x {rows} inner corners was found",
        "show the whole board with a white rim, flat, sharp enough and in even light; or correct the board's size",
    )  # fmt: skip


def _exposure(image: np.ndarray) -> Check:
    finite = image[np.isfinite(image).all(axis=2)]
    if not finite.size:
        return Check("exposure", "warn", "the picture holds no finite value", "photograph it again")
    saturated, bright = float((finite.max(axis=1) >= SATURATION).mean()), float(np.percentile(finite, 99))
    figures = {"saturated_share": saturated, "percentile_99": bright}
    if saturated > _SATURATED:
        finding = f"{saturated:.0%} of the picture is too bright to be measured"
        return Check("exposure", "warn", finding, "expose less, and keep it so for all photographs", figures)
    if bright < _DARK:
        finding = f"the brightest parts reach {bright:.0%} of full scale"
        return Check("exposure", "warn", finding, "more light, or a longer exposure", figures)
    return Check("exposure", "ok", f"bright parts at {bright:.0%} of full scale", "", figures)


def _file(notes: Sequence[str]) -> list[Check]:
    """Say what reading the file warned of."""
    return [Check("file", "cannot tell", note, "") for note in notes]


def _against_ruler(reading: Reading, session: Session) -> list[Check]:
    assert reading.ruler_mm is not None
    ratio = reading.pose_mm / reading.ruler_mm
    figures = {"ruler_mm": reading.ruler_mm, "by_corners_mm": reading.pose_mm}
    finding = f"the ruler says {reading.ruler_mm:.0f} mm, the size of the squares {reading.pose_mm:.0f} mm"
    if ratio > _SCALE or ratio < 1 / _SCALE:
        return [
            Check("ruler", "warn", finding, "give the distance in mm, from the sensor's mark to the board", figures)
        ]
    if abs(ratio - 1) > _RULER:
        advice = (
            f"measure the distance again; or the squares are not {session.square_mm:g} mm, or the focal length is wrong"
        )
        return [Check("ruler", "warn", finding, advice, figures)]
    return [Check("ruler", "ok", finding, "", figures)]


def _squareness(reading: Reading) -> Check:
    lean = float(np.hypot(*reading.lean_deg))
    if lean <= _SQUARE_TO_AXIS_DEG:
        return Check("squareness", "ok", f"{lean:.0f} degrees off square", "", {"lean_deg": lean})
    side = "left or right" if abs(reading.lean_deg[0]) > abs(reading.lean_deg[1]) else "up or down"
    advice = f"turn the camera or the board {side} until both sides are equally far"
    return Check("squareness", "warn", f"the board is {lean:.0f} degrees off square to the camera", advice,
                 {"lean_deg": lean})  # fmt: skip


def _blur(reading: Reading, session: Session, model: DepthModel) -> list[Check]:
    """Compare the blur with that of this distance; one direction alone is motion."""
    if not np.isfinite(reading.blur_px).all():
        return []
    aperture = design_named(session.design)
    at_mm = reading.ruler_mm or reading.pose_mm
    radius = abs(_disparity_at(model, at_mm)) / view_reach(aperture)
    expected = [float(np.hypot(_SPREAD * radius * s, _SHARPEST_PX)) for s in pupil_spread(aperture)]
    excess = [found / e for found, e in zip(reading.blur_px, expected, strict=True)]
    figures = {"blur_px": float(max(reading.blur_px)), "expected_px": max(expected)}
    finding = f"edges are blurred by {max(reading.blur_px):.1f} px, expected {max(expected):.1f} at this distance"
    allowed = [_TOO_BLURRED * e + _BLUR_ALLOWANCE_PX for e in expected]
    blurred = [found > most for found, most in zip(reading.blur_px, allowed, strict=True)]
    if any(blurred) and max(excess) > _MOTION * min(excess):
        way = "sideways" if excess[0] > excess[1] else "up and down"
        return [Check("motion", "warn", f"{finding}; it moved {way}", "put the camera on a stand and take it again",
                      figures)]  # fmt: skip
    if any(blurred):
        advice = "is the focus where it was? Then measure the distance again, or hold everything still"
        return [Check("sharpness", "warn", finding, advice, figures)]
    return [Check("sharpness", "ok", finding, "", figures)]


def _film(reading: Reading, model: DepthModel, *, known: bool, session: Session) -> list[Check]:
    """Judge film and focus from the disparity: absent film has none, turned film the opposite one."""
    assert reading.ruler_mm is not None
    expected, found = _disparity_at(model, reading.ruler_mm), reading.disparity_px
    if not np.isfinite(found):
        return [Check("film", "cannot tell", "too little texture to see the film's effect",
                      "put a pattern around the board: 'chromaperture board' prints one")]  # fmt: skip
    slope = float(model.scale_px_mm) / (reading.ruler_mm - float(model.sensor_to_pupil_mm)) ** 2
    figures = {"disparity_px": found, "expected_px": expected}
    says = f"colours are {found:+.2f} px apart, expected {expected:+.2f}"
    if abs(expected) > _VISIBLE_PX and abs(found) < 0.15 * abs(expected):
        return [Check("film", "warn", f"{says}: as without film", "put the film into the pupil", figures)]
    if abs(expected) > _VISIBLE_PX and abs(found + expected) < 0.4 * abs(expected):
        advice = "turn the film by 180 degrees, or set the focus distance right: near and far look exchanged"
        return [Check("film orientation", "warn", says, advice, figures)]
    if not known:
        return [Check("film", "ok", says, "", figures)]
    off = found - expected
    sigma = np.hypot(reading.disparity_sigma_px, slope * session.ruler_error_mm)
    if abs(off) > max(_MOVED_PX, _MOVED_SIGMAS * float(sigma)):
        advice = (
            f"the focus or the iris moved since the first board, or the ruler is off by {abs(off / slope):.0f} mm: "
            "measure again; if the focus moved, begin anew and tape the ring"
        )
        return [Check("focus", "warn", f"{says} by the boards before it", advice, figures)]
    return [Check("focus", "ok", f"{says}: focus and iris are where they were", "", figures)]


def _inside(corners: np.ndarray, session: Session) -> Check:
    size = np.array([session.sensor.width_px, session.sensor.height_px])
    gap = float(min(corners.min(), (size - 1 - corners).min()))
    if gap < _EDGE_PX:
        return Check("frame", "cannot tell", "the board touches the edge of the picture", "a little farther inside")
    return Check("board", "ok", f"all {len(corners)} corners found")


def _disparity_at(model: DepthModel, at_mm: float) -> float:
    z = max(at_mm - float(model.sensor_to_pupil_mm), 1.0)
    return float(model.infinity_disparity_px) - float(model.scale_px_mm) / z


def read_for_check(session: Session, path: Path) -> tuple[np.ndarray, list[str]]:
    """Read a photograph of a session; returns it and what reading it warned of; raises InputError."""
    with heard() as notes:
        image = session.read(path)
    return image, notes()
