"""Compare a photograph, best of the chessboard, whose corners give a distance, with the camera file."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from chromaperture.calibration.chessboard import Intrinsics, board_points, find_corners
from chromaperture.calibration.fit_response import fit_response, fold_board
from chromaperture.camera.method import sensor_noise
from chromaperture.capture.exif import Exif
from chromaperture.color.film import FilmMatch, match_film
from chromaperture.color.image import checked_image
from chromaperture.color.unmixing import view_reach
from chromaperture.depth.conversion import depth_to_disparity
from chromaperture.evaluation.checks import TINT, Check, Exposure, is_healthy, is_uneven, measure_tint
from chromaperture.matching.estimate import estimate_disparity
from chromaperture.model.camera_file import Calibration
from chromaperture.model.camera_parts import Board
from chromaperture.settings.methods import Quality, preset
from chromaperture.system.errors import InputError

# Names of the checks.
_FILM, _TINT, _LIGHT, _DISTANCE, _ORIENTATION = (
    "film", "tint over the frame", "linear light", "board distance", "filter orientation"
)  # fmt: skip
_QUALITY: Quality = "real-time"
# Tolerances, chosen by hand from the causes named; relative unless in px.
_FOCAL_TOLERANCE = 0.06  # zooms engrave and EXIF rounds; a lens of another focal length differs by more
_STOP_TOLERANCE = 0.09  # a third of a stop is 12 % of the f-number
_FOCUS_TOLERANCE = 0.10  # cameras report the focus distance in coarse steps
_DISPARITY_TOLERANCE_PX = 0.15  # the bias by blur is 0.05 px; a calibrated camera stays within 0.1
_DISPARITY_TOLERANCE = 0.06  # of the disparity: the effect of a change of the aperture by a sixth of a stop
_FAR_FROM_FOCUS_PX = 0.4  # expected disparity below which a turned filter is within the tolerance
_TURNED_TOLERANCE_PX = 0.35  # from the mirrored disparity: the bias is larger with the wrong layout of the filter
_DEPTH_TOLERANCE = 0.02
_SQUARE_TOLERANCE = 0.02  # of the square's side: poses behind blur err by 1 %; the disparity's tolerance is added
# Rms error of the exponents: single boards of four linear sessions have at most 0.10, of files with a tone curve 0.33.
_TONE_TOLERANCE = 0.2
_SEARCH_MARGIN_PX = 1.5  # beyond the calibrated disparities: a refocused camera has others
_LEAST_MEASURED = 0.25  # fraction of the board's pixels that must have a disparity


def check_camera(
    image: np.ndarray, calibration: Calibration, *, board: Board | None = None, exif: Exif | None = None
) -> list[Check]:
    """Compare one photograph of linear RGB, and its EXIF settings, with the calibration and its board."""
    image = checked_image(image)
    if not calibration.is_calibrated:
        raise InputError("this camera file has no depth curve to check against; run 'chromaperture calibrate' first")
    checks = [_resolution(image, calibration), *_settings(exif or Exif(), calibration), _exposure(image)]
    if checks[0].verdict == "warn":
        reason = "the photograph is not of the calibrated size"
        return checks + [Check(name, "cannot tell", reason) for name in (_FILM, _TINT, _LIGHT, _DISTANCE, _ORIENTATION)]
    seen = _against_board(image, calibration, board or calibration.board)
    if calibration.sensor.dual_pixel is not None:  # without film
        return checks + seen
    film = _film(film_match(image, calibration), calibration)
    judged = [film, *seen]
    # Values that are no light change colours and disparity, and another film disparity: what follows cannot be judged.
    cause = next((c for name in (_LIGHT, _FILM) for c in judged if c.name == name and c.verdict == "warn"), None)
    if cause is not None:
        judged = [
            replace(c, advice=f"see the {cause.name} first") if c.verdict == "warn" and c is not cause else c
            for c in judged
        ]
    return [*checks, judged[0], _tint(image), *judged[1:]]


def film_match(image: np.ndarray, calibration: Calibration) -> FilmMatch:
    """Compare a photograph of the calibrated size with the camera's film."""
    aperture = calibration.aperture.with_film(calibration.film.transmissions())
    reach = view_reach(aperture)  # the disparity of the unmixed views is reach times the blur radius
    quality: Quality = "paper" if "paper" in calibration.depth else _QUALITY
    near, far = (v / reach for v in calibration.disparity_range_px(quality))
    return match_film(image, aperture, calibration.film.aperture, (near, far))


