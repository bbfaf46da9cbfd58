"""
Dual pixels
===========

A sensor whose pixels are split in two needs no film: the left and the right picture of one exposure see two sides of
the pupil. This example simulates such a camera, photographs two flat boards and a scene, and goes from the files to
millimetres, as ``chromaperture calibrate`` and ``chromaperture depth`` do.
"""

import tempfile
from pathlib import Path

import cv2
import matplotlib.pyplot as plt
import numpy as np

import chromaperture as cap
from chromaperture.optics.dual_pixel_rays import HalfPixels, half_pixel_rays
from chromaperture.optics.pinhole import PupilCamera
from chromaperture.optics.ray_table import pinhole_rays
from chromaperture.optics.simulator.render import render
from chromaperture.optics.simulator.scene import plane
from chromaperture.optics.simulator.sensor import SensorModel, expose
from chromaperture.optics.simulator.textures import noise

# A 50 mm lens at f/2, focused at 1 m. Half a pixel sees a ramp across the pupil, not one side of it alone.
lens = PupilCamera(288, 192, focal_px=600.0, pupil_radius_mm=12.5, focus_mm=1000.0, sensor_to_pupil_mm=50.0,
                   pixel_pitch_mm=0.0833)  # fmt: skip
halves = HalfPixels(slope=0.6, half_slope_px=300.0)
rays = half_pixel_rays(pinhole_rays(lens, cap.DESIGNS["open"], cells=10), halves, pupil_radius_mm=12.5)
sensor = SensorModel(full_well_electrons=60_000, read_noise_electrons=8, black_level=0, white_level=65535, bits=16)
folder = Path(tempfile.mkdtemp())


def paper(distance_mm, width_mm, seed, x_mm=0.0):
    """A printed sheet square to the axis."""
    grey = noise((400, 600), exponent=0.8, seed=seed, mean=0.45, contrast=0.16)
    return plane(np.repeat(grey[..., None], 3, axis=2), center_mm=(x_mm, 0.0, distance_mm), width_mm=width_mm)


def photograph(name, planes, seed=0):
    """Write NAME_left.png and NAME_right.png; the rays give red to the right half and blue to the left one."""
    counts = expose(render(rays, planes), sensor, seed=seed)
    for side, channel in (("right", 0), ("left", 2)):
        cv2.imwrite(str(folder / f"{name}_{side}.png"), counts[..., channel])


# %%
# Two boards are enough. ``flat = true``: they are full of texture and have no chessboard.

photograph("near", [paper(650, 500, seed=1)], seed=1)
photograph("far", [paper(1800, 1400, seed=2)], seed=2)
(folder / "distances.csv").write_text("file,ruler_mm\nnear_left.png,650\nfar_left.png,1800\n")
(folder / "session.toml").write_text(
    """
[sensor]
width_px = 288
height_px = 192
pixel_pitch_mm = 0.0833
dual_pixel = "left-right"
[lens]
nominal_focal_length_mm = 50
nominal_f_number = 2
focused_at_about_mm = 1000
[board]
flat = true
"""
)
calibration = cap.calibrate(folder)
print(calibration, *calibration.provenance["notes"], sep="\n")

# %%
# A sheet at 800 mm before a wall at 1600 mm. The path of the left picture finds the right one.

photograph("scene", [paper(1600, 1300, seed=3), paper(800, 180, seed=4, x_mm=-40.0)], seed=3)
calibration.save(folder / "camera.asdf")
camera = cap.load_camera(folder / "camera.asdf", quality="accurate", device="cpu")
frame = camera.measure(folder / "scene_left.png")
figure = frame.show()

# %%
# The parallax behind it: about a pixel between the nearest and the farthest, a third of what film of two halves gives.

distances = np.geomspace(500, 4000, 100)
curve = calibration.on_axis("accurate")
figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
axes.semilogx(distances, cap.depth_to_disparity(distances, curve), label="measured on two boards")
axes.semilogx(distances, lens.disparity_px(distances, halves.slope / 4), "--", label="of the ramps")
axes.set(xlabel="distance from the sensor, mm", ylabel="half disparity, px")
axes.legend()
axes.grid(alpha=0.3, which="both")
