"""HD colour restoration, and refocusing, beside the matcher in the same process."""

from __future__ import annotations

import cv2
import numba
import numpy as np
from matcher import CONFIG, HEIGHT, NOISE, WIDTH, scene
from timing import fastest_ms

from chromaperture.color.alignment import align_channels, channel_directions
from chromaperture.color.unmixing import view_directions
from chromaperture.disparity import kernels
from chromaperture.disparity.inputs import prepare_views, view_pairs
from chromaperture.effects.refocus import Focus, refocus
from chromaperture.optics.aperture import design_named

DESIGNS = {"hd_restoration_two_filters": "cy_halves", "hd_restoration_three_filters": "rgb_squares"}


def benchmark() -> dict:
    results: dict = {}
    for case, design in DESIGNS.items():
        aperture = design_named(design)
        directions = view_directions(aperture)
        views, guide, truth = scene(directions)
        count = len(views)
        image = np.ascontiguousarray(np.dstack([views[0], guide, views[-1]]), np.float32)
        shifts = channel_directions(aperture, {})
        # With steps, so that there are strips to fill, and a blur as wide as the photographs of the demo have.
        radius = (2.4 * truth).astype(np.float32)
        color = cv2.cvtColor(guide, cv2.COLOR_GRAY2RGB)

        def match(views=views, guide=guide, directions=directions, count=count) -> object:
            inputs = prepare_views(
                views, guide, np.ones((HEIGHT, WIDTH), bool), directions=directions, config=CONFIG,
                noise_variance=np.broadcast_to(np.float32(NOISE**2), (HEIGHT, WIDTH, count)),
                noise_covariance=np.broadcast_to(np.float32(0), (HEIGHT, WIDTH, len(view_pairs(count)))),
            )  # fmt: skip
            return kernels.match(inputs, CONFIG)

        def align(image=image, truth=truth, shifts=shifts) -> object:
            return align_channels(image, truth, shifts)

        def focus(color=color, radius=radius) -> object:
            return refocus(color, radius, Focus(float(radius.min()), 1.0))

        results[case] = {}
        for threads in (1, 2):
            if threads > numba.config.NUMBA_NUM_THREADS:
                continue
            best = fastest_ms({"matcher": match, "align": align, "refocus": focus}, threads=threads, rounds=4)
            results[case][f"threads_{threads}"] = {
                "ratio_to_matcher": round(best["align"] / best["matcher"], 3),
                "refocus_ratio_to_matcher": round(best["refocus"] / best["matcher"], 3),
                "ms": round(best["align"], 1),
                "matcher_ms": round(best["matcher"], 1),
                "refocus_ms": round(best["refocus"], 1),
            }
    return results
