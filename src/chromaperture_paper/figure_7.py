"""Figure 7: equivalent baseline and in-focus surface over the frame."""

from __future__ import annotations

import numpy as np

from chromaperture.evaluation.figures import baseline_map, draw_surfaces
from chromaperture_paper.context import Context
from chromaperture_paper.exhibit import Chart, Comparison, Content


def make(context: Context) -> Content:
    """Draw the fields of the calibrated camera."""
    result, source = context.calibrated()
    focus, baseline = result.calibration.depth_model("paper").in_focus_mm, baseline_map(result)
    return Content(
        source=source,
        charts=[Chart("surfaces", draw_surfaces(result),
                      "A flat focus surface and an even baseline would have one colour; the lens curves the focus, its "
                      "rims cut the baseline.")],
        comparisons=[
            Comparison("in-focus surface", "curved (a picture, no figure)",
                       f"{np.percentile(focus, 1):.0f} to {np.percentile(focus, 99):.0f} mm",
                       "Another lens, so another curvature; like the paper's it is curved."),
            Comparison("baseline b", "uneven (a picture, no figure)",
                       f"{np.percentile(baseline, 1):.2f} to {np.percentile(baseline, 99):.2f} mm",
                       "Vignetting cuts the pupil towards the corners, which takes area from the outer side."),
        ],
    )  # fmt: skip
