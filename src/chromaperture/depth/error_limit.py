"""Removal of uncertain depth, for products that carry no error bar."""

from __future__ import annotations

from typing import TYPE_CHECKING

from chromaperture.system.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from chromaperture.system.memory import RowsOnDemand

# sigma / depth. Filled pixels and those of them within 5 % of the truth, real-time, 24 frames of a ray-traced walk past
# halves of a pupil: 99 and 60 % without a limit, 66 and 71 % at 0.15, 45 and 81 % at 0.10, 18 and 89 % at 0.05.
MAX_RELATIVE_SIGMA = 0.10


def checked_limit(max_relative_sigma: float) -> float:
    """Return a limit of sigma / depth; raises InputError for what is not positive."""
    if not max_relative_sigma > 0:
        raise InputError(f"the largest relative sigma must be positive, got {max_relative_sigma:g}")
    return max_relative_sigma


def within_error(
    depth_mm: np.ndarray, sigma_mm: np.ndarray, max_relative_sigma: float = MAX_RELATIVE_SIGMA
) -> np.ndarray:
    """Remove depth whose standard deviation is too large a fraction of it.

    Parameters
    ----------
    depth_mm, sigma_mm : (H, W) float, mm, NaN unknown
    max_relative_sigma : float
        Largest sigma / depth; inf keeps every pixel with an error bar.

    Returns
    -------
    (H, W) float32, mm; NaN where removed

    Raises
    ------
    InputError
        The limit is not positive.
    """
    checked_limit(max_relative_sigma)
    import numpy as np  # here: the command line reads the constant above, and shows its help without NumPy

    from chromaperture.system.threads import each_band

    kept = np.array(depth_mm, np.float32)

    def remove(rows: slice) -> None:
        with np.errstate(invalid="ignore"):  # NaN compares false; inf * 0 too
            certain = sigma_mm[rows] <= max_relative_sigma * depth_mm[rows]
        kept[rows][~certain] = np.nan

    each_band(remove, len(kept))
    return kept


def rows_within_error(depth_mm: np.ndarray, sigma_mm: np.ndarray, max_relative_sigma: float) -> RowsOnDemand:
    """Return `within_error`, made row by row when it is asked for; raises InputError as it does."""
    import numpy as np

    from chromaperture.system.memory import RowsOnDemand

    def make(rows: slice) -> np.ndarray:
        return within_error(depth_mm[rows], sigma_mm[rows], max_relative_sigma)

    make(slice(0, 1))  # an error is raised here
    return RowsOnDemand(depth_mm.shape, np.dtype(np.float32), make)
