"""What a device makes of a photograph: disparity, and where asked for depth in millimetres and aligned colours."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from chromaperture.color.lens_shift import LensMoves
from chromaperture.color.row_alignment import FEWEST, OCCLUSION_PX, RADIUS_PX, RIDGE, SAME_SURFACE_PX, STILL
from chromaperture.matching.device.device import Array, Chain, Device, DeviceError
from chromaperture.matching.result import NO_EXTRAS, Alignment, Conversion, Disparity, Extras, Measured, Method, Pending
from chromaperture.system.errors import OutOfMemoryError

MAPS = ("disparity", "sigma", "confidence")  # arrays that every method leaves, (H, W) each
_MILLIMETRES = ("depth_mm", "sigma_mm")
_COLOR = "color"
_PLACES, _TAPS = 32, 8  # of OpenCV's Lanczos filter: places between two pixels, and samples


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
        "conversion", [disparity, sigma, chain.constant("fields", fields), chain.constant("curve", table), *outputs],
        disparity.size, uses=(uses,), pixels=disparity.size, table_count=count, **of_fields,
        first_px=float(curve.first_px), last_px=float(curve.last_px), per_px=(count - 1) / span if count else 0.0,
        low_px=float(curve.low_px), high_px=float(curve.high_px), slope=slope, slope_count=len(slope),
        has_errors=len(curve.errors) > 0, max_depth_mm=float(conversion.max_depth_mm),
    )  # fmt: skip


def _mapped(conversion: Conversion) -> tuple[str, np.ndarray, dict[str, Any]]:
    """Return the section of `field`, its array and its constants, where every field is a map or a number."""
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


def add_alignment(chain: Chain, image: Array, disparity: Array, size: tuple[int, int], alignment: Alignment) -> None:
    """Add the stages from an image (H, W, 3) and ``disparity`` to ``color``, (H, W, 3)."""
    height, width = size
    pixels = height * width
    frame: dict[str, Any] = {"width": width, "height": height}
    filled = _add_filled(chain, disparity, size, alignment.step)
    nearest = chain.array("depth_buffers", 3 * pixels, np.uint32)
    shifted, visible = chain.array("shifted", 3 * pixels), chain.array("visible", pixels, np.uint32)
    order = np.argsort(np.linalg.norm(alignment.directions, axis=1), kind="stable")
    views: dict[str, Any] = {"directions": np.ravel(alignment.directions), "still": STILL, **frame}
    chain.add("fill_zero", [nearest], nearest.size, size=nearest.size)
    chain.add("depth_buffer", [filled, nearest], pixels, **views)
    lens = alignment.lens
    of_lens = {} if lens is None else _constants_of(lens)
    tables = [] if lens is None else [chain.constant("lens", lens.table), chain.constant("lanczos", lanczos_weights())]
    chain.add(
        "channels_shifted", [image, filled, nearest, shifted, visible, *tables], pixels,
        uses=("moved_by_disparity" if lens is None else "moved_by_lens",), occlusion_px=OCCLUSION_PX, **views,
        **of_lens,
    )  # fmt: skip
    color = chain.array("color", 3 * pixels)
    chain.add(
        "hidden_filled", [shifted, visible, filled, color], pixels, order=[float(k) for k in order],
        gains=np.ravel(alignment.gains), radius_px=RADIUS_PX, same_surface_px=float(SAME_SURFACE_PX),
        fewest=float(FEWEST), ridge=RIDGE, **frame,
    )  # fmt: skip


def _add_filled(chain: Chain, disparity: Array, size: tuple[int, int], step: int) -> Array:
    """Add a map without unknown pixels, (H, W)."""
    filled = chain.array("filled", disparity.size)
    if step == 1:
        _add_nearest(chain, disparity, filled, size)
        return filled
    few_tall, few_wide = (len(range(step // 2, side, step)) for side in size)
    of_few: dict[str, Any] = {"width": size[1], "spacing": step, "few_tall": few_tall, "few_wide": few_wide}
    few, few_filled = (chain.array(name, few_tall * few_wide) for name in ("few", "few_filled"))
    chain.add("every_nth", [disparity, few], few.size, **of_few)
    _add_nearest(chain, few, few_filled, (few_tall, few_wide))
    chain.add(
        "filled_from_few", [disparity, few_filled, filled], filled.size, height=size[0], **of_few,
    )  # fmt: skip
    return filled


def _add_nearest(chain: Chain, values: Array, filled: Array, size: tuple[int, int]) -> None:
    """Add the value of the nearest known pixel."""
    frame: dict[str, Any] = {"width": size[1], "height": size[0]}
    rows = chain.array("nearest_rows", values.size, np.int32)
    chain.add("nearest_rows", [values, rows], size[1], **frame)
    chain.add("nearest_known", [values, rows, filled], values.size, **frame)


def _constants_of(lens: LensMoves) -> dict[str, Any]:
    rows, columns, radii = lens.table.shape[:3]
    return {
        "table_rows": rows, "table_columns": columns, "table_radii": radii, "first_radius_px": lens.first_px,
        "radius_step_px": lens.step_px, "at_zero_px": lens.at_zero_px, "per_px": lens.per_px,
        "lens_factor": float(lens.factor), "by_lanczos": lens.exact,
    }  # fmt: skip


def lanczos_weights() -> np.ndarray:
    """Return Lanczos' filter of 8 samples as OpenCV has it, sinc(t) sinc(t / 4) of sum 1; (32, 8) float64."""
    apart = np.arange(_PLACES)[:, None] / _PLACES - (np.arange(_TAPS) - 3)
    weights = np.sinc(apart) * np.sinc(apart / 4)
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))


