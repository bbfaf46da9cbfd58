"""Table 3: time of the depth extraction, and the times in section 4.1."""

from __future__ import annotations

import platform
from collections.abc import Callable

import cv2
import numpy as np

from chromaperture.matching.estimate import estimate_disparity
from chromaperture.optics.aperture import DESIGNS
from chromaperture.optics.psf import geometric_otf
from chromaperture.optics.simulator.textures import noise
from chromaperture.settings.methods import Quality, preset
from chromaperture.system.threads import limited_opencv_threads, limited_threads, thread_count
from chromaperture_paper import methods
from chromaperture_paper.context import Context
from chromaperture_paper.exhibit import Comparison, Content, CsvTable
from chromaperture_paper.prior.annulus import annulus_radius
from chromaperture_paper.total_variation import smooth_disparity

_HD, _PAPER = (720, 1280), (1280, 1920)  # rows, columns, of the paper's pictures
_ANNULUS_PARTS = 64  # the annulus is timed on this part of the paper's picture


def make(context: Context) -> Content:
    """Time single images from linear RGB to disparity and error bar, 32 layers, after one run to compile."""
    repeats = 1 if context.quick else 5
    most = thread_count()
    threads = sorted({1, most})
    hd, large = picture(_HD), picture(_PAPER)
    disparity = np.asarray(5 * large[..., 0], np.float32)
    cases: dict[str, Callable[[], object]] = {
        "HD, two filters, real-time": lambda: _match(hd, "cy_halves", "real-time"),
        "HD, two filters, paper": lambda: _match(hd, "cy_halves", "paper"),
        "1280x1920, two filters, paper": lambda: _match(large, "cy_halves", "paper"),
        "1280x1920, three filters, paper": lambda: _match(large, "rgb_squares", "paper"),
        "1280x1920, total variation, 100 rounds": lambda: smooth_disparity(disparity, iterations=100),
    }
    seconds: dict[tuple[str, int], float] = {}
    for count in threads:
        with limited_threads(count), limited_opencv_threads(count):
            for name, run in cases.items():
                run()
                seconds[name, count] = min(methods.timed(run)[1] for _ in range(repeats))
    annulus_s = _ANNULUS_PARTS * _annulus_s()
    rows = [(name, *(f"{1000 * seconds[name, count]:.0f}" for count in threads)) for name in cases]

    def ours(name: str, count: int = 1) -> str:
        return f"{1000 * seconds[name, count]:.0f} ms on {count} thread{'s' if count > 1 else ''}"

    other = "Another machine and ten years: the order of size only."
    return Content(
        source=f"Timed on this machine ({platform.machine()}, {most} threads), the best of {repeats} runs.",
        tables=[CsvTable("times", "Milliseconds for one image",
                         ("what", *(f"{c} thread{'s' if c > 1 else ''}" for c in threads)), rows)],
        comparisons=[
            Comparison("HD, Galaxy S3 / Note 3", "30 s / 5 s", "not measured", "No telephone at hand."),
            Comparison("HD, Core i7-2600, Matlab", "2 s", ours("HD, two filters, paper"), other),
            Comparison("HD, GeForce 780 Ti", "19 ms (53 frames a second)", ours("HD, two filters, real-time", most),
                       "Ours runs on the processor alone."),
            Comparison("1280x1920, two filters, one thread", "3.5 s", ours("1280x1920, two filters, paper"), other),
            Comparison("1280x1920, three filters, one thread", "6 s", ours("1280x1920, three filters, paper"), other),
            Comparison("1280x1920, magenta annulus [5]", "28 s", f"{annulus_s:.0f} s",
                       "Its likelihood written anew in NumPy: 13 sizes of blur on a picture of 240x160, times 64."),
            Comparison("1280x1920, total variation", "3 s", ours("1280x1920, total variation, 100 rounds"),
                       "The paper gives no number of rounds."),
        ],
    )  # fmt: skip


def picture(shape: tuple[int, int]) -> np.ndarray:
    """Return a texture whose red and blue are shifted by +-3 px; (H, W, 3) float32."""
    grey = noise(shape, exponent=1.0, seed=1)
    return np.ascontiguousarray(np.stack([np.roll(grey, 3, 1), grey, np.roll(grey, -3, 1)], axis=-1))


def _annulus_s() -> float:
    """Time the annulus's likelihood on a 64th of the paper's picture, with the 13 levels of its publication; s."""
    small = cv2.resize(picture(_HD), (240, 160), interpolation=cv2.INTER_AREA)
    radii, padded = np.arange(13) / 2, (200, 288)
    transfer = [geometric_otf(DESIGNS["magenta_annulus"], float(r), padded) for r in radii]
    return methods.timed(annulus_radius, small, transfer, radii, padded)[1]


def _match(image: np.ndarray, design: str, quality: Quality) -> object:
    return estimate_disparity(image, aperture=design, config=preset(quality))
