"""How accurate a calibration is, in sentences for the person who will use the camera."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from chromaperture.calibration.calibrate_session import CalibrationResult
from chromaperture.calibration.options import Progress, reported, silent
from chromaperture.calibration.read_boards import pixel_sigma
from chromaperture.camera.camera import CodedApertureCamera
from chromaperture.camera.method import default_config
from chromaperture.color.unmixing import view_reach
from chromaperture.depth.conversion import DepthModel, depth_sigma, depth_to_disparity, disparity_to_depth
from chromaperture.settings.methods import Quality
from chromaperture.system.errors import InputError

QUALITY: Quality = "real-time"  # of the report: the one that users start with
_STEPS = 400  # depths over the working range
_PLACES = 12  # image positions along the width and the height, for the mean over the frame; chosen by hand
# Limits of a camera that measures anything, chosen by hand: a phone's baseline of 0.7 mm measures to 5 %.
_USELESS_PIXEL = 0.10  # rms error of a pixel at the best depth, relative
_USELESS_BOARDS = 0.05  # median error of the boards over the frame, relative
_LARGE_PUPIL_SIGMA_MM = 5.0  # standard deviation of delta above which more boards are advised; chosen by hand
_DISAGREE = 3.0  # standard deviations of ruler and corners, and times the ruler's own error; chosen by hand
_LARGE_CORNER_RMS_PX = 0.5  # residual of the lens model above which flatness and focus are questioned; chosen by hand


@dataclass(frozen=True)
class DepthAccuracy:
    """Accuracy over the working range; (N,) float64 each, mm."""

    depth_mm: np.ndarray  # from the sensor plane, ascending; the boards' distances are among them
    # Standard deviation of one pixel on the boards, calibration included; root mean square over the frame. NaN unknown
    pixel_sigma_mm: np.ndarray
    curve_sigma_mm: np.ndarray  # that of the calibration alone, which averaging over pixels does not reduce
    bias_mm: np.ndarray  # error of the boards' medians over the frame, interpolated between them; NaN beyond them
    step_mm: np.ndarray  # depth per px of disparity, on the axis

    @property
    def total_mm(self) -> np.ndarray:
        """Root mean square error of one pixel, bias included; NaN beyond the boards."""
        return np.hypot(self.pixel_sigma_mm, self.bias_mm)


def qualities(result: CalibrationResult) -> tuple[Quality, ...]:
    """Return the qualities that the report describes: ``accurate`` where its depth curve was measured on the boards."""
    return (QUALITY,) if result.layers is None else (QUALITY, "accurate")


def depth_accuracy(result: CalibrationResult, quality: Quality = QUALITY) -> DepthAccuracy:
    """Propagate pixel noise and the curve's covariance to mm, all over the frame: px are more mm in corners."""
    calibration = result.calibration
    width, height = calibration.sensor.width_px, calibration.sensor.height_px
    field = calibration.depth[quality]
    rulers = np.array([board.ruler_mm for board in result.boards])
    inside = rulers[(rulers >= calibration.near_mm) & (rulers <= calibration.far_mm)]
    depth = np.union1d(np.linspace(calibration.near_mm, calibration.far_mm, _STEPS), inside)

    def between_boards(values: np.ndarray, *, beyond_them: bool) -> np.ndarray:
        known = np.isfinite(values)
        if not known.any():
            return np.full(depth.shape, np.nan)
        order = np.argsort(rulers[known])
        beyond = None if beyond_them else np.nan
        return np.interp(depth, rulers[known][order], values[known][order], left=beyond, right=beyond)

    unknown = np.full(len(rulers), np.nan)
    # Interpolated, because blur increases the noise away from the focus.
    noise_px = between_boards(np.asarray(result.pixel_sigma_px.get(quality, unknown), float), beyond_them=True)
    bias = between_boards(board_errors(result, quality), beyond_them=False)
    x, y = np.meshgrid(*((np.arange(_PLACES) + 0.5) / _PLACES * count - 0.5 for count in (width, height)))
    model = field.at(x.ravel(), y.ravel(), width, height)
    z = (depth - field.sensor_to_pupil_mm)[:, None]
    calibrated = depth_sigma(z, model, 0.0)
    read = z**2 / model.scale_px_mm * noise_px[:, None] / _mean_slope(z, model, noise_px[:, None])
    step = (depth - field.sensor_to_pupil_mm) ** 2 / float(np.asarray(field.on_axis(width, height).scale_px_mm))
    return DepthAccuracy(depth, _over_frame(np.hypot(calibrated, read)), _over_frame(calibrated), bias, step)


