"""
First depth
===========

A photograph through cyan and yellow film, and the camera file that belongs to it, come with the package. Measuring it
takes one call.
"""

import chromaperture as cap

camera, photograph = cap.open_sample("still_life_cy_halves", quality="real-time")
frame = camera.measure(photograph)
frame.show()

# %%
# Red and blue fringes at edges are the signal: they point one way where a thing is nearer than the focus and the other
# way where it is farther. Distances are in millimetres from the sensor; white is unknown, and the third picture says
# how far to trust the rest.

print(frame)
print(f"depth in the middle: {frame.depth_mm[240, 360]:.0f} mm, give or take {frame.sigma_mm[240, 360]:.0f} mm")

# %%
# Quality ``accurate`` matches with the lens's own blur and explains walls by planes. It takes seconds, and finds more.

accurate, _ = cap.open_sample("still_life_cy_halves", quality="accurate")
better = accurate.measure(photograph)
better.show()

# %%
# ``frame.save("results/photo")`` writes depth, error bar, colour, points and a preview: the files of ``chromaperture
# depth``.
