"""Depth error of flat walls: designs x light x distance x colours x seeds, with the Cramer-Rao bound."""

from __future__ import annotations

from itertools import product

import numpy as np
from matplotlib.figure import Figure

from chromaperture.evaluation.figures import BLUE, GREY, RED, new_figure, plain_log_scale, style_axes
from chromaperture.optics.aperture import channel_transmission
from chromaperture_paper import methods, world
from chromaperture_paper.context import Context
from chromaperture_paper.registry import Chart, Comparison, Content, CsvTable
from chromaperture_paper.sweep import Trial
from chromaperture_paper.world import DIM, EIGHT, LIGHTS, NUMERALS, full_name

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


def accuracy(context: Context) -> Content:
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


_AT_MM = 2600.0  # distance of the wall of the bound: beyond the focus, within the still life
_LIGHT_KEYS = ("median_error", "within_2", "within_5")
_WHY = {
    "equal level": "Exposed as long as it takes (15 and 9 times as long as VIII), I and II are best: their openings "
    "are small, blur little and lie far apart; the paper does not rank at equal level.",
    "equal time": "In good light photons suffice for all designs, and the distance of the views decides.",
    "equal time, dim": "The paper's argument: where light is short, I and II have too little of it. VII has most, but "
    "its views lie a third as far apart, which costs more than the light gains.",
}
_LIGHT_COLORS = dict(zip(LIGHTS, (GREY, BLUE, RED), strict=True))
Figures = dict[tuple[str, str], dict[str, float]]  # by design and light: _LIGHT_KEYS, and the Cramer-Rao bound


def equal_light(context: Context) -> Content:
    """Sweep designs, light and seeds on all cores."""
    width, height = context.scene_size
    seeds = range(1 if context.quick else 3)
    trials = [
        Trial(methods.method_of(design), design, world.exposure_in(design, light), width, height, context.cells, seed)
        for design, light, seed in product(_DESIGNS, LIGHTS, seeds)
    ]
    results = context.sweep(trials, "trials of equal-light")
    camera = world.camera_of(width, height)
    found: Figures = {}
    for i, (design, light) in enumerate(product(_DESIGNS, LIGHTS)):
        own = results[i * len(seeds) : (i + 1) * len(seeds)]
        bound = methods.relative_bound(design, light, camera, np.array([_AT_MM]))[0]
        found[design, light] = {key: float(np.mean([r[key] for r in own])) for key in _LIGHT_KEYS} | {
            "bound": float(bound)
        }
    light_of = {name: float(channel_transmission(world.real_film(name)).mean()) for name in _DESIGNS}
    rows = [
        (full_name(d), f"{light_of[d]:.0%}", light, f"{at['median_error']:.2%}", f"{at['within_2']:.1%}",
         f"{at['within_5']:.1%}", f"{at['bound']:.2%}" if np.isfinite(at["bound"]) else "-")
        for (d, light), at in found.items()
    ]  # fmt: skip
    head = ("design", "light", "exposure", "median error", "within 2 %", "within 5 %", "Cramer-Rao")
    return Content(
        source=f"Simulated: {len(seeds)} still life{'s' if len(seeds) > 1 else ''} a point, {width}x{height} px.",
        charts=[Chart("equal-light", _light_figure(found, light_of), "Right and low is good. Dashed: no method can be "
                      "better on a grey wall, with the same window; edges, occlusions and colours cost the rest.")],
        tables=[CsvTable("equal-light", "Equal level: white paper at 0.9; equal time: 0.9 through the open pupil; "
                         f"dim: {DIM:g} through the open pupil", head, rows)],
        comparisons=_comparisons({key: at["within_5"] for key, at in found.items()}),
    )  # fmt: skip


def _light_figure(found: Figures, light_of: dict[str, float]) -> Figure:
    """Draw the median error and its bound over the light efficiency, a colour for each light."""
    figure = new_figure(height=3.8)
    axes = figure.subplots()
    for light, color in _LIGHT_COLORS.items():
        errors = [100 * found[d, light]["median_error"] for d in _DESIGNS]
        axes.plot([100 * light_of[d] for d in _DESIGNS], errors, "o", color=color, label=light)
        bounds = sorted((100 * light_of[d], 100 * found[d, light]["bound"]) for d in _DESIGNS)
        axes.plot(*zip(*(p for p in bounds if np.isfinite(p[1])), strict=True), "--", color=color, alpha=0.6)
    for design, error in zip(_DESIGNS, errors, strict=True):  # of the last light
        x = 100 * light_of[design]
        axes.annotate(NUMERALS[design], (x, error), xytext=(4, 4), textcoords="offset points", fontsize=9)
    axes.plot([], [], "--", color=GREY, alpha=0.8, label=f"Cramer-Rao, grey wall at {_AT_MM:.0f} mm")
    axes.axvline(100, color=GREY, linewidth=0.8)
    axes.annotate("VIII: no depth", (100, 0.5), xycoords=("data", "axes fraction"), rotation=90, fontsize=8,
                  ha="right", va="center", color=GREY)  # fmt: skip
    axes.margins(y=0.12)
    plain_log_scale(axes)
    style_axes(axes, xlabel="light efficiency, %", ylabel="median error of the depth, %")
    axes.legend(frameon=False, fontsize=8, ncols=2, loc="lower left")
    return figure


def _comparisons(right: dict[tuple[str, str], float]) -> list[Comparison]:
    """Compare with the paper; ``right`` is the fraction within 5 %, by design and light."""
    level, _, dim = LIGHTS
    v, vi = right["cy_halves", dim], right["magenta_annulus", dim]
    kept = {d: right[d, dim] / max(right[d, level], 1e-9) for d in _DESIGNS}
    order = {c: ", ".join(NUMERALS[d] for d in sorted(_DESIGNS, key=lambda d: -right[d, c])) for c in LIGHTS}
    return [
        Comparison("V better than VI at equal light", "yes",
                   f"{'yes' if v > vi else 'no'}: {v:.0%} against {vi:.0%} within 5 %",
                   "Judged in dim light at equal time."),
        Comparison("I and II are dark", "5.5 % of the light for II",
                   f"in dim light I keeps {kept['rgb_circles']:.0%}, II {kept['rgb_squares']:.0%}, V "
                   f"{kept['cy_halves']:.0%}, VII {kept['cy_open']:.0%} of their right pixels",
                   "A design that passes little loses most in dim light."),
        *(Comparison(f"ranking, {c}", "V for depth, VII for light", order[c],
                     f"By the fraction within 5 %, best first. {_WHY[c]}") for c in LIGHTS),
    ]  # fmt: skip
