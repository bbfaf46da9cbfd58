"""
Why colours move
================

A point out of focus is drawn as the picture of the pupil: upright beyond the focus, turned by 180 degrees before it.
With film in the pupil the picture is coloured, and its red and blue halves lie on different sides.
"""

import matplotlib.pyplot as plt
import numpy as np

import chromaperture as cap
from chromaperture.optics.aperture import centroids
from chromaperture.optics.pinhole import PupilCamera
from chromaperture.optics.psf import geometric_psf

design = cap.DESIGNS["cy_halves"]
camera = PupilCamera(
    width_px=720,
    height_px=480,
    focal_px=1660,
    pupil_radius_mm=12.5,
    focus_mm=2000,
    sensor_to_pupil_mm=70,
    pixel_pitch_mm=0.031,
)
distances = np.array([1000.0, 1400.0, 2000.0, 3000.0, 4000.0])
figure, tiles = plt.subplots(1, 5, figsize=(11, 2.7), layout="constrained")
for tile, distance in zip(tiles, distances, strict=True):
    blur = geometric_psf(design, float(camera.blur_radius_px(distance)), 41)
    tile.imshow(np.moveaxis(blur / blur.max(axis=(1, 2), keepdims=True), 0, -1))
    tile.set_title(f"{distance:.0f} mm")
    tile.axis("off")

# %%
# Disparity is the displacement of a colour's centre of light. Over inverse distance it is a straight line, Eq. (6),
# :math:`d = A - B / z`; over distance it is a curve that flattens: far away, a pixel is worth ever more millimetres.

red, _, blue = centroids(design)  # pupil radii
beta = abs(red[0] - blue[0]) / 2
z = np.linspace(800, 6000, 300)
d = camera.disparity_px(z, beta)
figure, (line, curve) = plt.subplots(1, 2, figsize=(11, 3.6), layout="constrained")
line.plot(1000 / (z - camera.sensor_to_pupil_mm), d, "k")
line.set(xlabel="1 / distance from the pupil, 1/m", ylabel="half disparity, px")
curve.plot(z, 0.1 * np.abs(np.gradient(z, d)) / z * 100, "k")
curve.set(xlabel="distance from the sensor, mm", ylabel="a tenth of a pixel is worth, % of it", ylim=(0, None))
for axes in (line, curve):
    axes.grid(alpha=0.3)
