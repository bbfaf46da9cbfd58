"""What a photograph will take of memory, and a refusal before work begins where there is not that much."""

from __future__ import annotations

from chromaperture.camera_file import Calibration
from chromaperture.camera_scale import SCALES
from chromaperture.config import Config
from chromaperture.memory import available_bytes, check_memory

# The program; a pixel of the photograph, with its results and files; a pixel that is matched, and a layer there. Peaks
# of 0.35 to 24 megapixels at scales of 1/8 to 1/2 (`benchmarks/large_pictures.py`) are 2 to 27 % below the sums.
_PROGRAM_BYTES, _PIXEL_BYTES = 0.3e9, 78
_MATCHED_BYTES = {"paper": (120, 3.0), "real-time": (120, 0.8), "accurate": (200, 16.0)}
_SMALL_BYTES = 1e9  # not checked: asking the system for every frame of a video is not worth it


def needed_bytes(calibration: Calibration, config: Config, *, scale: float | None = None) -> float:
    """Estimate the most memory that measuring a photograph and writing its files takes.

    Parameters
    ----------
    calibration : Calibration
        Of the photograph's size.
    config : Config
    scale : float, optional
        Instead of the configuration's: at a coarser one the range holds fewer layers.
    """
    sensor, scale = calibration.sensor, scale or config.scale
    pixels = sensor.width_px * sensor.height_px
    each, each_layer = _MATCHED_BYTES[config.quality]
    layers = len(config.matcher.layers.values_px) * config.scale / scale
    return _PROGRAM_BYTES + _PIXEL_BYTES * pixels + pixels / scale**2 * (each + each_layer * layers)


def fitting_jobs(calibration: Calibration, config: Config, jobs: int) -> int:
    """Return how many photographs at a time there is memory for, 1 at least and at most ``jobs``.

    Where there is none for a single one, `check_camera_memory` refuses it.
    """
    return max(1, min(jobs, int(min(available_bytes() / needed_bytes(calibration, config), jobs))))


def check_camera_memory(what: str, calibration: Calibration, config: Config) -> None:
    """Check that there is memory for a photograph.

    Parameters
    ----------
    what : str
        The photograph, for the message.
    calibration : Calibration
        Of the photograph's size.
    config : Config

    Raises
    ------
    OutOfMemoryError
        It would need more than this process may use.
    """
    needed = needed_bytes(calibration, config)
    if needed < _SMALL_BYTES:
        return
    sensor, scale = calibration.sensor, config.scale
    megapixels = sensor.width_px * sensor.height_px / 1e6
    free = available_bytes()
    fitting = (s for s in SCALES if s > scale and needed_bytes(calibration, config, scale=s) <= free)
    coarser = next((f"match at a coarser scale (--scale 1/{s}), " for s in fitting), "")
    advice = f"{coarser}take smaller pictures, or close other programs"
    check_memory(f"{what}, {megapixels:.3g} megapixels at scale 1/{scale:g}", needed, advice=advice)
