"""Figures of one frame."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np

from chromaperture.frame.depth_frame import DepthFrame
from chromaperture.system.threads import parallel_map

_PERCENTILES = (5, 25, 50, 75, 95)  # of disparity and depth
# Of a map of many megapixels every n-th row and column is used: the median of a million samples is off by a thousandth
# of the spread.
_SAMPLES = 1 << 20
_LEAST_SAMPLES = 10_000  # known ones; below, all pixels count


def summarise(frame: DepthFrame, seconds: dict[str, float]) -> dict[str, Any]:
    """Collect the figures of one frame, units in the names; ``seconds`` is the time of each stage."""
    known = frame.valid if frame.is_calibrated else np.isfinite(frame.disparity_px)
    disparity, depth, sigma = parallel_map(_percentiles, (frame.disparity_px, frame.depth_mm, frame.sigma_mm))
    return {
        "fill_rate": float(known.mean()),
        "disparity_percentiles_px": disparity,
        "depth_percentiles_mm": depth,
        "sigma_median_mm": None if sigma is None else sigma["50"],
        "seconds": {name: round(value, 4) for name, value in seconds.items()},
        "config": None if frame.config is None else dataclasses.asdict(frame.config),
        "camera": None if frame.calibration is None else frame.calibration.summary(),
    }


def one_line(frame: DepthFrame) -> str:
    """Describe a frame: size, fill rate, median depth and error bar; disparity where there is no depth."""
    height, width = frame.disparity_px.shape
    values, sigma, name, unit, form = frame.depth_mm, frame.sigma_mm, "depth", "mm", ".0f"
    if not frame.valid.any():
        values, sigma, name, unit, form = frame.disparity_px, frame.disparity_sigma_px, "disparity", "px", ".2f"
    known = np.isfinite(values)
    text = f"{width}x{height} px, {known.mean():.1%} filled"
    if not known.any():
        return text
    text += f", median {name} {np.median(values[known]):{form}} {unit}"
    sigma = sigma[np.isfinite(sigma)]
    return text + (f", median sigma {np.median(sigma):{form}} {unit}" if sigma.size else "")


def _percentiles(values: np.ndarray) -> dict[str, float] | None:
    step = math.isqrt(values.size // _SAMPLES) or 1
    sample = values[::step, ::step]
    known = sample[np.isfinite(sample)]
    if known.size < _LEAST_SAMPLES:
        known = values[np.isfinite(values)]
    if known.size == 0:
        return None
    return {str(p): float(v) for p, v in zip(_PERCENTILES, np.percentile(known, _PERCENTILES), strict=True)}
