"""Figures of the calibration report about its input: photographs, corners, film, ruler, covariance."""

from __future__ import annotations

import cv2
import numpy as np
from matplotlib.figure import Figure

from chromaperture.calibration.calibrate_session import CalibrationResult
from chromaperture.color.color_maps import DIFFERENCE, OTHER, color_map
from chromaperture.color.response import ResponseCurve
from chromaperture.color.srgb import linear_to_srgb, srgb_to_linear
from chromaperture.evaluation.figures import (
    BLUE,
    CHANNEL_COLORS,
    GREY,
    ORANGE,
    new_figure,
    ruler_distances,
    show_image,
    style_axes,
)
from chromaperture.evaluation.verdict import QUALITY

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
