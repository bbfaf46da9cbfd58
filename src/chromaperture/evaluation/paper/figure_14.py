"""Figure 14: the restored picture and its focus moved by depth."""

from __future__ import annotations

import numpy as np

from chromaperture.camera import CodedApertureCamera
from chromaperture.camera_matching import default_config
from chromaperture.color.srgb import linear_to_srgb
from chromaperture.effects.refocusing import Focus, refocus
from chromaperture.effects.restore import restore
from chromaperture.evaluation.figures import new_figure
from chromaperture.evaluation.paper import world
from chromaperture.evaluation.paper.context import Context
from chromaperture.evaluation.paper.exhibit import Compared, Drawn, Made


def make(context: Context) -> Made:
    """Measure a scene with the calibrated camera, restore it, focus on the front and on the back."""
    simulated = context if context.data is None else Context(context.out, quick=context.quick, workers=context.workers)
    result, source = simulated.calibrated()
    calibration = result.calibration
    optics = context.session_camera
    table = world.traced_table(optics, world.real_film("cy_halves"), context.cells)
    shot = world.photograph(
        table, world.still_life(seed=14, saturation=0.6), optics, seed=14, exposure=world.level_exposure("cy_halves")
    )
    camera = CodedApertureCamera(calibration, default_config(calibration, "real-time"))
    frame = camera.measure(shot.image)
    sharp = restore(shot.image, frame.disparity_px, camera, sigma_px=frame.disparity_sigma_px, sharpness="fast")
    near, far = (float(v) for v in np.percentile(sharp.radius_px, (3, 90)))
    focused = [refocus(sharp.color, sharp.radius_px, Focus(at, strength=1.5)) for at in (near, far)]
    figure = new_figure(height=4.6)
    pictures = (sharp.color, None, *focused)
    titles = ("(a) restored", "(b) disparity, px", "(c) focus on the foreground", "(d) focus on the background")
    white = float(np.percentile(sharp.color, 99.5))
    for axes, picture, title in zip(figure.subplots(2, 2).ravel(), pictures, titles, strict=True):
        if picture is None:
            shown = axes.imshow(frame.disparity_px, cmap="viridis")
            figure.colorbar(shown, ax=axes, fraction=0.03)
        else:
            axes.imshow(linear_to_srgb(np.clip(picture / white, 0, 1)))
        axes.set_title(title, fontsize=9, loc="left")
        axes.set_axis_off()
    return Made(
        source=f"{source} The scene is photographed by the same simulated lens.",
        drawn=[Drawn("effects", figure, "One capture; the focus is set afterwards.")],
        compared=[
            Compared("effects", "pictures of a telephone", "pictures of a simulated reflex camera",
                     "The same chain: disparity, restored colour, blur by depth.")
        ],
    )  # fmt: skip