def outcome(checks: list[Check]) -> int:
    """Return 0 for a camera as calibrated, 1 for a changed one, 2 where no board was measured."""
    if not is_healthy(checks):
        return 1
    return 0 if any(c.name == _DISTANCE and c.verdict == "ok" for c in checks) else 2


def _resolution(image: np.ndarray, calibration: Calibration) -> Check:
    have, expected = image.shape[1::-1], (calibration.sensor.width_px, calibration.sensor.height_px)
    figures = {"width_px": float(have[0]), "height_px": float(have[1])}
    if have == expected:
        return Check("resolution", "ok", f"{have[0]}x{have[1]} px, as calibrated", "", figures)
    if have == expected[::-1]:
        advice = "it looks rotated: give the file as the sensor read it, not turned upright"
    else:
        advice = "give the original of the calibrated size, neither cropped nor scaled, or calibrate at this size"
    finding = f"{have[0]}x{have[1]} px, calibrated at {expected[0]}x{expected[1]}"
    return Check("resolution", "warn", finding, advice, figures)


def _film(match: FilmMatch, calibration: Calibration) -> Check:
    figures = {
        name: float(value)
        for name, value in (("green_cast", match.cast), ("displacement_explained", match.explained))
        if value is not None
    }
    if match.doubts:
        advice = f"put the film of {calibration.aperture.title} back, or give its camera file; or the light is coloured"
        return Check(_FILM, "warn", "; ".join(match.findings), advice, figures)
    if match.cast is None:
        return Check(_FILM, "cannot tell", "no edges to compare colours at", "", figures)
    return Check(_FILM, "ok", f"green of the edges is {np.expm1(match.cast):+.0%} off the camera's white", "", figures)


def _settings(exif: Exif, calibration: Calibration) -> list[Check]:
    rows = (
        ("focal length (EXIF)", exif.focal_length_mm, calibration.lens.focal_length_mm, "mm", _FOCAL_TOLERANCE,
         "set the lens to the focal length of the calibration; a zoom needs one calibration for each"),
        ("aperture (EXIF)", exif.f_number, calibration.lens.f_number, "f-number", _STOP_TOLERANCE,
         "open the iris as for the calibration: it must not cut the filter"),
        ("focus (EXIF)", exif.subject_distance_mm, calibration.in_focus_mm, "mm", _FOCUS_TOLERANCE,
         "focus as for the calibration and tape the ring; or calibrate again"),
    )  # fmt: skip
    checks = []
    for name, found, expected, unit, tolerance, advice in rows:
        if found is None or expected is None or not np.isfinite(expected):
            where = "the file" if found is None else "the camera file"
            checks.append(Check(name, "cannot tell", f"{where} does not state it"))
            continue
        ok = abs(found / expected - 1) <= tolerance
        finding = f"{found:.4g} {unit}, calibrated at {expected:.4g}"
        key = unit.replace("-", "_")
        figures = {f"found_{key}": float(found), f"expected_{key}": float(expected)}
        checks.append(Check(name, "ok" if ok else "warn", finding, "" if ok else advice, figures))
    return checks


def _exposure(image: np.ndarray) -> Check:
    seen = Exposure.of(image)
    if seen is None:
        raise InputError("the image has no finite value; export it again")
    if seen.is_saturated:
        advice = "expose less: where a channel is saturated, nothing is measured"
        return Check("exposure", "warn", f"{seen.saturated:.1%} of the pixels are saturated", advice, seen.figures)
    if seen.is_dark:
        finding = f"the brightest parts reach {seen.bright:.1%} of full scale"
        advice = "expose longer or add light; check --black-level and --white-level"
        return Check("exposure", "warn", finding, advice, seen.figures)
    finding = f"{seen.saturated:.1%} saturated, bright parts at {seen.bright:.0%}"
    return Check("exposure", "ok", finding, "", seen.figures)


