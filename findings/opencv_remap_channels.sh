#!/usr/bin/env bash
# OpenCV's remap with INTER_LINEAR: a ramp moved by .3 px, as one plane and as planes stacked in one picture.
#
# Expected: every plane moves alike, by .3 px or, in OpenCV's steps of 1/32 px, by .3125 px.
# Seen with OpenCV 5.0.0: float32 and uint16 of one, three and four channels move by .3000 px, of two and five by .3125
# px: depth stacked with its error bar is sampled elsewhere than either alone. int16 moves by .3125 px at any number,
# float32 of one channel too in undistort. With 4.13.0 everything moves by .3125 px.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
for version in 5.0.0.93 4.13.0.92; do
    python3 -m venv "$folder/$version"
    "$folder/$version/bin/pip" install -q numpy==2.4.6 "opencv-python-headless==$version"
    "$folder/$version/bin/python" - <<'PYTHON'
import cv2
import numpy as np

WIDTH, HEIGHT, MOVE_PX, STEPPED_PX, SLOPE = 64, 16, 0.3, 10 / 32, 320.0
x, y = np.meshgrid(np.arange(WIDTH, dtype=np.float32), np.arange(HEIGHT, dtype=np.float32))
ramp = SLOPE * x


def moved_px(seen, picture):
    return float(np.mean((seen.astype(float) - picture)[4:-4, 8:-8])) / SLOPE


def remapped_px(kind, channels):
    picture = np.repeat(ramp[..., None], channels, axis=2).squeeze().astype(kind)
    return moved_px(cv2.remap(picture, x + np.float32(MOVE_PX), y, cv2.INTER_LINEAR), picture)


matrix = np.array([[100.0, 0, 30], [0, 100, 8], [0, 0, 1]])
straight = matrix - [[0, 0, MOVE_PX], [0, 0, 0], [0, 0, 0]]  # no distortion, only another principal point
undistorted = moved_px(cv2.undistort(ramp, matrix, np.zeros(5), newCameraMatrix=straight), ramp)
found = {(kind, n): remapped_px(kind, n) for kind in ("float32", "uint16", "int16") for n in range(1, 6)}
print(f"OpenCV {cv2.__version__}: undistort of float32 moves by {undistorted:.4f} px, remap of")
for kind in ("float32", "uint16", "int16"):
    print(f"  {kind} with 1 to 5 channels by", " ".join(f"{found[kind, n]:.4f}" for n in range(1, 6)), "px")
is_new = cv2.__version__.startswith("5.")
for (kind, n), px in found.items():
    expected = MOVE_PX if is_new and kind != "int16" and n in (1, 3, 4) else STEPPED_PX
    assert abs(px - expected) < 1e-3, f"{kind} of {n} channels moves by {px:.4f} px now"
assert abs(undistorted - STEPPED_PX) < 1e-3, "undistort no longer moves in steps"
PYTHON
done
