"""Figure 12: scenes through a reflex camera's lens, and small objects through a telephone's."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from chromaperture.color.srgb import linear_to_srgb
from chromaperture.evaluation.figures import new_figure, show_image
from chromaperture.optics.paraxial import focused_at
from chromaperture.optics.pinhole import PupilCamera, pupil_camera
from chromaperture.optics.prescription import load_lens
from chromaperture.optics.simulator.scene import Plane, plane
from chromaperture.optics.simulator.textures import noise
from chromaperture_paper import methods, world
from chromaperture_paper.context import Context
from chromaperture_paper.exhibit import Chart, Comparison, Content

_DESIGN = "cy_halves"
_PHONE_FOCUS_MM, _PHONE_SENSOR_MM = 60.0, 4.6  # close, as the paper's models; width of a telephone's sensor


@dataclass(frozen=True)
class Measured:
    """A scene with measured and true depth in mm, or half disparity in px."""

    name: str
    image: np.ndarray
    found: np.ndarray
    truth: np.ndarray
    unit: str
    blur_span_px: float

    @property
    def fill(self) -> float:
        """Fraction of the pixels with a measurement."""
        return float(np.isfinite(self.found).mean())

    @property
    def error(self) -> float:
        """Median error: relative for depth, px for disparity."""
        error = np.abs(self.found - self.truth)
        return float(np.nanmedian(error / self.truth if self.unit == "mm" else error))


def make(context: Context) -> Content:
    """Photograph two still lifes with one camera and two tables of small cards with the other."""
    reflex = [_by_reflex(context, seed) for seed in (12, 13)]
    phone = [_by_phone(context, seed) for seed in (20, 30)]
    figure = new_figure(height=7.6)
    panels = figure.subplots(4, 4, width_ratios=(0.5, 1, 1, 1))
    for line, one, letters, aperture in zip(panels, reflex + phone, ("bc", "de", "gh", "ij"), "a f ", strict=True):
        line[0].set_axis_off()
        if aperture != " ":
            show_image(line[0], linear_to_srgb(aperture_picture()), f"({aperture}) aperture")
        low, high = (float(v) for v in np.nanpercentile(one.truth, (1, 99)))
        show_image(line[1], linear_to_srgb(np.clip(one.image / 0.9, 0, 1)), f"({letters[0]}) {one.name}")
        kind = "depth" if one.unit == "mm" else "disparity"
        shown = show_image(line[2], one.found, f"({letters[1]}) {kind}", vmin=low, vmax=high)
        show_image(line[3], one.truth, "truth", vmin=low, vmax=high)
        figure.colorbar(shown, ax=list(line[2:]), fraction=0.02, label=one.unit)

    def listed(form: str, values: Iterable[float]) -> str:
        return " and ".join(format(value, form) for value in values)

    return Content(
        source="Simulated, cyan and yellow halves of real film; the telephone's lens is the package's 4 mm one, set "
        f"at {_PHONE_FOCUS_MM:.0f} mm.",
        charts=[Chart("cameras", figure, "Above the reflex camera, below the telephone before small cards.")],
        comparisons=[
            Comparison("reflex camera", "depth maps (pictures)",
                       f"median error {listed('.1%', (s.error for s in reflex))} of the depth, "
                       f"{listed('.0%', (s.fill for s in reflex))} answered",
                       "Other scenes; ours have a truth to compare with."),
            Comparison("telephone", "disparity maps of tiny models (pictures)",
                       f"median error {listed('.2f', (s.error for s in phone))} px, "
                       f"{listed('.0%', (s.fill for s in phone))} answered, "
                       f"{listed('.1f', (s.blur_span_px for s in phone))} px of blur radius between nearest and "
                       "farthest",
                       "The simulated filter lies in the pupil; the paper's was before the lens, at a distance that it "
                       "does not state."),
        ],
    )  # fmt: skip


def _by_reflex(context: Context, seed: int) -> Measured:
    camera = world.camera_of(*context.scene_size)
    planes = world.still_life(seed=seed, saturation=0.6)
    shot = world.pinhole_capture(_DESIGN, planes, camera, cells=context.cells, seed=seed)
    curve = methods.calibrate("ours, real-time", _DESIGN, camera, context.cells)
    found = methods.our_disparity(shot.image, methods.setting_of(_DESIGN, camera), quality="real-time")
    depth = methods.depth_of(curve.radius_of(found.value_px), camera)
    return Measured("50 mm f/2", shot.image, depth, shot.depth_mm, "mm", float(np.ptp(shot.radius_px)))


def _by_phone(context: Context, seed: int) -> Measured:
    camera = phone_camera(*context.scene_size)
    shot = world.pinhole_capture(_DESIGN, cards(camera, seed), camera, cells=context.cells, seed=seed)
    known = np.isfinite(shot.radius_px)
    setting = replace(methods.setting_of(_DESIGN, camera), span_px=span(shot.radius_px))
    disparity = np.asarray(methods.our_disparity(shot.image, setting, quality="real-time").value_px, float)
    # Leaks of the film scale the geometric disparity: one factor, fitted to the truth.
    both = known & np.isfinite(disparity)
    gain = float(np.median(disparity[both] * shot.radius_px[both]) / np.median(shot.radius_px[both] ** 2))
    blur_span_px = float(np.ptp(shot.radius_px[known]))
    return Measured("telephone", shot.image, disparity, gain * shot.radius_px, "half disparity, px", blur_span_px)


def aperture_picture() -> np.ndarray:
    """Draw the transmitted light of the aperture, seen from behind the camera; (160, 160, 3), white around."""
    y, x = np.mgrid[-1.08:1.08:160j, -1.08:1.08:160j]
    light = world.real_film(_DESIGN).transmission_map(x, y)
    return np.where((np.hypot(x, y) <= 1)[..., None], light, 1.0)


def phone_camera(width_px: int, height_px: int) -> PupilCamera:
    """Return the first-order model of the telephone's lens, focused close."""
    optics = focused_at(load_lens("phone_4"), _PHONE_FOCUS_MM)
    return pupil_camera(optics, width_px=width_px, height_px=height_px, pixel_pitch_mm=_PHONE_SENSOR_MM / width_px)


def cards(camera: PupilCamera, seed: int = 20) -> list[Plane]:
    """Build a wall and three cards before it, at 45 to 110 mm."""
    side = -1 if seed % 20 else 1  # the other table is the mirror image, with other textures
    made = []
    for i, (z, x, size) in enumerate(((110.0, 0.0, 1.6), (80.0, -0.25, 0.3), (60.0, 0.02, 0.26), (47.0, 0.29, 0.24))):
        seen_mm = z * camera.width_px / camera.focal_px  # width of the picture at this distance
        grey = np.repeat(noise((500, 600), exponent=0.9, seed=seed + i)[..., None], 3, axis=2)
        tint = np.array([(1, 1, 1), (1, 0.7, 0.6), (0.7, 1, 0.7), (0.8, 0.85, 1)][i], np.float32)
        made.append(plane(grey * tint, center_mm=(side * x * seen_mm, 0.02 * seen_mm * i, z), width_mm=size * seen_mm))
    return made


def span(radius_px: np.ndarray) -> tuple[float, float]:
    """Return the range of half disparities of a scene with a margin of 1 px."""
    beta = methods.HALVES_BETA
    return beta * float(np.nanmin(radius_px)) - 1.0, beta * float(np.nanmax(radius_px)) + 1.0
