"""Table 1: transparency maps of designs VII, V and II, channel by channel."""

from __future__ import annotations

from chromaperture.color.transparency_map import light_efficiency
from chromaperture.evaluation.figures import new_figure
from chromaperture.evaluation.paper.context import Context
from chromaperture.evaluation.paper.exhibit import Compared, Drawn, Listed, Made
from chromaperture.evaluation.paper.white import shares, white_sheets
from chromaperture.evaluation.paper.world import NUMERALS
from chromaperture.evaluation.tables import Table

# Read off the paper: minimum and maximum for R, G, B, and the integral efficiency.
PAPER = {
    "cy_open": (((0.84, 0.97), (0.90, 0.98), (0.78, 0.89)), 0.86),
    "cy_halves": (((0.46, 0.54), (0.72, 0.76), (0.34, 0.41)), 0.55),
    "rgb_squares": (((0.04, 0.06), (0.05, 0.07), (0.06, 0.08)), 0.055),
}
_WHY = {
    "cy_open": "The paper's film and the width of its open part are not given; ours are chosen to come near.",
    "cy_halves": "The film is chosen after this row; the spread over the frame is the lens's vignetting.",
    "rgb_squares": "Squares of this size pass 16 % with ideal film and 13 % with ours: the paper's film is darker, or "
    "its squares are smaller.",
}


def make(context: Context) -> Made:
    """Divide white sheets, Eq. (11)."""
    sheets, source = white_sheets(context, ("open", *PAPER))
    maps = shares(sheets)
    figure = new_figure(height=6.0)
    panels = figure.subplots(3, len(maps), squeeze=False)
    rows, compared = [], []
    for column, (name, share) in enumerate(maps.items()):
        light = light_efficiency(share)
        cells = [f"{NUMERALS[name]} {name}"]
        for k, channel in enumerate("RGB"):
            axes = panels[k, column]
            shown = axes.imshow(share[..., k], cmap="viridis")
            figure.colorbar(shown, ax=axes, fraction=0.04)
            low, high = light.minimum[k], light.maximum[k]
            axes.set_title(f"{NUMERALS[name]} {channel}: {low:.2f} to {high:.2f}", fontsize=9, loc="left")
            axes.set_axis_off()
            cells.append(f"{low:.3f} to {high:.3f}")
        rows.append((*cells, f"{light.efficiency:.1%}"))
        ranges, efficiency = PAPER[name]
        theirs = ", ".join(f"{c} {a:.2f} to {b:.2f}" for c, (a, b) in zip("RGB", ranges, strict=True))
        ours = ", ".join(f"{c} {a:.2f} to {b:.2f}" for c, a, b in zip("RGB", light.minimum, light.maximum, strict=True))
        compared.append(Compared(f"{NUMERALS[name]}, transparency", theirs, ours, _WHY[name]))
        compared.append(
            Compared(f"{NUMERALS[name]}, light efficiency", f"{efficiency:.1%}", f"{light.efficiency:.1%}", _WHY[name])
        )
    table = Table("Transparency, smallest to largest over the frame", ("design", "R", "G", "B", "mean"), rows)
    return Made(source, [Drawn("maps", figure, "Eq. (11), as in Table 1.")], [Listed("transparency", table)], compared)