def _tint(image: np.ndarray) -> Check:
    tint = measure_tint(image)
    if tint is None:
        return Check(_TINT, "cannot tell", "too dark or too bright to compare colours")
    figures = {"ramp_share": tint.ramp, "scatter_share": tint.scatter}
    finding = f"colour changes by {tint.ramp:.0%} from the middle to the edge, {tint.scatter:.0%} of scatter"
    if is_uneven(tint):
        advice = (
            "the filter is not in the plane of the stop (then each part of the frame sees a different part of it), or "
            "the light is uneven: move the filter to the iris and photograph a white sheet"
        )
        return Check(_TINT, "warn", finding, advice, figures)
    if tint.scatter > TINT:
        return Check(_TINT, "cannot tell", f"{finding}: the scene has colours", "photograph a white sheet", figures)
    return Check(_TINT, "ok", finding, "", figures)


def _against_board(image: np.ndarray, calibration: Calibration, board: Board | None) -> list[Check]:
    def unknown(reason: str, advice: str) -> list[Check]:
        return [Check(name, "cannot tell", reason, advice) for name in (_LIGHT, _DISTANCE, _ORIENTATION)]

    if board is None:
        return unknown("no board was asked for", "photograph the chessboard and give --board and --square-mm")
    corners = find_corners(image[..., 1], board.inner_corners)
    if corners is None:
        advice = "show the whole board, larger and nearer to focus; check --board (inner corners)"
        columns, rows = board.inner_corners
        return unknown(f"no board of {columns}x{rows} inner corners was found", advice)
    found = _compare(image, calibration, board, corners)
    if found is None:
        advice = "add texture around the board (chromaperture board prints some) or come nearer to focus"
        return unknown("no disparity on the board", advice)
    light = _light(image, corners, board, found)
    turned = (
        "the filter is turned by 180 degrees or its colours are swapped: turn it, arrow up"
        if calibration.sensor.dual_pixel is None
        else "the left and the right picture are exchanged: give the other as --left"
    )
    return [light, _board_distance(found, calibration, board), _orientation(found, turned)]


def _light(image: np.ndarray, corners_px: np.ndarray, board: Board, found: _BoardReading) -> Check:
    """Tell whether the image is linear light, as the camera file decodes it, by the blurred edges of the board."""
    folded = None
    if abs(found.expected_px) > _FAR_FROM_FOCUS_PX:
        folded = fold_board(np.asarray(image, np.float32), corners_px, board.inner_corners)
    if folded is None:
        return Check(_LIGHT, "cannot tell", "the board is in focus or saturated", "photograph it well off the focus")
    tones = fit_response([folded])
    low, high = tones.exponents
    finding = f"light grows with the powers {low:.2f} to {high:.2f} of the decoded values"
    figures = {"rms_exponent_error": tones.deviation}
    if tones.deviation < _TONE_TOLERANCE:
        return Check(_LIGHT, "ok", finding, "", figures)
    advice = "export it as the calibration's photographs were: linear, or with the same tone curve"
    return Check(_LIGHT, "warn", finding, advice, figures)


@dataclass(frozen=True)
class _BoardReading:
    """Medians over the board: distance by pose, mm from the sensor, and disparities, px."""

    pose_mm: float
    measured_px: float
    expected_px: float

    @property
    def tolerance_px(self) -> float:
        return max(_DISPARITY_TOLERANCE_PX, _DISPARITY_TOLERANCE * abs(self.expected_px))

    @property
    def is_turned(self) -> bool:
        """Whether the mirrored disparity explains the measured one and the expected one does not."""
        if abs(self.expected_px) <= _FAR_FROM_FOCUS_PX:
            return False
        mirrored, upright = abs(self.measured_px + self.expected_px), abs(self.measured_px - self.expected_px)
        return mirrored < max(_TURNED_TOLERANCE_PX, 2 * self.tolerance_px) < upright


