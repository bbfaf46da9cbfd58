"""Effects guided by depth: remove colour or sharpness from the background."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from chromaperture.effects.refocusing import Compositor, Focus, refocus
from chromaperture.system.errors import InputError

BackgroundEffect = Literal["keep", "desaturate", "blur"]
BACKGROUND_EFFECTS: tuple[BackgroundEffect, ...] = get_args(BackgroundEffect)
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)  # of linear sRGB, IEC 61966-2-1
_RAMP_PX = 1.0  # blur radius over which the background sets in, and its distance from the focus; chosen by hand


def background_weight(radius_px: np.ndarray, focus_radius_px: float) -> np.ndarray:
    """Return how far each pixel belongs to the background of the focus, a smooth step; (H, W) float32 in [0, 1]."""
    t = np.clip((radius_px - np.float32(focus_radius_px)) / _RAMP_PX - 1, 0, 1).astype(np.float32)
    return t * t * (3 - 2 * t)


def desaturate_background(color: np.ndarray, radius_px: np.ndarray, focus_radius_px: float) -> np.ndarray:
    """Turn the background grey at its own luminance.

    ``color`` (H, W, 3) float32, linear RGB; ``radius_px`` (H, W) float32, px: signed blur radius of the capture, +
    beyond its focus; ``focus_radius_px``: that of the surface that keeps its colour. Returns (H, W, 3) float32.
    """
    grey = (color @ _LUMINANCE)[..., None]
    weight = background_weight(radius_px, focus_radius_px)[..., None]
    return np.asarray(color + weight * (grey - color), np.float32)


def apply_background(
    color: np.ndarray,
    radius_px: np.ndarray,
    focus: Focus,
    effect: BackgroundEffect,
    *,
    compositor: Compositor | None = None,
) -> np.ndarray:
    """Refocus with one of the effects, see `refocus`; raises InputError for an unknown one; (H, W, 3) float32."""
    if effect not in BACKGROUND_EFFECTS:
        raise InputError(f"unknown background effect {effect!r}: choose {', '.join(BACKGROUND_EFFECTS)}")
    if effect == "blur":  # only what lies behind the focus
        radius_px = np.maximum(radius_px, np.float32(focus.radius_px))
    elif effect == "desaturate":
        color = desaturate_background(color, radius_px, focus.radius_px)
    return refocus(color, radius_px, focus, compositor=compositor)
