"""What a photograph will take of memory, and a refusal before work begins where there is not that much."""

from __future__ import annotations

from chromaperture.camera_file import Calibration
from chromaperture.config import Config
from chromaperture.memory import check_memory

# The program; a pixel of the photograph, with its results and files; a pixel that is matched, and a layer there. Peaks
# that `benchmarks/large_pictures.py --memory` measures are below these by up to a quarter.
_PROGRAM_BYTES, _PIXEL_BYTES = 0.3e9, 75
_MATCHED_BYTES = {"paper": (100, 8), "real-time": (120, 2), "accurate": (200, 28)}
_SMALL_BYTES = 1e9  # not checked: asking the system for every frame of a video is not worth it


def needed_bytes(calibration: Calibration, config: Config) -> float:
    """Estimate the most memory that measuring a photograph and writing its files takes."""
    sensor = calibration.sensor
    pixels = sensor.width_px * sensor.height_px
    each, each_layer = _MATCHED_BYTES[config.quality]
    layers = len(config.matcher.layers.values_px)
    return _PROGRAM_BYTES + _PIXEL_BYTES * pixels + pixels / config.scale**2 * (each + each_layer * layers)


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
    advice = f"give a coarser working scale, such as --scale 1/{2 * scale}, a smaller picture, or close other programs"
    check_memory(f"{what}, {megapixels:.3g} megapixels at scale 1/{scale}", needed, advice=advice)
