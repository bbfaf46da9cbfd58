"""What a calibration is worth, in the words of the person who will use the camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from chromaperture.calibration.calibrate_session import CalibrationResult
from chromaperture.config import Quality
from chromaperture.depth.conversion import depth_sigma, depth_to_disparity, disparity_to_depth

_STEPS = 400  # of the working range


@dataclass(frozen=True)
class Reach:
    """How well a quality measures over the working range, on the axis.

    Attributes
    ----------
    depth_mm : (N,) float64
        From the sensor plane, evenly spaced.
    pixel_sigma_mm : (N,) float64
        Standard deviation of one pixel on the boards, calibration included.
    curve_sigma_mm : (N,) float64
        That of the calibration alone: what averaging over many pixels leaves.
    bias_mm : (N,) float64
        Error of the boards' medians over the frame, between the boards; NaN beyond them.
    step_mm : (N,) float64
        What one px of disparity is worth there.
    """

    depth_mm: np.ndarray
    pixel_sigma_mm: np.ndarray
    curve_sigma_mm: np.ndarray
    bias_mm: np.ndarray
    step_mm: np.ndarray

    @property
    def total_mm(self) -> np.ndarray:
        """Root mean square error of one pixel, its bias counted; NaN beyond the boards."""
        return np.hypot(self.pixel_sigma_mm, self.bias_mm)


def reach(result: CalibrationResult, quality: Quality = "real-time") -> Reach:
    """Propagate the spread of pixels on the boards and the covariance of the curve to millimetres.

    Parameters
    ----------
    result : CalibrationResult
    quality : Quality

    Returns
    -------
    Reach
    """
    calibration = result.calibration
    model = calibration.on_axis(quality)
    depth = np.linspace(calibration.near_mm, calibration.far_mm, _STEPS)
    rulers = np.array([board.ruler_mm for board in result.boards])
    spread = np.asarray(result.pixel_sigma_px[quality], float)
    known = np.isfinite(spread)
    order = np.argsort(rulers[known])
    # Blur widens the spread away from the focus: it is taken from the boards on either side.
    sigma = np.interp(depth, rulers[known][order], spread[known][order]) if known.any() else np.full(_STEPS, np.nan)
    z = depth - float(np.asarray(model.sensor_to_pupil_mm))
    step = z**2 / float(np.asarray(model.scale_px_mm))  # d depth / d disparity of d = A - B / z
    errors = board_errors(result, quality)
    measured = np.isfinite(errors)
    order = np.argsort(rulers[measured])
    bias = np.interp(depth, rulers[measured][order], errors[measured][order], left=np.nan, right=np.nan)
    return Reach(depth, depth_sigma(z, model, sigma), depth_sigma(z, model, 0.0), bias, step)


def stretches(depth_mm: np.ndarray, good: np.ndarray) -> list[tuple[float, float]]:
    """Give the stretches of depth where ``good`` holds, from .. to .., mm."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], good, [False]]).astype(int)))
    return [(float(depth_mm[a]), float(depth_mm[b - 1])) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def board_errors(result: CalibrationResult, quality: Quality = "real-time") -> np.ndarray:
    """Median error of every board over the whole frame by the fitted fields; (boards,) float64, mm, NaN unknown."""
    depth = [board_depth(result, i, quality) for i in range(len(result.boards))]
    return np.array([
        float(np.nanmedian(d)) - board.ruler_mm if np.isfinite(d).any() else np.nan
        for d, board in zip(depth, result.boards, strict=True)
    ])  # fmt: skip


def board_depth(
    result: CalibrationResult, index: int, quality: Quality = "real-time", *, corrected: bool = True
) -> np.ndarray:
    """Depth of a board on the grid: by the fields over the frame, or by the one curve of the axis.

    Parameters
    ----------
    result : CalibrationResult
    index : int
        Of the board.
    quality : Quality
    corrected : bool
        Whether to use the fields.

    Returns
    -------
    (h, w) float64, mm from the sensor plane; NaN unknown
    """
    board, calibration = result.boards[index], result.calibration
    axis = calibration.on_axis(quality)
    disparity = np.asarray(board.grid_px[quality], float)
    if corrected:
        # A px of residual is worth 1 / B(i, j) of inverse depth: put back onto the curve of the axis.
        ratio = float(np.asarray(axis.scale_px_mm)) / _scale_on_grid(result, quality)
        residual = np.asarray(result.residual_px[quality][index], float)
        disparity = float(depth_to_disparity(board.ruler_mm, axis)) + residual * ratio
    return disparity_to_depth(disparity, axis)[0].astype(float)


def _scale_on_grid(result: CalibrationResult, quality: Quality) -> np.ndarray:
    sensor = result.calibration.sensor
    shape = (sensor.height_px, sensor.width_px)
    scale = np.broadcast_to(np.asarray(result.calibration.depth_model(quality).scale_px_mm), shape)
    return scale[np.ix_(result.grid_y_px.astype(int), result.grid_x_px.astype(int))]


@dataclass(frozen=True)
class Sentence:
    """One line of the verdict; ``tone`` is "good", "weak" or "plain"."""

    text: str
    tone: str = "plain"


def sentences(result: CalibrationResult, quality: Quality = "real-time") -> list[Sentence]:
    """Say what the camera is good for, what is weak, and what to do about it."""
    calibration = result.calibration
    seen = reach(result, quality)
    lines = [_accuracy(seen, share) for share in (0.01, 0.02)]
    lines.append(Sentence(
        f"It measures from {calibration.near_mm:.0f} to {calibration.far_mm:.0f} mm (boards stood from "
        f"{min(b.ruler_mm for b in result.boards):.0f} to {max(b.ruler_mm for b in result.boards):.0f} mm) and is in "
        f"focus at {calibration.in_focus_mm:.0f} mm. Distances count from the sensor plane."
    ))  # fmt: skip
    middle = len(seen.depth_mm) // 2
    lines.append(Sentence(
        "A tenth of a pixel of disparity is worth " + ", ".join(
            f"{0.1 * seen.step_mm[i]:.0f} mm at {seen.depth_mm[i]:.0f} mm" for i in (0, middle, -1)
        ) + "."
    ))  # fmt: skip
    rulers = np.array([board.ruler_mm for board in result.boards])
    errors = board_errors(result, quality)
    worst = int(np.nanargmax(np.abs(errors / rulers)))
    share = abs(errors[worst]) / rulers[worst]
    lines.append(Sentence(
        f"The boards themselves come back to within {share:.1%} over the whole frame; the worst is "
        f"{result.boards[worst].name}, off by {errors[worst]:+.0f} mm.",
        "good" if share <= 0.01 else "weak",
    ))  # fmt: skip
    return lines + weaknesses(result, quality)


def _accuracy(seen: Reach, share: float) -> Sentence:
    """Where one pixel is good to a share of its depth."""
    total = seen.total_mm / seen.depth_mm
    good = np.isfinite(total) & (total <= share)
    ranges = stretches(seen.depth_mm, good)
    if not ranges:
        if not np.isfinite(total).any():
            return Sentence(f"Whether a pixel is good to {share:.0%} cannot be told: too few boards were read.", "weak")
        best = int(np.nanargmin(total))
        where = f"{total[best]:.1%}, at {seen.depth_mm[best]:.0f} mm"
        return Sentence(f"One pixel is nowhere good to {share:.0%}; its best is {where}.", "weak")
    text = " and ".join(f"from {a:.0f} to {b:.0f} mm" for a, b in ranges)
    return Sentence(f"One pixel is good to {share:.0%} {text} (one standard deviation, on the boards).", "good")


def weaknesses(result: CalibrationResult, quality: Quality) -> list[Sentence]:
    """Give what limits this calibration, each with what to do."""
    found = []
    rulers = np.array([board.ruler_mm for board in result.boards])
    focus = result.calibration.in_focus_mm
    near, far = int((rulers < 0.95 * focus).sum()), int((rulers > 1.05 * focus).sum())
    if min(near, far) == 0:
        side = "nearer" if near == 0 else "farther"
        found.append(f"No board stands {side} than the focus at {focus:.0f} mm: photograph two or three there.")
    model = result.fits[quality].model
    sigma = np.sqrt(np.diag(np.asarray(model.covariance)))
    if sigma[2] > 5:
        found.append(
            f"The distance from the sensor to the pupil is known to {sigma[2]:.0f} mm only, which is that much of "
            "error near the camera: add boards close by and tilted ones."
        )
    if result.intrinsics is None:
        found.append("The lens was not measured, points may be off sideways by a few %: add tilted boards.")
    elif result.intrinsics.rms_px > 0.5:
        found.append(f"Corners miss the lens model by {result.intrinsics.rms_px:.2f} px: is the board flat and sharp?")
    missing = [board.name for board in result.boards if board.corners_px is None]
    if missing:
        found.append(
            f"No chessboard was found in {len(missing)} of {len(rulers)} boards ({', '.join(missing[:4])}): their "
            "distance rests on the ruler alone."
        )
    blank = [
        board.name
        for board in result.boards
        if not np.isfinite(board.grid_px[quality]).mean() > 0.5
    ]
    if blank:
        found.append(f"Less than half of the frame has texture on {', '.join(blank[:4])}: cover the wall with speckle.")
    trusted_mm = result.session.ruler_error_mm
    found += [
        f"Ruler and corners of {board.name} disagree by {off:+.0f} mm: measure that distance again."
        for board, off in zip(result.boards, result.ruler_residual_mm, strict=False)
        if abs(off) > 3 * trusted_mm and board.name not in result.outliers  # False where there is no pose
    ]
    return [Sentence(text, "weak") for text in (*found, *result.outliers.values())]
