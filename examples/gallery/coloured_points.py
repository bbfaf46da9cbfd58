"""
Coloured points
===============

Every pixel of known depth is a point in millimetres: origin at the entrance pupil, x right, y down, z forward.
"""

import matplotlib.pyplot as plt
import numpy as np

import chromaperture as cap

camera, photograph = cap.open_sample("still_life_cy_halves", quality="accurate")
frame = camera.measure(photograph)
cloud = frame.points(max_relative_sigma=0.03)
print(cloud, f"of {frame.depth_mm.size} pixels; nearest {cloud.points_mm[:, 2].min():.0f} mm")

# %%
# Matplotlib draws a few thousand of them, here of those nearer than 2.8 m. ``cap.write_ply("points.ply", cloud)`` keeps
# all for any viewer, and ``frame.show_points()`` turns them in a notebook.

near = np.flatnonzero(cloud.points_mm[:, 2] < 2800)
some = np.random.default_rng(0).choice(near, 12000, replace=False)
x, y, z = cloud.points_mm[some].T / 1000
figure = plt.figure(figsize=(11, 5), layout="constrained")
for place, (elevation, azimuth, title) in enumerate([(8, -82, "from in front"), (55, -60, "from above")], 1):
    axes = figure.add_subplot(1, 2, place, projection="3d")
    axes.scatter(x, z, -y, c=cloud.colors[some] / 255, s=3, depthshade=False)
    axes.view_init(elevation, azimuth)
    axes.set(xlabel="x, m", ylabel="z, m", zlabel="up, m", title=title)
    axes.set_box_aspect((np.ptp(x), np.ptp(z), np.ptp(y)), zoom=1.05)
    axes.locator_params(nbins=4)
