"""Figures of an aperture that follow from its masks alone: light, centroids and how far they are from the centre."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from chromaperture.optics.aperture import Aperture, centroids, channel_transmission

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # ITU-R BT.709


@dataclass(frozen=True)
class ApertureFigures:
    """Figures of one design."""

    channel_transmission: np.ndarray  # (3,) float64; light in R, G, B over that of the open pupil
    efficiency_mean: float  # mean of the three
    efficiency_luminance: float  # the same, weighted by luminance (ITU-R BT.709)
    centroids: np.ndarray  # (K, 2) float64; of the K channels, pupil radii; NaN for a channel without light
    beta: float  # r_c / R, mean distance of the outlying centroids from the pupil's centre, half the baseline: Eq. (6)


def film_unmixing(aperture: Aperture) -> np.ndarray:
    """Compute the least-squares unmixing of white light into the views; (K, 3) float64, identity without views."""
    if not aperture.views:
        return np.eye(3)
    colours = np.array([aperture.filter_named(name).transmission for name in aperture.views])
    return np.linalg.pinv(colours.T)


def aperture_figures(aperture: Aperture, unmixing: np.ndarray | None = None) -> ApertureFigures:
    """Compute the figures of a design for the sensor's channels, or for combinations of them.

    ``unmixing`` (K, 3) float: rows are combinations of R, G, B; see `film_unmixing`. The identity when absent.
    """
    transmission = channel_transmission(aperture)
    rho = centroids(aperture, unmixing)
    seen = rho[np.isfinite(rho).all(axis=1)]
    distance = np.linalg.norm(seen, axis=1)
    outlying = distance > 1e-6  # green is the centred reference of complementary halves
    return ApertureFigures(
        channel_transmission=transmission,
        efficiency_mean=float(transmission.mean()),
        efficiency_luminance=float(transmission @ LUMINANCE),
        centroids=rho,
        beta=float(distance[outlying].mean()) if outlying.any() else 0.0,
    )
