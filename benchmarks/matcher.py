"""The matcher against OpenCV's stereo matchers: HD, 32 layers of half a pixel, from float planes to disparity.

The scene is a textured wavy surface with steps, seen through the sub-apertures by exact shifts of a smooth texture;
its truth is known, so that the fraction of right pixels is beside the speed. The stereo pair of the peers is made of
the first and the last view, 32 whole-pixel disparities of twice the range.
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from timing import fastest_ms

from chromaperture.matching.execution import execution_named
from chromaperture.matching.labels import IDENTITY
from chromaperture.matching.real_time import RealTimeMethod
from chromaperture.matching.views import halved, view_spaces
from chromaperture.matching.winner import Surface
from chromaperture.optics.aperture import Aperture, design_named
from chromaperture.settings.methods import RealTimeConfig
from chromaperture.system.threads import thread_count

HEIGHT, WIDTH = 720, 1280
NOISE = 0.004
CONFIG = RealTimeConfig()
DESIGNS = {"hd32_two_filters": "cy_halves", "hd32_three_filters": "cmy_squares", "hd32_three_circles": "cmy_circles"}


def scene(
    directions: np.ndarray, *, seed: int = 5, shape: tuple[int, int] = (HEIGHT, WIDTH)
) -> tuple[list[np.ndarray], np.ndarray, np.ndarray]:
    """Views (H, W) and guide as float32 planes and the true half disparity, px."""
    height, width = shape
    rng = np.random.default_rng(seed)
    margin = 24
    big = (height + 2 * margin, width + 2 * margin)
    texture = sum(s * cv2.GaussianBlur(rng.normal(size=big).astype(np.float32), (0, 0), s) for s in (1.5, 5.0))
    texture = 0.5 + 0.1 * texture / texture.std()
    y, x = np.mgrid[:height, :width].astype(np.float32)
    truth = 4 * np.sin(x / 190) * np.cos(y / 150)
    truth[150:400, 300:700] -= 2
    truth = truth.astype(np.float32)
    planes = []
    for u, v in (*directions, (0, 0)):
        at_x, at_y = x + margin - truth * np.float32(u), y + margin - truth * np.float32(v)
        view = cv2.remap(texture, at_x, at_y, cv2.INTER_CUBIC)
        planes.append((view + rng.normal(0, NOISE, view.shape)).astype(np.float32))
    return planes[:-1], planes[-1], truth


def matching(
    aperture: Aperture, views: list[np.ndarray], guide: np.ndarray, config: RealTimeConfig = CONFIG
) -> Callable[[], Surface]:
    """From float planes (H, W) to the surface by the real-time method, as a function without arguments."""
    space = view_spaces(aperture, None, config.space)[0]
    config = config.for_views(space.directions)
    method = RealTimeMethod(config, space, IDENTITY, execution_named("numba"))
    mask = np.ones(guide.shape, bool)
    return lambda: method.surface(
        *halved(views, guide, mask, directions=space.directions, config=config.views)
    )


def benchmark() -> dict:
    results: dict = {}
    for case, design in DESIGNS.items():
        aperture = design_named(design)
        views, guide, truth = scene(view_spaces(aperture, None, CONFIG.space)[0].directions)
        match = matching(aperture, views, guide)
        found = match().disparity_px
        results[case] = {
            "accuracy": {
                "median_error_px": round(float(np.nanmedian(np.abs(found - truth))), 4),
                "share_within_half_px": round(float((np.abs(found - truth) < 0.5).mean()), 4),
            }
        }
        for threads in (1, 2):
            if threads > thread_count():
                continue
            best = fastest_ms({"match": match, **peers(views)}, threads=threads)
            own = best.pop("match")
            figures = {f"ratio_to_{name}": round(own / peer, 3) for name, peer in best.items()}
            results[case][f"threads_{threads}"] = {**figures, "ms": round(own, 1)}
    return results


def peers(views: list[np.ndarray]) -> dict:
    """OpenCV's matchers at work on the 8-bit pair; 32 disparities, block 7."""
    left, right = (np.clip(255 * view, 0, 255).astype(np.uint8) for view in (views[0], views[-1]))
    block, disparities = 7, 32
    steps = {"P1": 8 * block**2, "P2": 32 * block**2}

    def semi_global(mode: int):
        return cv2.StereoSGBM.create(-16, disparities, block, mode=mode, **steps)

    three_way, full = semi_global(cv2.STEREO_SGBM_MODE_SGBM_3WAY), semi_global(cv2.STEREO_SGBM_MODE_SGBM)
    block_matcher = cv2.StereoBM.create(disparities, block)
    return {
        "sgbm_3way": lambda: three_way.compute(left, right),
        "sgbm": lambda: full.compute(left, right),
        "bm": lambda: block_matcher.compute(left, right),
    }