def _compare(image: np.ndarray, calibration: Calibration, board: Board, corners: np.ndarray) -> _BoardReading | None:
    """Measure pose and disparity on the board; None where too little is measured."""
    import cv2

    pose = Intrinsics(calibration.lens.camera_matrix, calibration.lens.distortion, 0.0)
    grid = board_points(board.inner_corners, board.square_mm)
    _, rotation, translation = cv2.solvePnP(grid, corners, pose.camera_matrix, pose.distortion)
    normal = cv2.Rodrigues(rotation)[0][:, 2]
    x0, y0 = np.floor(corners.min(axis=0)).astype(int)
    x1, y1 = np.ceil(corners.max(axis=0)).astype(int)
    rows, columns = slice(max(y0, 0), y1 + 1), slice(max(x0, 0), x1 + 1)
    # Depth z of the board's plane along every ray r: n . (z r) = n . t
    height, width = image.shape[:2]
    y, x = np.mgrid[:height, :width][:, rows, columns].astype(float)
    rays = cv2.undistortPoints(np.stack([x, y], -1).reshape(-1, 1, 2), pose.camera_matrix, pose.distortion)
    slope = np.concatenate([rays[:, 0], np.ones((len(rays), 1))], axis=1) @ normal
    model = calibration.depth_model(_QUALITY)
    delta = float(np.median(model.sensor_to_pupil_mm))
    z = (normal @ translation[:, 0] / slope).reshape(x.shape)
    patch = replace(model, **{
        name: value[rows, columns] if np.ndim(value := getattr(model, name)) == 2 else value
        for name in ("infinity_disparity_px", "scale_px_mm", "sensor_to_pupil_mm")
    })  # fmt: skip
    expected = depth_to_disparity(z + delta, patch)
    low, high = calibration.disparity_range_px(_QUALITY)
    reach = max(abs(low), abs(high)) + _SEARCH_MARGIN_PX  # both signs: the filter may be turned
    disparity = estimate_disparity(
        image,
        aperture=calibration.aperture,
        unmixing=calibration.unmixing,
        noise_variance=sensor_noise(image, calibration),
        config=preset(_QUALITY).with_range(-reach, reach),
        channel_moves_px=calibration.channel_moves_px,
    ).value_px[rows, columns]
    known = np.isfinite(disparity) & np.isfinite(expected)
    if known.mean() < _LEAST_MEASURED:
        return None
    difference = float(np.median((disparity - expected)[known]))
    middle = float(np.median(expected[known]))
    return _BoardReading(float(np.median(z)) + delta, middle + difference, middle)


