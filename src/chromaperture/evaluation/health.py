"""Is the camera still the one that was calibrated? One photograph answers what it can and says what it cannot.

A photograph of the chessboard tells most: its corners give a distance that owes nothing to the aperture, and the
disparity there must be the one the camera file predicts.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from chromaperture.calibration.chessboard import Intrinsics, board_points, find_corners
from chromaperture.camera_file import Calibration
from chromaperture.camera_matching import sensor_noise
from chromaperture.capture.exif import Exif
from chromaperture.color.image import SATURATION, checked_image
from chromaperture.config import Quality, preset
from chromaperture.depth.conversion import depth_to_disparity
from chromaperture.disparity.estimate import estimate_disparity
from chromaperture.errors import InputError
from chromaperture.evaluation.tint import measure_tint

Verdict = Literal["ok", "warn", "cannot tell"]

_QUALITY: Quality = "real-time"
_FOCAL_TOLERANCE = 0.06  # zooms engrave and EXIF rounds; a lens of another focal length is further off
_STOP_TOLERANCE = 0.09  # a third of a stop is 12 % of the f-number
_FOCUS_TOLERANCE = 0.10  # cameras report the focus distance in coarse steps
_DISPARITY_TOLERANCE_PX = 0.15  # blur's own bias is 0.05 px; a calibrated camera stays within 0.1
_DISPARITY_TOLERANCE = 0.06  # of the disparity itself: what a change of aperture by a sixth of a stop makes
_FAR_FROM_FOCUS_PX = 0.4  # below, a turned filter reads the same as the right one, within the tolerance
_DEPTH_TOLERANCE = 0.02
_TINT_TOLERANCE = 0.10  # from the middle of the frame to its edge
_SATURATED = 0.02
_DARK = 0.05  # of the white level: noise rules
_SEARCH_MARGIN_PX = 1.5


@dataclass(frozen=True)
class Check:
    """One test of the camera.

    Attributes
    ----------
    name : str
    verdict : "ok", "warn" or "cannot tell"
    finding : str
        What was found, in one sentence with its figures.
    advice : str
        What to do; empty when nothing.
    figures : dict of str to float
        The same figures, units in their names.
    """

    name: str
    verdict: Verdict
    finding: str
    advice: str = ""
    figures: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Board:
    """The chessboard in a photograph: inner corners (columns, rows) and the side of a square."""

    inner_corners: tuple[int, int]
    square_mm: float


def check_camera(
    image: np.ndarray, calibration: Calibration, *, board: Board | None = None, exif: Exif | None = None
) -> list[Check]:
    """Compare one photograph with the calibration.

    Parameters
    ----------
    image : (H, W, 3) float, linear RGB, 1.0 = white level
    calibration : Calibration
    board : Board, optional
        The chessboard to look for.
    exif : Exif, optional
        What the camera wrote into the file.

    Returns
    -------
    list of Check

    Raises
    ------
    InputError
        The image is no RGB picture, or the camera was never calibrated.
    """
    image = checked_image(image)
    if not calibration.is_calibrated:
        raise InputError("this camera file holds no depth curve to check against; run 'chromaperture calibrate' first")
    checks = [_resolution(image, calibration), *_settings(exif or Exif(), calibration), _exposure(image)]
    if checks[0].verdict == "warn":
        reason = "the photograph is not of the calibrated size"
        names = ("tint over the frame", "board distance", "filter orientation")
        return [*checks, *(Check(name, "cannot tell", reason) for name in names)]
    checks.append(_tint(image, calibration))
    return [*checks, *_against_board(image, calibration, board)]


def is_healthy(checks: list[Check]) -> bool:
    """Tell whether nothing warns."""
    return all(check.verdict != "warn" for check in checks)


def _resolution(image: np.ndarray, calibration: Calibration) -> Check:
    have, want = image.shape[1::-1], (calibration.sensor.width_px, calibration.sensor.height_px)
    figures = {"width_px": float(have[0]), "height_px": float(have[1])}
    if have == want:
        return Check("resolution", "ok", f"{have[0]}x{have[1]} px, as calibrated", "", figures)
    if have == want[::-1]:
        advice = "the picture was turned: give the file as the sensor read it, without rotation"
    else:
        advice = "give the original of the calibrated size, neither cropped nor scaled, or calibrate at this size"
    finding = f"{have[0]}x{have[1]} px, calibrated at {want[0]}x{want[1]}"
    return Check("resolution", "warn", finding, advice, figures)


def _settings(exif: Exif, calibration: Calibration) -> list[Check]:
    focus_mm = calibration.in_focus_mm
    rows = (
        ("focal length (EXIF)", exif.focal_length_mm, calibration.lens.focal_length_mm, "mm", _FOCAL_TOLERANCE,
         "set the lens to the focal length of the calibration; a zoom needs one calibration for each"),
        ("aperture (EXIF)", exif.f_number, calibration.lens.f_number, "f-number", _STOP_TOLERANCE,
         "open the iris as for the calibration: it must not cut the filter"),
        ("focus (EXIF)", exif.subject_distance_mm, focus_mm, "mm", _FOCUS_TOLERANCE,
         "focus as for the calibration and tape the ring; or calibrate again"),
    )  # fmt: skip
    checks = []
    for name, found, expected, unit, tolerance, advice in rows:
        if found is None or expected is None or not np.isfinite(expected):
            where = "the file does not say" if found is None else "the camera file does not say"
            checks.append(Check(name, "cannot tell", where))
            continue
        ok = abs(found / expected - 1) <= tolerance
        finding = f"{found:.4g} {unit}, calibrated at {expected:.4g}"
        key = unit.replace("-", "_")
        figures = {f"found_{key}": float(found), f"expected_{key}": float(expected)}
        checks.append(Check(name, "ok" if ok else "warn", finding, "" if ok else advice, figures))
    return checks


def _exposure(image: np.ndarray) -> Check:
    finite = image[np.isfinite(image).all(axis=2)]
    if not finite.size:
        raise InputError("the image holds no finite value; export it again")
    saturated = float((finite.max(axis=1) >= SATURATION).mean())
    bright = float(np.percentile(finite, 99))
    figures = {"saturated_share": saturated, "percentile_99": bright}
    if saturated > _SATURATED:
        advice = "expose less: where a channel is full, nothing is measured"
        return Check("exposure", "warn", f"{saturated:.1%} of the pixels are saturated", advice, figures)
    if bright < _DARK:
        advice = "expose longer or add light; check --black-level and --white-level"
        return Check("exposure", "warn", f"the brightest parts reach {bright:.1%} of full scale", advice, figures)
    return Check("exposure", "ok", f"{saturated:.1%} saturated, bright parts at {bright:.0%}", "", figures)


def _tint(image: np.ndarray, calibration: Calibration) -> Check:
    name = "tint over the frame"
    tint = measure_tint(image)
    if tint is None:
        return Check(name, "cannot tell", "too dark or too full to compare colours")
    figures = {"ramp_share": tint.ramp, "scatter_share": tint.scatter}
    finding = f"colour changes by {tint.ramp:.0%} from the middle to the edge, {tint.scatter:.0%} from place to place"
    if tint.ramp > _TINT_TOLERANCE and tint.ramp > 2 * tint.scatter:
        advice = (
            "the filter is not in the plane of the stop (then every part of the frame sees another part of it), or the "
            "light is uneven: move the filter to the iris and photograph a white sheet"
        )
        return Check(name, "warn", finding, advice, figures)
    if tint.scatter > _TINT_TOLERANCE:
        return Check(name, "cannot tell", f"{finding}: the scene has colours", "photograph a white sheet", figures)
    return Check(name, "ok", finding, "", figures)


def _against_board(image: np.ndarray, calibration: Calibration, board: Board | None) -> list[Check]:
    distance, turned = "board distance", "filter orientation"
    if board is None:
        advice = "photograph the chessboard and give --board and --square"
        return [Check(name, "cannot tell", "no board was asked for", advice) for name in (distance, turned)]
    corners = find_corners(image[..., 1], board.inner_corners)
    if corners is None:
        advice = "show the whole board, larger and nearer to focus; check --board (inner corners)"
        return [Check(name, "cannot tell", "no board was found", advice) for name in (distance, turned)]
    seen = _compare(image, calibration, board, corners)
    if seen is None:
        advice = "add texture around the board (chromaperture board prints some) or come nearer to focus"
        return [Check(name, "cannot tell", "no disparity on the board", advice) for name in (distance, turned)]
    return [_board_distance(seen, calibration), _orientation(seen)]


@dataclass(frozen=True)
class _Seen:
    """Medians over the board: distance by pose, mm from the sensor, and disparities, px."""

    pose_mm: float
    measured_px: float
    expected_px: float

    @property
    def tolerance_px(self) -> float:
        return max(_DISPARITY_TOLERANCE_PX, _DISPARITY_TOLERANCE * abs(self.expected_px))

    @property
    def is_turned(self) -> bool:
        """Whether the mirrored disparity explains what was seen and the right one does not."""
        far = abs(self.expected_px) > _FAR_FROM_FOCUS_PX
        # The blur of a turned filter is that of the other side of the focus; matched with the wrong layout its bias
        # adds up, so the mirrored value is met less closely.
        return far and abs(self.measured_px + self.expected_px) < max(0.35, 2 * self.tolerance_px) < abs(
            self.measured_px - self.expected_px
        )


def _compare(image: np.ndarray, calibration: Calibration, board: Board, corners: np.ndarray) -> _Seen | None:
    """Pose and disparity on the board; None where too little is measured."""
    import cv2

    pose = Intrinsics(calibration.lens.camera_matrix, calibration.lens.distortion, 0.0)
    grid = board_points(board.inner_corners, board.square_mm)
    _, rotation, translation = cv2.solvePnP(grid, corners, pose.camera_matrix, pose.distortion)
    normal = cv2.Rodrigues(rotation)[0][:, 2]
    x0, y0 = np.floor(corners.min(axis=0)).astype(int)
    x1, y1 = np.ceil(corners.max(axis=0)).astype(int)
    rows, columns = slice(max(y0, 0), y1 + 1), slice(max(x0, 0), x1 + 1)
    # Depth of the board's plane along every ray: n . (z r) = n . t
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
    ).value_px[rows, columns]
    known = np.isfinite(disparity) & np.isfinite(expected)
    if known.mean() < 0.25:
        return None
    difference = float(np.median((disparity - expected)[known]))
    middle = float(np.median(expected[known]))
    return _Seen(float(np.median(z)) + delta, middle + difference, middle)


def _board_distance(seen: _Seen, calibration: Calibration) -> Check:
    axis = calibration.on_axis(_QUALITY)
    infinity, scale, delta = (
        float(v) for v in (axis.infinity_disparity_px, axis.scale_px_mm, axis.sensor_to_pupil_mm)
    )
    shift = seen.measured_px - seen.expected_px
    inverse = 1 / (seen.pose_mm - delta) - shift / scale  # by the calibrated curve
    depth_mm = 1 / inverse + delta if inverse > 0 else np.inf
    # A sensor moved by a refocus shifts A and hardly touches B: d = A - B / z.
    focus_mm = scale / (infinity + shift) + delta if infinity + shift > 0 else np.inf
    error_mm = depth_mm - seen.pose_mm
    figures = {
        "pose_mm": seen.pose_mm,
        "depth_mm": depth_mm,
        "error_mm": error_mm,
        "measured_disparity_px": seen.measured_px,
        "expected_disparity_px": seen.expected_px,
        "difference_px": shift,
        "in_focus_if_refocused_mm": focus_mm,
        "in_focus_calibrated_mm": calibration.in_focus_mm,
    }
    finding = (
        f"board at {seen.pose_mm:.0f} mm by its corners, {depth_mm:.0f} mm by its disparity ({error_mm:+.0f} mm); "
        f"disparity {seen.measured_px:+.2f} px, expected {seen.expected_px:+.2f}"
    )
    if abs(shift) <= seen.tolerance_px:
        return Check("board distance", "ok", finding, "", figures)
    if abs(error_mm) <= _DEPTH_TOLERANCE * seen.pose_mm and abs(shift) <= 2 * _DISPARITY_TOLERANCE_PX:
        return Check("board distance", "ok", finding, "", figures)
    advice = (
        f"if only the focus moved, it now stands at {focus_mm:.0f} mm instead of {calibration.in_focus_mm:.0f}: set it "
        "back, or calibrate again"
    )
    if seen.is_turned:
        advice = "see the filter's orientation first"
    elif abs(seen.expected_px) > _FAR_FROM_FOCUS_PX and 0.2 < seen.measured_px / seen.expected_px < 5:
        ratio = seen.measured_px / seen.expected_px
        figures["scale_if_aperture_changed"] = ratio
        advice += f"; if only the aperture changed, the pupil is {ratio:.2f} times as wide: set the iris as it was"
    return Check("board distance", "warn", finding, advice, figures)


def _orientation(seen: _Seen) -> Check:
    name = "filter orientation"
    figures = {"measured_disparity_px": seen.measured_px, "expected_disparity_px": seen.expected_px}
    if seen.is_turned:
        finding = f"disparity {seen.measured_px:+.2f} px, expected {seen.expected_px:+.2f}: the sign is wrong"
        advice = "the filter is turned by 180 degrees or its colours are swapped: turn it, arrow up"
        return Check(name, "warn", finding, advice, figures)
    if abs(seen.expected_px) <= _FAR_FROM_FOCUS_PX:
        finding = f"the board is too near to the focus ({seen.expected_px:+.2f} px) to tell"
        return Check(name, "cannot tell", finding, "photograph it clearly nearer or farther", figures)
    if seen.measured_px * seen.expected_px > 0 and abs(seen.measured_px) > seen.tolerance_px:
        return Check(name, "ok", f"disparity {seen.measured_px:+.2f} px has the expected sign", "", figures)
    finding = f"disparity {seen.measured_px:+.2f} px instead of {seen.expected_px:+.2f}: neither right nor mirrored"
    return Check(name, "cannot tell", finding, "set the focus right first", figures)
