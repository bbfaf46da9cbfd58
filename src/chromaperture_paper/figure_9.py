"""Figure 9: depth error with whole layers and with sub-pixel estimation."""

from __future__ import annotations

import numpy as np

from chromaperture.evaluation.figures import draw_layers, layer_errors, ruler_distances
from chromaperture_paper.context import Context
from chromaperture_paper.exhibit import Chart, Comparison, Content, CsvTable


def make(context: Context) -> Content:
    """Compare the median error of a pixel on the boards."""
    result, source = context.calibrated()
    whole, half, fine = layer_errors(result)
    rows = [
        (f"{ruler:.0f}", *(f"{v:.1f}" for v in values))
        for ruler, *values in zip(ruler_distances(result), whole, half, fine, strict=True)
    ]
    ratio = float(np.nanmedian(whole / fine))
    return Content(
        source=source,
        charts=[Chart("layers", draw_layers(result), "Median error of single pixels in the middle of the frame.")],
        tables=[CsvTable("layers", "Median error of a pixel, mm",
                         ("ruler, mm", "layers of 1 px", "the matcher's layers", "sub-pixel"), rows)],
        comparisons=[
            Comparison("sub-pixel against layers", "significantly better (a picture)",
                       f"{ratio:.1f} times smaller error than whole-px layers, in the median over the boards",
                       "Agrees. Near the focus blur is small and both are good; layers are worst where depth "
                       "changes most per px. A board whose disparity happens to be a layer favours them.")
        ],
    )  # fmt: skip
