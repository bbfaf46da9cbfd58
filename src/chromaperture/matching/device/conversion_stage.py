"""Disparity to millimetres on the device: ``depth/conversion_kernels.py``, in WGSL."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from chromaperture.matching.device.device import Array, Chain
from chromaperture.matching.device.workgroups import groups_for


@dataclass(frozen=True)
class Conversion:
    """The depth curve of every pixel, in numbers.

    Attributes
    ----------
    fields : nine arrays, (H, W) or (1, 1), or FieldNumbers
        A, B, delta, and their covariances AA, AB, A delta, BB, B delta, delta delta; or what they are computed from,
        of ``depth/field.py``, which this package does not import: maps of many megapixels take 36 bytes a pixel.
    curve : CurveTable
        Of ``depth/conversion_kernels.py``, which this package does not import.
    max_depth_mm : float
    """

    fields: Any
    curve: Any
    max_depth_mm: float


def add_conversion(chain: Chain, disparity: Array, sigma: Array, conversion: Conversion) -> None:
    """Add the stage from ``disparity`` and ``sigma`` to ``depth_mm`` and ``sigma_mm``, (H, W) each."""
    uses, fields, of_fields = _smooth(conversion) if hasattr(conversion.fields, "covariance") else _mapped(conversion)
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
        [disparity, sigma, chain.constant("fields", fields), chain.constant("curve", table), *outputs],
        groups=groups_for(disparity.size), uses=(uses,), pixels=disparity.size, table_count=count, **of_fields,
        first_px=float(curve.first_px), last_px=float(curve.last_px), per_px=(count - 1) / span if count else 0.0,
        low_px=float(curve.low_px), high_px=float(curve.high_px), slope=slope, slope_count=len(slope),
        has_errors=len(curve.errors) > 0, max_depth_mm=float(conversion.max_depth_mm),
    )  # fmt: skip


def _mapped(conversion: Conversion) -> tuple[str, np.ndarray, dict[str, Any]]:
    """Return the file of `field`, its array and its constants, where every field is a map or a number."""
    parts = [np.asarray(part, np.float32).ravel() for part in conversion.fields]
    starts = np.concatenate([[0], np.cumsum([part.size for part in parts])[:-1]])
    of_fields = {"field_at": [float(at) for at in starts], "field_is_map": [float(part.size > 1) for part in parts]}
    return "fields_mapped", np.concatenate(parts), of_fields


def _smooth(conversion: Conversion) -> tuple[str, np.ndarray, dict[str, Any]]:
    """As `_mapped`, where fields are computed from numbers."""
    numbers = conversion.fields
    parts = (numbers.infinity_px, numbers.scale_px_mm, numbers.local, numbers.covariance)
    last_px = [float(max(side - 1, 1)) for side in (numbers.width_px, numbers.height_px)]
    of_fields = {
        "width": numbers.width_px, "frame_last_px": last_px, "field_side": len(numbers.infinity_px),
        "pupil_mm": float(numbers.pupil_mm), "local_rows": numbers.local.shape[1],
        "local_columns": numbers.local.shape[2], "local_start": float(numbers.local_start_px),
        "local_step": float(numbers.local_step_px), "node_rows": numbers.covariance.shape[1],
        "node_columns": numbers.covariance.shape[2],
    }  # fmt: skip
    return "fields_smooth", np.concatenate([np.asarray(part, np.float32).ravel() for part in parts]), of_fields
