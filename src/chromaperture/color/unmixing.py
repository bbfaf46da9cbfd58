"""Unmixing of sensor channels into the views through the filters (paper section 2.2, Eq. (1))."""

from __future__ import annotations

import numpy as np

from chromaperture.optics.aperture import Aperture, centroids
from chromaperture.system.errors import InputError

# Limits of usable film: noise of the views grows with the condition number. Chosen by hand, not tuned.
_MIN_FILTER_ANGLE_DEG = 15.0
_MAX_CONDITION = 20.0


def mixing_matrix(filter_colors: np.ndarray) -> np.ndarray:
    """Build M, (3, 3), from R, G, B of white light through 2 or 3 filters, (K, 3) of any scale: its columns.

    For two filters the third column is the unit normal X of their plane: then the first two rows of the inverse are the
    least-squares unmixing, and the third measures the residual. Raises InputError: colours not finite, or too similar.
    """
    colors = np.asarray(filter_colors, float)
    if colors.ndim != 2 or colors.shape[0] not in (2, 3) or colors.shape[1] != 3 or not np.isfinite(colors).all():
        raise InputError("filter colours must be two or three finite R, G, B triples")
    norms = np.linalg.norm(colors, axis=1, keepdims=True)
    if norms.min() <= 0:
        raise InputError("a filter colour is black: measure it with the filter lit, black level subtracted once")
    unit = colors / norms
    angles = [np.degrees(np.arccos(np.clip(a @ b, -1, 1))) for i, a in enumerate(unit) for b in unit[:i]]
    if min(angles) < _MIN_FILTER_ANGLE_DEG:
        raise InputError(
            f"two filters are only {min(angles):.1f} deg apart in colour; the views cannot be separated. Use "
            "complementary film, or check that the filter colours were measured through the filters"
        )
    condition = np.linalg.cond(unit)  # of unit vectors: brightness does not matter
    if condition > _MAX_CONDITION:
        raise InputError(
            f"filter colours are nearly dependent (condition {condition:.0f}): the third view cannot be told from "
            "the other two; use film of three distinct colours"
        )
    columns = list(colors)
    if len(columns) == 2:
        normal = np.cross(unit[0], unit[1])
        columns.append(normal / np.linalg.norm(normal))
    return np.stack(columns, axis=1)


def unmixing_rows(mixing: np.ndarray, view_count: int) -> np.ndarray:
    """Return the rows of M^-1 that make the matched views; (view_count, 3) float64."""
    return np.linalg.inv(mixing)[:view_count]


def own_film_unmixing(aperture: Aperture) -> np.ndarray:
    """Compute the unmixing rows of the aperture's own film under white light; (K, 3) float64."""
    if not aperture.views:
        raise InputError(
            f"{aperture.title} shifts no channel against another, so it has no disparity to measure; "
            "choose a design with two or three separated filters"
        )
    colors = np.array([aperture.filter_named(name).transmission for name in aperture.views])
    return unmixing_rows(mixing_matrix(colors), len(aperture.views))


def view_reach(aperture: Aperture) -> float:
    """Compute the mean distance of the unmixed views' centroids from the centre, in pupil radii: r_c / R of Eq. (6)."""
    return float(np.linalg.norm(centroids(aperture, own_film_unmixing(aperture)), axis=1).mean())


def pure_channels(aperture: Aperture) -> np.ndarray | None:
    """Select channels of one filter's light by view, (K, 3) of 0 and 1, free of crosstalk; None without them."""
    light = np.array([aperture.remainder.transmission, *(part.filter.transmission for part in aperture.parts)])
    names = [None, *(part.filter.name for part in aperture.parts)]
    rows = []
    for view in aperture.views:
        own = np.array([name == view for name in names])
        pure = (light[own].min(axis=0) > 0) & (light[~own].max(axis=0) == 0)
        if not pure.any():
            return None
        rows.append(np.eye(3)[int(np.argmax(pure))])
    return np.array(rows)


def mixes_three_views(aperture: Aperture) -> bool:
    """Return whether a design has three views that are mixed of channels which see several filters each: CMY."""
    return len(aperture.views) == 3 and pure_channels(aperture) is None


def view_directions(aperture: Aperture) -> np.ndarray:
    """Compute the displacement (x, y) of every view per px of disparity; (K, 2) float64.

    View k is the centre view displaced by ``d * u_k``, where ``u_k`` is the centroid of its (unmixed) pupil in units of
    the mean centroid distance, for ideal film. Leaks of real film bring the views together, which the calibrated scale
    takes up; uneven ones also move the middle of two views off that of the pupil (docs/conventions.md).
    """
    rho = centroids(aperture, own_film_unmixing(aperture))
    directions = rho / np.linalg.norm(rho, axis=1).mean()
    # The grid is accurate to 4e-4; rounding to 1e-3 keeps axis-aligned shifts exactly on the axis.
    return np.round(directions, 3) + 0.0
