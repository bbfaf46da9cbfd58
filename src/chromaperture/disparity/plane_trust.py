"""Choose between planes and the surface that they explain, by what told their errors apart on captures of known depth.

`where_they_agree` compares both by the error bar of the surface alone. That is one of four signs here: a surface that
is rough nearby follows noise, which planes take out; a plane that much of its own area contradicts is wrong elsewhere,
too. The choice is logistic regression (Cox 1958); ``benchmarks/plane_trust_training.py`` found its weights.

References
----------
D. R. Cox: The regression analysis of binary sequences. JRSS B 20, 1958. doi:10.1111/j.2517-6161.1958.tb00292.x
"""

from __future__ import annotations

import numpy as np

from chromaperture.disparity.error_bar import pooled_sigma
from chromaperture.disparity.learned_error_bar import POOLED_PX, pooled
from chromaperture.disparity.planar import Planes
from chromaperture.disparity.plane_agreement import AGREEMENT_SIGMAS, where_they_agree
from chromaperture.threads import parallel_map

ROUGH_PX = 16.0  # sigma of the window in which differences are averaged; 4, 8, 32 px: docs/measurements.md
MOST_DIFFERENCE = 3.0  # labels: a depth edge does not count more; 1 and 10: docs/measurements.md
LEAST = 0.02  # labels: smaller steps and error bars are not told apart, and every sign needs a finite logarithm
# Log odds that the plane is nearer to the truth where both are more than a label apart, by sign; found by
# ``benchmarks/plane_trust_training.py``.
WEIGHTS = {"rough": 0.22, "posterior": 0.29, "rejected": -1.51, "agreed": 0.38}
CONSTANT = 0.29


def planes_or_surface(planes: Planes, surface_px: np.ndarray, sigma_px: np.ndarray, step_px: float) -> np.ndarray:
    """Take the planes where they are trusted or lie within a label of the surface that they explain, else the surface.

    Closer than a label a plane, which many pixels tell, is the more exact.

    Parameters
    ----------
    planes : Planes
    surface_px, sigma_px : (H, W) float, px
        The surface, without NaN, and the standard deviation of its posterior.
    step_px : float
        Between two labels.

    Returns
    -------
    (H, W) float32, px
    """
    found = signs_of_trust(planes, surface_px, sigma_px, step_px)
    log_odds = sum((np.float32(WEIGHTS[name]) * sign for name, sign in found.items()), start=np.float32(CONSTANT))
    label_px = planes.label_px
    taken = (log_odds > 0) | (np.abs(label_px - surface_px) <= step_px)
    return np.where(taken, label_px, surface_px).astype(np.float32)


def signs_of_trust(
    planes: Planes, surface_px: np.ndarray, sigma_px: np.ndarray, step_px: float
) -> dict[str, np.ndarray]:
    """Return what tells whether planes are to be trusted, as `planes_or_surface`; (H, W) float32 each.

    ``rough``: logarithm of how far the surface's neighbouring pixels differ, labels. ``posterior``: logarithm of its
    error bar, labels. ``rejected``: share of the pixels of a plane from which the surface is apart. ``agreed``: share
    of the pixels around at which `where_they_agree` takes the plane.
    """
    sigma = np.hypot(sigma_px, step_px)  # with a label's own place
    label_px = planes.label_px

    def rough() -> np.ndarray:
        label = np.asarray(surface_px, np.float32) / np.float32(step_px)
        return np.log(pooled(neighbour_differences(label), ROUGH_PX) + np.float32(LEAST))

    def posterior() -> np.ndarray:
        return np.log(pooled_sigma(sigma_px, POOLED_PX) / np.float32(step_px) + np.float32(LEAST))

    def rejected() -> np.ndarray:
        apart = np.abs(label_px - surface_px) > AGREEMENT_SIGMAS * sigma
        area = np.bincount(planes.choice.ravel())
        of_plane = np.bincount(planes.choice.ravel(), apart.ravel()) / np.maximum(area, 1)
        return of_plane.astype(np.float32)[planes.choice]

    def agreed() -> np.ndarray:
        return pooled(where_they_agree(planes, surface_px, sigma) == label_px)

    work = {"rough": rough, "posterior": posterior, "rejected": rejected, "agreed": agreed}
    return dict(zip(work, parallel_map(lambda sign: sign(), list(work.values())), strict=True))


def neighbour_differences(label: np.ndarray) -> np.ndarray:
    """Return how far a pixel's right and lower neighbours differ, summed, at most `MOST_DIFFERENCE`; (H, W) float32."""
    out = np.zeros(label.shape, np.float32)
    out[:, :-1] += np.abs(np.diff(label, axis=1))
    out[:-1] += np.abs(np.diff(label, axis=0))
    return np.minimum(out, np.float32(MOST_DIFFERENCE))
