"""The sRGB curve by a table, compiled."""

from __future__ import annotations

import numpy as np

from chromaperture.system.compilation import compiled


@compiled(error_model="numpy")
def encode(values, table, encoded):  # type: ignore[no-untyped-def]
    """Look up values of linear light, clipped to [0, 1] and NaN as 0, in a table of bytes."""
    last = np.float32(len(table) - 1)
    for i in range(len(values)):
        light = values[i] if values[i] > np.float32(0) else np.float32(0)
        light = light if light < np.float32(1) else np.float32(1)
        encoded[i] = table[np.int32(light * last + np.float32(0.5))]
