"""The plan by which a browser measures: all that it runs on its own device, decided here.

A plan is the chain of ``matching/device`` for a camera and a size of frame, written down: shaders, arrays, what
the constant ones hold, and the dispatches in their order. The page (``static/webgpu.js``) adds nothing of its own.
"""

from __future__ import annotations

from functools import cache
from typing import Any, get_args

import numpy as np

from chromaperture.app.messages import Packing, collect_warnings
from chromaperture.camera.alignment import channel_shifts
from chromaperture.camera.camera import CodedApertureCamera
from chromaperture.capture.checks import all_black
from chromaperture.capture.files import Decoded, linearise
from chromaperture.color.color_maps import DISTANCE, ERROR, draw_levels
from chromaperture.color.image import DARK
from chromaperture.depth.error_limit import MAX_RELATIVE_SIGMA
from chromaperture.depth.pointcloud import RAY_PITCH_PX, grid_of_rays
from chromaperture.matching.device.device import Exchange, PlannedChain
from chromaperture.matching.device.measured import add_conversion
from chromaperture.matching.device.picture_stages import (
    add_colored_maps,
    add_light_of_counts,
    add_sparse_maps,
    row_pitch,
)
from chromaperture.matching.device.real_time_chain import add_real_time
from chromaperture.matching.real_time import RealTimeMethod
from chromaperture.matching.views import CONSTANT, constant_view, no_usable_pixel
from chromaperture.model.camera_file import Calibration
from chromaperture.settings.methods import Quality
from chromaperture.system.errors import InputError

MOST_PX = (
    4_000_000  # of a frame: up to here cameras keep the curves of all pixels, see `CodedApertureCamera.conversion`
)
FORMAT = 1  # of the message; `plan.js` refuses others
# Places in the array `stats`, as `shared` names them.
_MEAN_ALL, _USABLE, _VARIANCE = 3, 4, 8


def make_plan(camera: CodedApertureCamera, exchange: str, facts: dict[str, Any]) -> bytes:
    """Return the plan: the length of a deflated JSON text (uint32, little-endian), the text, and its arrays."""
    if exchange not in get_args(Exchange):
        raise InputError(f"unknown exchange {exchange!r}: choose {', '.join(get_args(Exchange))}")
    method = camera.method
    if not isinstance(method, RealTimeMethod):
        raise InputError("a browser measures at real-time quality only, and frames that need not be reduced")
    sensor = camera.calibration.sensor
    if sensor.width_px * sensor.height_px > MOST_PX:
        raise InputError("this frame has too many pixels for a browser; the computer measures it")
    calibration = camera.calibration
    chain, size = PlannedChain(exchange), (calibration.sensor.height_px, calibration.sensor.width_px)  # type: ignore[arg-type]
    light, notes = light_of_counts(calibration)
    image = add_light_of_counts(chain, size, light)
    add_real_time(chain, image, size, method)
    maps = ("disparity", "sigma")
    if camera.conversion is not None:
        add_conversion(chain, chain.arrays["disparity"], chain.arrays["sigma"], camera.conversion)
        maps = ("depth_mm", "sigma_mm")
    white = np.asarray(calibration.film.aperture, float)
    seen = {"shifts": channel_shifts(calibration, camera.config.quality), "balance": white.max() / white}
    sparse = add_sparse_maps(chain, size, maps, **seen)
    measure_count = len(chain.dispatches)
    limit = None if camera.conversion is None else MAX_RELATIVE_SIGMA
    add_colored_maps(chain, size, maps, color_tables(), most_relative=limit, **seen)

    sources = list(dict.fromkeys(d.source for d in chain.dispatches))
    steps = [
        {"stage": d.stage, "source": sources.index(d.source), "arrays": [a.name for a in d.arrays], "groups": d.groups}
        for d in chain.dispatches
    ]
    packing = Packing()
    text = facts | {
        "notes": [*notes, *facts.get("notes", [])],
        "plan": FORMAT, "exchange": exchange, "width": size[1], "height": size[0], "pitch": row_pitch(size[1]),
        "sources": sources, "measure": steps[:measure_count], "draw": steps[measure_count:],
        "arrays": {
            name: {"size": array.size} | ({"values": packing.put(chain.values[name])} if name in chain.values else {})
            for name, array in chain.arrays.items()
        },
        "maps": maps, "sparse": sparse, "unit": "px" if limit is None else "mm", "most_relative": limit,
        "checks": _checks(len(method.space.rows), size[0] * size[1]),
        "colors": {name: table.tolist() for name, table in zip(("depth", "sigma"), color_tables(), strict=True)},
        "points": _points(calibration, camera.config.quality, packing),
    }  # fmt: skip
    return packing.message(text)


def make_points(calibration: Calibration, quality: Quality) -> bytes:
    """Return what makes points of the maps of a camera's size, as a message like `make_plan`'s."""
    packing = Packing()
    return packing.message({"points": _points(calibration, quality, packing)})


def light_of_counts(calibration: Calibration) -> tuple[np.ndarray, list[str]]:
    """Return the linear light of the 256 counts of a picture of 8 bits, (256,) float32, and notes about it."""
    counts = np.repeat(np.arange(256, dtype=np.uint8)[:, None, None], 3, axis=2)
    encoding = calibration.sensor.encoding if calibration.is_calibrated else None
    with collect_warnings() as notes:
        light = linearise(Decoded(counts), camera_encoding=encoding)
    return np.ascontiguousarray(light[:, 0, 0]), notes()


@cache
def color_tables() -> np.ndarray:
    """Return the 257 colours of depth and of its error bar, the last of unknown pixels; (2, 257, 3) uint8."""
    levels = np.append((np.arange(256) + 0.5) / 256, np.nan)[None]
    return np.stack([draw_levels(levels, kind)[0] for kind in (DISTANCE, ERROR)])


def _checks(view_count: int, pixels: int) -> list[dict[str, Any]]:
    """Return what must hold of the numbers in ``stats``, and what to say where it does not."""
    checks = [
        (_USABLE, 0.02 * pixels, no_usable_pixel()),  # the rest is saturated, as `check_capture` allows
        (_MEAN_ALL, DARK, all_black()),
        *((_VARIANCE + k, CONSTANT**2, constant_view()) for k in range(view_count)),
    ]
    return [{"at": at, "least": least, "says": str(error)} for at, least, error in checks]


def _points(calibration: Calibration, quality: Quality, packing: Packing) -> dict[str, Any] | None:
    """Return what makes points of depth, as `depth_to_points`; None for a camera that was never calibrated."""
    if not calibration.is_calibrated:
        return None
    lens, sensor = calibration.lens, calibration.sensor
    size = (sensor.height_px, sensor.width_px)
    rays = grid_of_rays(size, np.asarray(lens.camera_matrix, float), np.asarray(lens.distortion, float))
    pupil_mm = float(calibration.depth[quality].sensor_to_pupil_mm)
    return {
        "rays": packing.put(rays.astype(np.float32)), "rows": rays.shape[0], "columns": rays.shape[1],
        "pitch_px": RAY_PITCH_PX, "sensor_to_pupil_mm": pupil_mm, "most_relative": MAX_RELATIVE_SIGMA,
    }  # fmt: skip
