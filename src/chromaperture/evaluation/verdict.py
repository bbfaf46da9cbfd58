"""How accurate a calibration is, in sentences for the person who will use the camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from chromaperture.calibration.calibrate_session import CalibrationResult
from chromaperture.config import Quality
from chromaperture.depth.conversion import depth_sigma, depth_to_disparity, disparity_to_depth

QUALITY: Quality = "real-time"  # of the report: the one that users start with
_STEPS = 400  # depths over the working range
# Limits of a camera that measures anything, chosen by hand: a phone's baseline of 0.7 mm measures to 5 %.
_USELESS_PIXEL = 0.10  # rms error of a pixel at the best depth, relative
_USELESS_BOARDS = 0.05  # median error of the boards over the frame, relative
_LARGE_PUPIL_SIGMA_MM = 5.0  # standard deviation of delta above which more boards are advised; chosen by hand
_LARGE_CORNER_RMS_PX = 0.5  # residual of the lens model above which flatness and focus are questioned; chosen by hand


@dataclass(frozen=True)
class DepthAccuracy:
    """Accuracy over the working range, on the axis; (N,) float64 each, mm."""

    depth_mm: np.ndarray  # from the sensor plane, evenly spaced
    pixel_sigma_mm: np.ndarray  # standard deviation of one pixel on the boards, calibration included
    curve_sigma_mm: np.ndarray  # that of the calibration alone, which averaging over pixels does not reduce
    bias_mm: np.ndarray  # error of the boards' medians over the frame, interpolated between them; NaN beyond them
    step_mm: np.ndarray  # depth per px of disparity

    @property
    def total_mm(self) -> np.ndarray:
        """Root mean square error of one pixel, bias included; NaN beyond the boards."""
        return np.hypot(self.pixel_sigma_mm, self.bias_mm)


def depth_accuracy(result: CalibrationResult) -> DepthAccuracy:
    """Propagate the pixel noise on the boards and the covariance of the curve to millimetres."""
    calibration = result.calibration
    model = calibration.on_axis(QUALITY)
    depth = np.linspace(calibration.near_mm, calibration.far_mm, _STEPS)
    rulers = np.array([board.ruler_mm for board in result.boards])

    def between_boards(values: np.ndarray, beyond: float | None) -> np.ndarray:
        known = np.isfinite(values)
        if not known.any():
            return np.full(_STEPS, np.nan)
        order = np.argsort(rulers[known])
        return np.interp(depth, rulers[known][order], values[known][order], left=beyond, right=beyond)

    # Interpolated, because blur increases the noise away from the focus.
    noise_px = between_boards(np.asarray(result.pixel_sigma_px[QUALITY], float), None)
    bias = between_boards(board_errors(result), np.nan)
    z = depth - float(np.asarray(model.sensor_to_pupil_mm))
    step = z**2 / float(np.asarray(model.scale_px_mm))  # d depth / d disparity of d = A - B / z
    return DepthAccuracy(depth, depth_sigma(z, model, noise_px), depth_sigma(z, model, 0.0), bias, step)


def intervals(depth_mm: np.ndarray, good: np.ndarray) -> list[tuple[float, float]]:
    """Return the intervals of depth where ``good`` holds; list of (first, last), mm."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], good, [False]]).astype(int)))
    return [(float(depth_mm[a]), float(depth_mm[b - 1])) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def board_errors(result: CalibrationResult) -> np.ndarray:
    """Return each board's median error over the frame by the fitted fields; (boards,) float64, mm, NaN unknown."""
    depth = [board_depth(result, i) for i in range(len(result.boards))]
    return np.array([
        float(np.nanmedian(d)) - board.ruler_mm if np.isfinite(d).any() else np.nan
        for d, board in zip(depth, result.boards, strict=True)
    ])  # fmt: skip


def board_depth(result: CalibrationResult, index: int, *, corrected: bool = True) -> np.ndarray:
    """Compute the depth of a board on the grid.

    Parameters
    ----------
    index : int
        Of the board.
    corrected : bool
        By the fields over the frame; otherwise by the curve of the axis.

    Returns
    -------
    (h, w) float64, mm from the sensor plane; NaN unknown
    """
    board, calibration = result.boards[index], result.calibration
    axis = calibration.on_axis(QUALITY)
    disparity = np.asarray(board.grid_px[QUALITY], float)
    if corrected:
        # A px of residual is 1 / B(i, j) of inverse depth; added to the curve of the axis.
        shape = (calibration.sensor.height_px, calibration.sensor.width_px)
        scale = np.broadcast_to(np.asarray(calibration.depth_model(QUALITY).scale_px_mm), shape)
        on_grid = scale[np.ix_(result.grid_y_px.astype(int), result.grid_x_px.astype(int))]
        ratio = float(np.asarray(axis.scale_px_mm)) / on_grid
        residual = np.asarray(result.residual_px[QUALITY][index], float)
        disparity = float(depth_to_disparity(board.ruler_mm, axis)) + residual * ratio
    return disparity_to_depth(disparity, axis)[0].astype(float)


@dataclass(frozen=True)
class Sentence:
    """One line of the verdict; ``tone`` is "good", "weak" or "plain"."""

    text: str
    tone: str = "plain"


def sentences(result: CalibrationResult) -> list[Sentence]:
    """Describe accuracy and range of the camera, then its weaknesses and their remedies."""
    calibration = result.calibration
    found = depth_accuracy(result)
    lines = [_accurate_range(found, fraction) for fraction in (0.01, 0.02)]
    lines.append(Sentence(
        f"It measures from {calibration.near_mm:.0f} to {calibration.far_mm:.0f} mm (boards from "
        f"{min(b.ruler_mm for b in result.boards):.0f} to {max(b.ruler_mm for b in result.boards):.0f} mm) and is in "
        f"focus at {calibration.in_focus_mm:.0f} mm. Distances count from the sensor plane."
    ))  # fmt: skip
    lines.append(Sentence(
        "A tenth of a pixel of disparity is " + ", ".join(
            f"{0.1 * found.step_mm[i]:.0f} mm at {found.depth_mm[i]:.0f} mm" for i in (0, _STEPS // 2, -1)
        ) + "."
    ))  # fmt: skip
    rulers = np.array([board.ruler_mm for board in result.boards])
    errors = board_errors(result)
    if np.isfinite(errors).any():
        worst = int(np.nanargmax(np.abs(errors / rulers)))
        relative = abs(errors[worst]) / rulers[worst]
        lines.append(Sentence(
            f"The boards themselves come back to within {relative:.1%} over the whole frame; the worst is "
            f"{result.boards[worst].name}, off by {errors[worst]:+.0f} mm.",
            "good" if relative <= 0.01 else "weak",
        ))  # fmt: skip
    return lines + weaknesses(result)


def unusable(result: CalibrationResult) -> list[str]:
    """Return the reasons why a camera cannot be used; empty for one that measures."""
    reasons = []
    found = depth_accuracy(result)
    total = found.total_mm / found.depth_mm
    if not np.isfinite(total).any():
        reasons.append("the error is unknown at every distance: too few boards were read")
    elif np.nanmin(total) > _USELESS_PIXEL:
        reasons.append(f"one pixel is nowhere good to {_USELESS_PIXEL:.0%}; its best is {np.nanmin(total):.0%}")
    relative = np.abs(board_errors(result)) / np.array([board.ruler_mm for board in result.boards])
    if np.isfinite(relative).any() and np.nanmedian(relative) > _USELESS_BOARDS:
        reasons.append(f"half of the boards are off by {np.nanmedian(relative):.0%} or more")
    if result.session.tilts and not result.tilts and result.intrinsics is None:
        reasons.append(
            f"no chessboard was found in any of {len(result.session.tilts)} tilted photographs: it must lie inside the "
            "frame, in focus"
        )
    return reasons


def _accurate_range(found: DepthAccuracy, fraction: float) -> Sentence:
    """State where one pixel is accurate to a fraction of its depth."""
    total = found.total_mm / found.depth_mm
    ranges = intervals(found.depth_mm, np.isfinite(total) & (total <= fraction))
    if ranges:
        text = " and ".join(f"from {a:.0f} to {b:.0f} mm" for a, b in ranges)
        return Sentence(f"One pixel is good to {fraction:.0%} {text} (one standard deviation, on the boards).", "good")
    if not np.isfinite(total).any():
        return Sentence(f"Whether a pixel is good to {fraction:.0%} is unknown: too few boards were read.", "weak")
    best = int(np.nanargmin(total))
    where = f"{total[best]:.1%}, at {found.depth_mm[best]:.0f} mm"
    return Sentence(f"One pixel is nowhere good to {fraction:.0%}; its best is {where}.", "weak")


def weaknesses(result: CalibrationResult) -> list[Sentence]:
    """List what limits this calibration, each with its remedy."""
    found = []
    rulers = np.array([board.ruler_mm for board in result.boards])
    focus = result.calibration.in_focus_mm
    nearer, farther = (rulers < 0.95 * focus).any(), (rulers > 1.05 * focus).any()  # 5 %: clearly off the focus
    if not (nearer and farther):
        side = "farther" if nearer else "nearer"
        found.append(f"No board stands {side} than the focus at {focus:.0f} mm: photograph two or three there.")
    sigma = np.sqrt(np.diag(np.asarray(result.fits[QUALITY].model.covariance)))
    if sigma[2] > _LARGE_PUPIL_SIGMA_MM:
        found.append(
            f"The distance from the sensor to the pupil is known to {sigma[2]:.0f} mm only, which is that much of "
            "error near the camera: add boards close by and tilted ones."
        )
    if result.intrinsics is None:
        found.append("The lens was not measured, points may be off sideways by a few %: add tilted boards.")
    elif result.intrinsics.rms_px > _LARGE_CORNER_RMS_PX:
        found.append(f"Corners miss the lens model by {result.intrinsics.rms_px:.2f} px: is the board flat and sharp?")
    missing = [board.name for board in result.boards if board.corners_px is None]
    if missing:
        found.append(
            f"No chessboard was found in {len(missing)} of {len(rulers)} boards ({', '.join(missing[:4])}): their "
            "distance rests on the ruler alone."
        )
    blank = [board.name for board in result.boards if not np.isfinite(board.grid_px[QUALITY]).mean() > 0.5]
    if blank:
        found.append(f"Less than half of the frame has texture on {', '.join(blank[:4])}: cover the wall with speckle.")
    found += [
        f"Ruler and corners of {board.name} disagree by {off:+.0f} mm: measure that distance again."
        for board, off in zip(result.boards, result.ruler_residual_mm, strict=False)
        # False without a pose, where ``off`` is NaN.
        if abs(off) > 3 * result.session.ruler_error_mm and board.name not in result.outliers
    ]
    return [Sentence(text, "weak") for text in (*found, *result.outliers.values())]
