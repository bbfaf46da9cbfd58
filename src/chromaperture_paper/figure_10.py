"""Figure 10: eight designs in rows; capture, raw disparity, and the same regularised by total variation."""

from __future__ import annotations

import numpy as np

from chromaperture.color.color_maps import DISTANCE, color_map
from chromaperture.color.srgb import linear_to_srgb
from chromaperture.evaluation.figures import new_figure
from chromaperture.optics.aperture import channel_transmission
from chromaperture.optics.pinhole import PupilCamera
from chromaperture_paper import methods, world
from chromaperture_paper.context import Context
from chromaperture_paper.exhibit import Chart, Comparison, Content, CsvTable
from chromaperture_paper.total_variation import smooth_disparity
from chromaperture_paper.world import EIGHT, NUMERALS, full_name

_SEED = 0
_TV_FIDELITY = 0.2  # per px of blur radius, a unit common to all designs; chosen by hand


def make(context: Context) -> Content:
    """Photograph the same still life through every design and match as the paper does."""
    camera = world.camera_of(*context.scene_size)
    planes = world.still_life(seed=_SEED)
    figure = new_figure(width=8.0, height=8 * 8.0 / 4 * camera.height_px / camera.width_px + 0.6)
    panels = figure.subplots(len(EIGHT), 4)
    rows: list[tuple[str, ...]] = []
    good: dict[str, float] = {}
    low, high = (float(r) for r in camera.blur_radius_px(np.array([1100.0, 3400.0])))
    for line, design in zip(panels, EIGHT, strict=True):
        shot = world.pinhole_capture(design, planes, camera, cells=context.cells, seed=_SEED)
        line[0].imshow(linear_to_srgb(np.clip(shot.image / 0.9, 0, 1)))
        line[0].set_ylabel(NUMERALS[design], rotation=0, labelpad=14, va="center", fontsize=11)
        line[3].imshow(shot.radius_px, cmap=color_map(DISTANCE), vmin=low, vmax=high)
        relative_exposure = world.level_exposure(design) / world.level_exposure("open")
        light = float(channel_transmission(world.real_film(design)).mean())
        first = (full_name(design), f"{light:.0%}", f"{relative_exposure:.2f}")
        if design == "open":
            for axes in line[1:3]:
                axes.text(0.5, 0.5, "no disparity", ha="center", va="center", transform=axes.transAxes, fontsize=9)
            rows.append((*first, *"-----"))
            continue
        both = _raw_and_regularised(design, shot.image, camera, context.cells, (low - 1, high + 1))
        for axes, radius in zip(line[1:3], both, strict=True):
            axes.imshow(radius, cmap=color_map(DISTANCE), vmin=low, vmax=high)
        found = [methods.scores(methods.depth_of(np.asarray(r, float), camera), shot.depth_mm) for r in both]
        good[design] = found[1]["within_5"]
        within = (f"{s[key]:.1%}" for s in found for key in ("within_2", "within_5"))
        rows.append((*first, *within, f"{found[1]['median_error']:.1%}"))
    for axes, title in zip(panels[0], ("capture", "raw disparity", "regularised", "truth"), strict=True):
        axes.set_title(title, fontsize=9)
    for axes in panels.ravel():
        axes.set_xticks([])
        axes.set_yticks([])
    head = ("design", "light", "exposure", "raw: within 2 %", "within 5 %", "regularised: within 2 %", "within 5 %",
            "median error")  # fmt: skip
    order = [NUMERALS[n] for n in sorted(good, key=lambda n: good[n], reverse=True)]
    return Content(
        source=f"Simulated: a still life at {camera.width_px}x{camera.height_px} px through an ideal 50 mm f/2 lens, "
        "exposed until white paper reaches the same level in every design, as the paper does.",
        charts=[Chart("designs", figure, "Rows I to VIII. Blue is near, yellow far; the last column is the truth.")],
        tables=[CsvTable("designs", "Fractions of ALL pixels whose depth is right; exposure relative to the open pupil",
                         head, rows)],
        comparisons=[
            Comparison("V against VI", "V seems better at almost the same light",
                       f"within 5 %: V {good['cy_halves']:.0%}, VI {good['magenta_annulus']:.0%}",
                       "Agrees: VI cannot distinguish near from far; everything before the focus is placed behind it."),
            Comparison("VII", "for when depth quality is no issue",
                       f"within 5 %: VII {good['cy_open']:.0%}, V {good['cy_halves']:.0%}",
                       "Agrees: its views lie a third as far apart."
                       if good["cy_open"] < good["cy_halves"] else "Does not agree on this scene."),
            Comparison("depth at equal image level, best first", "not ranked", ", ".join(order),
                       "At equal level the noise is the same; distance and blur of the views decide."),
        ],
        lines=["All designs but VI go through the same matcher (quality paper); VI has its own likelihood [5]. The "
               "same total variation [6] regularises all."],
    )  # fmt: skip


def _raw_and_regularised(
    design: str, image: np.ndarray, camera: PupilCamera, cells: int, bounds_px: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Measure the blur radius as the paper does, before and after total variation; two (H, W) arrays, px."""
    method = methods.method_of(design)
    reading = methods.METHODS[method](image, methods.setting_of(design, camera))
    raw = methods.calibrate(method, design, camera, cells).radius_of(reading)
    return raw, smooth_disparity(raw, fidelity=_TV_FIDELITY, bounds_px=bounds_px).disparity_px
