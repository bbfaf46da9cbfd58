"""Figures of the calibration report: its input, depth (the paper's Figures 6 to 9, accuracy), blur."""

from __future__ import annotations

from typing import Any, Literal

import cv2
import numpy as np
import scipy.fft
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from chromaperture.calibration.calibrate_session import CalibrationResult
from chromaperture.color.color_maps import DIFFERENCE, DISTANCE, OTHER, color_map
from chromaperture.color.encoding import ResponseCurve
from chromaperture.color.srgb import linear_to_srgb, srgb_to_linear
from chromaperture.depth.conversion import DepthModel, disparity_to_depth
from chromaperture.evaluation.verdict import QUALITY, board_depth, board_errors, depth_accuracy, qualities
from chromaperture.optics.lens_blur import LensBlur
from chromaperture.settings.methods import Quality, preset
from chromaperture.system.robust import robust_sigma

BLUE, ORANGE, GREY, RED, GREEN = "#2b6ca3", "#c8702a", "#777777", "#b03030", "#3c8c50"
CHANNEL_COLORS = {"R": "#c83c3c", "G": "#3c9c50", "B": "#3c5cc8"}
_QUALITIES: tuple[tuple[Quality, str, str], ...] = (
    ("real-time", BLUE, "o"),
    ("paper", ORANGE, "s"),
    ("accurate", GREEN, "^"),
)
_OUTLIER_SIGMAS = 4.0  # residuals beyond are matching errors, not errors of the field; chosen by hand
_ROUNDS = 5  # fits, each without the outliers of the one before; chosen by hand
_SHOWN_BOARD = 1.25  # in-focus distances: beyond the focus, where depth changes much per px; chosen by hand


def new_figure(width: float = 8.0, height: float = 3.4) -> Figure:
    """Return an empty figure; width and height in inches."""
    return Figure(figsize=(width, height), dpi=110, layout="constrained", facecolor="white")


def style_axes(axes: Axes, **labels: str) -> None:
    """Label a plot, add a light grid, remove the upper and the right border."""
    axes.set(**labels)
    axes.grid(alpha=0.25, linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)


def plain_log_scale(axes: Axes, *names: Literal["x", "y"]) -> None:
    """Make axes logarithmic, y by default, with ticks as people write them: 0.5, 1, 2, 5, 10, not 5 x 10^-1."""
    for name in names or ("y",):
        getattr(axes, f"set_{name}scale")("log")
        axis = getattr(axes, f"{name}axis")
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.12g}"))
        axis.set_minor_locator(NullLocator())


def show_image(
    axes: Axes,
    image: np.ndarray,
    title: str = "",
    *,
    size: int = 9,
    bar: str | None = None,
    colors: str | None = None,
    **options: Any,
) -> AxesImage:
    """Show a map or picture without ticks; ``bar`` labels a colour bar, ``options`` are of imshow."""
    shown = axes.imshow(image, cmap=None if colors is None else color_map(colors), **options)
    axes.set_title(title, fontsize=size, loc="left")
    axes.set_axis_off()
    if bar is not None:
        axes.figure.colorbar(shown, ax=axes, fraction=0.035, label=bar)
    return shown


def ruler_distances(result: CalibrationResult) -> np.ndarray:
    """Return the boards' ruler distances; (boards,) float64, mm."""
    return np.array([board.ruler_mm for board in result.boards])


def draw_true_against_measured(result: CalibrationResult) -> Figure:
    """Draw Figure 6 of the paper: measured against true distance, and the difference below."""
    rulers = ruler_distances(result)
    figure = new_figure(height=4.6)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(1.5, 1))
    line = np.array([rulers.min(), rulers.max()])
    above.plot(line, line, color=GREY, linewidth=0.8, label="perfect")
    below.axhline(0, color=GREY, linewidth=0.8)
    for fraction, alpha in ((0.02, 0.10), (0.01, 0.16)):
        band = fraction * line
        below.fill_between(line, -band, band, color=GREY, alpha=alpha, linewidth=0, label=f"±{fraction:.0%}")
    for quality, color, marker in _QUALITIES:
        residual = board_errors(result, quality) if quality == "accurate" else result.fits[quality].residual_mm
        if not np.isfinite(residual).any():
            continue  # accurate has no curve of its own without the lens's blur
        above.plot(rulers, rulers + residual, marker, color=color, label=quality, markersize=5, alpha=0.8)
        below.plot(rulers, residual, marker, color=color, markersize=5, alpha=0.8)
    style_axes(above, ylabel="measured, mm")
    above.legend(frameon=False)
    style_axes(below, xlabel="true distance by ruler, mm", ylabel="measured - true, mm")
    below.legend(frameon=False, ncols=2, loc="upper left", fontsize=8)
    return figure


