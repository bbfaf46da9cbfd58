"""What a photograph will take of memory; where there is not that much, volumes go to disk, or work is refused."""

from __future__ import annotations

import warnings

from chromaperture.model.camera_file import Calibration
from chromaperture.model.scale import SCALES
from chromaperture.settings.methods import Config
from chromaperture.system.errors import CaptureWarning
from chromaperture.system.memory import (
    address_space_bytes,
    available_bytes,
    check_memory,
    free_scratch_bytes,
    limit_bytes,
    scratch_folder,
)

# The program; a pixel of the photograph, with its results and files; a pixel that is matched, and a layer there. Peaks
# of 0.35 to 24 megapixels at scales of 1/8 to 1/2 (`benchmarks/large_pictures.py`) are 2 to 27 % below the sums.
_PROGRAM_BYTES, _PIXEL_BYTES = 0.3e9, 78
_MATCHED_BYTES = {"paper": (120, 3.0), "real-time": (120, 0.8), "accurate": (200, 16.0)}
_VOLUME_BYTES = {"accurate": 16.0}  # of a pixel and a layer: two volumes of float32 at two labels a layer
_SMALL_BYTES = 1e9  # the system is not asked: for every frame of a video that is not worth it


def needed_bytes(calibration: Calibration, config: Config, *, scale: float | None = None) -> float:
    """Estimate the most memory that measuring a photograph, at a scale, and writing its files takes."""
    pixels = calibration.sensor.width_px * calibration.sensor.height_px
    matched, entries = _matched(calibration, config, scale or config.scale)
    each, each_layer = _MATCHED_BYTES[config.quality]
    return _PROGRAM_BYTES + _PIXEL_BYTES * pixels + matched * each + entries * each_layer


def volume_bytes(calibration: Calibration, config: Config) -> float:
    """Return how much of `needed_bytes` are volumes that can be kept on disk."""
    return _matched(calibration, config, config.scale)[1] * _VOLUME_BYTES.get(config.quality, 0.0)


def _matched(calibration: Calibration, config: Config, scale: float) -> tuple[float, float]:
    """Return how many pixels are matched, and how many entries a volume of one number a pixel and layer has."""
    pixels = calibration.sensor.width_px * calibration.sensor.height_px / scale**2
    return pixels, pixels * len(config.matcher.layers.values_px) * config.scale / scale


def fitting_jobs(calibration: Calibration, config: Config, jobs: int) -> int:
    """Return how many photographs at a time there is memory for, from 1 to ``jobs``."""
    return max(1, min(jobs, int(min(available_bytes() / needed_bytes(calibration, config), jobs))))


def check_camera_memory(what: str, calibration: Calibration, config: Config) -> bool:
    """Return whether volumes are to be kept on disk; raises OutOfMemoryError where not even that will do."""
    needed = needed_bytes(calibration, config)
    if needed < _SMALL_BYTES and needed < limit_bytes():
        return False
    sensor, scale = calibration.sensor, config.scale
    megapixels = sensor.width_px * sensor.height_px / 1e6
    free, volumes = available_bytes(), volume_bytes(calibration, config)
    if needed > free >= needed - volumes and needed <= address_space_bytes() and 0 < volumes < free_scratch_bytes():
        return True
    fitting = (s for s in SCALES if s > scale and needed_bytes(calibration, config, scale=s) <= free)
    coarser = next((f"match at a coarser scale (--scale 1/{s}), " for s in fitting), "")
    advice = f"{coarser}take smaller pictures, or close other programs"
    check_memory(f"{what}, {megapixels:.3g} megapixels at scale 1/{scale:g}", needed, advice=advice)
    return False


def volumes_go_to_disk(calibration: Calibration, config: Config, *, is_said: bool) -> bool:
    """As `check_camera_memory` just before matching; warns where ``is_said``."""
    on_disk = check_camera_memory("the photograph", calibration, config)
    if on_disk and is_said:
        size = volume_bytes(calibration, config) / 1e9
        warnings.warn(
            f"not enough memory for volumes of {size:.1f} GB: they are kept in {scratch_folder()}, which takes longer; "
            "a coarser --scale needs less",
            CaptureWarning,
            stacklevel=4,
        )
    return on_disk
