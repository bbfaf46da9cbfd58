"""Depth error of flat walls: designs x light x distance x colours x seeds, with the Cramer-Rao bound."""

from __future__ import annotations

from itertools import product

import numpy as np
from matplotlib.figure import Figure

from chromaperture.evaluation.figures import new_figure, plain_log_scale, style_axes
from chromaperture_paper import methods, world
from chromaperture_paper.context import Context
from chromaperture_paper.exhibit import Chart, Comparison, Content, CsvTable
from chromaperture_paper.trial import Trial
from chromaperture_paper.world import EIGHT, NUMERALS, full_name

_WIDTH, _HEIGHT = 160, 112  # px, a crop of the full picture
_FULL_MM, _QUICK_MM = (1150.0, 1500.0, 1850.0, 2300.0, 2900.0, 3600.0), (1500.0, 2900.0)
_SATURATIONS = {0.0: "grey", 0.7: "coloured"}  # with 0.7 the weakest channel has 0.3 to 0.5 of the light
_LIGHTS = (world.LIGHTS[0], world.LIGHTS[2])
_DESIGNS = tuple(name for name in EIGHT if name != "open")
_COLORS = ("#777777", "#b03030", "#c8702a", "#8a7a00", "#2b6ca3", "#8040a0", "#3c9c50")
_FIELDS = ("design", "light", "distance_mm", "saturation", "seed")
_KEYS = ("fill", "within_2", "within_5", "median_error", "bias", "scatter")
Case = tuple[str, str, float, float, int]  # _FIELDS
Results = dict[Case, dict[str, float]]


def make(context: Context) -> Content:
    """Sweep on all cores, or on a cluster."""
    distances = _QUICK_MM if context.quick else _FULL_MM
    saturations = list(_SATURATIONS)[:1] if context.quick else list(_SATURATIONS)
    cases = list(product(_DESIGNS, _LIGHTS, distances, saturations, range(1 if context.quick else 2)))
    trials = [
        Trial(methods.method_of(design), design, world.exposure_in(design, light), _WIDTH, _HEIGHT, context.cells, seed,
              saturation=saturation, scene="wall", distance_mm=distance)
        for design, light, distance, saturation, seed in cases
    ]  # fmt: skip
    results: Results = dict(zip(cases, context.sweep(trials, "trials of accuracy"), strict=True))
    camera = world.camera_of(480, 320)
    bounds = {
        (design, light): methods.relative_bound(design, light, camera, np.array(distances))
        for design, light in product(_DESIGNS, _LIGHTS)
    }
    rows = []
    for design, light, distance in product(_DESIGNS, _LIGHTS, distances):
        fixed = {"design": design, "light": light, "distance_mm": distance}
        bound = bounds[design, light][distances.index(distance)]
        rows.append((
            full_name(design), light, f"{distance:.0f}",
            *(f"{_median(results, 'scatter', saturation=s, **fixed):.2%}" for s in saturations),
            f"{bound:.2%}" if np.isfinite(bound) else "-", f"{_median(results, 'bias', **fixed):+.2%}",
            f"{_median(results, 'within_2', **fixed):.0%}",
        ))  # fmt: skip
    head = ("design", "light", "distance, mm", *(f"scatter, {_SATURATIONS[s]}" for s in saturations), "Cramer-Rao",
            "bias", "within 2 %")  # fmt: skip
    every = [
        (*(f"{value}" for value in case), *(f"{result[key]:.6g}" for key in _KEYS)) for case, result in results.items()
    ]
    return Content(
        source=f"Simulated: walls of speckle at {_WIDTH}x{_HEIGHT} px, pieces of a picture of 480x320; {len(trials)} "
        "trials.",
        charts=[
            Chart("accuracy", _figure(results, bounds, distances), "Scatter of single pixels about the wall's median, "
                  "grey walls. Dashed: the Cramer-Rao bound of the matcher's window; aggregation over more of the "
                  "picture may have less.")
        ],
        tables=[
            CsvTable("accuracy", "Median over seeds; scatter is the robust standard deviation", head, rows),
            CsvTable("trials", "Every trial", (*_FIELDS, *_KEYS), every, on_page=False),
        ],
        comparisons=[
            Comparison(f"ranking, {light}", "V for depth, VII for light", _ranking(results, light),
                       "By the fraction of pixels within 2 %, best first, over all walls.")
            for light in _LIGHTS
        ],
        lines=["The magenta annulus (VI) has no disparity, so no bound; it places walls before the focus behind it."],
    )  # fmt: skip


def _median(results: Results, key: str, **fixed: object) -> float:
    """Return the median of a score over the trials with fixed values of some of _FIELDS; NaN if none is known."""
    wanted = {_FIELDS.index(name): value for name, value in fixed.items()}
    found = np.array([r[key] for case, r in results.items() if all(case[i] == v for i, v in wanted.items())])
    return float(np.nanmedian(found)) if np.isfinite(found).any() else float("nan")


def _figure(results: Results, bounds: dict[tuple[str, str], np.ndarray], distances: tuple[float, ...]) -> Figure:
    figure = new_figure(height=4.2)
    panels = figure.subplots(1, len(_LIGHTS), sharey=True)
    for axes, light in zip(panels, _LIGHTS, strict=True):
        for design, color in zip(_DESIGNS, _COLORS, strict=True):
            fixed = {"design": design, "light": light, "saturation": 0.0}
            scatter = [100 * _median(results, "scatter", distance_mm=d, **fixed) for d in distances]
            axes.plot(distances, scatter, "o-", color=color, markersize=4, label=NUMERALS[design])
            if np.isfinite(bounds[design, light]).all():
                axes.plot(distances, 100 * bounds[design, light], "--", color=color, alpha=0.6, linewidth=1)
        plain_log_scale(axes)
        axes.set_title(light, fontsize=9, loc="left")
        style_axes(axes, xlabel="distance, mm", ylabel="scatter of a pixel's depth, %")
    panels[0].legend(frameon=False, fontsize=8, ncols=2)
    return figure


def _ranking(results: Results, light: str) -> str:
    """Rank the designs by the fraction of pixels within 2 %, mean over all walls and seeds in one light."""
    right = {d: float(np.mean([r["within_2"] for case, r in results.items() if case[:2] == (d, light)]))
             for d in _DESIGNS}  # fmt: skip
    return ", ".join(f"{NUMERALS[d]} ({right[d]:.0%})" for d in sorted(_DESIGNS, key=lambda d: -right[d]))