def _board_distance(found: _BoardReading, calibration: Calibration, board: Board) -> Check:
    axis = calibration.on_axis(_QUALITY)
    infinity, scale, delta = (float(v) for v in (axis.infinity_disparity_px, axis.scale_px_mm, axis.sensor_to_pupil_mm))
    shift = found.measured_px - found.expected_px
    inverse = 1 / (found.pose_mm - delta) - shift / scale  # by the calibrated curve
    # Farther away the disparity cannot be told from that of infinity.
    last_mm = scale / found.tolerance_px + delta
    depth_mm = 1 / inverse + delta if inverse > 0 else np.inf
    depth_mm = depth_mm if depth_mm <= last_mm else np.inf
    # Refocusing moves the sensor, which changes A and hardly B: d = A - B / z.
    focus_mm = scale / (infinity + shift) + delta if infinity + shift > 0 else np.inf
    error_mm = depth_mm - found.pose_mm
    # The distance of the corners from the pupil is proportional to the square.
    square_mm = board.square_mm * (depth_mm - delta) / (found.pose_mm - delta)
    figures = {
        "square_if_another_mm": square_mm,
        "pose_mm": found.pose_mm,
        "depth_mm": depth_mm,
        "error_mm": error_mm,
        "measured_disparity_px": found.measured_px,
        "expected_disparity_px": found.expected_px,
        "difference_px": shift,
        "in_focus_if_refocused_mm": focus_mm,
        "in_focus_calibrated_mm": calibration.in_focus_mm,
    }
    error = f" ({error_mm:+.0f} mm)" if np.isfinite(error_mm) else ""
    finding = (
        f"board at {found.pose_mm:.0f} mm by its corners, {_or_beyond(depth_mm, last_mm)} by its disparity{error}; "
        f"disparity {found.measured_px:+.2f} px, expected {found.expected_px:+.2f}"
    )
    accurate = abs(error_mm) <= _DEPTH_TOLERANCE * found.pose_mm and abs(shift) <= 2 * _DISPARITY_TOLERANCE_PX
    if abs(shift) <= found.tolerance_px or accurate:
        return Check(_DISTANCE, "ok", finding, "", figures)
    advice = (
        f"if only the focus moved, it is now at {_or_beyond(focus_mm, last_mm)} instead of "
        f"{calibration.in_focus_text}: set it back, or calibrate again"
    )
    if found.is_turned:
        advice = "see the filter's orientation first"
    elif abs(found.expected_px) > _FAR_FROM_FOCUS_PX and 0.2 < found.measured_px / found.expected_px < 5:
        ratio = found.measured_px / found.expected_px
        figures["scale_if_aperture_changed"] = ratio
        advice += f"; if only the aperture changed, the pupil is {ratio:.2f} times as wide: set the iris as it was"
    if not found.is_turned and np.isfinite(square_mm):
        tolerance = _SQUARE_TOLERANCE + _DISPARITY_TOLERANCE_PX * (depth_mm - delta) / scale  # of B / z, hence of z
        advice = _squares(square_mm, board, calibration.board, tolerance, otherwise=advice)
    return Check(_DISTANCE, "warn", finding, advice, figures)


def _or_beyond(distance_mm: float, last_mm: float) -> str:
    """Format a distance; one that is too far to be measured as "beyond" the last that is, to two digits."""
    return f"{distance_mm:.0f} mm" if distance_mm <= last_mm else f"beyond {float(f'{last_mm:.2g}'):.0f} mm"


def _squares(square_mm: float, board: Board, calibrated: Board | None, tolerance: float, *, otherwise: str) -> str:
    """Return the advice about squares of the side at which corners and disparity agree."""
    if calibrated is not None and calibrated.square_mm != board.square_mm:
        side = calibrated.square_mm
        if abs(square_mm / side - 1) <= tolerance:
            return (
                f"the squares measure {side:g} mm, as in the calibration, not {board.square_mm:g} mm: give "
                f"--square-mm {side:g}; then corners and disparity agree"
            )
    return f"{otherwise}; if the squares have another size, it is {square_mm:.1f} mm: measure one, give --square-mm"


def _orientation(found: _BoardReading, turned: str) -> Check:
    figures = {"measured_disparity_px": found.measured_px, "expected_disparity_px": found.expected_px}
    if found.is_turned:
        finding = f"disparity {found.measured_px:+.2f} px, expected {found.expected_px:+.2f}: the sign is wrong"
        return Check(_ORIENTATION, "warn", finding, turned, figures)
    if abs(found.expected_px) <= _FAR_FROM_FOCUS_PX:
        finding = f"the board is too near to the focus ({found.expected_px:+.2f} px) to tell"
        return Check(_ORIENTATION, "cannot tell", finding, "photograph it clearly nearer or farther", figures)
    if found.measured_px * found.expected_px > 0 and abs(found.measured_px) > found.tolerance_px:
        return Check(_ORIENTATION, "ok", f"disparity {found.measured_px:+.2f} px has the expected sign", "", figures)
    finding = f"disparity {found.measured_px:+.2f} px instead of {found.expected_px:+.2f}: neither right nor mirrored"
    return Check(_ORIENTATION, "cannot tell", finding, "set the focus right first", figures)
