"""Checks of photographs: what `check`, the app and a session's photographs judge alike, with the same limits."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from chromaperture.color.image import SATURATION
from chromaperture.system.robust import robust_sigma

Verdict = Literal["ok", "warn", "cannot tell"]

# Limits, chosen by hand from the causes named.
_SATURATED = 0.02  # share of the pixels above which the exposure is too long
_DARK = 0.05  # 99th percentile, of the white level, below which noise dominates
TINT = 0.10  # change of a channel ratio from the middle of the frame to its edge


@dataclass(frozen=True)
class Check:
    """One test of a camera or of a photograph."""

    name: str
    verdict: Verdict
    finding: str  # one sentence with the measured values
    advice: str = ""  # the remedy; empty when none is needed
    figures: dict[str, float] = field(default_factory=dict)  # the measured values, units in their names


NOTHING_SEEN = Check("exposure", "warn", "the picture holds no finite value", "photograph it again")


@dataclass(frozen=True)
class Exposure:
    """How bright a photograph is."""

    saturated: float  # share of the pixels with a saturated channel
    bright: float  # 99th percentile of all values, of the white level

    @classmethod
    def of(cls, image: np.ndarray) -> Exposure | None:
        """Measure the pixels of (H, W, C) linear light that are finite; None where there are none."""
        finite = image[np.isfinite(image).all(axis=2)]
        if not finite.size:
            return None
        return cls(float((finite.max(axis=1) >= SATURATION).mean()), float(np.percentile(finite, 99)))

    @property
    def is_saturated(self) -> bool:
        """Whether it is exposed too long."""
        return self.saturated > _SATURATED

    @property
    def is_dark(self) -> bool:
        """Whether noise dominates even its bright parts."""
        return self.bright < _DARK

    @property
    def figures(self) -> dict[str, float]:
        """The numbers for a `Check`."""
        return {"saturated_share": self.saturated, "percentile_99": self.bright}


def is_uneven(tint: Tint) -> bool:
    """Whether colour changes steadily over the frame, as behind film that is not in the plane of the stop."""
    return tint.ramp > TINT and tint.ramp > 2 * tint.scatter


def is_healthy(checks: Iterable[Check]) -> bool:
    """Whether no check warns."""
    return all(check.verdict != "warn" for check in checks)


def urgent_first(checks: Iterable[Check]) -> list[Check]:
    """Return the checks that warn before the others."""
    return sorted(checks, key=lambda check: check.verdict != "warn")


_CELLS = (8, 12)  # rows, columns
_LEAST = 0.004  # mean of a channel, of white level, below which a cell is too dark to have a colour; chosen by hand
_LEAST_PIXELS = 16  # usable ones of a cell; chosen by hand
_ROUNDS = 5  # of reweighting; chosen by hand
_LINEAR_FROM = 1.5  # robust standard deviations at which the loss turns linear, as Huber's at 1.345; chosen by hand


@dataclass(frozen=True)
class Tint:
    """Change of the colour ratios over the frame."""

    ramp: float  # largest relative change of a channel ratio from the middle of the frame to its edge
    scatter: float  # robust relative standard deviation of the cells about the ramp: large in coloured scenes


def measure_tint(image: np.ndarray) -> Tint | None:
    """Fit a plane to the logarithms of the channel ratios, which a film off the stop tilts; None where unknown."""
    height, width = image.shape[:2]
    rows = np.array_split(np.arange(height), _CELLS[0])
    columns = np.array_split(np.arange(width), _CELLS[1])
    with np.errstate(invalid="ignore"):
        usable = (image.max(axis=2) < SATURATION) & np.isfinite(image).all(axis=2)
    values, positions = [], []
    for r in rows:
        for c in columns:
            cell = image[r[0] : r[-1] + 1, c[0] : c[-1] + 1][usable[r[0] : r[-1] + 1, c[0] : c[-1] + 1]]
            if len(cell) < _LEAST_PIXELS:
                continue
            mean = cell.mean(axis=0)
            if mean.min() > _LEAST:
                values.append(np.log(mean))
                positions.append((2 * c.mean() / (width - 1) - 1, 2 * r.mean() / (height - 1) - 1))
    if len(values) < _CELLS[0] * _CELLS[1] / 2:
        return None
    logs = np.array(values)
    basis = np.column_stack([np.ones(len(positions)), np.array(positions)])
    tints = []
    for a, b in ((0, 1), (1, 2), (0, 2)):
        slope, scatter = _robust_plane(basis, logs[:, a] - logs[:, b])
        tints.append(Tint(float(np.expm1(np.hypot(*slope))), scatter))
    return max(tints, key=lambda tint: tint.ramp - tint.scatter)


def _robust_plane(basis: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, float]:
    """Fit a plane by reweighted least squares; return its slopes in x and y and the robust scatter about it."""
    weights: np.ndarray = np.ones(len(values))
    scatter = 0.0
    solution: np.ndarray = np.zeros(3)
    for _ in range(_ROUNDS):
        solution, *_ = np.linalg.lstsq(basis * weights[:, None], values * weights, rcond=None)
        residual = values - basis @ solution
        scatter = robust_sigma(residual)
        weights = 1 / np.sqrt(np.maximum(1.0, np.abs(residual) / max(_LINEAR_FROM * scatter, 1e-6)))
    return solution[1:], scatter
