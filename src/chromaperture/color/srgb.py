"""The sRGB curve, for picture files; all other images of the package are linear."""

from __future__ import annotations

from functools import cache

import numpy as np

from chromaperture.system.threads import in_parallel

_LEVELS = 65535  # of the table: 16 bits


def srgb_to_linear(encoded: np.ndarray) -> np.ndarray:
    """Decode the sRGB curve (IEC 61966-2-1); float32 in [0, 1]."""
    encoded = np.asarray(encoded, np.float32)
    return np.where(encoded <= 0.04045, encoded / 12.92, ((np.maximum(encoded, 0.0) + 0.055) / 1.055) ** 2.4).astype(
        np.float32
    )


def linear_to_srgb(linear: np.ndarray) -> np.ndarray:
    """Encode linear light with the sRGB curve, clipped; float32 in [0, 1]."""
    light = np.clip(np.nan_to_num(np.asarray(linear, np.float32)), 0, 1)
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055).astype(np.float32)


def linear_to_srgb_bytes(linear: np.ndarray, *, out: np.ndarray | None = None) -> np.ndarray:
    """Encode linear light as 8-bit sRGB, clipped, NaN black, by a table within a fiftieth of a grey level."""
    from chromaperture.color import srgb_kernels  # compiling starts here, not at import

    light = np.ascontiguousarray(linear, np.float32)
    values, table = light.reshape(-1), _bytes()
    if out is not None:  # a band: its caller has divided the work
        srgb_kernels.encode(values, table, out.reshape(-1))
        return out
    encoded = np.empty(light.size, np.uint8)

    def encode(thread: int, first: int, last: int) -> None:
        srgb_kernels.encode(values[first:last], table, encoded[first:last])

    in_parallel(encode, values.size)
    return encoded.reshape(light.shape)


@cache
def _bytes() -> np.ndarray:
    return np.rint(linear_to_srgb(np.arange(_LEVELS + 1) / _LEVELS) * 255).astype(np.uint8)