def _over_frame(sigma: np.ndarray) -> np.ndarray:
    """Return the root mean square over the image positions, (N, P) to (N,)."""
    return np.asarray(np.sqrt(np.mean(sigma**2, axis=1)))


def _mean_slope(z_mm: np.ndarray, model: DepthModel, noise_px: np.ndarray) -> np.ndarray:
    """Return d measured / d linear disparity, averaged over readings one deviation to both sides; (N, P)."""
    curve = model.nonlinearity
    linear = model.infinity_disparity_px - model.scale_px_mm / z_mm
    if curve is None:
        return np.ones(np.shape(linear))
    reach = np.maximum(np.nan_to_num(noise_px), 1e-3)  # px; the derivative where there is no noise
    return np.asarray((curve.measured(linear + reach) - curve.measured(linear - reach)) / (2 * reach))


def intervals(depth_mm: np.ndarray, good: np.ndarray) -> list[tuple[float, float]]:
    """Return the intervals of depth where ``good`` holds; list of (first, last), mm."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], good, [False]]).astype(int)))
    return [(float(depth_mm[a]), float(depth_mm[b - 1])) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def board_errors(result: CalibrationResult, quality: Quality = QUALITY) -> np.ndarray:
    """Return each board's median error, mm, by the fitted fields, over the cells that a curve was fitted to."""
    if quality == "accurate":
        return _accurate_errors(result)
    rulers = np.array([board.ruler_mm for board in result.boards])
    depth = [board_depth(result, i) for i in range(len(rulers))]
    return np.array([np.nanmedian(d) if np.isfinite(d).any() else np.nan for d in depth], float) - rulers


def _accurate_errors(result: CalibrationResult) -> np.ndarray:
    """Return `board_errors` by the best layers of the cells, which are those of ``accurate``."""
    distances, layers = result.evidence.from_sensor_mm, result.layers
    errors = np.full(len(distances), np.nan)
    if layers is None:
        return errors
    curve = result.calibration.depth["accurate"].at(layers.x_px, layers.y_px, *layers.size_px)
    for i in np.flatnonzero(np.isfinite(layers.layer_px).any(axis=1)):
        depth = disparity_to_depth(layers.layer_px[i], curve)[0].astype(float)
        errors[i] = np.nanmedian(depth) - distances[i] if np.isfinite(depth).any() else np.nan
    return errors


