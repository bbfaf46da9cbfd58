"""Write a focus sweep, from the nearest surface to the farthest and back, as GIF or MP4."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from chromaperture.color.srgb import linear_to_srgb
from chromaperture.effects.refocusing import Compositor, Focus, refocus
from chromaperture.system.errors import InputError

_FRAMES_PER_SECOND = 12
_MIN_SWEEP_PX = 3.0  # blur radius: range of the sweep of a flat scene; chosen by hand
SUFFIXES = (".gif", ".mp4")


def sweep(
    color: np.ndarray, radius_px: np.ndarray, focus: Focus, *, frames: int = 24, compositor: Compositor | None = None
) -> Iterator[np.ndarray]:
    """Yield pictures focused from near to far.

    ``color``, ``radius_px``: as `refocus` takes them; ``focus``: pupil and strength; its focus is replaced;
    ``compositor``: as `refocus` takes it. Yields (H, W, 3) uint8, sRGB.
    """
    if frames < 2:
        raise InputError(f"a sweep needs at least 2 frames, got {frames}")
    near, far = np.percentile(radius_px, (2, 98))  # without outliers
    short = max(0.0, _MIN_SWEEP_PX - (far - near)) / 2
    near, far = near - short, far + short
    for radius in np.linspace(near, far, frames):
        picture = refocus(color, radius_px, replace(focus, radius_px=float(radius)), compositor=compositor)
        yield np.rint(linear_to_srgb(picture) * 255).astype(np.uint8)


def write_sweep(path: Path, frames: Iterator[np.ndarray]) -> None:
    """Write frames forwards and backwards; raises InputError for a suffix other than .gif and .mp4."""
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"cannot write a sweep as {path.suffix or 'a file without suffix'}: choose .gif or .mp4")
    forwards = list(frames)
    shown = forwards + forwards[-2:0:-1]
    if path.suffix.lower() == ".gif":
        pictures = [Image.fromarray(frame).quantize(128, dither=Image.Dither.FLOYDSTEINBERG) for frame in shown]
        pictures[0].save(
            path, save_all=True, append_images=pictures[1:], duration=1000 // _FRAMES_PER_SECOND, loop=0, format="GIF"
        )
        return
    height, width = shown[0].shape[0] // 2 * 2, shown[0].shape[1] // 2 * 2  # the codec needs even sides
    video = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), _FRAMES_PER_SECOND, (width, height))
    if not video.isOpened():
        raise InputError("this OpenCV cannot write MP4; choose a .gif")
    try:
        for frame in shown:
            video.write(np.ascontiguousarray(frame[:height, :width, ::-1]))
    finally:
        video.release()