def baseline_map(result: CalibrationResult) -> np.ndarray:
    """Return the equivalent baseline b = 2 μ B / F; (H, W) float64 or a scalar, mm."""
    calibration = result.calibration
    scale = np.asarray(calibration.depth_model("paper").scale_px_mm, float)
    return np.asarray(2 * calibration.sensor.pixel_pitch_mm * scale / calibration.image_distance_mm)


def draw_surfaces(result: CalibrationResult) -> Figure:
    """Draw Figure 7: the baseline and the in-focus distance over the frame."""
    calibration = result.calibration
    shape = (calibration.sensor.height_px, calibration.sensor.width_px)
    in_focus = calibration.depth_model("paper").in_focus_mm
    figure = new_figure(height=3.0)
    maps = ((baseline_map(result), "baseline b, mm", OTHER), (in_focus, "in focus at, mm", DISTANCE))
    for axes, (values, name, colors) in zip(figure.subplots(1, 2), maps, strict=True):
        values = np.broadcast_to(np.asarray(values, float), shape)
        if np.ptp(values) > 1e-9 * abs(float(values.mean())):  # contours of a constant map raise a warning
            lines = axes.contour(values, levels=6, colors="white", linewidths=0.6)
            axes.clabel(lines, fontsize=7, fmt="%.4g")
        show_image(axes, values, bar=name, colors=colors)
    return figure


def plane_residual(depth_mm: np.ndarray) -> tuple[np.ndarray, float]:
    """Subtract the best plane from a depth map; returns the rest and its rms within four robust deviations."""
    y, x = np.mgrid[: depth_mm.shape[0], : depth_mm.shape[1]]
    known = np.isfinite(depth_mm)
    out = np.full(depth_mm.shape, np.nan)
    if known.sum() < 3:
        return out, np.nan
    basis = np.stack([np.ones(known.sum()), x[known], y[known]], axis=1)
    values, keep = depth_mm[known], np.ones(known.sum(), bool)
    residual = values
    for _ in range(_ROUNDS):
        solution, *_ = np.linalg.lstsq(basis[keep], values[keep], rcond=None)
        residual = values - basis @ solution
        keep = np.abs(residual) <= _OUTLIER_SIGMAS * robust_sigma(residual) + 1e-9  # mm; all of an exact plane
    out[known] = residual
    return out, float(np.sqrt(np.mean(residual[keep] ** 2)))


def flat_board(result: CalibrationResult) -> tuple[int, float, float]:
    """Return the board nearest to 1.25 in-focus distances and its plane-fit RMS before and after the fields, mm."""
    index = int(np.argmin(np.abs(ruler_distances(result) - _SHOWN_BOARD * result.calibration.in_focus_mm)))
    before, after = (plane_residual(board_depth(result, index, corrected=c))[1] for c in (False, True))
    return index, before, after


def draw_flat_board(result: CalibrationResult) -> Figure:
    """Draw Figure 8: deviation of a flat board from a plane, before and after the fields."""
    index, before, _ = flat_board(result)
    figure = new_figure(height=2.9)
    limit_mm = max(3 * before, 1e-6)
    panels = figure.subplots(1, 2)
    for axes, corrected, name in zip(panels, (False, True), ("one curve", "field"), strict=True):
        values, rms = plane_residual(board_depth(result, index, corrected=corrected))
        title = f"{name}: {rms:.0f} mm rms from a plane"
        shown = show_image(axes, values, title, size=10, colors=DIFFERENCE, vmin=-limit_mm, vmax=limit_mm)
    figure.colorbar(shown, ax=list(panels), fraction=0.025, label="from the plane, mm", extend="both")
    return figure


