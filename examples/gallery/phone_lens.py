"""
My phone's lens
===============

A lens of 4 mm has a pupil of 2 mm: how far does it see depth? This example takes a prescription of such a lens, which
could as well be your own as a TOML file, and asks before anything is cut.
"""

import matplotlib.pyplot as plt
import numpy as np

import chromaperture as cap
from chromaperture.optics.aperture import centroids, made_of
from chromaperture.optics.depth_error_bound import expected_accuracy
from chromaperture.optics.pinhole import focused_at, pupil_camera
from chromaperture.optics.prescription import load_lens
from chromaperture.optics.psf import diffraction_psf

WIDTH, HEIGHT, SENSOR_MM = 1440, 960, 3.6
design = made_of(cap.DESIGNS["cy_halves"], "real")


def phone(focus_mm: float):
    """The lens, focused at a distance from the sensor, as a pinhole with a pupil."""
    lens = focused_at(load_lens("phone_4"), focus_mm)
    return pupil_camera(lens, width_px=WIDTH, height_px=HEIGHT, pixel_pitch_mm=SENSOR_MM / WIDTH)


near = phone(300)
print(f"pupil {2 * near.pupil_radius_mm:.2f} mm, f/{near.f_number:.1f}, {near.focal_px:.0f} px of focal length")

# %%
# Half disparity over distance at three focus settings. The baseline is below a millimetre, so a phone measures things
# on the table and not the room.

red, _, blue = centroids(design)
beta = abs(red[0] - blue[0]) / 2
figure, (parallax, error) = plt.subplots(1, 2, figsize=(11, 4), layout="constrained")
for focus in (200, 300, 500):
    camera = phone(focus)
    distances = np.geomspace(120, 1500, 80)
    bound = expected_accuracy(design, camera, distances)
    parallax.semilogx(distances, camera.disparity_px(distances, beta), label=f"focused at {focus} mm")
    error.loglog(distances, 100 * bound.sigma_mm / distances)
parallax.axhline(0, color="0.7", linewidth=0.8)
parallax.set(xlabel="distance from the sensor, mm", ylabel="half disparity, px")
parallax.legend()
error.set(xlabel="distance from the sensor, mm", ylabel="least error of a pixel, % of the distance")
for axes in (parallax, error):
    axes.grid(alpha=0.3, which="both")

# %%
# Diffraction, which lenses of this size cannot leave out: the blur of a point at 200 mm, with the waves of light.

blur = diffraction_psf(design, near, 200.0, size=61)
figure, axes = plt.subplots(figsize=(4, 4), layout="constrained")
axes.imshow(np.moveaxis(np.sqrt(blur / blur.max(axis=(1, 2), keepdims=True)), 0, -1))
axes.set_title("point at 200 mm, focus at 300 mm")
axes.axis("off")

# %%
# ``chromaperture simulate session/phone --lens phone_4 --sensor-width-mm 3.6 --focus-mm 300`` goes on from here: a
# whole calibration session with this lens.
