"""Check a photograph of a calibration session at once, while the board still stands there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy.optimize import least_squares
from scipy.special import erf

from chromaperture.calibration.assemble_camera import assemble_camera
from chromaperture.calibration.chessboard import board_points, find_corners
from chromaperture.calibration.fit_response import LEAST_RATIO, ToneCurve, disparity_error, measure_tone
from chromaperture.calibration.options import DEFAULT
from chromaperture.calibration.read_boards import read_board
from chromaperture.calibration.session import SHEETS, Session, nominal_depth_model
from chromaperture.calibration.white_sheets import WhiteSheets
from chromaperture.color.film import completed_film
from chromaperture.color.image import SATURATION
from chromaperture.color.unmixing import view_reach
from chromaperture.depth.conversion import DepthModel
from chromaperture.depth.field import DepthField
from chromaperture.evaluation.checks import (
    NOTHING_SEEN,
    Check,
    Exposure,
    is_healthy,
    is_uneven,
    measure_tint,
    urgent_first,
)
from chromaperture.model.camera_file import Calibration
from chromaperture.model.camera_parts import CameraSensor, Film
from chromaperture.optics.aperture import USUAL_FILM, Aperture, channel_transmission, design_named, made_of
from chromaperture.optics.pinhole import centered_pinhole
from chromaperture.optics.psf import pupil_samples
from chromaperture.settings.methods import QUALITIES
from chromaperture.system.errors import ChromapertureError, InputError
from chromaperture.system.robust import MAD_TO_SIGMA

_REACH = 0.42  # of a square, to either side of an edge: beyond lies the blur of the next edge; chosen by hand
_SAMPLES = 61  # of a profile, more than the px it covers; chosen by hand
_FEWEST = 4  # edges of one direction; chosen by hand
_CELLS = 32  # across the pupil; chosen by hand
GREEN = 1  # the channel in which corners are found


def edge_blur(plane: np.ndarray, corners: np.ndarray, inner_corners: tuple[int, int]) -> tuple[float, float]:
    """Measure the blur across a chessboard's edges along x and y, px: about half of a disc's radius."""
    columns, rows = inner_corners
    grid = corners.reshape(rows, columns, 2).astype(float)
    found = {0: [], 1: []}  # type: dict[int, list[np.ndarray]]
    lengths: dict[int, list[float]] = {0: [], 1: []}
    for axis in (0, 1):
        first, second = (grid[:-1], grid[1:]) if axis == 0 else (grid[:, :-1], grid[:, 1:])
        for a, b in zip(first.reshape(-1, 2), second.reshape(-1, 2), strict=True):
            length = float(np.linalg.norm(b - a))
            across = np.array([-(b - a)[1], (b - a)[0]]) / max(length, 1e-6)
            upright = int(abs(across[0]) < abs(across[1]))  # 0: the edge is upright, and is crossed along x
            found[upright].append(_profile(plane, (a + b) / 2, across, (b - a) / length, _REACH * length))
            lengths[upright].append(length)
    return _spread(found[0], lengths[0]), _spread(found[1], lengths[1])


def _profile(
    plane: np.ndarray, middle: np.ndarray, across: np.ndarray, along: np.ndarray, reach_px: float
) -> np.ndarray:
    """Sample across an edge, averaged over a third of its length."""
    steps = np.linspace(-reach_px, reach_px, _SAMPLES)[None, :, None] * across
    places = middle + steps + np.linspace(-0.4, 0.4, 5)[:, None, None] * reach_px * along
    maps = places.astype(np.float32)
    sampled = cv2.remap(plane, maps[..., 0], maps[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    profile = np.asarray(sampled.mean(axis=0), float)
    return profile if profile[-_SAMPLES // 4 :].mean() > profile[: _SAMPLES // 4].mean() else profile[::-1]


def _spread(profiles: list[np.ndarray], lengths: list[float]) -> float:
    if len(profiles) < _FEWEST:
        return float("nan")
    mean, reach = np.mean(profiles, axis=0), _REACH * float(np.mean(lengths))
    t = np.linspace(-reach, reach, _SAMPLES)
    low, high = float(mean.min()), float(mean.max())
    if not high > low:
        return float("nan")

    def residual(p: np.ndarray) -> np.ndarray:
        level = p[0] + p[1] * erf((t - p[2]) / (np.sqrt(2) * np.exp(p[3])))
        return np.asarray((level - mean) / (high - low))

    start = np.array([(low + high) / 2, (high - low) / 2, 0.0, np.log(reach / 4)])
    fit = least_squares(residual, start)
    sigma = float(np.exp(fit.x[3]))
    return sigma if 0 < sigma < 2 * reach else float("nan")


def pupil_spread(aperture: Aperture) -> tuple[float, float]:
    """Return the standard deviation of the pupil's light in green, along x and y; pupil radii."""
    points, light = pupil_samples(aperture, _CELLS)
    weight = light[:, GREEN] / light[:, GREEN].sum()
    mean = weight @ points
    x, y = np.sqrt(np.maximum(weight @ (points - mean) ** 2, 0))
    return float(x), float(y)