def layer_errors(result: CalibrationResult) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return each board's median error of a pixel with whole-px layers, the matcher's layers, and sub-pixel; mm."""
    axis = result.calibration.on_axis("paper")
    out = []
    for step in (1.0, preset("paper").layers.step_px, 0.0):
        errors = []
        for board in result.boards:
            rows, columns = (slice(n // 3, n - n // 3) for n in board.grid_px["paper"].shape)
            disparity = np.asarray(board.grid_px["paper"][rows, columns], float)
            layered = np.round(disparity / step) * step if step else disparity
            depth = disparity_to_depth(layered, axis)[0]
            known = np.isfinite(depth)
            errors.append(float(np.median(np.abs(depth[known] - board.ruler_mm))) if known.any() else np.nan)
        out.append(np.array(errors))
    return out[0], out[1], out[2]


def draw_layers(result: CalibrationResult) -> Figure:
    """Draw Figure 9: error with whole layers against sub-pixel estimation."""
    rulers = ruler_distances(result)
    order = np.argsort(rulers)
    figure = new_figure()
    axes = figure.subplots()
    names = ("layers of 1 px", f"layers of {preset('paper').layers.step_px:g} px", "sub-pixel")
    for values, name, color in zip(layer_errors(result), names, (RED, ORANGE, BLUE), strict=True):
        axes.plot(rulers[order], values[order], "o-", color=color, label=name, markersize=4)
    plain_log_scale(axes)
    style_axes(axes, xlabel="true distance by ruler, mm", ylabel="median error of a pixel, mm")
    axes.legend(frameon=False)
    return figure


def draw_accuracy(result: CalibrationResult) -> Figure:
    """Draw the standard deviation of a pixel and of the calibration alone over the working range, % of depth."""
    shown = qualities(result)
    figure = new_figure()
    panels = figure.subplots(1, len(shown), sharey=True, squeeze=False)[0]
    rulers = ruler_distances(result)
    for axes, quality in zip(panels, shown, strict=True):
        found = depth_accuracy(result, quality)
        for values, color, name in (
            (found.pixel_sigma_mm, BLUE, "one pixel"),
            (found.curve_sigma_mm, ORANGE, "the calibration alone"),
            (np.abs(found.bias_mm), GREY, "error of the boards' medians"),
        ):
            if np.isfinite(values).any():
                axes.plot(found.depth_mm, 100 * values / found.depth_mm, color=color, label=name)
        for percent in (1, 2):
            axes.axhline(percent, color=GREY, linewidth=0.8, linestyle=":")
        for first, last in ((found.depth_mm[0], rulers.min()), (rulers.max(), found.depth_mm[-1])):
            axes.axvspan(first, max(first, last), color=GREY, alpha=0.15, linewidth=0)
        style_axes(axes, xlabel="distance from the sensor plane, mm")
        axes.set_title(f"quality {quality}", fontsize=9, loc="left")
    panels[0].set(ylabel="standard deviation, % of distance", ylim=(0, None))
    panels[0].legend(frameon=False, fontsize=8)
    return figure


def draw_residuals(result: CalibrationResult) -> Figure:
    """Draw the residuals of every board over the whole frame: median, quartiles and 5 to 95 %, in px and per cent."""
    figure = new_figure()
    left, right = figure.subplots(1, 2)
    numbers = np.arange(len(result.boards))
    names = [f"{board.ruler_mm:.0f}" for board in result.boards]
    residuals = np.asarray(result.residual_px[QUALITY], float).reshape(len(numbers), -1)
    measured = np.isfinite(residuals).any(axis=1)
    draw_boxes(left, numbers[measured], residuals[measured])
    errors = 100 * board_errors(result) / ruler_distances(result)
    colors = [RED if board.name in result.outliers else BLUE for board in result.boards]
    right.bar(numbers, errors, color=colors, label=QUALITY)
    by_blur = 100 * board_errors(result, "accurate") / ruler_distances(result)
    if np.isfinite(by_blur).any():
        right.plot(numbers, by_blur, "^", color=GREEN, markersize=4, label="accurate")
        right.legend(frameon=False, fontsize=8)
    right.axhline(0, color=GREY, linewidth=0.8)
    for axes, label in ((left, "residual, px"), (right, "median error, % of distance")):
        every = -(-len(numbers) // 8)  # more labels overlap
        axes.set_xticks(numbers[::every], names[::every], fontsize=8)
        style_axes(axes, xlabel="board at, mm", ylabel=label)
    return figure


def draw_boxes(axes: Axes, x: np.ndarray, values: np.ndarray) -> None:
    """Draw median, quartiles and 5 to 95 % of each row of values (N, P), over x (N,)."""
    low, first, median, third, high = np.nanpercentile(values, (5, 25, 50, 75, 95), axis=1)
    axes.vlines(x, low, high, color=GREY, linewidth=1)
    axes.vlines(x, first, third, color=BLUE, linewidth=4)
    axes.plot(x, median, ".", color="white", markersize=4, markeredgecolor=BLUE)
    axes.axhline(0, color=GREY, linewidth=0.8)


_THUMB_PX = 360  # largest width of a shown photograph
_THUMBS = 8  # boards shown at most, and four tilted ones


def draw_corners(result: CalibrationResult) -> Figure:
    """Draw photographs of boards, near to far, then tilted ones, with the corners found."""
    session = result.session
    found = {board.name: board.corners_px for board in result.boards}
    boards = sorted(session.boards, key=lambda path: session.boards[path])
    chosen = np.unique(np.linspace(0, len(boards) - 1, min(_THUMBS, len(boards))).round().astype(int))
    shown = [(boards[i], found.get(boards[i].name), f"{session.boards[boards[i]]:.0f} mm") for i in chosen]
    shown += [(path, result.tilts.get(path.name), f"tilt {path.stem}") for path in session.tilts[:4]]
    columns = min(4, len(shown))
    rows = -(-len(shown) // columns)
    ratio = session.sensor.height_px / session.sensor.width_px
    figure = new_figure(height=rows * (8.0 / columns * ratio + 0.25))
    panels = np.atleast_1d(figure.subplots(rows, columns, squeeze=False)).ravel()
    for axes in panels:
        axes.set_axis_off()
    for axes, (path, corners, title) in zip(panels, shown, strict=False):
        image = session.read(path)
        scale = min(1.0, _THUMB_PX / image.shape[1])
        small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        title = title if corners is not None else f"{title}: no corners"
        show_image(axes, linear_to_srgb(small / max(float(np.percentile(small, 99.5)), 1e-6)), title, size=8)
        if corners is not None:
            x, y = ((corners + 0.5) * scale - 0.5).T
            axes.plot(x, y, ".", color="#ff2050", markersize=1.5)
    return figure


def white_sheets(result: CalibrationResult) -> dict[str, np.ndarray]:
    """Read and smooth the white sheets through the open pupil and through the aperture, as far as they exist."""
    session = result.session
    return {
        name: cv2.GaussianBlur(session.read(session.sheets[name]), (0, 0), session.sensor.width_px / 90)
        for name in ("open", session.design)
        if name in session.sheets
    }


def draw_transparency(result: CalibrationResult) -> Figure | None:
    """Draw vignetting (the open sheet of Eq. 11) and the aperture's transparency by channel; None without sheets."""
    sheets = white_sheets(result)
    if not sheets:
        return None
    opened, coded = sheets.get("open"), sheets.get(result.session.design)
    panels: list[tuple[str, np.ndarray]] = []
    if opened is not None:
        panels.append(("open pupil, green / middle", opened[..., 1] / _middle(opened[..., 1])))
    if coded is not None:
        for channel, name in enumerate(("red", "green", "blue")):
            if opened is not None:
                panels.append((f"{name} let through", coded[..., channel] / np.maximum(opened[..., channel], 1e-4)))
            else:
                panels.append((f"{name} / middle", coded[..., channel] / _middle(coded[..., channel])))
    figure = new_figure(height=2.0)
    for axes, (name, values) in zip(figure.subplots(1, len(panels), squeeze=False).ravel(), panels, strict=True):
        # At least +-15 % of range, so that an even sheet looks even.
        center = _middle(values)
        low, high = min(float(values.min()), 0.85 * center), max(float(values.max()), 1.15 * center)
        show_image(axes, values, name, size=8, bar="", colors=OTHER, vmin=low, vmax=high)
    return figure


