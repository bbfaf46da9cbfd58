"""Let several fits of planes and the surface that they explain vote, block by block, on where each block lies.

Which neighbours become one plane often hangs on next to nothing. Fits with other costs of borders are wrong in other
places. Each says: with some probability a block lies on my plane, else where the surface is. The mean of what they say
is a mixture of places, and its mode is the answer. Where the photograph's depth edges bound areas, the fits have one
half of the votes and the surface the other, and the plane that wins is taken. Where the guide bounds them planes are
wrong more often, and how far a fit is to be trusted is told by what told the errors of planes and of surfaces apart on
captures of known depth: a surface that is rough nearby follows noise, which planes take out; a plane that much of its
own area contradicts is wrong elsewhere, too. The probability is that of logistic regression (Cox 1958);
``benchmarks/plane_voting_training.py`` found its weights.

References
----------
D. R. Cox: The regression analysis of binary sequences. JRSS B 20, 1958. doi:10.1111/j.2517-6161.1958.tb00292.x
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from chromaperture.disparity.learned_error_bar import POOLED_PX, pooled
from chromaperture.disparity.plane_agreement import AGREEMENT_SIGMAS
from chromaperture.disparity.plane_fit import Planes, of_pixels
from chromaperture.threads import parallel_map

ROUGH_PX = 16.0  # sigma of the window in which differences are averaged; 4, 8, 32 px: docs/measurements.md
MOST_DIFFERENCE = 3.0  # labels: a depth edge does not count more; 1 and 10: docs/measurements.md
LEAST = 0.02  # labels: smaller differences and error bars are not told apart, and every sign needs a finite logarithm
NEAR_LABELS = 2.0  # standard deviation of what counts as the same place; 3: docs/measurements.md
# Share of the most votes with which a plane is as good as the best: one .4 labels away is; 1: docs/measurements.md.
ALIKE = 0.98


class Trust(NamedTuple):
    """Log odds that a plane is nearer to the truth where it and the surface are more than a label apart.

    Attributes
    ----------
    weights : dict
        Of `signs_of_trust`.
    constant : float
    """

    weights: dict[str, float]
    constant: float


# For areas that the guide bounds; found by ``benchmarks/plane_voting_training.py``. docs/measurements.md has the gain.
OF_GUIDED = Trust({"rough": 0.22, "posterior": 0.29, "rejected": -1.51, "agreed": 0.38}, 0.29)


def voted_planes(
    fits: Sequence[Planes],
    surface_px: np.ndarray,
    sigma_px: np.ndarray,
    step_px: float,
    block_px: int,
    *,
    trust: Trust | None = None,
) -> Planes:
    """Give every block the plane for which most of the fits' probability speaks.

    Parameters
    ----------
    fits : sequence of Planes
        Of one picture; blocks have one plane each.
    surface_px, sigma_px : (H, W) float, px
        The surface that they explain, without NaN, and the standard deviation of its posterior.
    step_px : float
        Between two labels.
    block_px : int
        Side of a block. H and W are at least twice as large.
    trust : Trust or None
        Without, a fit is as likely nearer to the truth as the surface, and planes are trusted everywhere.

    Returns
    -------
    Planes
        Those of all fits that a block has, with ``trusted``: with a trust, where more speaks for the plane than for
        the surface.
    """
    label_of = np.stack([labels_of_blocks(fit, block_px) for fit in fits])
    log_odds = np.zeros_like(label_of)
    if trust is not None:
        signs = signs_of_trust(fits, surface_px, sigma_px, step_px, block_px)
        log_odds += trust.constant + sum(trust.weights[name] * sign for name, sign in signs.items())
    of_planes, of_surface = votes(
        label_of / np.float32(step_px), block_means(surface_px, block_px) / np.float32(step_px), log_odds
    )
    best = chosen_fit(of_planes)
    firsts = np.cumsum([0, *(len(fit.planes) for fit in fits)])[: len(fits)]
    every = np.stack([_of_blocks(fit.choice, block_px) + first for fit, first in zip(fits, firsts, strict=True)])
    used, choice = np.unique(np.take_along_axis(every, best[None], axis=0)[0], return_inverse=True)
    trusted = of_planes.max(axis=0) >= of_surface if trust is not None else np.ones(best.shape, bool)
    planes = np.concatenate([fit.planes for fit in fits])[used]
    choice_at, trusted_at = (
        of_pixels(part.reshape(best.shape), surface_px.shape, block_px) for part in (choice, trusted)
    )
    return Planes(planes, choice_at, fits[0].blocks, trusted_at, label_of)


def votes(label: np.ndarray, surface: np.ndarray, log_odds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return how much of what the fits say lies at each one's plane, and at the surface.

    Parameters
    ----------
    label : (K, h, w) float, labels
        Of the planes of K fits.
    surface : (h, w) float, labels
    log_odds : (K, h, w) float
        That a fit's plane is nearer to the truth than the surface.

    Returns
    -------
    of_planes : (K, h, w) float
    of_surface : (h, w) float
    """
    likely = 1 / (1 + np.exp(-log_odds)) / len(label)
    places = np.concatenate([label, surface[None]])
    shares = np.concatenate([likely, 1 - likely.sum(axis=0, keepdims=True)])
    found = np.stack(
        [(shares * np.exp(-((places - place) ** 2) / (2 * NEAR_LABELS**2))).sum(axis=0) for place in places]
    )
    return found[:-1], found[-1]


