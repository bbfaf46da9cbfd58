"""Figure 7: equivalent baseline and in-focus surface over the frame."""

from __future__ import annotations

import numpy as np

from chromaperture.evaluation.figures import draw_surfaces
from chromaperture.evaluation.paper.context import Context
from chromaperture.evaluation.paper.exhibit import Compared, Drawn, Made


def make(context: Context) -> Made:
    """Draw the fields of the calibrated camera."""
    result, source = context.calibrated()
    paper = result.calibration.paper_parameters(result.calibration.depth_model("paper"))
    focus, baseline = np.asarray(paper.in_focus_mm, float), np.asarray(paper.baseline_mm, float)
    return Made(
        source=source,
        drawn=[Drawn("surfaces", draw_surfaces(result),
                     "A flat focus surface and an even baseline would have one colour; the lens bends the one, its "
                     "rims cut the other.")],
        compared=[
            Compared("in-focus surface", "curved (a picture, no figure)",
                     f"{np.percentile(focus, 1):.0f} to {np.percentile(focus, 99):.0f} mm",
                     "Another lens, so another curvature; like the paper's it is curved."),
            Compared("baseline b", "uneven (a picture, no figure)",
                     f"{np.percentile(baseline, 1):.2f} to {np.percentile(baseline, 99):.2f} mm",
                     "Vignetting cuts the pupil towards the corners, which takes area from the outer side."),
        ],
    )  # fmt: skip
