"""Figure 8: a flat floor before and after the fields."""

from __future__ import annotations

import numpy as np

from chromaperture.calibration.calibrate_session import CalibrationResult
from chromaperture.camera.camera import CodedApertureCamera
from chromaperture.camera.method import default_config
from chromaperture.color.color_maps import DIFFERENCE, DISTANCE
from chromaperture.color.srgb import linear_to_srgb
from chromaperture.depth.conversion import disparity_to_inverse_depth
from chromaperture.evaluation.figures import draw_flat_board, flat_board, new_figure, plane_residual, show_image
from chromaperture.optics.simulator import textures
from chromaperture.optics.simulator.scene import Plane, plane
from chromaperture_paper.context import Context
from chromaperture_paper.exhibit import Chart, Comparison, Content

_CELLS = 10  # along each side of the grid of `bend`; chosen by hand
_WHY = "The paper shows pictures only; here as there one curve for all pixels bends what is flat."


def make(context: Context) -> Content:
    """Photograph a floor with an object on it; with real photographs, use the wall of a board."""
    result, source = context.calibrated()
    if context.data is not None:
        _, before, after = flat_board(result)
        ours = f"{before:.0f} and {after:.0f} mm"
        compared = Comparison("rms from a plane", "concave before, planar after", ours, _WHY)
        chart = Chart("flat", draw_flat_board(result), "A flat wall by one curve and by the fields.")
        return Content(source, [chart], (), [compared])
    shot = context.session_capture(floor_scene(), seed=8)
    maps = [depth_by(result, shot.image, fields=fields) for fields in (False, True)]
    bends = [bend(depth, shot.depth_mm) for depth in maps]
    figure = new_figure(height=4.4)
    panels = figure.subplots(2, 2)
    show_image(panels[0, 0], linear_to_srgb(np.clip(shot.image / 0.9, 0, 1)), "(a) capture")
    low, high = np.nanpercentile(shot.depth_mm, (1, 99))
    show_image(panels[0, 1], maps[1], "depth by the fields", bar="mm", colors=DISTANCE, vmin=low, vmax=high)
    for axes, depth, name, value in zip(panels[1], maps, ("(b) one curve", "(c) fields"), bends, strict=True):
        title = f"{name}: error, bend {value:.1%} of the depth"
        shown = show_image(axes, 100 * (depth / shot.depth_mm - 1), title, colors=DIFFERENCE, vmin=-15, vmax=15)
    figure.colorbar(shown, ax=list(panels[1]), fraction=0.02, label="error, %", extend="both")
    return Content(
        source=f"{source} The floor is photographed by the same simulated lens.",
        charts=[Chart("floor", figure, "A flat floor is white below; a curved one is red or blue at the rim.")],
        comparisons=[Comparison("the floor", "concave before, planar after",
                                f"bend of {bends[0]:.1%} before and {bends[1]:.1%} after, of the depth", _WHY)],
        lines=["Bend is the rms over the frame of the smoothed error, from which noise is averaged out."],
    )  # fmt: skip


def floor_scene() -> list[Plane]:
    """Build a floor that fills the picture, and a small upright object instead of the paper's rabbit."""
    grey = textures.noise((900, 1000), exponent=0.9, seed=80)
    floor = np.repeat(grey[..., None], 3, axis=2) * np.float32(1.1)
    upright = np.repeat(textures.noise((160, 120), exponent=0.8, seed=81)[..., None], 3, axis=2)
    return [
        plane(np.clip(floor, 0, 1), center_mm=(0, 0, 2100.0), width_mm=2200, tilt_deg=(-50.0, 0, 0)),
        plane(upright, center_mm=(60, -10, 1750.0), width_mm=180),
    ]


def depth_by(result: CalibrationResult, image: np.ndarray, *, fields: bool) -> np.ndarray:
    """Measure depth by the fields, or by the curve of the axis for all pixels; (H, W) float64, mm."""
    calibration = result.calibration
    frame = CodedApertureCamera(calibration, default_config(calibration, "real-time")).measure(image)
    if fields:
        return np.asarray(frame.depth_mm, float)
    axis = calibration.on_axis("real-time")
    inverse = disparity_to_inverse_depth(np.asarray(frame.disparity_px, float), axis)
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = np.where(inverse > 0, 1 / inverse, np.nan)
    return np.asarray(depth + float(np.asarray(axis.sensor_to_pupil_mm)))


def bend(depth_mm: np.ndarray, truth_mm: np.ndarray) -> float:
    """Return the rms over a grid of cells of the median relative error less its best plane: curvature, not tilt."""
    error = depth_mm / truth_mm - 1
    parts = [part for rows in np.array_split(error, _CELLS) for part in np.array_split(rows, _CELLS, axis=1)]
    medians = [np.nanmedian(part) if np.isfinite(part).mean() > 0.3 else np.nan for part in parts]
    return plane_residual(np.reshape(medians, (_CELLS, _CELLS)))[1]
