"""
Focus elsewhere, afterwards
===========================

With the depth known, the blur of the capture can be taken back, and that of another lens put in its place. The
photograph is reduced to half its width first, which a camera file allows: restoration takes seconds instead of tens
of them.
"""

import warnings

import cv2
import matplotlib.pyplot as plt
import numpy as np

import chromaperture as cap
from chromaperture.color.srgb import linear_to_srgb

camera, photograph = cap.open_sample("still_life_cy_halves", quality="accurate")
half = cv2.resize(photograph, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
warnings.simplefilter("ignore", cap.CaptureWarning)  # it says that this is another size than the calibrated one
frame = camera.measure(half)

sharp = cap.all_in_focus(frame, sharpness="fast")
near = cap.refocus(frame, 1450, f_number=1.4, sharp=sharp)
far = cap.refocus(frame, 3600, f_number=1.4, bokeh="hex", sharp=sharp)

# %%
# The capture is focused at 2 m. The new lens is at f/1.4, on the right with an iris of six blades.

pictures = {"captured": half, "all in focus": sharp.color, "focused at 1.45 m": near, "focused at 3.6 m": far}
figure, tiles = plt.subplots(2, 2, figsize=(11, 7.6), layout="constrained")
white = np.percentile(sharp.color, 99.5)
for tile, (title, picture) in zip(tiles.flat, pictures.items(), strict=True):
    tile.imshow(linear_to_srgb(np.clip(picture / white, 0, 1)))
    tile.set_title(title)
    tile.axis("off")
