"""Depth error against light efficiency: all designs at equal time, in good and in dim light, and at equal level."""

from __future__ import annotations

from functools import partial

import numpy as np

from chromaperture.evaluation.figures import BLUE, GREY, RED, new_figure, tidy
from chromaperture.evaluation.paper import world
from chromaperture.evaluation.paper.context import Context
from chromaperture.evaluation.paper.exhibit import Compared, Drawn, Listed, Made
from chromaperture.evaluation.paper.trial import Trial
from chromaperture.evaluation.paper.world import EIGHT, NUMERALS
from chromaperture.evaluation.tables import Table
from chromaperture.optics.aperture import channel_transmission
from chromaperture.optics.depth_error_bound import expected_accuracy

_DIM = 0.03  # of white level that white paper reaches through the open pupil
_AT_MM = 2600.0  # where the bound is taken
CONDITIONS = ("equal level", "equal time", "equal time, dim")
_WHY = {
    "equal level": "Exposed as long as it takes (15 and 9 times as long as VIII), I and II are best: their openings "
    "are small, blur little and lie far apart; the paper does not rank at equal level.",
    "equal time": "In good light there are photons for all, and what counts is how far apart the views are.",
    "equal time, dim": "What the paper argues: where light is short, I and II have too little of it. VII has most, but "
    "its views lie a third as far apart, which costs more than light wins.",
}
_COLORS = dict(zip(CONDITIONS, (GREY, BLUE, RED), strict=True))


def make(context: Context) -> Made:
    """Sweep designs, light and seeds on all cores."""
    designs = [name for name in EIGHT if name != "open"]
    width, height = context.scene_size
    seeds = range(1 if context.quick else 3)
    cases = [(design, condition, seed) for design in designs for condition in CONDITIONS for seed in seeds]
    trials = [
        Trial(
            method="annulus" if design == "magenta_annulus" else "ours, paper",
            design=design,
            exposure=_exposure(design, condition),
            width_px=width,
            height_px=height,
            cells=context.cells,
            seed=seed,
        )
        for design, condition, seed in cases
    ]
    results = context.sweep(trials, "trials of equal-light")
    camera = world.camera_of(width, height)

    def mean(design: str, condition: str, key: str) -> float:
        found = [r[key] for (d, c, _), r in zip(cases, results, strict=True) if (d, c) == (design, condition)]
        return float(np.mean(found))

    light = {name: float(channel_transmission(world.real_film(name)).mean()) for name in designs}
    bound = {
        (name, condition): float(expected_accuracy(world.real_film(name), camera, np.array([_AT_MM]),
                                                   exposure=_exposure(name, condition)).sigma_mm[0]) / _AT_MM
        for name in designs for condition in CONDITIONS
    }  # fmt: skip
    rows = [
        (f"{NUMERALS[d]} {d}", f"{light[d]:.0%}", c, f"{mean(d, c, 'median_error'):.2%}",
         f"{mean(d, c, 'within_2'):.1%}",
         f"{mean(d, c, 'within_5'):.1%}", f"{bound[d, c]:.2%}" if np.isfinite(bound[d, c]) else "-")
        for d in designs for c in CONDITIONS
    ]  # fmt: skip
    figure = new_figure(height=3.8)
    axes = figure.subplots()
    for condition in CONDITIONS:
        color = _COLORS[condition]
        errors = [100 * mean(d, condition, "median_error") for d in designs]
        axes.plot([100 * light[d] for d in designs], errors, "o", color=color, label=condition)
        views = sorted((d for d in designs if np.isfinite(bound[d, condition])), key=lambda d: light[d])
        axes.plot(
            [100 * light[d] for d in views], [100 * bound[d, condition] for d in views], "--", color=color, alpha=0.6
        )
        if condition == CONDITIONS[-1]:
            for d, error in zip(designs, errors, strict=True):
                axes.annotate(
                    NUMERALS[d], (100 * light[d], error), xytext=(4, 4), textcoords="offset points", fontsize=9
                )
    axes.plot([], [], "--", color=GREY, alpha=0.8, label=f"Cramer-Rao, grey wall at {_AT_MM:.0f} mm")
    axes.axvline(100, color=GREY, linewidth=0.8)
    axes.annotate("VIII: no depth", (100, 0.5), xycoords=("data", "axes fraction"), rotation=90, fontsize=8,
                  ha="right", va="center", color=GREY)
    axes.margins(y=0.12)
    axes.set_yscale("log")
    tidy(axes, xlabel="light efficiency, %", ylabel="median error of the depth, %")
    axes.legend(frameon=False, fontsize=8, ncols=2, loc="lower left")
    head = ("design", "light", "exposure", "median error", "within 2 %", "within 5 %", "Cramer-Rao")
    five = {(d, c): mean(d, c, "within_5") for d in designs for c in CONDITIONS}
    order = {c: [NUMERALS[d] for d in sorted(designs, key=partial(_negative, five, c))] for c in CONDITIONS}
    dim = CONDITIONS[-1]
    v_vi = five["cy_halves", dim] > five["magenta_annulus", dim]
    fall = {d: five[d, dim] / max(five[d, "equal level"], 1e-9) for d in designs}
    return Made(
        source=f"Simulated: {len(seeds)} still life{'s' if len(seeds) > 1 else ''} a point, {width}x{height} px.",
        drawn=[Drawn("equal-light", figure, "Right and low is good. Dashed: no method can be better on a grey wall, "
                     "with the same window; edges, occlusions and colours cost the rest.")],
        listed=[Listed("equal-light", Table("Equal level: white paper at 0.9; equal time: 0.9 through the open pupil; "
                                            f"dim: {_DIM:g} through the open pupil", head, rows))],
        compared=[
            Compared("V better than VI at equal light", "yes",
                     f"{'yes' if v_vi else 'no'}: {five['cy_halves', dim]:.0%} against "
                     f"{five['magenta_annulus', dim]:.0%} within 5 %", "Judged in dim light at equal time."),
            Compared("I and II are dark", "5.5 % of the light for II",
                     f"in dim light I keeps {fall['rgb_circles']:.0%}, II {fall['rgb_squares']:.0%}, V "
                     f"{fall['cy_halves']:.0%}, VII {fall['cy_open']:.0%} of their right pixels",
                     "A design that passes little loses most when the light goes."),
            *(Compared(f"ranking, {c}", "V for depth, VII for light", ", ".join(order[c]),
                       f"By the share within 5 %, best first. {_WHY[c]}") for c in CONDITIONS),
        ],
    )  # fmt: skip


def _negative(shares: dict[tuple[str, str], float], condition: str, design: str) -> float:
    return -shares[design, condition]


def _exposure(design: str, condition: str) -> float:
    if condition == "equal level":
        return world.level_exposure(design)
    return world.WHITE if condition == "equal time" else _DIM
