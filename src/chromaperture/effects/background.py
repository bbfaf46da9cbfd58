"""Effects that depth guides: the background loses its colour, or its sharpness."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from chromaperture.effects.refocusing import Focus, refocus
from chromaperture.errors import InputError

BackgroundEffect = Literal["keep", "desaturate", "blur"]
BACKGROUND_EFFECTS: tuple[BackgroundEffect, ...] = get_args(BackgroundEffect)
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)
_DEEP_PX = 1.0  # blur radius of the capture by which the focus surface is deep


def background_share(radius_px: np.ndarray, focus_radius_px: float) -> np.ndarray:
    """How much each pixel belongs to what lies behind the focus; rises smoothly, (H, W) float32 in [0, 1]."""
    t = np.clip((radius_px - np.float32(focus_radius_px)) / _DEEP_PX - 1, 0, 1).astype(np.float32)
    return t * t * (3 - 2 * t)


def desaturate_background(color: np.ndarray, radius_px: np.ndarray, focus_radius_px: float) -> np.ndarray:
    """Turn what lies behind the focus grey, at its own luminance.

    Parameters
    ----------
    color : (H, W, 3) float32, linear RGB
    radius_px : (H, W) float32, px
        Signed blur radius of the capture, + beyond its focus.
    focus_radius_px : float
        That of the surface that keeps its colour.

    Returns
    -------
    (H, W, 3) float32
    """
    grey = (color @ _LUMINANCE)[..., None]
    share = background_share(radius_px, focus_radius_px)[..., None]
    return np.asarray(color + share * (grey - color), np.float32)


def blur_background(color: np.ndarray, radius_px: np.ndarray, focus: Focus) -> np.ndarray:
    """Blur only what lies behind the focus; all before it stays sharp. See `refocus`; (H, W, 3) float32."""
    return refocus(color, np.maximum(radius_px, np.float32(focus.radius_px)), focus)


def apply_background(color: np.ndarray, radius_px: np.ndarray, focus: Focus, effect: BackgroundEffect) -> np.ndarray:
    """Refocus with one of the effects; raises InputError for an unknown one; (H, W, 3) float32."""
    if effect not in BACKGROUND_EFFECTS:
        raise InputError(f"unknown background effect {effect!r}: choose {', '.join(BACKGROUND_EFFECTS)}")
    if effect == "blur":
        return blur_background(color, radius_px, focus)
    if effect == "desaturate":
        color = desaturate_background(color, radius_px, focus.radius_px)
    return refocus(color, radius_px, focus)
