"""Prior art beside the project's own method: the same captures, the same boards to calibrate on."""

from __future__ import annotations

import time

import numpy as np

from chromaperture.evaluation.figures import new_figure
from chromaperture.evaluation.paper import methods, stereo_pair, world
from chromaperture.evaluation.paper.context import Context
from chromaperture.evaluation.paper.exhibit import Drawn, Listed, Made
from chromaperture.evaluation.paper.world import NUMERALS
from chromaperture.evaluation.tables import Table
from chromaperture.optics.aperture import channel_transmission

DESIGNS_READ = ("rgb_squares", "cmy_circles", "cy_halves", "cy_open", "magenta_annulus")
_SHOWN = "cy_halves"
_SATURATIONS = (0.0, 0.7)


def make(context: Context) -> Made:
    """Run every method that can read a design on a grey and a coloured still life."""
    camera = world.camera_of(*context.scene_size)
    rows, pictures = [], []
    truth = None
    for design in (_SHOWN, DESIGNS_READ[-1]) if context.quick else DESIGNS_READ:
        exposure = world.level_exposure(design)
        table = world.pinhole_table(camera, design, context.cells)
        shots = [
            world.photograph(table, world.still_life(seed=3, saturation=s), camera, seed=3, exposure=exposure)
            for s in _SATURATIONS
        ]
        light = float(channel_transmission(world.real_film(design)).mean())
        setting = methods.setting_of(design, camera)
        for name in methods.METHODS:
            if not methods.applies(name, design):
                continue
            curve = methods.calibrate(name, design, camera, context.cells)
            start = time.perf_counter()
            values = [methods.METHODS[name](s.image, setting) for s in shots]
            depths = [methods.depth_of(curve.radius_of(value), camera) for value in values]
            seconds = (time.perf_counter() - start) / 2
            rows.append(_row(name, design, light, depths, shots, seconds))
            if name == "annulus":  # told by the truth which side of the focus it is on: what is lost to the ambiguity
                sided = [
                    methods.depth_of(np.sign(s.radius_px) * np.abs(_radius(d, camera)), camera)
                    for d, s in zip(depths, shots, strict=True)
                ]
                rows.append(_row("annulus, told the side", design, light, sided, shots, seconds))
            if design == _SHOWN:
                pictures.append((name, depths[1]))
                truth = shots[1].depth_mm
    pair = [
        stereo_pair.measured(world.still_life(seed=3, saturation=s), camera, seed=3, cells=context.cells)
        for s in _SATURATIONS
    ]
    rows.append(_row("two cameras, OpenCV StereoSGBM", "", 1 / stereo_pair.STOPPED**2, [depth for _, depth, _ in pair],
                     [shot for shot, _, _ in pair], pair[1][2], label="two lenses at f/8"))  # fmt: skip
    pictures.append(("two cameras, 60 mm apart", pair[1][1]))
    figure = new_figure(width=8.5, height=5.0)
    panels = figure.subplots(-(-(len(pictures) + 1) // 4), 4).ravel()
    for axes, (name, depth) in zip(panels, [*pictures, ("truth", truth)], strict=False):
        axes.imshow(depth, cmap="viridis", vmin=1100, vmax=3400)
        axes.set_title(name, fontsize=7, loc="left")
    for axes in panels:
        axes.set_axis_off()
    head = ("method", "design", "light", "grey: within 2 %", "within 5 %", "coloured: within 2 %", "within 5 %", "fill",
            "time, ms")  # fmt: skip
    return Made(
        source=f"Simulated still life at {camera.width_px}x{camera.height_px} px, equal image level, real film.",
        drawn=[Drawn("methods", figure, "Depth of the coloured still life through cyan and yellow halves.")],
        listed=[Listed("methods", Table("Shares of ALL pixels whose depth is right; every method is calibrated on "
                                        "the same boards", head, rows))],
        lines=[
            ranking(rows, NUMERALS[_SHOWN]),
            "Every prior method is written anew from its publication's formulas. Graph cuts of [4] are replaced by "
            "semi-global paths over the same measure; the likelihood of [5] is divided by the gradient's energy, "
            "without which the largest blur always wins on this film.",
            f"Two cameras {stereo_pair.BASELINE_MM:g} mm apart are what a user would pick instead: stopped down to f/8 "
            "so that all is sharp, each with a sixteenth of the light, exposed to the same level; calibration, "
            "synchronisation and a second camera are not counted. Their baseline is seven times that of the halves.",
            "Times are of this run on this machine, prior methods in plain NumPy and OpenCV: they tell orders of size.",
            "Quality accurate runs here without the lens's blur, which only a calibrated camera knows.",
        ],
    )  # fmt: skip


def ranking(rows: list[tuple[str, ...]], numeral: str) -> str:
    """Say which methods put most pixels of the coloured scene within 5 %, through one design."""
    shares = {row[0]: float(row[6].rstrip("%")) for row in rows if row[1].startswith(f"{numeral} ")}
    best = sorted(shares, key=lambda name: -shares[name])
    told = ", ".join(f"{name} ({shares[name]:.0f} %)" for name in best)
    return f"Through design {numeral}, coloured scene, within 5 %, best first: {told}."


def _radius(depth_mm: np.ndarray, camera: world.PupilCamera) -> np.ndarray:
    return np.asarray(camera.blur_radius_px(depth_mm))


def _row(
    name: str,
    design: str,
    light: float,
    depths: list[np.ndarray],
    shots: list[world.Capture],
    seconds: float,
    *,
    label: str = "",
) -> tuple[str, ...]:
    judged = [methods.scores(depth, shot.depth_mm) for depth, shot in zip(depths, shots, strict=True)]
    shares = [f"{s[key]:.1%}" for s in judged for key in ("within_2", "within_5")]
    fill = f"{judged[1]['fill']:.1%}"
    return name, label or f"{NUMERALS[design]} {design}", f"{light:.0%}", *shares, fill, f"{1000 * seconds:.0f}"
