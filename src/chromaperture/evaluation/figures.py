"""Pictures of the calibration report about depth: the paper's Figures 6 to 9, residuals, reach."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from chromaperture.calibration.calibrate_session import CalibrationResult
from chromaperture.config import Quality, preset
from chromaperture.depth.conversion import disparity_to_depth
from chromaperture.evaluation.verdict import board_depth, board_errors, reach

BLUE, ORANGE, GREY, RED = "#2b6ca3", "#c8702a", "#777777", "#b03030"
_QUALITIES: tuple[tuple[Quality, str], ...] = (("real-time", BLUE), ("paper", ORANGE))


def new_figure(width: float = 8.0, height: float = 3.4) -> Figure:
    """Give an empty figure of the report's size, in inches."""
    return Figure(figsize=(width, height), dpi=110, layout="constrained", facecolor="white")


def tidy(axes: Axes, **labels: str) -> None:
    """Label a plot and take the ink off that says nothing."""
    axes.set(**labels)
    axes.grid(alpha=0.25, linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)


def rulers_of(result: CalibrationResult) -> np.ndarray:
    """Ruler distances of the boards; (boards,) float64, mm."""
    return np.array([board.ruler_mm for board in result.boards])


def draw_true_against_measured(result: CalibrationResult) -> Figure:
    """Draw Figure 6 of the paper: measured against true distance, and the difference below."""
    rulers = rulers_of(result)
    figure = new_figure(height=4.6)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(1.5, 1))
    line = np.array([rulers.min(), rulers.max()])
    above.plot(line, line, color=GREY, linewidth=0.8, label="perfect")
    below.axhline(0, color=GREY, linewidth=0.8)
    for share, alpha in ((0.02, 0.10), (0.01, 0.16)):
        below.fill_between(line, -share * line, share * line, color=GREY, alpha=alpha, linewidth=0,
                           label=f"±{share:.0%}")  # fmt: skip
    for (quality, color), marker in zip(_QUALITIES, "os", strict=True):
        residual = result.fits[quality].residual_mm
        above.plot(rulers, rulers + residual, marker, color=color, label=quality, markersize=5, alpha=0.8)
        below.plot(rulers, residual, marker, color=color, markersize=5, alpha=0.8)
    tidy(above, ylabel="measured, mm")
    above.legend(frameon=False)
    tidy(below, xlabel="true distance by ruler, mm", ylabel="measured - true, mm")
    below.legend(frameon=False, ncols=2, loc="upper left", fontsize=8)
    return figure


def draw_surfaces(result: CalibrationResult) -> Figure:
    """Draw Figure 7: the baseline and the in-focus distance over the frame."""
    calibration = result.calibration
    shape = (calibration.sensor.height_px, calibration.sensor.width_px)
    paper = calibration.paper_parameters(calibration.depth_model("paper"))
    figure = new_figure(height=3.0)
    maps = ((paper.baseline_mm, "baseline b, mm", "viridis"), (paper.in_focus_mm, "in focus at, mm", "cividis"))
    for axes, (values, name, colors) in zip(figure.subplots(1, 2), maps, strict=True):
        values = np.broadcast_to(np.asarray(values, float), shape)
        shown = axes.imshow(values, cmap=colors)
        if np.ptp(values) > 1e-9 * abs(float(values.mean())):
            lines = axes.contour(values, levels=6, colors="white", linewidths=0.6)
            axes.clabel(lines, fontsize=7, fmt="%.4g")
        figure.colorbar(shown, ax=axes, fraction=0.035, label=name)
        axes.set_axis_off()
    return figure


def plane_residual(depth_mm: np.ndarray) -> tuple[np.ndarray, float]:
    """Take the best plane off a depth map, robustly.

    Parameters
    ----------
    depth_mm : (h, w) float, NaN unknown

    Returns
    -------
    residual_mm : (h, w) float64
    rms_mm : float
        Of the residual within four robust standard deviations: single wrong pixels are the matcher's, not the field's.
    """
    y, x = np.mgrid[: depth_mm.shape[0], : depth_mm.shape[1]]
    known = np.isfinite(depth_mm)
    if known.sum() < 3:
        return np.full(depth_mm.shape, np.nan), np.nan
    basis = np.stack([np.ones(known.sum()), x[known], y[known]], axis=1)
    values, keep = depth_mm[known], np.ones(known.sum(), bool)
    residual: np.ndarray = np.zeros(known.sum())
    for _ in range(5):
        solution, *_ = np.linalg.lstsq(basis[keep], values[keep], rcond=None)
        residual = values - basis @ solution
        keep = np.abs(residual) <= 4 * 1.4826 * np.median(np.abs(residual)) + 1e-9
    out = np.full(depth_mm.shape, np.nan)
    out[known] = residual
    return out, float(np.sqrt(np.mean(residual[keep] ** 2)))


def flat_board(result: CalibrationResult, quality: Quality = "real-time") -> tuple[int, float, float]:
    """Give the board next to 1.25 times the focus and its plane-fit RMS before and after the fields, mm."""
    index = int(np.argmin(np.abs(rulers_of(result) - 1.25 * result.calibration.in_focus_mm)))
    before, after = (plane_residual(board_depth(result, index, quality, corrected=c))[1] for c in (False, True))
    return index, before, after