def board_depth(result: CalibrationResult, index: int, *, corrected: bool = True) -> np.ndarray:
    """Compute the depth of a board on the grid, mm, by the fields, or by the curve of the axis."""
    board, sensor, field = result.boards[index], result.calibration.sensor, result.calibration.depth[QUALITY]
    axis = field.on_axis(sensor.width_px, sensor.height_px)
    disparity = np.asarray(board.grid_px[QUALITY], float)
    if corrected:
        # A px of residual is 1 / B(i, j) of inverse depth; added to the curve of the axis.
        x, y = np.meshgrid(result.grid_x_px, result.grid_y_px)
        on_grid = field.at(x, y, sensor.width_px, sensor.height_px).scale_px_mm
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
    lines = []
    for quality in qualities(result):
        accuracy = depth_accuracy(result, quality)
        if quality == QUALITY or np.isfinite(accuracy.total_mm).any():  # the noise of accurate may be unmeasured
            lines += [_accurate_range(accuracy, fraction, quality) for fraction in (0.01, 0.02)]
    lines.append(Sentence(
        "That holds for flat surfaces as full of texture as the boards. On weak texture and beside edges of objects "
        "pixels are worse, and half of a whole scene may be: in the still life of the demo, through a lens good to "
        "1 %, the middle error bar is 4 % at accurate and 10 % at real-time. It is written beside each depth."
    ))  # fmt: skip
    lines.append(Sentence(
        f"It measures from {calibration.near_mm:.0f} to {calibration.far_mm:.0f} mm (boards from "
        f"{min(b.ruler_mm for b in result.boards):.0f} to {max(b.ruler_mm for b in result.boards):.0f} mm) and is in "
        f"focus at {calibration.in_focus_text}. Distances count from the sensor plane."
    ))  # fmt: skip
    lines.append(Sentence(
        "A tenth of a pixel of disparity is " + ", ".join(
            f"{0.1 * found.step_mm[i]:.0f} mm at {found.depth_mm[i]:.0f} mm" for i in (0, len(found.depth_mm) // 2, -1)
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
    faults = faults_of(result, QUALITY)
    if faults and not unusable(result):
        lines.append(Sentence(f"Measure with quality accurate: at {QUALITY} {'; '.join(faults)}.", "weak"))
    return lines + weaknesses(result)


def unusable(result: CalibrationResult) -> list[str]:
    """Return why a camera cannot be used at any quality; ``accurate`` measures more than ``real-time``."""
    faults = [faults_of(result, quality) for quality in qualities(result)]
    reasons = faults[0] if all(faults) else []
    if is_of_another_design(result):
        reasons.append(
            f"the boards are displaced {baseline_ratio(result):.2f} times as far as through design "
            f"{result.session.design}: correct design in session.toml"
        )
    if result.session.tilts and not result.tilts and result.intrinsics is None:
        reasons.append(
            f"no chessboard was found in any of {len(result.session.tilts)} tilted photographs: it must lie inside the "
            "frame, in focus"
        )
    return reasons


def faults_of(result: CalibrationResult, quality: Quality) -> list[str]:
    """Return why a quality does not measure with a camera; empty where it does."""
    faults = []
    found = depth_accuracy(result, quality)
    total = found.total_mm / found.depth_mm
    relative = np.abs(board_errors(result, quality)) / np.array([board.ruler_mm for board in result.boards])
    measured, read = np.isfinite(total).any(), np.isfinite(relative).any()
    if not (measured or (read and quality == "accurate")):  # the noise of accurate may be unmeasured
        faults.append("the error is unknown at every distance: too few boards were read")
    elif measured and np.nanmin(total) > _USELESS_PIXEL:
        faults.append(f"one pixel is nowhere good to {_USELESS_PIXEL:.0%}; its best is {np.nanmin(total):.0%}")
    if read and np.nanmedian(relative) > _USELESS_BOARDS:
        faults.append(f"half of the boards are off by {np.nanmedian(relative):.0%} or more")
    return faults


def _accurate_range(found: DepthAccuracy, fraction: float, quality: Quality) -> Sentence:
    """State where one pixel is accurate to a fraction of its depth."""
    total = found.total_mm / found.depth_mm
    ranges = intervals(found.depth_mm, np.isfinite(total) & (total <= fraction))
    if ranges:
        text = " and ".join(f"from {a:.0f} to {b:.0f} mm" for a, b in ranges)
        return Sentence(
            f"At quality {quality}, one pixel of a textured board is good to {fraction:.0%} {text} (one standard "
            "deviation, over the whole frame).",
            "good",
        )
    if not np.isfinite(total).any():
        return Sentence(f"Whether a pixel is good to {fraction:.0%} is unknown: too few boards were read.", "weak")
    best = int(np.nanargmin(total))
    where = f"{total[best]:.1%}, at {found.depth_mm[best]:.0f} mm"
    return Sentence(
        f"At quality {quality}, one pixel is nowhere good to {fraction:.0%}, even on a textured board; its best is "
        f"{where}.",
        "weak",
    )


def weaknesses(result: CalibrationResult) -> list[Sentence]:
    """List what limits this calibration, each with its remedy."""
    found = []
    rulers = np.array([board.ruler_mm for board in result.boards])
    focus = result.calibration.in_focus_mm
    nearer, farther = (rulers < 0.95 * focus).any(), (rulers > 1.05 * focus).any()  # 5 %: clearly off the focus
    if not (nearer and (farther or result.session.focuses_at_infinity)):
        side = "farther" if nearer else "nearer"
        at = result.calibration.in_focus_text
        found.append(f"No board stands {side} than the focus at {at}: photograph two or three there.")
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
    found += _against_rulers(result)
    return [Sentence(text, "weak") for text in (*contradictions(result), *found, *result.outliers.values())]


def _against_rulers(result: CalibrationResult) -> list[str]:
    """Name the boards whose ruler and corners disagree by more than both may err; far boards' corners err by cm."""
    sigma_mm = np.zeros(len(result.boards)) if result.ruler is None else result.ruler.residual_sigma_mm
    limit_mm = _DISAGREE * np.fmax(sigma_mm, result.session.ruler_error_mm)
    return [
        f"Ruler and corners of {board.name} disagree by {off:+.0f} mm: measure that distance again."
        for board, off, limit in zip(result.boards, result.ruler_residual_mm, limit_mm, strict=False)
        if abs(off) > limit and board.name not in result.outliers  # False without a pose, where ``off`` is NaN
    ]


# Of 22 right cameras of simulated sessions, seven designs, focal lengths are 0.94 to 1.01 of the stated ones, baselines
# 0.98 to 1.08 of those of design and f-number, 0.75 to 0.88 of open designs, whose rim vignettes.
_FOCAL_TOLERANCE = 0.15  # engraved ones are rounded, and lenses change theirs when they focus near
_BASELINE_RATIO = (0.65, 1.35)  # a wrong f-number by a stop is 1.4
# Halves taken for the open design are 2.54, for three squares 0.07; a wrong f-number by two stops is 2.
_OTHER_DESIGN_RATIO = (0.4, 2.2)


def contradictions(result: CalibrationResult) -> list[str]:
    """Return a sentence for every stated fact that the photographs contradict."""
    session, found = result.session, []
    focal_mm = result.calibration.lens.focal_length_mm
    if result.intrinsics is not None and abs(focal_mm / session.nominal_focal_length_mm - 1) > _FOCAL_TOLERANCE:
        found.append(
            f"By boards and ruler the focal length is {focal_mm:.1f} mm, session.toml says "
            f"{session.nominal_focal_length_mm:g} mm: check square_mm, pixel_pitch_mm and nominal_focal_length_mm; "
            "sideways positions are wrong by as much."
        )
    (low, high), ratio = _BASELINE_RATIO, baseline_ratio(result)
    if not found and not low <= ratio <= high:  # a wrong focal length makes a wrong baseline
        found.append(
            f"The baseline is {result.calibration.baseline_mm:.1f} mm, {ratio:.2f} times that of design "
            f"{session.design} at f/{session.nominal_f_number:g}: check design, nominal_f_number, and that the film "
            "fills the iris, wide open."
        )
    delta_mm = float(result.calibration.on_axis("real-time").sensor_to_pupil_mm)
    if result.ruler is not None and delta_mm < 0:
        found.append(
            f"By boards and ruler the entrance pupil lies {-delta_mm:.0f} mm behind the sensor, as of long telephoto "
            "lenses only: were distances measured from the sensor mark? Depth counts from where the ruler began."
        )
    return found


def is_of_another_design(result: CalibrationResult) -> bool:
    """Whether the baseline is so far from that of the stated design that the film must be another."""
    low, high = _OTHER_DESIGN_RATIO
    return not low <= baseline_ratio(result) <= high


def baseline_ratio(result: CalibrationResult) -> float:
    """Return the baseline over that of design, focal length and f-number; 1 of half pixels, whose ramps none states."""
    camera = result.calibration
    if camera.sensor.dual_pixel is not None:
        return 1.0
    expected_mm = view_reach(camera.aperture) * camera.lens.focal_length_mm / result.session.nominal_f_number
    return camera.baseline_mm / expected_mm


# Of all boards together: 16 s at 8 s a megapixel (README), which is less than the calibration itself takes.
MOST_MEGAPIXELS = 2.0


def chosen_boards(result: CalibrationResult) -> list[int]:
    """Return the nearest, sharpest and farthest board, between which noise is interpolated; or none."""
    if result.layers is None:
        return []
    used, distance = np.flatnonzero(result.evidence.used), result.evidence.from_sensor_mm
    blurred = np.abs(depth_to_disparity(distance, result.calibration.on_axis("accurate")))
    found = (used[np.argmin(distance[used])], used[np.argmin(blurred[used])], used[np.argmax(distance[used])])
    return sorted({int(i) for i in found})


def with_accurate_noise(
    result: CalibrationResult, *, most_megapixels: float = MOST_MEGAPIXELS, progress: Progress = silent
) -> CalibrationResult:
    """Measure a few boards at quality ``accurate`` for its noise, unless they have too many megapixels."""
    calibration = result.calibration
    width, height = calibration.sensor.width_px, calibration.sensor.height_px
    boards = chosen_boards(result)
    if not boards or len(boards) * width * height > 1e6 * most_megapixels:
        return result
    # A board is a plane, but nothing explains it as one: the plate follows the evidence of a board as of any surface.
    camera = CodedApertureCamera(calibration, default_config(calibration, "accurate"))
    x, y = np.meshgrid(result.grid_x_px, result.grid_y_px)
    model = calibration.depth["accurate"].at(x, y, width, height)
    rows, columns = result.grid_y_px.astype(int), result.grid_x_px.astype(int)
    paths, sigma = list(result.session.boards), np.full(len(result.boards), np.nan)
    for i in reported(boards, "boards at quality accurate", progress):
        try:
            measured = camera.measure(result.session.read(paths[i])).disparity_px[np.ix_(rows, columns)]
        except InputError:  # as a saturated board; the calibration itself does not depend on it
            continue
        residual = measured - depth_to_disparity(float(result.evidence.from_sensor_mm[i]), model)
        sigma[i] = pixel_sigma(residual[None])[0]
    return replace(result, pixel_sigma_px={**result.pixel_sigma_px, "accurate": sigma})
