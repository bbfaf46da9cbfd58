"""Figures of the calibration report about the fitted blur of the lens."""

from __future__ import annotations

import numpy as np
import scipy.fft
from matplotlib.figure import Figure

from chromaperture.calibration.calibrate_session import CalibrationResult
from chromaperture.depth.conversion import DepthModel, disparity_to_depth
from chromaperture.evaluation.figures import draw_boxes, new_figure, show_image, style_axes
from chromaperture.optics.lens_blur import LensBlur

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


def layer_errors(result: CalibrationResult) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Compute the depth error of the best layer of every cell on every board; None without a blur.

    Returns ``distance_mm`` (N,) float64, from the sensor; ``by_blur, by_curve`` (N, P) float64, per cent of the
    distance: by the fitted blur alone, and by the depth curve of quality accurate.
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
    """Draw `layer_errors` over distance."""
    found = layer_errors(result)
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
