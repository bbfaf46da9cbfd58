"""What a device makes of a photograph: disparity, and where asked for depth in millimetres and aligned colours."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np

from chromaperture.matching.device.alignment_stage import Alignment, add_alignment
from chromaperture.matching.device.conversion_stage import Conversion, add_conversion
from chromaperture.matching.device.device import Array, Chain, Device, DeviceError
from chromaperture.matching.result import Disparity
from chromaperture.system.errors import OutOfMemoryError

MAPS = ("disparity", "sigma", "confidence")  # arrays that every method leaves, (H, W) each
_MILLIMETRES = ("depth_mm", "sigma_mm")
_COLOR = "color"


class Further(NamedTuple):
    """What a device makes of a disparity where it is asked to."""

    conversion: Conversion | None = None
    alignment: Alignment | None = None


NOTHING = Further()


class Measured(NamedTuple):
    """Disparity, and what was asked for besides.

    Attributes
    ----------
    disparity : Disparity
    depth_mm, sigma_mm : (H, W) float32, mm, or None
    color : (H, W, 3) float32, or None
        Aligned and white balanced.
    """

    disparity: Disparity
    depth_mm: np.ndarray | None = None
    sigma_mm: np.ndarray | None = None
    color: np.ndarray | None = None


class OnDevice(ABC):
    """A method whose stages run on a device, in chains that are made at the first photograph of a size, and kept.

    For one thread at a time, safe from several.
    """

    device: Device
    _chain: Any

    @abstractmethod
    def start(self, image: np.ndarray, further: Further = NOTHING) -> Any:
        """Send an image (H, W, 3) to the device, which begins; at most two are under way, `finish` them in turn."""

    @abstractmethod
    def finish(self, started: Any) -> Measured:
        """Wait for what `start` has begun; raises DeviceError, OutOfMemoryError besides InputError."""

    def match(self, image: np.ndarray) -> Disparity:
        """Return the disparity of an image (H, W, 3); raises as `finish`."""
        return self.finish(self.start(image)).disparity

    @contextmanager
    def _freed_on_failure(self) -> Iterator[None]:
        try:
            yield
        except (DeviceError, OutOfMemoryError):
            self._chain = None  # gives its memory back
            raise


def add_further(chain: Chain, image: Array, size: tuple[int, int], further: Further) -> None:
    """Add what is asked for behind a chain's disparity and error bar; ``image`` is the photograph, ``size`` (H, W)."""
    if further.conversion is not None:
        add_conversion(chain, chain.arrays["disparity"], chain.arrays["sigma"], further.conversion)
    if further.alignment is not None:
        add_alignment(chain, image, chain.arrays["disparity"], size, further.alignment)


def outputs_of(further: Further) -> list[str]:
    """Return the arrays that come down."""
    names = [*MAPS, *(_MILLIMETRES if further.conversion is not None else ())]
    return names if further.alignment is None else [*names, _COLOR]


def measured_from(found: dict[str, np.ndarray], size: tuple[int, int]) -> Measured:
    """Return the measurement in the arrays that came down, of (H, W)."""
    disparity = Disparity(*(found[name].reshape(size) for name in MAPS))
    depth_mm, sigma_mm = (found[name].reshape(size) if name in found else None for name in _MILLIMETRES)
    color = found[_COLOR].reshape(*size, 3) if _COLOR in found else None
    return Measured(disparity, depth_mm, sigma_mm, color)


def is_same(one: Further, other: Further) -> bool:
    """Whether two hold the same objects."""
    return all(a is b for a, b in zip(one, other, strict=True))
