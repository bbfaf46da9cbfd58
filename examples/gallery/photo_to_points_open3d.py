"""
Photo to points in Open3D
=========================

A photograph becomes an Open3D point cloud, is thinned and freed from strays, and its largest plane is found. Needs
the extra ``open3d`` (where this site was built without it, the script is shown and not run).
"""

import matplotlib.pyplot as plt
import numpy as np

import chromaperture as cap

camera, photograph = cap.open_sample("still_life_cy_halves", quality="accurate")
cloud = camera.measure(photograph).to_open3d(max_relative_sigma=0.03)
print(cloud)

# %%
# Open3D counts in metres; x right, y down, z forward, as its own cameras have it.

thinned = cloud.voxel_down_sample(0.01)
clean, _ = thinned.remove_statistical_outlier(nb_neighbors=20, std_ratio=2.0)
(a, b, c, d), inside = clean.segment_plane(distance_threshold=0.03, ransac_n=3, num_iterations=500)
print(f"{len(clean.points)} points; the largest plane holds {len(inside) / len(clean.points):.0%} of them")
print(f"its normal is ({a:.2f}, {b:.2f}, {c:.2f}), its distance from the pupil {abs(d):.2f} m")

# %%
# ``open3d.visualization.draw(clean)`` opens Open3D's window. On this page the plane is drawn from above, in red.

points = np.asarray(clean.points)
colors = np.asarray(clean.colors).copy()
colors[inside] = (0.85, 0.1, 0.1)
figure, axes = plt.subplots(figsize=(8, 5), layout="constrained")
axes.scatter(points[:, 0], points[:, 2], c=colors, s=1)
axes.set(xlabel="x, m", ylabel="z, m", aspect="equal")
