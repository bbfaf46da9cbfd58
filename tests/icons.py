"""The icons of the app: a pupil with cyan and yellow halves; ``python tests/icons.py`` writes them."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from chromaperture.files.pictures import write_png

_DARK, _CYAN, _YELLOW, _MIDDLE = (20, 22, 26), (60, 200, 216), (233, 196, 106), (232, 230, 227)  # sRGB
_FINE = 4  # samples of a pixel's side; chosen by hand
ICONS = {"icon-192.png": (192, 0.80), "icon-512.png": (512, 0.80), "icon-maskable-512.png": (512, 0.60)}


def draw_icon(size_px: int, diameter: float) -> np.ndarray:
    """Draw the pupil, ``diameter`` in sizes of the icon: systems cut some to 0.8; (size, size, 3) uint8 sRGB."""
    n = size_px * _FINE
    y, x = (np.mgrid[:n, :n] + 0.5) / n - 0.5
    radius = np.hypot(x, y)
    picture = np.broadcast_to(np.array(_DARK, float), (n, n, 3)).copy()
    pupil = radius < diameter / 2
    picture[pupil & (x < 0)] = _CYAN
    picture[pupil & (x >= 0)] = _YELLOW
    picture[radius < diameter * 0.16] = _DARK
    picture[radius < diameter * 0.10] = _MIDDLE
    return np.asarray(cv2.resize(picture, (size_px, size_px), interpolation=cv2.INTER_AREA).round().astype(np.uint8))


STATIC = Path(__file__).parents[1] / "src" / "chromaperture" / "app" / "static"

if __name__ == "__main__":
    for name, (size, diameter) in ICONS.items():
        write_png(STATIC / name, draw_icon(size, diameter))
