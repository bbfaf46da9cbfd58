"""Maps whose rows are made when a writer asks for them: of many megapixels no further map is kept in memory."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class RowsOnDemand:
    """A map (H, W) or (H, W, C) that only gives slices of rows, each made anew."""

    shape: tuple[int, ...]
    dtype: np.dtype
    make: Callable[[slice], np.ndarray]  # from a slice of rows to their array

    def __getitem__(self, rows: slice) -> np.ndarray:
        return self.make(rows)

    def __len__(self) -> int:
        return self.shape[0]


Rows = np.ndarray | RowsOnDemand
