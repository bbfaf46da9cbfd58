"""Figure 14: the restored picture, refocused by depth."""

from __future__ import annotations

import numpy as np

from chromaperture.camera.camera import CodedApertureCamera
from chromaperture.camera.method import default_config
from chromaperture.color.color_maps import DISTANCE
from chromaperture.color.srgb import linear_to_srgb
from chromaperture.effects.refocusing import Focus, refocus
from chromaperture.effects.restore import restore
from chromaperture.evaluation.figures import new_figure, show_image
from chromaperture_paper import world
from chromaperture_paper.context import Context
from chromaperture_paper.exhibit import Chart, Comparison, Content


def make(context: Context) -> Content:
    """Measure a scene with the calibrated camera, restore it, focus on the front and on the back."""
    simulated = context.simulated
    result, source = simulated.calibrated()
    shot = simulated.session_capture(world.still_life(seed=14, saturation=0.6), seed=14)
    camera = CodedApertureCamera(result.calibration, default_config(result.calibration, "real-time"))
    frame = camera.measure(shot.image)
    sharp = restore(shot.image, frame.disparity_px, camera, sigma_px=frame.disparity_sigma_px, sharpness="fast")
    near, far = (float(v) for v in np.percentile(sharp.radius_px, (3, 90)))
    pictures = {"(a) restored": sharp.color}
    for title, at in (("(c) focus on the foreground", near), ("(d) focus on the background", far)):
        pictures[title] = refocus(sharp.color, sharp.radius_px, Focus(at, strength=1.5))
    figure = new_figure(height=4.6)
    first, disparity, *rest = figure.subplots(2, 2).ravel()
    show_image(disparity, frame.disparity_px, "(b) disparity, px", bar="", colors=DISTANCE)
    white = float(np.percentile(sharp.color, 99.5))
    for axes, (title, picture) in zip((first, *rest), pictures.items(), strict=True):
        show_image(axes, linear_to_srgb(np.clip(picture / white, 0, 1)), title)
    return Content(
        source=f"{source} The scene is photographed by the same simulated lens.",
        charts=[Chart("effects", figure, "One capture; the focus is set afterwards.")],
        comparisons=[
            Comparison("effects", "pictures of a telephone", "pictures of a simulated reflex camera",
                       "The same chain: disparity, restored colour, blur by depth.")
        ],
    )  # fmt: skip
