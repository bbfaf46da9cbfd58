"""Prior art beside the project's own method: the same captures and boards; and two ordinary cameras side by side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from chromaperture.color.color_maps import DISTANCE
from chromaperture.evaluation.figures import new_figure, show_image
from chromaperture.optics.aperture import channel_transmission
from chromaperture.optics.pinhole import PupilCamera
from chromaperture.optics.ray_table import pinhole_rays
from chromaperture.optics.simulator.scene import Plane
from chromaperture_paper import methods, world
from chromaperture_paper.context import Context
from chromaperture_paper.prior_methods import semi_global_matching
from chromaperture_paper.registry import Chart, Content, CsvTable
from chromaperture_paper.world import NUMERALS, Capture, full_name

DESIGNS_READ = ("rgb_squares", "cmy_circles", "cy_halves", "cy_open", "magenta_annulus")
_SHOWN = "cy_halves"
_SATURATIONS = (0.0, 0.7)  # a grey and a coloured still life
_SEED = 3
Row = tuple[str, ...]


def prior_art(context: Context) -> Content:
    """Run every method that can read a design on a grey and a coloured still life."""
    camera = world.camera_of(*context.scene_size)
    scenes = [world.still_life(seed=_SEED, saturation=s) for s in _SATURATIONS]
    rows, pictures = [], {}
    for design in (_SHOWN, DESIGNS_READ[-1]) if context.quick else DESIGNS_READ:
        shots = [world.pinhole_capture(design, s, camera, cells=context.cells, seed=_SEED) for s in scenes]
        for name in methods.METHODS:
            if methods.applies(name, design):
                found, depths = _by_method(name, design, shots, camera, context.cells)
                rows += found
                if design == _SHOWN:
                    pictures[name], truth = depths[1], shots[1].depth_mm
    pair = [measured_by_pair(s, camera, seed=_SEED, cells=context.cells) for s in scenes]
    shots, depths, seconds = zip(*pair, strict=True)
    light = 1 / STOPPED**2
    rows.append(_row("two cameras, OpenCV StereoSGBM", "two lenses at f/8", light, depths, shots, seconds[1]))
    pictures |= {"two cameras, 60 mm apart": depths[1], "truth": truth}
    figure = new_figure(width=8.5, height=5.0)
    panels = figure.subplots(-(-len(pictures) // 4), 4).ravel()
    for axes in panels:
        axes.set_axis_off()
    for axes, (name, depth) in zip(panels, pictures.items(), strict=False):
        show_image(axes, depth, name, size=7, colors=DISTANCE, vmin=1100, vmax=3400)
    head = ("method", "design", "light", "grey: within 2 %", "within 5 %", "coloured: within 2 %", "within 5 %", "fill",
            "time, ms")  # fmt: skip
    return Content(
        source=f"Simulated still life at {camera.width_px}x{camera.height_px} px, equal image level, real film.",
        charts=[Chart("methods", figure, "Depth of the coloured still life through cyan and yellow halves.")],
        tables=[CsvTable("methods", "Fractions of ALL pixels whose depth is right; every method is calibrated on the "
                         "same boards", head, rows)],
        lines=[
            ranking(rows, NUMERALS[_SHOWN]),
            "Every prior method is implemented from its publication's formulas. Graph cuts of [4] are replaced by "
            "semi-global paths over the same measure; the likelihood of [5] is divided by the gradient's energy, "
            "without which the largest blur always wins on this film.",
            f"Two cameras {BASELINE_MM:g} mm apart are what a user would pick instead: stopped down to f/8 "
            "so that all is sharp, each with a sixteenth of the light, exposed to the same level; calibration, "
            "synchronisation and a second camera are not counted. Their baseline is seven times that of the halves.",
            "Times are of this run on this machine, prior methods in plain NumPy and OpenCV: orders of magnitude only.",
            "Quality accurate runs here without the lens's blur, which needs a calibrated camera.",
        ],
    )  # fmt: skip


def ranking(rows: Sequence[Row], numeral: str) -> str:
    """Rank the methods by the pixels of the coloured scene within 5 %, through one design."""
    right = {row[0]: float(row[6].rstrip("%")) for row in rows if row[1].startswith(f"{numeral} ")}
    best = ", ".join(f"{name} ({right[name]:.0f} %)" for name in sorted(right, key=lambda name: -right[name]))
    return f"Through design {numeral}, coloured scene, within 5 %, best first: {best}."


def _by_method(
    name: str, design: str, shots: Sequence[Capture], camera: PupilCamera, cells: int
) -> tuple[list[Row], list[np.ndarray]]:
    """Measure captures by a method; return its rows of the table and the depths, mm."""
    setting, curve = methods.setting_of(design, camera), methods.calibrate(name, design, camera, cells)
    depths, seconds = methods.timed(
        lambda: [methods.depth_of(curve.radius_of(methods.METHODS[name](s.image, setting)), camera) for s in shots]
    )
    seconds /= len(shots)
    light = float(channel_transmission(world.real_film(design)).mean())
    rows = [_row(name, full_name(design), light, depths, shots, seconds)]
    if name == "annulus":  # with the side of the focus from the truth: the cost of the ambiguity
        sided = [
            methods.depth_of(np.sign(shot.radius_px) * np.abs(camera.blur_radius_px(depth)), camera)
            for depth, shot in zip(depths, shots, strict=True)
        ]
        rows.append(_row("annulus, told the side", full_name(design), light, sided, shots, seconds))
    return rows, depths


def _row(
    name: str, design: str, light: float, depths: Sequence[np.ndarray], shots: Sequence[Capture], seconds: float
) -> Row:
    found = [methods.scores(depth, shot.depth_mm) for depth, shot in zip(depths, shots, strict=True)]
    within = [f"{s[key]:.1%}" for s in found for key in ("within_2", "within_5")]
    return name, design, f"{light:.0%}", *within, f"{found[1]['fill']:.1%}", f"{1000 * seconds:.0f}"


BASELINE_MM, STOPPED = 60.0, 4.0  # as in commercial pairs; f/2 stopped down to f/8, so that all is sharp
_NEAREST_MM = 1000.0  # of the searched range, as the coded cameras'


def measured_by_pair(
    planes: Sequence[Plane], camera: PupilCamera, *, seed: int, cells: int
) -> tuple[world.Capture, np.ndarray, float]:
    """Photograph a scene with two cameras, exposed to the same level as the others, and match them.

    Returns ``capture``: the left picture and its truth; ``depth_mm`` (H, W) float64, NaN unknown; ``seconds`` of the
    matching.
    """
    stopped = replace(camera, pupil_radius_mm=camera.pupil_radius_mm / STOPPED)
    table = pinhole_rays(stopped, world.real_film("open"), cells=cells)
    shots = [
        world.photograph(table, _beside(planes, x), stopped, seed=seed + i, exposure=world.WHITE)
        for i, x in enumerate((0.0, BASELINE_MM))
    ]
    return shots[0], *methods.timed(depth_of_pair, shots[0].image, shots[1].image, camera)


def depth_of_pair(left: np.ndarray, right: np.ndarray, camera: PupilCamera) -> np.ndarray:
    """Match two pictures of cameras side by side; depth from the sensor plane, (H, W) float64, mm, NaN unknown."""
    scale = camera.focal_px * BASELINE_MM
    count = 16 * int(np.ceil(scale / (_NEAREST_MM - camera.sensor_to_pupil_mm) / 16))
    pair = [(255 * np.sqrt(np.clip(picture.mean(axis=2), 0, 1))).astype(np.uint8) for picture in (left, right)]
    padded = [cv2.copyMakeBorder(p, 0, 0, count, 0, cv2.BORDER_REFLECT_101) for p in pair]
    disparity = semi_global_matching(padded[0], padded[1], 0, count)[:, count:].astype(float)
    with np.errstate(divide="ignore"):
        return np.where(disparity > 0, scale / disparity + camera.sensor_to_pupil_mm, np.nan)


def _beside(planes: Sequence[Plane], x_mm: float) -> list[Plane]:
    """Transform planes into the frame of a camera that stands farther right."""
    return [replace(p, center_mm=p.center_mm - np.array([x_mm, 0, 0])) for p in planes]