# Limits, chosen by hand from the causes named.
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
# Limits, chosen by hand from the causes named.
_SHEET_SATURATED, _SHEET_DARK = 0.001, 0.10  # share of the pixels of the middle; its mean, of full scale
_TEXTURE = 0.10  # scatter of the middle over its mean: a sheet in focus shows its dirt, a scene much more
# Ratio of channels against clear, from 1 and from usual film, natural logarithm; yellow gels are within 0.6, green not.
_NO_FILM, _WRONG_FILM = 0.10, 0.6
_DENSE = 0.75  # light of the brightest channel through usual film, below which its absence is no change of the lamp
# Limits, chosen by hand from the causes named.
# Of the exponent. Exposure times are stated to some 5 %, which is 0.07 of it at a factor of two.
_AS_ASSUMED, _IMPOSSIBLE = 0.03, 0.5
# Of single blocks' exponents about that of their level: noise of 8 bits makes 0.02, another scene more than 0.3.
_SCATTER = 0.15
_SAME_LIGHT = 0.15  # exponent below which the pictures are equally bright, whatever exposures are stated


@dataclass(frozen=True)
class Reading:
    """What one photograph of the board tells; px are those of `Session.sensor`."""

    ruler_mm: float | None = None  # None for a tilted board
    # Of the pictures that px are of: `Session` reduces large photographs the more, the nearer its boards are
    width_px: int = 0
    corners_px: np.ndarray | None = None  # (N, 2) float
    # Distance of the board's middle from the sensor plane by its corners and the engraved focal length
    pose_mm: float = float("nan")
    lean_deg: tuple[float, float] = (float("nan"), float("nan"))  # of its left edge, and its top, towards the camera
    disparity_px: float = float("nan")  # of the middle of the frame; NaN for a tilted board
    disparity_sigma_px: float = float("nan")
    pixel_sigma_px: float = float("nan")  # scatter of single pixels of disparity
    blur_px: tuple[float, float] = (float("nan"), float("nan"))  # along x and y
    # Of a sheet at two exposures: ms as typed, or time, gain and f-number together as the file states them
    exposure: float | None = None
    is_exposure_typed: bool = False
    # (level, exponent) that it told together with another one, see `ToneCurve`; empty for the first one
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
        return is_healthy(self.checks)


def check_board(
    image: np.ndarray,
    session: Session,
    *,
    ruler_mm: float,
    range_mm: tuple[float, float],
    notes: Sequence[str] = (),
    curve: DepthModel | None = None,
) -> CheckedShot:
    """Check a board square to the axis at ``ruler_mm``; ``curve`` is fitted to the earlier boards."""
    checks = [_exposure(image, session.sensor), *_file(notes)]
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
    return CheckedShot(reading, urgent_first(checks))


def check_tilt(image: np.ndarray, session: Session, *, notes: Sequence[str] = ()) -> CheckedShot:
    """Check a photograph of the leaning board; parameters as `check_board`."""
    checks = [_exposure(image, session.sensor), *_file(notes)]
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
    return CheckedShot(reading, urgent_first(checks))


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
    pixel = float(MAD_TO_SIGMA * np.median(known)) if known.size else float("nan")
    return {"disparity_px": middle, "disparity_sigma_px": sigma, "pixel_sigma_px": pixel}


def draft_camera(session: Session, range_mm: tuple[float, float]) -> Calibration:
    """Return the camera of the engraved lens and usual film over a range, before anything is fitted."""
    session = replace(session, boards={Path(end): at for end, at in zip(("near", "far"), range_mm, strict=True)})
    aperture = made_of(design_named(session.design), USUAL_FILM)
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


_UNSTATED_WHITE = 65535.0  # the white level of 16 bits, where session.toml states none


