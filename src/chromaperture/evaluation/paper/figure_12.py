"""Figure 12: scenes through a reflex camera's lens, and tiny things through a telephone's."""

from __future__ import annotations

from dataclasses import dataclass, replace

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


@dataclass(frozen=True)
class Seen:
    """A scene, what was measured of it and what is true; depth in mm or half disparity in px."""

    name: str
    image: np.ndarray
    found: np.ndarray
    truth: np.ndarray
    unit: str
    blur_span_px: float

    @property
    def answered(self) -> float:
        """Share of the pixels with an answer."""
        return float(np.isfinite(self.found).mean())

    @property
    def error(self) -> float:
        """Median of the error: of depth as a share, of disparity in px."""
        error = np.abs(self.found - self.truth)
        return float(np.nanmedian(error / self.truth if self.unit == "mm" else error))


def make(context: Context) -> Made:
    """Photograph two still lifes with the one camera and two tables of small cards with the other."""
    seen = [
        *(_by_reflex(context, seed) for seed in (12, 13)),
        *(_by_phone(context, seed) for seed in (20, 30)),
    ]
    figure = new_figure(height=7.6)
    panels = figure.subplots(4, 4, width_ratios=(0.5, 1, 1, 1))
    for number, (line, one) in enumerate(zip(panels, seen, strict=True)):
        if number in (0, 2):
            line[0].imshow(linear_to_srgb(aperture_picture()))
            line[0].set_title("(a) aperture" if number == 0 else "(f) aperture", fontsize=9, loc="left")
        low, high = (float(v) for v in np.nanpercentile(one.truth, (1, 99)))
        line[1].imshow(linear_to_srgb(np.clip(one.image / 0.9, 0, 1)))
        shown = line[2].imshow(one.found, cmap="viridis", vmin=low, vmax=high)
        line[3].imshow(one.truth, cmap="viridis", vmin=low, vmax=high)
        figure.colorbar(shown, ax=list(line[2:]), fraction=0.02, label=one.unit)
        kind = "depth" if one.unit == "mm" else "disparity"
        letters = ("bc", "de", "gh", "ij")[number]
        titles = (f"({letters[0]}) {one.name}", f"({letters[1]}) {kind}", "truth")
        for axes, title in zip(line[1:], titles, strict=True):
            axes.set_title(title, fontsize=9, loc="left")
        for axes in line:
            axes.set_axis_off()
    reflex, phone = seen[:2], seen[2:]
    return Made(
        source="Simulated, cyan and yellow halves of real film; the telephone's lens is the package's 4 mm one, set "
        f"at {_PHONE_FOCUS_MM:.0f} mm.",
        drawn=[Drawn("cameras", figure, "Above the reflex camera, below the telephone before small cards.")],
        compared=[
            Compared("reflex camera", "depth maps (pictures)",
                     "median error " + " and ".join(f"{s.error:.1%}" for s in reflex) + " of the depth, "
                     + " and ".join(f"{s.answered:.0%}" for s in reflex) + " answered",
                     "Other scenes; ours have a truth to compare with."),
            Compared("telephone", "disparity maps of tiny models (pictures)",
                     "median error " + " and ".join(f"{s.error:.2f}" for s in phone) + " px, "
                     + " and ".join(f"{s.answered:.0%}" for s in phone) + " answered, "
                     + " and ".join(f"{s.blur_span_px:.1f}" for s in phone) + " px of blur radius between nearest and "
                     "farthest",
                     "The simulated filter lies in the pupil; the paper's lay before the lens, at a distance it "
                     "does not know."),
        ],
    )  # fmt: skip


def _by_reflex(context: Context, seed: int) -> Seen:
    camera = world.camera_of(*context.scene_size)
    exposure = world.level_exposure(_DESIGN)
    table = world.pinhole_table(camera, _DESIGN, context.cells)
    shot = world.photograph(table, world.still_life(seed=seed, saturation=0.6), camera, seed=seed, exposure=exposure)
    curve = methods.calibrate("ours, real-time", _DESIGN, camera, context.cells)
    found = methods.our_disparity(shot.image, methods.setting_of(_DESIGN, camera), quality="real-time")
    depth = methods.depth_of(curve.radius_of(found.value_px), camera)
    return Seen("50 mm f/2", shot.image, depth, shot.depth_mm, "mm", float(np.ptp(shot.radius_px)))


def _by_phone(context: Context, seed: int) -> Seen:
    camera = phone_camera(*context.scene_size)
    table = world.pinhole_table(camera, _DESIGN, context.cells)
    shot = world.photograph(table, cards(camera, seed), camera, seed=seed, exposure=world.level_exposure(_DESIGN))
    known = np.isfinite(shot.radius_px)
    setting = replace(methods.setting_of(_DESIGN, camera), span_px=span(shot.radius_px))
    disparity = np.asarray(methods.our_disparity(shot.image, setting, quality="real-time").value_px, float)
    # Leaks of the film make the reading a share of the geometric disparity: one number, fitted to the truth.
    both = known & np.isfinite(disparity)
    gain = float(np.median(disparity[both] * shot.radius_px[both]) / np.median(shot.radius_px[both] ** 2))
    truth = gain * shot.radius_px
    return Seen("telephone", shot.image, disparity, truth, "half disparity, px", float(np.ptp(shot.radius_px[known])))


def aperture_picture(size_px: int = 160) -> np.ndarray:
    """Draw the aperture as light shines through it, seen from behind the camera; (size, size, 3), white around."""
    y, x = np.mgrid[-1.08 : 1.08 : size_px * 1j, -1.08 : 1.08 : size_px * 1j]
    light = world.real_film(_DESIGN).transmission_map(x, y)
    return np.where((np.hypot(x, y) <= 1)[..., None], light, 1.0)


def phone_camera(width_px: int, height_px: int) -> PupilCamera:
    """Give the first order of the telephone's lens, focused close."""
    optics = focused_at(load_lens("phone_4"), _PHONE_FOCUS_MM)
    return pupil_camera(optics, width_px=width_px, height_px=height_px, pixel_pitch_mm=_PHONE_SENSOR_MM / width_px)


def cards(camera: PupilCamera, seed: int = 20) -> list[Plane]:
    """Build a wall and three cards before it, at 45 to 110 mm."""
    from chromaperture.optics.textures import noise

    side = -1 if seed % 20 else 1  # the other table is the mirror image, with other cards
    made = []
    for i, (z, x, share) in enumerate(((110.0, 0.0, 1.6), (80.0, -0.25, 0.3), (60.0, 0.02, 0.26), (47.0, 0.29, 0.24))):
        field = z * camera.width_px / camera.focal_px
        grey = np.repeat(noise((500, 600), exponent=0.9, seed=seed + i)[..., None], 3, axis=2)
        tint = np.array([(1, 1, 1), (1, 0.7, 0.6), (0.7, 1, 0.7), (0.8, 0.85, 1)][i], np.float32)
        made.append(plane(grey * tint, center_mm=(side * x * field, 0.02 * field * i, z), width_mm=share * field))
    return made


def span(radius_px: np.ndarray) -> tuple[float, float]:
    """Range of half disparities of a scene, with a margin; px."""
    beta = 0.42  # of two halves
    return beta * float(np.nanmin(radius_px)) - 1.0, beta * float(np.nanmax(radius_px)) + 1.0
