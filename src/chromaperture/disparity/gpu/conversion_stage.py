"""Disparity to millimetres on the device: ``depth/conversion_kernels.py``, in WGSL."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from chromaperture.disparity.gpu.device import Array, Chain
from chromaperture.disparity.gpu.view_stages import SHARED
from chromaperture.disparity.gpu.workgroups import groups_for


@dataclass(frozen=True)
class Conversion:
    """The depth curve of every pixel, in numbers.

    Attributes
    ----------
    fields : nine arrays, (H, W) or (1, 1)
        A, B, delta, and their covariances AA, AB, A delta, BB, B delta, delta delta.
    curve : CurveTable
        Of ``depth/conversion_kernels.py``, which this package does not import.
    max_depth_mm : float
    """

    fields: Sequence[np.ndarray]
    curve: Any
    max_depth_mm: float


def add_conversion(chain: Chain, disparity: Array, sigma: Array, conversion: Conversion) -> None:
    """Add the stage from ``disparity`` and ``sigma`` to ``depth_mm`` and ``sigma_mm``, (H, W) each."""
    parts = [np.asarray(part, np.float32).ravel() for part in conversion.fields]
    starts = np.concatenate([[0], np.cumsum([part.size for part in parts])[:-1]])
    curve = conversion.curve
    count = len(curve.linear_px)
    table = np.zeros((max(count, 2), 5), np.float32)
    if count:
        table[:, 0] = curve.linear_px
    if len(curve.errors):
        table[:, 1:] = curve.errors
    span = curve.last_px - curve.first_px
    slope = [float(value) for value in curve.slope] or [0.0, 0.0]
    outputs = [chain.array(name, disparity.size) for name in ("depth_mm", "sigma_mm")]
    chain.add(
        "conversion",
        [disparity, sigma, chain.constant("fields", np.concatenate(parts)), chain.constant("curve", table), *outputs],
        groups=groups_for(disparity.size), uses=SHARED,
        pixels=disparity.size, field_at=[float(start) for start in starts],
        field_is_map=[float(part.size > 1) for part in parts], table_count=count,
        first_px=float(curve.first_px), last_px=float(curve.last_px), per_px=(count - 1) / span if count else 0.0,
        low_px=float(curve.low_px), high_px=float(curve.high_px), slope=slope, slope_count=len(slope),
        has_errors=len(curve.errors) > 0, max_depth_mm=float(conversion.max_depth_mm),
    )  # fmt: skip
