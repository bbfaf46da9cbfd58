"""Log-likelihood of layers by the correlations of pairs of channels, in plain NumPy: the oracle of the compiled one.

Correlations are smoother along the layers than their squares, which count: where a layer's is not computed, it is read
from a polynomial through six others.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from chromaperture.matching.readable.paths import lagrange_weights

# 3.5 nats a band at most: a perfect agreement must not outweigh the whole neighbourhood
MAX_CORRELATION2_OF_BANDS = 0.999
CONTRARY = 0.3  # product of two pairs' correlations; .1 and any finds the same: docs/decisions.md


class Fallback(NamedTuple):
    """How much secondary pairs count beside primary ones; see `CrossFilterConfig`."""

    weight: float
    nats: float


def pair_evidence(
    correlation: np.ndarray, places: np.ndarray, *, primary: int, band_weights: Sequence[float], fallback: Fallback
) -> np.ndarray:
    """Return what the correlations of all pairs and bands earn at every layer.

    Parameters
    ----------
    correlation : (L, P, B, H, W) float32
        Of the layers that are computed, P pairs and B bands.
    places : (2, D) int
        Where in ``correlation`` every layer's is, of primary pairs and of the others. Where it is -1, it is read
        between two: between even layers if its number is odd, else between every fourth.
    primary : int
        Pairs that are primary: the first.
    band_weights : (B,) float
    fallback : Fallback

    Returns
    -------
    (H, W, D) float32, nats a pixel
    """
    every = np.stack(
        [_every_layer(correlation[:, pair], places[0 if pair < primary else 1]) for pair in range(correlation.shape[1])]
    )
    logs = np.log1p(-explained_variance(every))  # (P, D, B, H, W)
    nats = np.tensordot(logs, np.float32(-0.5) * np.asarray(band_weights, np.float32), axes=(2, 0))
    likelihood = nats[:primary].mean(axis=0)
    if len(nats) > primary:
        weight = np.exp(-likelihood.max(axis=0) / np.float32(fallback.nats))
        likelihood += np.float32(fallback.weight) * weight * nats[primary:].mean(axis=0)
    return np.ascontiguousarray(np.moveaxis(likelihood, 0, -1))


def _every_layer(computed: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Correlations of all layers (D, ...) from those that are computed, (L, ...)."""
    evens = places[::2]
    every_second = computed[evens]
    if (evens < 0).any():
        between = with_midpoints(computed[evens[::2]])
        unknown = np.flatnonzero(evens < 0)
        every_second[unknown] = between[unknown]
    out = with_midpoints(every_second)
    known = 1 + 2 * np.flatnonzero(places[1::2] >= 0)
    out[known] = computed[places[known]]
    return out


def with_midpoints(volume: np.ndarray) -> np.ndarray:
    """Interpolate a volume (D, ...) halfway between its layers, by a polynomial through six; (2 D - 1, ...)."""
    count = len(volume)
    mirrored = [2 * volume[0] - volume[min(k, count - 1)] for k in (2, 1)]
    wide = np.stack([*mirrored, *volume, *(2 * volume[-1] - volume[max(count - 1 - k, 0)] for k in (1, 2))])
    out = np.empty((2 * count - 1, *volume.shape[1:]), volume.dtype)
    out[::2] = volume
    weights = (np.float32(weight) for weight in lagrange_weights(np.array(0.5)))
    out[1::2] = sum(weight * wide[k : k + count - 1] for k, weight in enumerate(weights))
    return out


def explained_variance(correlation: np.ndarray) -> np.ndarray:
    """Return the share of variance that pairs of channels explain of each other, bounded; as (pairs, ...).

    Where orange meets blue, one channel rises as another falls: their correlation is negative, and as good a sign.
    The signs of a surface that changes between two colours agree: of three pairs none or two are negative. A negative
    correlation counts as far as the product of the other two is negative, in full from `CONTRARY` on.
    """
    found = np.maximum(correlation, 0) ** 2
    for i in range(len(correlation) if len(correlation) == 3 else 0):
        one, other = (correlation[k] for k in range(3) if k != i)
        contrary = np.clip(one * other / np.float32(-CONTRARY), 0, 1)
        found[i] += contrary * np.minimum(correlation[i], 0) ** 2
    return np.asarray(np.minimum(found, np.float32(MAX_CORRELATION2_OF_BANDS)))
