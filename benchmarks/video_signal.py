"""From light to what a browser gives of a small sensor's video: noise, tone curve, 4:2:0 colours, 8 bits.

Each step can be left out, so that its cost can be told from that of the others.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

import cv2
import numpy as np

from chromaperture.optics.simulator.sensor import SensorModel, develop, expose
from chromaperture.system.errors import InputError

Curve = Literal["srgb", "bt709"]

# Luma from R, G, B, ITU-R BT.709-6, item 3.2; blue and red differences are divided so that they end at +-0.5.
_LUMA = np.array([0.2126, 0.7152, 0.0722], np.float32)
_BLUE, _RED = np.float32(1.8556), np.float32(1.5748)
_LUMA_STEPS, _CHROMA_STEPS = np.float32(219), np.float32(224)  # 8 bits of narrow range, ITU-R BT.709-6, item 5
_RGB_STEPS = np.float32(255)


@dataclass(frozen=True)
class VideoSignal:
    """What happens to the light of one frame."""

    # Noise of a pixel of the video, and its rounding; None: none, and nothing is clipped below white.
    sensor: SensorModel | None = field(default_factory=SensorModel)
    curve: Curve = "srgb"  # {"srgb", "bt709"}: tone curve of the camera. Whoever reads 8 bits takes them for sRGB
    # {"4:4:4", "4:2:0"}: colours at the full size, or at half of it each way.
    chroma: Literal["4:4:4", "4:2:0"] = "4:2:0"
    bits: Literal[8] | None = 8  # {8, None}: rounding to 8 bits of narrow range, and of R, G, B again; None: none

    def __post_init__(self) -> None:
        if self.curve not in CURVES or self.chroma not in ("4:4:4", "4:2:0") or self.bits not in (8, None):
            raise InputError("a video has the curve srgb or bt709, the chroma 4:4:4 or 4:2:0, and 8 bits or None")


def srgb_curve(light: np.ndarray) -> np.ndarray:
    """Encode by IEC 61966-2-1; (...) float32, clipped to [0, 1]."""
    light = np.clip(np.asarray(light, np.float32), 0, 1)
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** np.float32(1 / 2.4) - 0.055).astype(np.float32)


def bt709_curve(light: np.ndarray) -> np.ndarray:
    """Encode by ITU-R BT.709-6, item 1.2, the curve of video cameras; (...) float32, clipped to [0, 1]."""
    light = np.clip(np.asarray(light, np.float32), 0, 1)
    return np.where(light < 0.018, 4.5 * light, 1.099 * light ** np.float32(0.45) - 0.099).astype(np.float32)


CURVES: dict[str, Callable[[np.ndarray], np.ndarray]] = {"srgb": srgb_curve, "bt709": bt709_curve}


def video_frame(light: np.ndarray, signal: VideoSignal, *, seed: int, exposure: float = 1.0) -> np.ndarray:
    """Simulate one decoded frame.

    ``light`` (H, W, 3) float, linear: of the size of the video; even sides where its chroma is 4:2:0; ``seed``: of the
    noise; ``exposure``: factor on the light; light 1.0 at exposure 1.0 is white. Returns (H, W, 3) float32, R, G, B as
    encoded by the curve, 0 to 1; whole 255ths where it has 8 bits. Raises InputError: odd sides with 4:2:0, or light
    that is negative or not finite.
    """
    light = np.asarray(light, np.float32)
    if signal.sensor is None:
        exposed = light * np.float32(exposure)
    else:
        exposed = develop(expose(light, signal.sensor, seed=seed, exposure=exposure), signal.sensor)
    encoded = CURVES[signal.curve](exposed)
    if signal.chroma == "4:4:4" and signal.bits is None:
        return encoded
    luma = encoded @ _LUMA
    differences = [(encoded[..., 2] - luma) / _BLUE, (encoded[..., 0] - luma) / _RED]
    if signal.chroma == "4:2:0":
        differences = [_halved(plane) for plane in differences]
    if signal.bits is not None:
        luma = np.rint(luma * _LUMA_STEPS) / _LUMA_STEPS
        differences = [np.rint(plane * _CHROMA_STEPS) / _CHROMA_STEPS for plane in differences]
    if signal.chroma == "4:2:0":
        differences = [_doubled(plane) for plane in differences]
    blue, red = luma + _BLUE * differences[0], luma + _RED * differences[1]
    green = (luma - _LUMA[0] * red - _LUMA[2] * blue) / _LUMA[1]
    decoded = np.clip(np.stack([red, green, blue], axis=-1), 0, 1)
    return decoded if signal.bits is None else np.rint(decoded * _RGB_STEPS) / _RGB_STEPS


def drawn_smaller(encoded: np.ndarray, signal: VideoSignal, *, factor: int = 2) -> np.ndarray:
    """Average factor x factor pixels of a frame as a canvas does, in encoded values, with its rounding to 8 bits."""
    height, width = encoded.shape[:2]
    if height % factor or width % factor:
        raise InputError(f"a frame of {width}x{height} px cannot be drawn {factor} times smaller: choose another size")
    mean = encoded.reshape(height // factor, factor, width // factor, factor, 3).mean(axis=(1, 3), dtype=np.float32)
    return mean if signal.bits is None else np.rint(mean * _RGB_STEPS) / _RGB_STEPS


def _halved(plane: np.ndarray) -> np.ndarray:
    height, width = plane.shape
    if height % 2 or width % 2:
        raise InputError(f"4:2:0 needs even sides, not {width}x{height} px")
    return plane.reshape(height // 2, 2, width // 2, 2).mean(axis=(1, 3), dtype=np.float32)


def _doubled(plane: np.ndarray) -> np.ndarray:
    """Interpolate between samples in the middle of their four pixels, linearly."""
    height, width = plane.shape
    return np.asarray(cv2.resize(plane, (2 * width, 2 * height), interpolation=cv2.INTER_LINEAR))
