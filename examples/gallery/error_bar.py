"""
Is the error bar honest?
========================

The simulator traces rays through a lens prescription, so the distance of everything in its photographs is known. Here
`examples/desk.toml` is photographed through the lens of the sample camera, and each pixel's error is compared with
the error bar that the measurement gave it.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import chromaperture as cap
from chromaperture.optics.aperture import DESIGNS, made_of
from chromaperture.optics.prescription import load_lens
from chromaperture.optics.ray_table import lens_rays
from chromaperture.optics.simulator.render import render, render_depth
from chromaperture.optics.simulator.scene import load_scene
from chromaperture.optics.simulator.sensor import SensorModel, develop, expose

here = Path(__file__).parent if "__file__" in globals() else Path.cwd()  # a notebook has no file
scene = load_scene(here.parent / "desk.toml")
camera = cap.load_camera(cap.sample_camera("still_life_cy_halves"), quality="real-time")
sensor = camera.calibration.sensor
rays = lens_rays(
    load_lens("double_gauss_50"),
    made_of(DESIGNS["cy_halves"], "real"),
    width_px=sensor.width_px,
    height_px=sensor.height_px,
    pixel_pitch_mm=sensor.pixel_pitch_mm,
    cells=12,
)
light, truth_mm = render(rays, scene), render_depth(rays, scene)

# %%
# The sensor adds photon noise, reading noise and rounding; then the photograph is measured like any other.

counts = expose(light / light.max(), SensorModel(), seed=1)
frame = camera.measure(develop(counts, SensorModel()))
frame.show()

# %%
# Errors in units of the error bar. Were the bars those of a normal distribution, 68 % would lie within one of them and
# 95 % within two. A higher share means bars that are longer than they need be: here, on surfaces full of texture, they
# are.

known = np.isfinite(frame.depth_mm) & np.isfinite(truth_mm)
error = (frame.depth_mm - truth_mm)[known]
ratio = error / frame.sigma_mm[known]
within = {bars: float(np.mean(np.abs(ratio) < bars)) for bars in (1, 2, 3)}
print(", ".join(f"{share:.0%} within {bars} error bars" for bars, share in within.items()))

figure, histogram = plt.subplots(figsize=(7, 4), layout="constrained")
x = np.linspace(-5, 5, 201)
histogram.hist(ratio, bins=np.linspace(-5, 5, 81), density=True, color="0.75", label="pixels")
histogram.plot(x, np.exp(-(x**2) / 2) / np.sqrt(2 * np.pi), "k", label="normal distribution")
histogram.set(xlabel="error / error bar", ylabel="density", title="How long the bars are")
histogram.legend()

# %%
# What the bar is for: measured are only the pixels whose bar is short. From left to right, ever more of them are kept.

relative = np.abs(error) / truth_mm[known]
order = np.argsort(frame.sigma_mm[known] / frame.depth_mm[known])
kept = np.arange(1, len(order) + 1)
figure, trust = plt.subplots(figsize=(7, 4), layout="constrained")
trust.plot(100 * kept / truth_mm.size, 100 * np.cumsum(relative[order] < 0.05) / kept, "k")
trust.set(xlabel="pixels kept, % of all", ylabel="of these within 5 % of the truth, %", title="Shortest bars first")
trust.grid(alpha=0.3)
