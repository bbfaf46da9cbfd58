"""Figure 12: scenes through a reflex camera's lens, and tiny things through a telephone's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from chromaperture.color.srgb import linear_to_srgb
from chromaperture.evaluation.figures import new_figure
from chromaperture.evaluation.paper import methods, world
from chromaperture.evaluation.paper.context import Context
from chromaperture.evaluation.paper.exhibit import Compared, Drawn, Made
from chromaperture.optics.paraxial import focused_at
from chromaperture.optics.pinhole import PupilCamera, pupil_camera
from chromaperture.optics.prescription import load_lens
from chromaperture.optics.scene import Plane, plane

_DESIGN = "cy_halves"
_PHONE_FOCUS_MM, _PHONE_SENSOR_MM = 60.0, 4.6


def make(context: Context) -> Made:
    """Photograph a still life with the one camera and a step of small cards with the other."""
    reflex = world.camera_of(*context.scene_size)
    phone = phone_camera(*context.scene_size)
    exposure = world.level_exposure(_DESIGN)
    figure = new_figure(height=4.4)
    panels = figure.subplots(2, 3)
    errors = []
    for line, camera, planes, name in (
        (panels[0], reflex, world.still_life(seed=12, saturation=0.6), "50 mm f/2"),
        (panels[1], phone, cards(phone), "telephone"),
    ):
        table = world.pinhole_table(camera, _DESIGN, context.cells)
        shot = world.photograph(table, planes, camera, seed=12, exposure=exposure)
        found = methods.our_disparity(
            shot.image, replace(methods.setting_of(_DESIGN, camera), span_px=span(shot.radius_px)), quality="real-time"
        )
        disparity = np.asarray(found.value_px, float)
        # Leaks of the film make the reading a share of the geometric disparity: one number, fitted to the truth.
        known = np.isfinite(disparity) & np.isfinite(shot.radius_px)
        gain = float(np.median(disparity[known] * shot.radius_px[known]) / np.median(shot.radius_px[known] ** 2))
        error = np.abs(disparity - gain * shot.radius_px)
        errors.append(
            (float(np.nanmedian(error)), float(np.isfinite(disparity).mean()), float(np.ptp(shot.radius_px[known])))
        )
        line[0].imshow(linear_to_srgb(np.clip(shot.image / 0.9, 0, 1)))
        low, high = (float(v) for v in np.nanpercentile(gain * shot.radius_px, (1, 99)))
        shown = line[1].imshow(disparity, cmap="viridis", vmin=low, vmax=high)
        line[2].imshow(gain * shot.radius_px, cmap="viridis", vmin=low, vmax=high)
        figure.colorbar(shown, ax=list(line[1:]), fraction=0.02, label="half disparity, px")
        for axes, title in zip(line, (name, "disparity", "truth"), strict=True):
            axes.set_title(title, fontsize=9, loc="left")
            axes.set_axis_off()
    return Made(
        source="Simulated, cyan and yellow halves of real film; the telephone's lens is the package's 4 mm one, set "
        f"at {_PHONE_FOCUS_MM:.0f} mm.",
        drawn=[Drawn("cameras", figure, "Above the reflex camera, below the telephone before small cards.")],
        compared=[
            Compared("reflex camera", "depth maps (pictures)",
                     f"median error {errors[0][0]:.2f} px of half disparity, {errors[0][1]:.0%} answered",
                     "Other scenes; ours have a truth to compare with."),
            Compared("telephone", "disparity maps of tiny models (pictures)",
                     f"median error {errors[1][0]:.2f} px, {errors[1][1]:.0%} answered, {errors[1][2]:.1f} px of blur "
                     "radius between nearest and farthest",
                     "The simulated filter lies in the pupil; the paper's lay before the lens, at a distance it "
                     "does not know."),
        ],
    )  # fmt: skip


def phone_camera(width_px: int, height_px: int) -> PupilCamera:
    """Give the first order of the telephone's lens, focused close."""
    optics = focused_at(load_lens("phone_4"), _PHONE_FOCUS_MM)
    return pupil_camera(optics, width_px=width_px, height_px=height_px, pixel_pitch_mm=_PHONE_SENSOR_MM / width_px)


def cards(camera: PupilCamera) -> list[Plane]:
    """Build a wall and three cards before it, at 45 to 110 mm."""
    from chromaperture.optics.textures import noise

    made = []
    for i, (z, x, share) in enumerate(((110.0, 0.0, 1.6), (80.0, -0.25, 0.3), (60.0, 0.02, 0.26), (47.0, 0.29, 0.24))):
        field = z * camera.width_px / camera.focal_px
        grey = np.repeat(noise((500, 600), exponent=0.9, seed=20 + i)[..., None], 3, axis=2)
        tint = np.array([(1, 1, 1), (1, 0.7, 0.6), (0.7, 1, 0.7), (0.8, 0.85, 1)][i], np.float32)
        made.append(plane(grey * tint, center_mm=(x * field, 0.02 * field * i, z), width_mm=share * field))
    return made


def span(radius_px: np.ndarray) -> tuple[float, float]:
    """Range of half disparities of a scene, with a margin; px."""
    beta = 0.42  # of two halves
    return beta * float(np.nanmin(radius_px)) - 1.0, beta * float(np.nanmax(radius_px)) + 1.0
