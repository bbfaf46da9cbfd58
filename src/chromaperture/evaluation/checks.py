"""Checks of photographs: what `check`, the app and a session's photographs judge alike, with the same limits."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from chromaperture.color.image import SATURATION
from chromaperture.evaluation.health import Tint

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
