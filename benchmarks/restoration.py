"""Colour restoration, and refocusing, beside the matcher in the same process; HD (1280x720) and full HD (1920x1080).

Refocusing stands beside one blur of the whole picture by the largest of its spots, too: what no depth would need.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import cv2
import numpy as np
from matcher import CONFIG, matching, scene
from timing import fastest_ms

from chromaperture.color.alignment import align_channels, channel_directions
from chromaperture.color.lens_shift import LensShift
from chromaperture.effects.bokeh import bokeh_kernel, bokeh_mask
from chromaperture.effects.refocusing import Focus, refocus
from chromaperture.matching.views import view_spaces
from chromaperture.optics.aperture import design_named
from chromaperture.optics.lens_blur import BlurModel, LensBlur, sample_pupil
from chromaperture.system.threads import thread_count

CASES = {
    "hd_restoration_two_filters": ("cy_halves", (720, 1280)),
    "hd_restoration_three_filters": ("rgb_squares", (720, 1280)),
    "full_hd_restoration_two_filters": ("cy_halves", (1080, 1920)),
}

THIN = BlurModel(10.0, 20000.0)  # in focus at 2 m


def processor_ms(work: Callable[[], object], *, rounds: int = 3) -> float:
    """Time of the processors that one run takes, whatever else they do."""
    spent = []
    for _ in range(rounds):
        begin = time.process_time()
        work()
        spent.append(1e3 * (time.process_time() - begin))
    return min(spent)


def benchmark() -> dict:
    results: dict = {}
    for case, (design, (height, width)) in CASES.items():
        aperture = design_named(design)
        views, guide, truth = scene(view_spaces(aperture, None, CONFIG.space)[0].directions, shape=(height, width))
        image = np.ascontiguousarray(np.dstack([views[0], guide, views[-1]]), np.float32)
        shifts = channel_directions(aperture, {})
        # With steps, so that there are strips to fill, and a blur as wide as the photographs of the demo have.
        radius = (2.4 * truth).astype(np.float32)
        color = cv2.cvtColor(guide, cv2.COLOR_GRAY2RGB)

        match = matching(aperture, views, guide)

        def align(image=image, truth=truth, shifts=shifts) -> object:
            return align_channels(image, truth, shifts)

        edges = LensShift(LensBlur(THIN, sample_pupil(aperture), width, height), near_mm=900.0, far_mm=6000.0)

        def align_by_lens(image=image, truth=truth, shifts=shifts, radius=radius, edges=edges) -> object:
            return align_channels(image, truth, shifts, displacement_px=edges(radius))

        def focus(color=color, radius=radius) -> object:
            return refocus(color, radius, Focus(float(radius.min()), 1.0))

        spot = bokeh_kernel(bokeh_mask("disc"), float(np.ptp(radius)))

        def plain_blur(color=color, spot=spot) -> object:
            return cv2.filter2D(color, -1, spot)

        results[case] = {}
        for threads in (1, 2):
            if threads > thread_count():
                continue
            work = {"matcher": match, "align": align, "align_by_lens": align_by_lens, "refocus": focus,
                    "plain_blur": plain_blur}  # fmt: skip
            best = fastest_ms(work, threads=threads, rounds=4)
            results[case][f"threads_{threads}"] = {
                "ratio_to_matcher": round(best["align"] / best["matcher"], 3),
                "lens_ratio_to_matcher": round(best["align_by_lens"] / best["matcher"], 3),
                "refocus_ratio_to_matcher": round(best["refocus"] / best["matcher"], 3),
                "refocus_ratio_to_plain_blur": round(best["refocus"] / best["plain_blur"], 3),
                "ms": round(best["align"], 1),
                "matcher_ms": round(best["matcher"], 1),
                "refocus_ms": round(best["refocus"], 1),
                "refocus_processor_ms": round(processor_ms(focus), 1),
            }
    return results
