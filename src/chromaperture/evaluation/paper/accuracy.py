"""Depth error of flat walls: designs x light x distance x colours x seeds, beside the Cramer-Rao bound."""

from __future__ import annotations

from itertools import product

import numpy as np

from chromaperture.evaluation.figures import new_figure, tidy
from chromaperture.evaluation.paper import world
from chromaperture.evaluation.paper.context import Context
from chromaperture.evaluation.paper.exhibit import Compared, Drawn, Listed, Made
from chromaperture.evaluation.paper.trial import Trial
from chromaperture.evaluation.paper.world import EIGHT, NUMERALS
from chromaperture.evaluation.tables import Table
from chromaperture.optics.depth_error_bound import expected_accuracy

_WIDTH, _HEIGHT = 160, 112
_FULL_MM, _QUICK_MM = (1150.0, 1500.0, 1850.0, 2300.0, 2900.0, 3600.0), (1500.0, 2900.0)
_SATURATIONS = (0.0, 0.7)
LIGHTS = ("equal level", "equal time, dim")
_DIM = 0.03  # of white level that white paper reaches through the open pupil
_COLORS = ("#777777", "#b03030", "#c8702a", "#8a7a00", "#2b6ca3", "#8040a0", "#3c9c50")
Case = tuple[str, str, float, float, int]  # design, light, distance, saturation, seed
_KEYS = ("fill", "within_2", "within_5", "median_error", "bias", "spread")


def make(context: Context) -> Made:
    """Sweep on all cores, or on a cluster."""
    designs = [name for name in EIGHT if name != "open"]
    distances = _QUICK_MM if context.quick else _FULL_MM
    seeds = range(1 if context.quick else 2)
    saturations = _SATURATIONS[:1] if context.quick else _SATURATIONS
    trials = {
        case: _trial(*case, cells=context.cells)
        for case in product(designs, LIGHTS, distances, saturations, seeds)
    }  # fmt: skip
    results = dict(zip(trials, context.sweep(list(trials.values()), "trials of accuracy"), strict=True))

    def median(key: str, **fixed: object) -> float:
        names = ("design", "light", "distance", "saturation", "seed")
        wanted = [(names.index(name), value) for name, value in fixed.items()]
        found = np.array([r[key] for case, r in results.items() if all(case[i] == v for i, v in wanted)])
        return float(np.nanmedian(found)) if np.isfinite(found).any() else float("nan")

    camera = world.camera_of(480, 320)
    bounds = {
        (design, light): expected_accuracy(
            world.real_film(design), camera, np.array(distances), exposure=_exposure(design, light)
        ).sigma_mm / np.array(distances)
        for design in designs for light in LIGHTS
    }  # fmt: skip
    figure = new_figure(height=4.2)
    panels = figure.subplots(1, len(LIGHTS), sharey=True)
    for axes, light in zip(panels, LIGHTS, strict=True):
        for design, color in zip(designs, _COLORS, strict=True):
            spread = [100 * median("spread", design=design, light=light, distance=d, saturation=0.0) for d in distances]
            axes.plot(distances, spread, "o-", color=color, markersize=4, label=NUMERALS[design])
            if np.isfinite(bounds[design, light]).all():
                axes.plot(distances, 100 * bounds[design, light], "--", color=color, alpha=0.6, linewidth=1)
        axes.set_yscale("log")
        axes.set_title(light, fontsize=9, loc="left")
        tidy(axes, xlabel="distance, mm", ylabel="spread of a pixel's depth, %")
    panels[0].legend(frameon=False, fontsize=8, ncols=2)
    rows = []
    for design, light, distance in product(designs, LIGHTS, distances):
        at = {"design": design, "light": light, "distance": distance}
        index = distances.index(distance)
        shown = [f"{median('spread', saturation=s, **at):.2%}" for s in saturations]
        bound = bounds[design, light][index]
        rows.append((
            f"{NUMERALS[design]} {design}", light, f"{distance:.0f}", *shown,
            f"{bound:.2%}" if np.isfinite(bound) else "-", f"{median('bias', **at):+.2%}",
            f"{median('within_2', **at):.0%}",
        ))  # fmt: skip
    head = ("design", "light", "distance, mm", *(f"spread, {n}" for n in ("grey", "coloured")[: len(saturations)]),
            "Cramer-Rao", "bias", "within 2 %")  # fmt: skip
    every = [
        (*(f"{value}" for value in case), *(f"{result[key]:.6g}" for key in _KEYS)) for case, result in results.items()
    ]
    ranking = {}
    for light in LIGHTS:
        right = {NUMERALS[d]: mean_right(results, d, light) for d in designs}
        ranking[light] = ", ".join(f"{n} ({right[n]:.0%})" for n in sorted(right, key=lambda n: -right[n]))
    return Made(
        source=f"Simulated: walls of speckle at {_WIDTH}x{_HEIGHT} px, pieces of a picture of 480x320; {len(trials)} "
        "trials.",
        drawn=[
            Drawn("accuracy", figure, "Spread of single pixels about the wall's median, grey walls. Dashed: the "
                  "Cramer-Rao bound of the matcher's window, which pooling over more of the picture may beat.")
        ],
        listed=[
            Listed("accuracy", Table("Median over seeds; spread is 1.4826 times the median deviation", head, rows)),
            Listed("trials", Table("Every trial", ("design", "light", "distance_mm", "saturation", "seed", *_KEYS),
                                   every), on_page=False),
        ],
        compared=[
            Compared(f"ranking, {light}", "V for depth, VII for light", ranking[light],
                     "By the share of pixels within 2 %, best first, over all walls.")
            for light in LIGHTS
        ],
        lines=["The magenta annulus (VI) has no disparity, so no bound of it; walls before the focus it puts behind."],
    )  # fmt: skip


def mean_right(results: dict[Case, dict[str, float]], design: str, light: str) -> float:
    """Share of pixels within 2 %, mean over all walls and seeds of a design in one light."""
    return float(np.mean([r["within_2"] for case, r in results.items() if case[:2] == (design, light)]))


def _trial(design: str, light: str, distance: float, saturation: float, seed: int, *, cells: int) -> Trial:
    return Trial(
        method="annulus" if design == "magenta_annulus" else "ours, paper",
        design=design,
        exposure=_exposure(design, light),
        width_px=_WIDTH,
        height_px=_HEIGHT,
        cells=cells,
        seed=seed,
        saturation=saturation,
        scene="wall",
        distance_mm=distance,
    )


def _exposure(design: str, light: str) -> float:
    return world.level_exposure(design) if light == LIGHTS[0] else _DIM
