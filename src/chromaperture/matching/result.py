"""The types of all methods: noise and what is wanted in, a measurement out."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypeVar

import numpy as np

from chromaperture.color.noise import estimate_noise_variance

if TYPE_CHECKING:
    from chromaperture.color.lens_shift import LensMoves

T = TypeVar("T")


class NoiseModel(NamedTuple):
    """Noise of a sensor's images."""

    # From an image (H, W, 3) to the noise variance of its channels, (H, W, 3), (white level)^2.
    variance: Callable[[np.ndarray], np.ndarray]
    # From the sensor's electrons; else estimated in the image, whose fine texture then counts as noise: good enough for
    # weights, but not to subtract from scores.
    is_known: bool

    def variance_of(self, image: np.ndarray, noise_variance: np.ndarray | None) -> np.ndarray:
        """Return the variance of an image's noise, (H, W, 3): what was computed before, if there is something."""
        return self.variance(image) if noise_variance is None else noise_variance


ESTIMATED_NOISE = NoiseModel(estimate_noise_variance, is_known=False)


@dataclass(frozen=True, repr=False)
class Disparity:
    """Disparity of every pixel, anchored in the view of the pupil's centre.

    Attributes
    ----------
    value_px : (H, W) float32
        Half disparity, px; 0 in focus, + beyond the focus surface, NaN unknown.
    sigma_px : (H, W) float32
        One standard deviation, px; NaN unknown.
    confidence : (H, W) float32
        In [0, 1]; 0 where unknown.
    """

    value_px: np.ndarray
    sigma_px: np.ndarray
    confidence: np.ndarray

    def __repr__(self) -> str:
        height, width = self.value_px.shape
        known = np.isfinite(self.value_px)
        median = f", median {np.median(self.value_px[known]):.2f} px" if known.any() else ""
        return f"Disparity({width}x{height} px, {known.mean():.1%} filled{median})"


@dataclass(frozen=True)
class Conversion:
    """The depth curve of every pixel, in numbers; two are of ``depth/``, which this package does not import."""

    # Nine arrays, (H, W) or (1, 1): A, B, delta, and their covariances AA, AB, A delta, BB, B delta, delta delta. Or
    # what they are computed from, FieldNumbers: maps of many megapixels take 36 bytes a pixel.
    fields: Any
    curve: Any  # CurveTable
    max_depth_mm: float


@dataclass(frozen=True)
class Alignment:
    """What the alignment needs to know besides a disparity."""

    directions: np.ndarray  # (3, 2) float64: displacement (x, y) of R, G, B per px of disparity
    gains: np.ndarray  # (3,) float64, of the white balance
    step: int = 1  # of `color.alignment.fill_unknown`
    lens: LensMoves | None = None  # displaces the channels; only occlusion is found by the directions then


class Extras(NamedTuple):
    """What a method that can makes of its disparity besides."""

    conversion: Conversion | None = None
    alignment: Alignment | None = None


NO_EXTRAS = Extras()


class Measured(NamedTuple):
    """Disparity, and what was made of it besides."""

    disparity: Disparity
    depth_mm: np.ndarray | None = None  # (H, W) float32, as its error bar
    sigma_mm: np.ndarray | None = None
    color: np.ndarray | None = None  # (H, W, 3) float32, aligned and white balanced


@dataclass(frozen=True)
class Pending(Generic[T]):
    """What is under way: ``result()`` waits for it, and raises what went wrong."""

    result: Callable[[], T]


class Method(ABC):
    """One way to estimate disparity, for one camera."""

    @abstractmethod
    def match(self, image: np.ndarray) -> Disparity:
        """Return the disparity of an image (H, W, 3) float32, linear."""

    def start(self, image: np.ndarray, extras: Extras = NO_EXTRAS) -> Pending[Measured]:
        """Begin with an image (H, W, 3); at most two are under way, to be awaited in turn.

        A method that does not work ahead begins when it is waited for.
        """
        return Pending(lambda: Measured(self.match(image)))

    @property
    def can_pipeline(self) -> bool:
        """Whether `start` computes a photograph while the one before is read back."""
        return False

    @property
    def makes_extras(self) -> bool:
        """Whether `start` makes what is asked for besides the disparity."""
        return False