def draw_flat_board(result: CalibrationResult, quality: Quality = "real-time") -> Figure:
    """Draw Figure 8: what a flat board departs from a plane by, before and after the fields."""
    index, *_ = flat_board(result, quality)
    figure = new_figure(height=2.9)
    pictures = []
    for corrected in (False, True):
        pictures.append(plane_residual(board_depth(result, index, quality, corrected=corrected)))
    reach_mm = max(3 * pictures[0][1], 1e-6)
    panels = figure.subplots(1, 2)
    for axes, (values, rms), name in zip(panels, pictures, ("one curve", "field"), strict=True):
        shown = axes.imshow(values, cmap="RdBu_r", vmin=-reach_mm, vmax=reach_mm)
        axes.set_title(f"{name}: {rms:.0f} mm rms from a plane", fontsize=10, loc="left")
        axes.set_axis_off()
    figure.colorbar(shown, ax=list(panels), fraction=0.025, label="from the plane, mm", extend="both")
    return figure


def layer_errors(result: CalibrationResult, quality: Quality = "paper") -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Median error of single pixels with whole-px layers, with the matcher's layers, and below layers; mm each."""
    axis = result.calibration.on_axis(quality)
    out = []
    for step in (1.0, preset(quality).layers.step_px, 0.0):
        errors = []
        for board in result.boards:
            rows, columns = (slice(n // 3, n - n // 3) for n in board.grid_px[quality].shape)
            disparity = np.asarray(board.grid_px[quality][rows, columns], float)
            layered = np.round(disparity / step) * step if step else disparity
            depth = disparity_to_depth(layered, axis)[0]
            known = np.isfinite(depth)
            errors.append(float(np.median(np.abs(depth[known] - board.ruler_mm))) if known.any() else np.nan)
        out.append(np.array(errors))
    return out[0], out[1], out[2]


def draw_layers(result: CalibrationResult) -> Figure:
    """Draw Figure 9: error with whole layers against sub-pixel estimation."""
    rulers = rulers_of(result)
    order = np.argsort(rulers)
    figure = new_figure()
    axes = figure.subplots()
    names = ("layers of 1 px", f"layers of {preset('paper').layers.step_px:g} px", "sub-pixel")
    for values, name, color in zip(layer_errors(result), names, (RED, ORANGE, BLUE), strict=True):
        axes.plot(rulers[order], values[order], "o-", color=color, label=name, markersize=4)
    axes.set_yscale("log")
    tidy(axes, xlabel="true distance by ruler, mm", ylabel="median error of a pixel, mm")
    axes.legend(frameon=False)
    return figure


def draw_reach(result: CalibrationResult) -> Figure:
    """Draw the error bar of a pixel and of the calibration alone over the working range, in per cent of the depth."""
    seen = reach(result)
    figure = new_figure()
    axes = figure.subplots()
    axes.plot(seen.depth_mm, 100 * seen.pixel_sigma_mm / seen.depth_mm, color=BLUE, label="one pixel")
    axes.plot(seen.depth_mm, 100 * seen.curve_sigma_mm / seen.depth_mm, color=ORANGE, label="the calibration alone")
    axes.plot(seen.depth_mm, 100 * np.abs(seen.bias_mm) / seen.depth_mm, color=GREY, linewidth=1,
              label="error of the boards' medians")  # fmt: skip
    for share in (1, 2):
        axes.axhline(share, color=GREY, linewidth=0.8, linestyle=":")
    tidy(axes, xlabel="distance from the sensor plane, mm", ylabel="standard deviation, % of distance")
    axes.set_ylim(bottom=0)
    axes.legend(frameon=False)
    return figure


def draw_residuals(result: CalibrationResult, quality: Quality = "real-time") -> Figure:
    """Draw the residuals of every board over the whole frame: median, quartiles and 5 to 95 %, in px and per cent."""
    figure = new_figure()
    left, right = figure.subplots(1, 2)
    places = np.arange(len(result.boards))
    names = [f"{board.ruler_mm:.0f}" for board in result.boards]
    residuals = np.asarray(result.residual_px[quality], float).reshape(len(places), -1)
    for place, values in zip(places, residuals, strict=True):
        known = values[np.isfinite(values)]
        if known.size:
            p = np.percentile(known, (5, 25, 50, 75, 95))
            left.plot([place, place], p[[0, 4]], color=BLUE, linewidth=1)
            left.plot([place, place], p[[1, 3]], color=BLUE, linewidth=5, alpha=0.5, solid_capstyle="butt")
            left.plot(place, p[2], "o", color=BLUE, markersize=4)
    errors = 100 * board_errors(result, quality) / rulers_of(result)
    right.bar(places, errors, color=[RED if board.name in result.outliers else BLUE for board in result.boards])
    for axes, label in ((left, "residual, px"), (right, "median error, % of distance")):
        axes.axhline(0, color=GREY, linewidth=0.8)
        every = -(-len(places) // 8)  # more names run into each other
        axes.set_xticks(places[::every], names[::every], fontsize=8)
        tidy(axes, xlabel="board at, mm", ylabel=label)
    return figure
