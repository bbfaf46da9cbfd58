"""What a photograph will take of memory; where there is not that much, work is refused."""

from __future__ import annotations

from chromaperture.model.camera_file import Calibration
from chromaperture.model.scale import SCALES
from chromaperture.settings.methods import Config
from chromaperture.system.memory import available_bytes, check_memory, limit_bytes

# The program; a pixel of the photograph, with its results and files; what a quality takes besides, and for a pixel that
# is matched and a layer there. Peaks of 0.35 to 24 megapixels at scales of 1/8 to 1 (`benchmarks/large_pictures.py`)
# are 2 to 35 % below the sums.
_PROGRAM_BYTES, _PIXEL_BYTES = 0.3e9, 78
_MATCHED_BYTES = {"paper": (0, 120, 3.0), "real-time": (0, 120, 0.8), "accurate": (0.2e9, 200, 3.5)}
_SMALL_BYTES = 1e9  # the system is not asked: for every frame of a video that is not worth it


def needed_bytes(calibration: Calibration, config: Config, *, scale: float | None = None) -> float:
    """Estimate the most memory that measuring a photograph, at a scale, and writing its files takes."""
    pixels = calibration.sensor.width_px * calibration.sensor.height_px
    matched, entries = _matched(calibration, config, scale or config.scale)
    more, each, each_layer = _MATCHED_BYTES[config.quality]
    return _PROGRAM_BYTES + more + _PIXEL_BYTES * pixels + matched * each + entries * each_layer


def _matched(calibration: Calibration, config: Config, scale: float) -> tuple[float, float]:
    """Return how many pixels are matched, and how many entries a volume of one number a pixel and layer has."""
    pixels = calibration.sensor.width_px * calibration.sensor.height_px / scale**2
    return pixels, pixels * len(config.matcher.layers.values_px) * config.scale / scale


def fitting_jobs(calibration: Calibration, config: Config, jobs: int) -> int:
    """Return how many photographs at a time there is memory for, from 1 to ``jobs``."""
    return max(1, min(jobs, int(min(available_bytes() / needed_bytes(calibration, config), jobs))))


def check_camera_memory(what: str, calibration: Calibration, config: Config) -> None:
    """Raise OutOfMemoryError where there is not enough for a photograph."""
    needed = needed_bytes(calibration, config)
    if needed < _SMALL_BYTES and needed < limit_bytes():
        return
    sensor, scale = calibration.sensor, config.scale
    megapixels = sensor.width_px * sensor.height_px / 1e6
    free = available_bytes()
    fitting = (s for s in SCALES if s > scale and needed_bytes(calibration, config, scale=s) <= free)
    coarser = next((f"match at a coarser scale (--scale 1/{s}), " for s in fitting), "")
    advice = f"{coarser}take smaller pictures, or close other programs"
    check_memory(f"{what}, {megapixels:.3g} megapixels at scale 1/{scale:g}", needed, advice=advice)
