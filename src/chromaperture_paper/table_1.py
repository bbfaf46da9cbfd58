"""Table 1: transparency maps of designs VII, V and II, channel by channel."""

from __future__ import annotations

from chromaperture.color.color_maps import OTHER
from chromaperture.color.transparency_map import light_efficiency
from chromaperture.evaluation.figures import new_figure, show_image
from chromaperture_paper.context import Context
from chromaperture_paper.exhibit import Chart, Comparison, Content, CsvTable
from chromaperture_paper.white import transparencies, white_sheets
from chromaperture_paper.world import NUMERALS, full_name

# Read off the paper: minimum and maximum for R, G, B, and the integral efficiency.
PAPER = {
    "cy_open": (((0.84, 0.97), (0.90, 0.98), (0.78, 0.89)), 0.86),
    "cy_halves": (((0.46, 0.54), (0.72, 0.76), (0.34, 0.41)), 0.55),
    "rgb_squares": (((0.04, 0.06), (0.05, 0.07), (0.06, 0.08)), 0.055),
}
_WHY = {
    "cy_open": "The paper's film and the width of its open part are not given; ours are chosen to be close.",
    "cy_halves": "The film is chosen after this row; the variation over the frame is the lens's vignetting.",
    "rgb_squares": "Squares of this size pass 16 % with ideal film and 13 % with ours: the paper's film is darker, or "
    "its squares are smaller.",
}


def make(context: Context) -> Content:
    """Divide white sheets, Eq. (11)."""
    sheets, source = white_sheets(context, ("open", *PAPER))
    maps = transparencies(sheets)
    figure = new_figure(height=6.0)
    panels = figure.subplots(3, len(maps), squeeze=False)
    rows, comparisons = [], []
    for column, (name, transparency) in enumerate(maps.items()):
        light = light_efficiency(transparency)
        limits = list(zip("RGB", light.minimum, light.maximum, strict=True))
        for k, (channel, low, high) in enumerate(limits):
            title = f"{NUMERALS[name]} {channel}: {low:.2f} to {high:.2f}"
            show_image(panels[k, column], transparency[..., k], title, bar="", colors=OTHER)
        rows.append((full_name(name), *(f"{a:.3f} to {b:.3f}" for _, a, b in limits), f"{light.efficiency:.1%}"))
        ranges, efficiency = PAPER[name]
        theirs = ", ".join(f"{c} {a:.2f} to {b:.2f}" for c, (a, b) in zip("RGB", ranges, strict=True))
        ours = ", ".join(f"{c} {a:.2f} to {b:.2f}" for c, a, b in limits)
        title, why = NUMERALS[name], _WHY[name]
        comparisons += [
            Comparison(f"{title}, transparency", theirs, ours, why),
            Comparison(f"{title}, light efficiency", f"{efficiency:.1%}", f"{light.efficiency:.1%}", why),
        ]
    caption = "Transparency, smallest to largest over the frame"
    table = CsvTable("transparency", caption, ("design", "R", "G", "B", "mean"), rows)
    return Content(source, [Chart("maps", figure, "Eq. (11), as in Table 1.")], [table], comparisons)
