"""Figure 8: a flat floor before and after the fields."""

from __future__ import annotations

import numpy as np

from chromaperture.calibration.calibrate_session import CalibrationResult
from chromaperture.camera import CodedApertureCamera
from chromaperture.camera_file import Calibration
from chromaperture.camera_matching import default_config
from chromaperture.color.srgb import linear_to_srgb
from chromaperture.depth.conversion import disparity_to_inverse_depth
from chromaperture.evaluation.figures import draw_flat_board, flat_board, new_figure, plane_residual
from chromaperture.evaluation.paper import world
from chromaperture.evaluation.paper.context import Context
from chromaperture.evaluation.paper.exhibit import Compared, Drawn, Made
from chromaperture.optics.scene import Plane

_WHY = "The paper shows pictures only; here as there one curve for all pixels bends what is flat."


def make(context: Context) -> Made:
    """Photograph a floor with a thing on it, or take the flattest evidence of real photographs: a board's wall."""
    result, source = context.calibrated()
    if context.data is not None:
        _, before, after = flat_board(result)
        figure = draw_flat_board(result)
        compared = Compared(
            "rms from a plane", "concave before, planar after", f"{before:.0f} and {after:.0f} mm", _WHY
        )
        return Made(source, [Drawn("flat", figure, "A flat wall by one curve and by the fields.")], (), [compared])
    camera = context.session_camera
    table = world.traced_table(camera, world.real_film("cy_halves"), context.cells)
    shot = world.photograph(table, floor_scene(), camera, seed=8, exposure=world.level_exposure("cy_halves"))
    maps = [depth_by(result, shot.image, fields=fields) for fields in (False, True)]
    bends = [bend(depth, shot.depth_mm) for depth in maps]
    figure = new_figure(height=4.4)
    panels = figure.subplots(2, 2)
    panels[0, 0].imshow(linear_to_srgb(np.clip(shot.image / 0.9, 0, 1)))
    panels[0, 0].set_title("(a) capture", fontsize=9, loc="left")
    low, high = np.nanpercentile(shot.depth_mm, (1, 99))
    shown = panels[0, 1].imshow(maps[1], cmap="viridis", vmin=low, vmax=high)
    panels[0, 1].set_title("depth by the fields", fontsize=9, loc="left")
    figure.colorbar(shown, ax=panels[0, 1], fraction=0.03, label="mm")
    for axes, depth, name, value in zip(panels[1], maps, ("(b) one curve", "(c) fields"), bends, strict=True):
        shown = axes.imshow(100 * (depth / shot.depth_mm - 1), cmap="RdBu_r", vmin=-15, vmax=15)
        axes.set_title(f"{name}: error, bend {value:.1%} of the depth", fontsize=9, loc="left")
    figure.colorbar(shown, ax=list(panels[1]), fraction=0.02, label="error, %", extend="both")
    for axes in panels.ravel():
        axes.set_axis_off()
    return Made(
        source=f"{source} The floor is photographed by the same simulated lens.",
        drawn=[Drawn("floor", figure, "A flat floor is white below; one that bends is red or blue at the rim.")],
        compared=[Compared("the floor", "concave before, planar after",
                           f"bend of {bends[0]:.1%} before and {bends[1]:.1%} after, of the depth", _WHY)],
        lines=["Bend is the rms over the frame of the error's blurred course: what is left after averaging out noise."],
    )  # fmt: skip


def floor_scene() -> list[Plane]:
    """Build a floor that fills the picture, and a small upright thing in the place of the paper's rabbit."""
    from chromaperture.optics import textures
    from chromaperture.optics.scene import plane

    grey = textures.noise((900, 1000), exponent=0.9, seed=80)
    floor = np.repeat(grey[..., None], 3, axis=2) * np.float32(1.1)
    thing = np.repeat(textures.noise((160, 120), exponent=0.8, seed=81)[..., None], 3, axis=2)
    return [
        plane(np.clip(floor, 0, 1), center_mm=(0, 0, 2100.0), width_mm=2200, tilt_deg=(-50.0, 0, 0)),
        plane(thing, center_mm=(60, -10, 1750.0), width_mm=180),
    ]


def depth_by(result: CalibrationResult, image: np.ndarray, *, fields: bool) -> np.ndarray:
    """Depth by the fields, or by the one curve of the axis for all pixels; (H, W) float64, mm."""
    calibration = result.calibration
    camera = CodedApertureCamera(calibration, default_config(calibration, "real-time"))
    frame = camera.measure(image)
    if fields:
        return np.asarray(frame.depth_mm, float)
    return _one_curve(calibration, np.asarray(frame.disparity_px, float))


def _one_curve(calibration: Calibration, disparity: np.ndarray) -> np.ndarray:
    axis = calibration.on_axis("real-time")
    inverse = disparity_to_inverse_depth(disparity, axis)
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = np.where(inverse > 0, 1 / inverse, np.nan)
    return np.asarray(depth + float(np.asarray(axis.sensor_to_pupil_mm)))


def bend(depth_mm: np.ndarray, truth_mm: np.ndarray, *, cells: int = 10) -> float:
    """Rms over a grid of cells of the median relative error, its mean plane taken off: the bend, not the tilt."""
    error = depth_mm / truth_mm - 1
    rows, columns = (np.array_split(np.arange(n), cells) for n in error.shape)
    medians = np.full((cells, cells), np.nan)
    for i, r in enumerate(rows):
        for j, c in enumerate(columns):
            cell = error[r[0] : r[-1] + 1, c[0] : c[-1] + 1]
            if np.isfinite(cell).mean() > 0.3:
                medians[i, j] = np.nanmedian(cell)
    return plane_residual(medians)[1]
