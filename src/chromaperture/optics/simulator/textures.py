"""Textures of planes: noise of known statistics, chessboards, plain paper, files."""

from __future__ import annotations

import os
from pathlib import Path

import cv2
import numpy as np

from chromaperture.system.errors import InputError

_MOST_TEXELS = 64e6  # of a plane; noise of that size takes 2 GB


def noise(
    shape: tuple[int, int], *, exponent: float, seed: int, mean: float = 0.45, contrast: float = 0.18
) -> np.ndarray:
    """Generate clipped Gaussian noise, amplitudes falling as frequency^-exponent (1: natural photographs)."""
    spectrum = np.fft.rfft2(np.random.default_rng(seed).normal(size=shape))
    frequency = np.hypot(np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1])[None])
    frequency[0, 0] = np.inf
    picture = np.fft.irfft2(spectrum * frequency**-exponent if exponent else spectrum, shape)
    picture *= contrast / picture.std()
    return np.clip(picture - picture.mean() + mean, 0.02, 0.98).astype(np.float32)


def chessboard(inner_corners: tuple[int, int], square_mm: float, texel_mm: float) -> np.ndarray:
    """Draw a chessboard with a white margin of one square, its top-left square black."""
    nx, ny = inner_corners[0] + 1, inner_corners[1] + 1
    width, height = (round((n * square_mm + 2 * square_mm) / texel_mm) for n in (nx, ny))
    x, y = (((np.arange(n) + 0.5) * texel_mm - square_mm) / square_mm for n in (width, height))
    inside = ((x >= 0) & (x < nx))[None] & ((y >= 0) & (y < ny))[:, None]
    black = (np.floor(x)[None] + np.floor(y)[:, None]) % 2 == 0
    return np.where(inside & black, 0.04, 0.92).astype(np.float32)


def named(
    name: str,
    *,
    width_mm: float,
    height_mm: float,
    texel_mm: float,
    color: tuple[float, float, float],
    seed: int,
    folder: Path | None,
) -> np.ndarray:
    """Make a scene file's texture; (h, w, 3) float32 linear. Raises InputError for unknown names."""
    height, width = height_mm / texel_mm, width_mm / texel_mm
    if not max(height, 2) * max(width, 2) <= _MOST_TEXELS:
        raise InputError(f"a texture of {width:.0f}x{height:.0f} texels is too large: raise texel_mm")
    shape = (max(2, round(height)), max(2, round(width)))
    tint = np.asarray(color, np.float32)
    if name == "plain":
        return np.broadcast_to(tint, (*shape, 3)).astype(np.float32)
    if name in ("speckle", "clouds"):
        grey = noise(shape, exponent=1.0 if name == "speckle" else 1.6, seed=seed)
        return np.clip(grey[..., None] * tint / 0.45, 0, 1).astype(np.float32)
    if name == "chessboard":
        board = chessboard((9, 6), width_mm / 12, texel_mm)
        return np.repeat(board[..., None], 3, axis=2)
    path = (folder or Path()) / name
    picture = cv2.imread(str(path), cv2.IMREAD_COLOR) if os.path.isfile(path) else None
    if picture is None:
        raise InputError(
            f"unknown texture {name!r}: choose plain, speckle, clouds, chessboard or a readable picture file"
        )
    return srgb_to_linear(picture[..., ::-1].astype(np.float32) / 255)


def srgb_to_linear(encoded: np.ndarray) -> np.ndarray:
    """Decode the sRGB curve (IEC 61966-2-1), float32; the simulator's own, independent of the estimator's."""
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4).astype(np.float32)