def _middle(plane: np.ndarray) -> float:
    rows, columns = (slice(n * 2 // 5, n * 3 // 5) for n in plane.shape)
    return max(float(plane[rows, columns].mean()), 1e-6)


def draw_film(result: CalibrationResult) -> Figure:
    """Draw the transmission of each piece of film and of the aperture in R, G, B."""
    film = result.calibration.film
    rows = {**film.transmissions(), "aperture": film.aperture / film.clear}
    figure = new_figure(height=2.4)
    axes = figure.subplots()
    width = 0.25
    for channel, (name, color) in enumerate(CHANNEL_COLORS.items()):
        heights = [float(row[channel]) for row in rows.values()]
        bars = axes.bar(np.arange(len(rows)) + (channel - 1) * width, heights, width, color=color, label=name)
        axes.bar_label(bars, fmt="%.2f", fontsize=7)
    axes.set_xticks(range(len(rows)), list(rows))
    style_axes(axes, ylabel="transmission")
    axes.legend(frameon=False, ncols=3, loc="upper right", bbox_to_anchor=(1, 1.2))
    return figure


def draw_ruler(result: CalibrationResult) -> Figure | None:
    """Draw ruler minus pose over distance; None without poses."""
    if not np.isfinite(result.ruler_residual_mm).any():
        return None
    figure = new_figure(height=2.6)
    axes = figure.subplots()
    error = result.session.ruler_error_mm
    axes.axhspan(-error, error, color=GREY, alpha=0.15, label=f"error limit of the ruler, ±{error:g} mm")
    colors = [ORANGE if board.name in result.outliers else BLUE for board in result.boards]
    axes.scatter(ruler_distances(result), result.ruler_residual_mm, c=colors, s=22, zorder=3)
    axes.axhline(0, color=GREY, linewidth=0.8)
    style_axes(axes, xlabel="distance by ruler, mm", ylabel="ruler - pose, mm")
    axes.legend(frameon=False, fontsize=8)
    return figure


def draw_response(result: CalibrationResult) -> Figure | None:
    """Draw the light of decoded values and its local exponents; None where values are light."""
    exponents = result.calibration.sensor.response
    if exponents is None:
        return None
    curve, codes = ResponseCurve(exponents), np.linspace(0, 1, 256)
    values = srgb_to_linear(codes)
    figure = new_figure(height=2.8)
    of_light, of_powers = figure.subplots(1, 2)
    of_light.plot(codes, codes, color=GREY, linewidth=0.8, label="decoded values")
    of_light.plot(codes, linear_to_srgb(curve.light(values)), color=BLUE, label="light")
    style_axes(of_light, xlabel="value, as sRGB code", ylabel="as sRGB code")
    of_light.legend(frameon=False, fontsize=8)
    of_powers.axhline(1, color=GREY, linewidth=0.8)
    of_powers.plot(codes, curve.exponent(values), color=BLUE)
    style_axes(of_powers, xlabel="value, as sRGB code", ylabel="power by which light grows")
    return figure


def draw_correlation(result: CalibrationResult) -> Figure:
    """Draw the correlation of the three parameters of the curve."""
    covariance = np.asarray(result.fits[QUALITY].model.covariance)
    sigma = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    values = covariance / np.outer(sigma, sigma)
    names = ("A", "B", "δ")
    figure = new_figure(width=4.4, height=2.8)
    axes = figure.subplots()
    shown = axes.imshow(values, cmap=color_map(DIFFERENCE), vmin=-1, vmax=1)
    for (i, j), value in np.ndenumerate(values):
        color = "white" if abs(value) > 0.6 else "black"
        axes.text(j, i, f"{value:+.2f}", ha="center", va="center", color=color)
    axes.set_xticks(range(3), names)
    axes.set_yticks(range(3), names)
    figure.colorbar(shown, ax=axes, label="correlation")
    return figure


_POSITIONS = (0.02, 0.26, 0.5, 0.74, 0.98)  # shown image positions: fractions of the width; three of them vertically
_PEAK_QUANTILE = 0.995  # of a patch's brightest channel, shown as white: single samples may be brighter


def draw_blur(result: CalibrationResult) -> Figure | None:
    """Draw the point-spread functions over the frame, of the nearest and the farthest board; None without a blur."""
    blur = result.calibration.field_blur()
    if blur is None or result.layers is None:
        return None
    z = result.evidence.distances.from_pupil_mm[result.evidence.used]
    delta = result.evidence.distances.sensor_to_pupil_mm
    figure = new_figure(height=2.9)
    for axes, distance in zip(figure.subplots(1, 2), (float(z.min()), float(z.max())), strict=True):
        title = f"{distance + delta:.0f} mm"
        show_image(axes, _patches(blur, 1 / distance), title, size=8, interpolation="nearest")
    return figure


def _patches(blur: LensBlur, inverse_mm: float) -> np.ndarray:
    """Render the PSFs at 5 x 3 image positions, each normalised to its peak; (H, W, 3) float64."""
    at_infinity, scale = blur.model.infinity_px, blur.model.scale_px_mm
    radius = 1.5 * abs(at_infinity - scale * inverse_mm) + 4
    size = int(scipy.fft.next_fast_len(2 * int(np.ceil(radius)), real=True))
    rows = []
    for v in (_POSITIONS[0], _POSITIONS[2], _POSITIONS[-1]):
        row = []
        for u in _POSITIONS:
            transfer = blur.transfer(u * (blur.width_px - 1), v * (blur.height_px - 1), inverse_mm, size)
            psf = np.fft.fftshift(scipy.fft.irfft2(transfer, s=(size, size)), axes=(1, 2)).transpose(1, 2, 0)
            peak = np.quantile(psf.max(axis=2), _PEAK_QUANTILE)
            row.append(np.pad(np.clip(psf / max(float(peak), 1e-9), 0, 1), ((1, 1), (1, 1), (0, 0)), constant_values=1))
        rows.append(np.concatenate(row, axis=1))
    return np.concatenate(rows, axis=0)


def blur_layer_errors(result: CalibrationResult) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Return distances (N,) and per-cent depth errors (N, P) by the blur alone and by the curve; or None."""
    layers, blur = result.layers, result.calibration.field_blur()
    if layers is None or blur is None:
        return None
    measured = np.flatnonzero(np.isfinite(layers.layer_px).any(axis=1))
    found, from_sensor = layers.layer_px[measured], result.evidence.from_sensor_mm[measured]
    delta = result.evidence.distances.sensor_to_pupil_mm
    curve = result.calibration.depth["accurate"].at(layers.x_px, layers.y_px, *layers.size_px)
    by_blur, by_curve = (
        100 * (np.stack([disparity_to_depth(row, model)[0] for row in found]) / from_sensor[:, None] - 1)
        for model in (DepthModel(*blur.reference, delta), curve)
    )
    return from_sensor, by_blur, by_curve


def draw_layers_of_blur(result: CalibrationResult) -> Figure | None:
    """Draw `blur_layer_errors` over distance."""
    found = blur_layer_errors(result)
    if found is None:
        return None
    mm, *both = found
    figure = new_figure(height=2.8)
    titles = ("the blur alone", "with the depth curve")
    for axes, errors, title in zip(figure.subplots(1, 2, sharey=True), both, titles, strict=True):
        draw_boxes(axes, mm, errors)
        axes.set_title(title, fontsize=8, loc="left")
        style_axes(axes, xlabel="distance, mm")
    figure.axes[0].set_ylabel("error of depth, %")
    return figure


def blur_lines(result: CalibrationResult) -> tuple[str, ...]:
    """State how well the channels of the boards agree with the fitted blur."""
    layers = result.layers
    if layers is None:
        return ("Calibrated without the lens's blur: quality accurate matches shifted views.",)
    return (
        f"Each channel blurred as the other was: {100 * layers.disagreement:.1f} % of the power disagrees with the "
        f"fitted blur, {100 * layers.start_disagreement:.1f} % with that of a thin lens.",
    )