def _exposure(image: np.ndarray, sensor: CameraSensor) -> Check:
    seen = Exposure.of(image)
    if seen is None:
        return NOTHING_SEEN
    if seen.is_saturated:
        finding = f"{seen.saturated:.0%} of the picture is too bright to be measured"
        return Check("exposure", "warn", finding, "expose less, and keep it so for all photographs", seen.figures)
    if seen.is_dark:
        finding = f"the brightest parts reach {seen.bright:.0%} of full scale"
        advice = "more light, or a longer exposure"
        counts = float(np.nanmax(image)) * (sensor.white_level - sensor.black_level) + sensor.black_level
        bits = next((bits for bits in (10, 12) if counts < 2**bits), None)
        if bits and sensor.white_level == _UNSTATED_WHITE:
            finding = f"no count exceeds {counts:.0f}, of {sensor.white_level:.0f}"
            advice = f"a camera of {bits} bits? Then set white_level = {2**bits - 1} in session.toml; else {advice}"
        return Check("exposure", "warn", finding, advice, seen.figures)
    return Check("exposure", "ok", f"bright parts at {seen.bright:.0%} of full scale", "", seen.figures)


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


def check_sheet(image: np.ndarray, name: str, *, design: str, clear: np.ndarray | None = None) -> list[Check]:
    """Check a photograph of a white sheet, of that name; ``clear`` is the open pupil's mean colour."""
    height, width = image.shape[:2]
    middle = image[height * 2 // 5 : height * 3 // 5, width * 2 // 5 : width * 3 // 5].reshape(-1, 3).astype(float)
    mean, brightest = middle.mean(axis=0), middle.max(axis=1)
    checks = []
    saturated = float((brightest >= SATURATION).mean())
    if saturated > _SHEET_SATURATED:
        checks.append(Check("exposure", "warn", "the sheet is too bright", "expose less, the same for all sheets"))
    elif mean.max() < _SHEET_DARK:
        finding = f"the sheet reaches {mean.max():.0%} of full scale"
        checks.append(Check("exposure", "warn", finding, "more light, or a longer exposure, the same for all sheets"))
    else:
        checks.append(Check("exposure", "ok", f"the sheet is at {mean.max():.0%} of full scale"))
    bright = int(mean.argmax())
    scatter = float(_blocks(image[..., bright]).std() / max(mean[bright], 1e-6))
    if scatter > _TEXTURE:
        checks.append(Check("sheet", "warn", f"the picture is uneven by {scatter:.0%}",
                            "fill the whole frame with plain paper in even light, out of focus"))  # fmt: skip
    if clear is not None and name != "open":
        checks.append(_sheet_film(mean / np.maximum(clear, 1e-6), name, design))
    if name == design:
        checks += _place(image)
    return urgent_first(checks)


def _blocks(plane: np.ndarray) -> np.ndarray:
    """Return the means of 8 x 8 blocks of the middle half of a picture, where vignetting is small."""
    height, width = plane.shape
    part = plane[height // 4 : height * 3 // 4, width // 4 : width * 3 // 4]
    rows, columns = (np.linspace(0, n, 9).astype(int)[:-1] for n in part.shape)
    sums = np.add.reduceat(np.add.reduceat(part.astype(float), rows, axis=0), columns, axis=1)
    counts = np.outer(np.diff([*rows, part.shape[0]]), np.diff([*columns, part.shape[1]]))
    return np.asarray(sums / counts)


def _sheet_film(through: np.ndarray, name: str, design: str) -> Check:
    """Compare the light that passed with usual film and with none."""
    aperture = made_of(design_named(design), USUAL_FILM)
    if name == design:
        expected, what = channel_transmission(aperture), "the aperture"
    else:
        color = next(c for c, sheet in SHEETS.items() if sheet == name)
        expected, what = np.asarray(aperture.filter_named(color).transmission, float), f"{color} film"
    ours, usual = (_ratios(v) for v in (through, expected))
    share = ", ".join(f"{v:.0%}" for v in through)
    finding = f"red, green and blue pass {what} by {share}"
    figures = {f"passed_{c}": float(v) for c, v in zip("rgb", through, strict=True)}
    tinted = np.abs(usual).max() > 2 * _NO_FILM  # two halves may be grey together; then their loss of light tells
    bright = expected.max() < _DENSE and through.min() > (1 + expected.max()) / 2
    if (tinted or bright) and np.abs(ours).max() < _NO_FILM:
        return Check(
            "film", "warn", f"{finding}: as without film", "put the film in; or this is the open pupil", figures
        )
    strong = np.abs(usual) > np.log(2)  # where the film must block, any film's own value may differ much
    wrong = np.sign(ours[strong]) != np.sign(usual[strong])
    if wrong.any() or np.abs(ours - usual)[~strong].max(initial=0) > _WRONG_FILM:
        return Check("film", "warn", finding, f"is this {what}? Usual film passes "
                     + ", ".join(f"{v:.0%}" for v in expected), figures)  # fmt: skip
    return Check("film", "ok", finding, "", figures)


def _ratios(light: np.ndarray) -> np.ndarray:
    """Return the logarithms of the channels over their geometric mean."""
    logs = np.log(np.maximum(light, 1e-3))
    return np.asarray(logs - logs.mean())


def _place(image: np.ndarray) -> list[Check]:
    """Find a ramp of tint over the frame, which film off the stop makes."""
    tint = measure_tint(image)
    if tint is None:
        return []
    figures = {"ramp_share": tint.ramp}
    if is_uneven(tint):
        return [Check("place of the film", "cannot tell", f"colour changes by {tint.ramp:.0%} over the frame",
                      "the film is away from the iris, or the light is uneven: turn the sheet by 180 degrees to see "
                      "which", figures)]  # fmt: skip
    return [Check("place of the film", "ok", f"colour changes by {tint.ramp:.0%} over the frame", "", figures)]


@dataclass(frozen=True)
class Exposed:
    """One of the photographs: linear as decoded, and its exposure in any unit that both have."""

    image: np.ndarray
    exposure: float


def check_exposed(image: np.ndarray) -> Check:
    """Check that a photograph of a sheet is neither dark nor saturated."""
    seen = Exposure.of(image.max(axis=2, keepdims=True))
    if seen is None:
        return NOTHING_SEEN
    if seen.is_saturated:
        advice = "expose less: what is saturated shows nothing of the curve"
        return Check("exposure", "warn", f"{seen.saturated:.0%} of the picture is too bright to be measured", advice)
    if seen.is_dark:
        return Check("exposure", "warn", f"the brightest parts reach {seen.bright:.0%} of full scale", "expose longer")
    return Check("exposure", "ok", f"bright parts at {seen.bright:.0%} of full scale")


def check_tone(
    first: Exposed, second: Exposed, *, design: str, is_encoded: bool = True
) -> tuple[list[Check], ToneCurve | None]:
    """Compare two exposures of one scene; the curve is None where the pictures tell nothing."""
    ratio = max(first.exposure, second.exposure) / min(first.exposure, second.exposure)
    if ratio < LEAST_RATIO:
        finding = f"both photographs have the same exposure, to a factor of {ratio:.2f}"
        return [
            Check("tone curve", "warn", finding, "take one at a half or a quarter of the other's exposure time")
        ], None
    shorter, longer = (first, second) if first.exposure < second.exposure else (second, first)
    try:
        curve = measure_tone(shorter.image, longer.image, ratio)
    except InputError as reason:
        return [Check("tone curve", "warn", str(reason), "photograph the sheet again")], None
    middle, error = float(np.median(curve.exponent)), curve.error
    figures = {"exposure_ratio": ratio, "exponent": middle, "exponent_error": error, "scatter": curve.scatter,
               "lowest_level": float(curve.level.min()), "highest_level": float(curve.level.max())}  # fmt: skip
    brighter = ratio**middle
    if curve.scatter > _SCATTER:
        finding = f"parts of the picture grew by factors {curve.scatter * np.log(ratio):.0%} apart"
        advice = "the scene, the light or the camera's place changed: both photographs must show the same, and no more"
        return [Check("same scene", "warn", finding, advice, figures)], None
    if middle < _SAME_LIGHT:
        finding = f"the exposures differ by a factor of {ratio:.2g}, the pictures by {brighter:.2f}"
        advice = "the camera evens them out: switch automatic exposure off, or correct the exposure times"
        return [Check("tone curve", "warn", finding, advice, figures)], None
    if error > _IMPOSSIBLE:
        finding = f"the exposures differ by a factor of {ratio:.2g}, the pictures by {brighter:.2g}"
        return [
            Check("tone curve", "warn", finding, "correct the exposure times: no curve is that wrong", figures)
        ], None
    span = f"from {curve.level.min():.0%} to {curve.level.max():.0%} of full scale"
    cost = disparity_error(design, error)
    if error <= _AS_ASSUMED:
        finding = f"light is proportional to exposure {span}, to {error:.3f} of the exponent"
        return [Check("tone curve", "ok", finding, "", figures)], curve
    assumed = "sRGB, as 8-bit files are decoded" if is_encoded else "linear, as deep files are taken"
    finding = (
        f"decoded light grows with the power {curve.exponent.min():.2f} to {curve.exponent.max():.2f} of the exposure "
        f"{span}: the curve is not {assumed}"
    )
    advice = f"error bars widen by {cost:.1%} of the disparity; RAW files have no tone curve"
    return [Check("tone curve", "cannot tell", finding, advice, figures)], curve
