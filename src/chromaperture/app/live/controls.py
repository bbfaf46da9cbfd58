"""Values that a page may set, and their limits: a message can hold anything, whatever a slider allows."""

from __future__ import annotations

import math
from dataclasses import dataclass

_RANGE = 2.0  # distances on the sliders reach from half the nearest to twice the farthest; chosen by hand
_MAX_STEPS = 1000  # of a slider of distances, chosen by hand: finer than its pixels


@dataclass(frozen=True)
class Limits:
    """Lowest, highest and initial value of a control."""

    lowest: float
    highest: float
    initial: float

    def bounded(self, value: object) -> float:
        """Return a number within the limits: the nearest one, or the initial value for what is no number."""
        if isinstance(value, bool) or not isinstance(value, int | float) or value != value:  # NaN
            return self.initial
        return float(min(max(value, self.lowest), self.highest))  # before float(), which refuses huge integers


@dataclass(frozen=True)
class ControlLimits:
    """Limits of every control of the page; distances in mm, ``percent`` of the distance, ``pupil`` of the camera's."""

    percent: Limits
    near: Limits
    far: Limits
    focus: Limits
    pupil: Limits = Limits(0.5, 4.0, 2.0)  # chosen by hand: smaller removes all blur, larger blurs all
    step_mm: float = 10.0

    @classmethod
    def of_camera(cls, near_mm: float, far_mm: float, max_relative_sigma: float) -> ControlLimits:
        """Choose the limits for a camera's working range."""
        lowest, highest = near_mm / _RANGE, far_mm * _RANGE
        step = 10.0 ** math.ceil(math.log10((highest - lowest) / _MAX_STEPS))
        low, high, near, far, middle = (
            max(step, round(mm / step) * step) for mm in (lowest, highest, near_mm, far_mm, math.sqrt(near_mm * far_mm))
        )
        percent = 100 * max_relative_sigma
        most = max(50.0, min(percent, 1000.0))  # "inf" has no place on a slider
        return cls(
            percent=Limits(0.1, most, min(max(percent, 0.1), most)),
            near=Limits(low, high, near),
            far=Limits(low, high, far),
            focus=Limits(low, high, middle),
            step_mm=step,
        )

    def distances(self, near: object, far: object) -> tuple[float, float]:
        """Return the nearest and the farthest distance drawn, a step apart at least, mm."""
        near_mm = self.near.bounded(near)
        return near_mm, max(self.far.bounded(far), near_mm + self.step_mm)