class OnDevice(Method):
    """A method whose stages run on a device, in chains that are made at the first photograph of a size, and kept.

    For one thread at a time, safe from several.
    """

    device: Device
    _chain: Any

    @abstractmethod
    def start(self, image: np.ndarray, extras: Extras = NO_EXTRAS) -> Pending[Measured]:
        """Send an image (H, W, 3) to the device, which begins; at most two are under way, to be awaited in turn.

        Both raise DeviceError and OutOfMemoryError besides InputError.
        """

    def match(self, image: np.ndarray) -> Disparity:
        """Return the disparity of an image (H, W, 3); raises as `start`."""
        return self.start(image).result().disparity

    @contextmanager
    def _freed_on_failure(self) -> Iterator[None]:
        try:
            yield
        except (DeviceError, OutOfMemoryError):
            self._chain = None  # gives its memory back
            raise


def add_extras(chain: Chain, image: Array, size: tuple[int, int], extras: Extras) -> None:
    """Add what is asked for behind a chain's disparity and error bar; ``image`` is the photograph, ``size`` (H, W)."""
    if extras.conversion is not None:
        add_conversion(chain, chain.arrays["disparity"], chain.arrays["sigma"], extras.conversion)
    if extras.alignment is not None:
        add_alignment(chain, image, chain.arrays["disparity"], size, extras.alignment)


def outputs_of(extras: Extras) -> list[str]:
    """Return the arrays that come down."""
    names = [*MAPS, *(_MILLIMETRES if extras.conversion is not None else ())]
    return names if extras.alignment is None else [*names, _COLOR]


def measured_from(found: dict[str, np.ndarray], size: tuple[int, int]) -> Measured:
    """Return the measurement in the arrays that came down, of (H, W)."""
    disparity = Disparity(*(found[name].reshape(size) for name in MAPS))
    depth_mm, sigma_mm = (found[name].reshape(size) if name in found else None for name in _MILLIMETRES)
    color = found[_COLOR].reshape(*size, 3) if _COLOR in found else None
    return Measured(disparity, depth_mm, sigma_mm, color)


def is_same(one: Extras, other: Extras) -> bool:
    """Whether two hold the same objects."""
    return all(a is b for a, b in zip(one, other, strict=True))