def chosen_fit(of_planes: np.ndarray) -> np.ndarray:
    """Return the first fit whose plane is as good as the best, so that areas stay whole; (h, w) int of (K, h, w)."""
    return np.asarray((of_planes >= ALIKE * of_planes.max(axis=0)).argmax(axis=0))


def planes_or_surface(planes: Planes, surface_px: np.ndarray, step_px: float) -> np.ndarray:
    """Take the planes where they are trusted or lie within a label of the surface that they explain, else the surface.

    Closer than a label a plane, which many pixels tell, is the more exact.

    Parameters
    ----------
    planes : Planes
        With ``trusted``.
    surface_px : (H, W) float, px
    step_px : float
        Between two labels.

    Returns
    -------
    (H, W) float32, px
    """
    label_px = planes.label_px
    return np.where(planes.trusted | (np.abs(label_px - surface_px) <= step_px), label_px, surface_px).astype(
        np.float32
    )


def signs_of_trust(
    fits: Sequence[Planes], surface_px: np.ndarray, sigma_px: np.ndarray, step_px: float, block_px: int
) -> dict[str, np.ndarray]:
    """Return what tells whether planes are to be trusted, as `voted_planes`; (K, h, w) or (h, w) float32 each.

    ``rough``: logarithm of how far the surface's neighbouring pixels differ, labels. ``posterior``: logarithm of its
    error bar, labels. ``rejected``: share of the pixels of a plane from which the surface is apart, by more than
    `AGREEMENT_SIGMAS` of its error bars. ``agreed``: share of the pixels around that are not apart from their plane.
    """
    sigma = np.hypot(sigma_px, step_px)  # with a label's own place

    def rough() -> np.ndarray:
        differences = neighbour_differences(np.asarray(surface_px, np.float32) / np.float32(step_px))
        return np.log(pooled(block_means(differences, block_px), ROUGH_PX / block_px) + np.float32(LEAST))

    def posterior() -> np.ndarray:
        variance = block_means(np.square(sigma_px, dtype=np.float32) / np.float32(step_px) ** 2, block_px)
        return np.log(np.sqrt(pooled(variance, POOLED_PX / block_px)) + np.float32(LEAST))

    def apart_of(fit: Planes) -> Callable[[], np.ndarray]:
        return lambda: block_means(np.abs(fit.label_px - surface_px) > AGREEMENT_SIGMAS * sigma, block_px)

    first, second, *apart = parallel_map(lambda work: work(), [rough, posterior, *map(apart_of, fits)])
    rejected = [
        (np.bincount(choice.ravel(), share.ravel()) / np.maximum(np.bincount(choice.ravel()), 1))[choice]
        for share, choice in zip(apart, (_of_blocks(fit.choice, block_px) for fit in fits), strict=True)
    ]
    return {
        "rough": first,
        "posterior": second,
        "rejected": np.asarray(rejected, np.float32),
        "agreed": 1 - np.stack([pooled(share, POOLED_PX / block_px) for share in apart]),
    }


def neighbour_differences(label: np.ndarray) -> np.ndarray:
    """Return how far a pixel's right and lower neighbours differ, summed, at most `MOST_DIFFERENCE`; (H, W) float32."""
    out = np.zeros(label.shape, np.float32)
    out[:, :-1] += np.abs(np.diff(label, axis=1))
    out[:-1] += np.abs(np.diff(label, axis=0))
    return np.minimum(out, np.float32(MOST_DIFFERENCE))


def labels_of_blocks(fit: Planes, block_px: int) -> np.ndarray:
    """Return the label of a plane, of which every block has one, in the middles of blocks; (h, w) float32, px."""
    choice = _of_blocks(fit.choice, block_px)
    y, x = (block_px * np.arange(n) + (block_px - 1) / 2 for n in choice.shape)
    a, b, c = (fit.planes[:, i][choice] for i in range(3))
    return np.asarray(a * x + b * y[:, None] + c, np.float32)


def block_means(values: np.ndarray, block_px: int) -> np.ndarray:
    """Return the means of squares of pixels, without what is left over at the right and below; (h, w) float32."""
    height, width = (n // block_px for n in values.shape)
    whole = np.asarray(values[: height * block_px, : width * block_px], np.float32)
    return whole.reshape(height, block_px, width, block_px).mean(axis=(1, 3))


def _of_blocks(values: np.ndarray, block_px: int) -> np.ndarray:
    """Return what whole blocks have in all of their pixels; (h, w)."""
    height, width = (n // block_px for n in values.shape)
    return values[: height * block_px : block_px, : width * block_px : block_px]
