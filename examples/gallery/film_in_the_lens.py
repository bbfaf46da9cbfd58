"""
Film in the lens, good and bad
==============================

Where the film sits decides whether there is depth at all. A lens of known prescription shows what you would see.
"""

import matplotlib.pyplot as plt
import numpy as np

from chromaperture.optics.aperture import DESIGNS, made_of
from chromaperture.optics.pinhole import focused_at
from chromaperture.optics.prescription import load_lens, with_filter_at
from chromaperture.optics.printing.board_pattern import board_page, speckle
from chromaperture.optics.ray_table import lens_rays, trace
from chromaperture.optics.simulator.render import render
from chromaperture.optics.simulator.scene import plane

COLOURS = ["#30c0d8", "#f2dc30"]
FRONT_MM = -30.0  # before the stop: a holder in front of the lens
lens = focused_at(load_lens("double_gauss_50"), 2000.0)
aperture = made_of(DESIGNS["cy_halves"], "lee")


def draw_lens(axes, film_mm, title):
    """The lens in section, film at a distance from the stop, light from the middle and from the side of the scene."""
    at, stop = lens.vertices_mm, lens.vertices_mm[lens.stop_index]
    for z, surface in zip(at, lens.surfaces, strict=True):
        y = np.linspace(-1, 1, 61) * surface.semi_diameter_mm
        if surface.role == "stop":
            for side in (-1, 1):
                axes.plot([z, z], [side * surface.semi_diameter_mm, side * 14], color="black", lw=3)
            continue
        sag = y**2 / surface.radius_mm / (1 + np.sqrt(1 - (y / surface.radius_mm) ** 2))
        axes.plot(z + sag, y, color="0.45", lw=1)
    for colour, ends in zip(COLOURS, ((0, 9), (-9, 0)), strict=True):
        axes.plot([stop + film_mm] * 2, ends, color=colour, lw=5, solid_capstyle="butt")
    heights = np.linspace(-8, 8, 9)
    for slope, colour in ((0.0, "#404040"), (0.22, "#c02020")):
        start = np.stack([np.zeros(9), heights - slope * 40, np.full(9, -40.0)], axis=1)
        ahead = np.broadcast_to([0.0, slope, 1.0], start.shape)
        passed = trace(lens, start, ahead, wavelength_um=0.54)
        rays = start, passed.position, passed.direction, passed.clear
        for first, last, direction, is_clear in zip(*rays, strict=True):
            if is_clear:
                end = last + direction * (lens.sensor_gap_mm / direction[2])
                axes.plot([first[2], last[2], end[2]], [first[1], last[1], end[1]], color=colour, lw=0.5)
    axes.plot([lens.first_vertex_to_sensor_mm] * 2, [-14, 14], color="black", lw=1)
    axes.set(title=title, xlim=(-45, 72), ylim=(-18, 18), aspect="equal")
    axes.axis("off")


# %%
# Two pieces of film across the pupil. At the stop (above) every point of the scene, in the middle (black) or at the
# side (red), sends its light through both. In front of the lens (below) what comes from the side passes mostly one.

figure, (above, below) = plt.subplots(2, 1, figsize=(7, 5), layout="constrained")
draw_lens(above, 0.0, "at the stop: good")
draw_lens(below, FRONT_MM, "in front of the lens: bad")


# %%
# A white sheet shows it, before anything is calibrated. Good film colours the whole frame alike; where it turns from
# one colour to the other across the frame, the film is not at the stop.


def white_sheet(film_mm):
    size = {"width_px": 180, "height_px": 120, "pixel_pitch_mm": 22.3 / 180}
    optics = with_filter_at(lens, film_mm) if film_mm else lens
    sheet = [plane(np.ones((2, 2, 3), np.float32), center_mm=(0, 0, 500.0), width_mm=4000)]
    picture = render(lens_rays(optics, aperture, **size, cells=12), sheet)
    return np.clip(picture / np.percentile(picture, 99.5), 0, 1) ** (1 / 2.2)


figure, axes = plt.subplots(1, 3, figsize=(7, 1.8), layout="constrained")
for panel, film_mm, title in zip(
    axes, (0.0, -5.0, FRONT_MM), ("at the stop", "5 mm before it", "in front of the lens"), strict=True
):
    panel.imshow(white_sheet(film_mm))
    panel.set_title(title)
    panel.axis("off")

# %%
# The board on the wall: a chessboard for the distances in speckle for the matcher, and pages of speckle around it,
# because white wall tells nothing.

page = board_page()
(width, height), (x, y) = page.size_mm, page.origin_mm
figure, wall = plt.subplots(figsize=(7, 5), layout="constrained")
for place in range(9):
    left_mm, top_mm = width * (place % 3 - 1), height * (place // 3 - 1)
    extent = (left_mm + 3, left_mm + width - 3, top_mm + height - 3, top_mm + 3)
    wall.imshow(speckle(page.size_mm, seed=place), cmap="gray", vmin=0, vmax=255, extent=extent)
side = page.square_mm
board_mm = (page.inner_corners[0] + 2) * side, (page.inner_corners[1] + 2) * side
wall.add_patch(plt.Rectangle((x - side / 2, y - side / 2), *board_mm, color="white"))
for corner in page.squares():
    wall.add_patch(plt.Rectangle(corner, side, side, color="black"))
wall.set(xlim=(-width, 2 * width), ylim=(2 * height, -height))
wall.axis("off")
