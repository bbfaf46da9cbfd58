"""Time to read a photograph and a video's frames, over Pillow's and OpenCV's in the same run.

A JPEG of 24 megapixels, 4:2:0, and a clip of 1080p, H.264 4:2:0. Ours are read at the size of their chroma, to linear
light, of the clip to counts, too; the peers' to 8-bit R, G, B (or B, G, R) of full size. Needs no data.

    python benchmarks/reading_speed.py
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import av
import cv2
import numpy as np
from PIL import Image

import chromaperture as cap

FRAMES, ROUNDS = 60, 5


def texture(width: int, height: int) -> np.ndarray:
    """Return a picture of even detail; (H, W, 3) uint8."""
    noise = np.random.default_rng(0).normal(128, 240, (height, width, 3)).astype(np.float32)
    return cv2.GaussianBlur(noise, (0, 0), 2).clip(0, 255).astype(np.uint8)


def write_clip(path: Path) -> None:
    """Write a clip of the texture, moving."""
    picture = texture(1920, 1080)
    with av.open(str(path), "w") as clip:
        stream = clip.add_stream("libx264", rate=30, options={"crf": "15"})
        stream.width, stream.height, stream.pix_fmt = 1920, 1080, "yuv420p"
        for i in range(FRAMES):
            clip.mux(stream.encode(av.VideoFrame.from_ndarray(np.roll(picture, 2 * i, axis=1), format="rgb24")))
        clip.mux(stream.encode())


def seconds(work: Callable[[], object]) -> float:
    """Return the shortest of some rounds."""
    work()
    found = []
    for _ in range(ROUNDS):
        began = time.perf_counter()
        work()
        found.append(time.perf_counter() - began)
    return min(found)


def by_opencv(path: Path) -> None:
    """Read all frames."""
    clip = cv2.VideoCapture(str(path))
    while clip.read()[0]:
        pass


def by_us(path: Path, *, as_light: bool = False) -> None:
    """Read all frames, as counts or as light."""
    with cap.open_source(str(path)) as frames:
        for frame in frames:
            _ = frame.image if as_light else frame.counts


def main() -> None:
    """Print the table."""
    with TemporaryDirectory() as folder:
        photo, clip = Path(folder, "photo.jpg"), Path(folder, "clip.mp4")
        Image.fromarray(texture(6000, 4000)).save(photo, quality=95, subsampling=2)
        write_clip(clip)
        pillow = seconds(lambda: np.asarray(Image.open(photo).convert("RGB")))
        ours = seconds(lambda: cap.read_image(photo))
        print(f"JPEG 24 MP: {1e3 * ours:.0f} ms, Pillow {1e3 * pillow:.0f} ms, ratio {ours / pillow:.2f}")
        opencv = seconds(lambda: by_opencv(clip)) / FRAMES
        for kind, is_light in (("counts", False), ("light", True)):
            ours = seconds(lambda is_light=is_light: by_us(clip, as_light=is_light)) / FRAMES  # type: ignore[misc]
            times = f"{1e3 * ours:.1f} ms, OpenCV {1e3 * opencv:.1f} ms"
            print(f"frame of 1080p to {kind}: {times}, ratio {ours / opencv:.2f}")


if __name__ == "__main__":
    main()
