"""Pictures of the calibration report about the fitted blur of the lens."""

from __future__ import annotations

import numpy as np
import scipy.fft
from matplotlib.figure import Figure

from chromaperture.calibration.calibrate_session import CalibrationResult
from chromaperture.depth.conversion import DepthModel, disparity_to_depth
from chromaperture.evaluation.figures import BLUE, GREY, new_figure, tidy
from chromaperture.optics.lens_blur import LensBlur

_PLACES = (0.02, 0.26, 0.5, 0.74, 0.98)  # over the width, and three of them over the height
_SHARE = 0.995  # of the light that a patch shows


def draw_blur(result: CalibrationResult) -> Figure | None:
    """Draw the point-spread functions over the frame, of the nearest and the farthest board; None without a blur."""
    blur = result.calibration.field_blur()
    if blur is None or result.layers is None:
        return None
    z = result.evidence.distances.from_pupil_mm[result.evidence.used]
    distances = (float(z.min()), float(z.max()))
    delta = result.evidence.distances.sensor_to_pupil_mm
    figure = new_figure(height=2.9)
    for axes, distance in zip(figure.subplots(1, 2), distances, strict=True):
        axes.imshow(_patches(blur, 1 / distance), interpolation="nearest")
        axes.set_title(f"{distance + delta:.0f} mm", fontsize=8, loc="left")
        axes.set_axis_off()
    return figure


def _patches(blur: LensBlur, inverse_mm: float) -> np.ndarray:
    """Colour picture of the PSFs at 5 x 3 places of the frame, each as bright as its peak."""
    at_infinity, scale = blur.model.infinity_px, blur.model.scale_px_mm
    radius = 1.5 * abs(at_infinity - scale * inverse_mm) + 4
    size = int(scipy.fft.next_fast_len(2 * int(np.ceil(radius)), real=True))
    rows = []
    for v in (_PLACES[0], _PLACES[2], _PLACES[-1]):
        row = []
        for u in _PLACES:
            transfer = blur.transfer(u * (blur.width_px - 1), v * (blur.height_px - 1), inverse_mm, size)
            psf = np.fft.fftshift(scipy.fft.irfft2(transfer, s=(size, size)), axes=(1, 2)).transpose(1, 2, 0)
            peak = np.quantile(psf.max(axis=2), _SHARE)
            row.append(np.pad(np.clip(psf / max(float(peak), 1e-9), 0, 1), ((1, 1), (1, 1), (0, 0)), constant_values=1))
        rows.append(np.concatenate(row, axis=1))
    return np.concatenate(rows, axis=0)


def layer_errors(result: CalibrationResult) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Tell by how much the best layer of every cell misses the board's distance.

    Returns
    -------
    distance_mm : (N,) float64, from the sensor
    by_blur, by_curve : (N, P) float64, per cent of the distance
        As the fitted blur alone would have it, and with the depth curve of quality accurate.
    """
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
    """Draw those errors over distance."""
    found = layer_errors(result)
    if found is None:
        return None
    mm, by_blur, by_curve = found
    figure = new_figure(height=2.8)
    for axes, errors, title in zip(
        figure.subplots(1, 2, sharey=True), (by_blur, by_curve), ("the blur alone", "with the depth curve"), strict=True
    ):
        low, first, median, third, high = np.nanpercentile(errors, (5, 25, 50, 75, 95), axis=1)
        axes.vlines(mm, low, high, color=GREY, linewidth=1)
        axes.vlines(mm, first, third, color=BLUE, linewidth=4)
        axes.plot(mm, median, ".", color="white", markersize=4, markeredgecolor=BLUE)
        axes.axhline(0, color=GREY, linewidth=0.8)
        axes.set_title(title, fontsize=8, loc="left")
        tidy(axes, xlabel="distance, mm")
    figure.axes[0].set_ylabel("error of depth, %")
    return figure


def blur_lines(result: CalibrationResult) -> tuple[str, ...]:
    """Say how much better the channels of the boards agree with the fitted blur."""
    layers = result.layers
    if layers is None:
        return ("Calibrated without the lens's blur: quality accurate matches shifted views.",)
    return (
        f"Each channel blurred as the other was: {100 * layers.disagreement:.1f} % of the power disagrees with the "
        f"fitted blur, {100 * layers.start_disagreement:.1f} % with that of a thin lens.",
    )
