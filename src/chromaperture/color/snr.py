"""Signal-to-noise ratio of white sheets and the exposure that restores it (paper section 4.3, Table 2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from chromaperture.color.noise import KERNEL_NORM, fine_structure
from chromaperture.system.errors import InputError


@dataclass(frozen=True)
class Exposure:
    """Factor on the exposure that compensates a loss of SNR."""

    shot: float  # for shot noise, SNR grows with the root of time: 10^(dB / 10)
    amplitude: float  # for read noise, SNR grows with time: 10^(dB / 20); the paper's "30 % for 2.3 dB"


def snr_db(first: np.ndarray, second: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Compute the signal-to-noise ratio in the middle and at the border of a white sheet, 20 log10(mean / sigma).

    ``first`` (H, W, 3) float, linear; ``second`` (H, W, 3) float: another photograph of the same sheet: their
    difference is temporal noise alone, without the sheet's texture and the pixels' gains. When absent, the noise is
    estimated from the fine structure of the first. Returns ``central, border`` (3,) float64, dB, per channel. Raises
    InputError: the two differ in size or brightness.
    """
    first = np.asarray(first, np.float32)
    if second is not None:
        second = np.asarray(second, np.float32)
        if second.shape != first.shape:
            raise InputError(f"the two photographs of the sheet differ in size: {first.shape} and {second.shape}")
        ratio = float(second.mean() / first.mean())
        if not 0.97 < ratio < 1.03:
            raise InputError(f"the two photographs of the sheet differ in brightness by {100 * (ratio - 1):+.0f} %")
    central = _central(first.shape)
    return _area_snr(first, second, central), _area_snr(first, second, ~central)


def exposure_to_restore(loss_db: float) -> Exposure:
    """Compute the exposure, as a multiple of the present one, that compensates a loss of SNR; both readings."""
    return Exposure(10 ** (loss_db / 10), 10 ** (loss_db / 20))


def expected_loss_db(transmission: float, *, read_variance_ratio: float = 0.0) -> float:
    """Compute the loss of SNR by an aperture from its transmission.

    ``transmission``: fraction of the light, (0, 1]; ``read_variance_ratio``: variance of the read noise over that of
    the shot noise at full light. Returns float, dB: 10 log10(1 / T) for shot noise alone.
    """
    if not 0 < transmission <= 1 or read_variance_ratio < 0:
        raise InputError("transmission must lie in (0, 1] and the ratio of read noise must be >= 0")
    open_snr = 1 / np.sqrt(1 + read_variance_ratio)
    coded_snr = transmission / np.sqrt(transmission + read_variance_ratio)
    return float(20 * np.log10(open_snr / coded_snr))


def _central(shape: tuple[int, ...]) -> np.ndarray:
    """Mask the middle two thirds of width and height; the rest is border (paper section 4.3)."""
    height, width = shape[:2]
    y, x = np.abs(np.linspace(-1, 1, height))[:, None], np.abs(np.linspace(-1, 1, width))[None]
    inside: np.ndarray = np.maximum(x, y) < 2 / 3
    return inside


def _area_snr(first: np.ndarray, second: np.ndarray | None, area: np.ndarray) -> np.ndarray:
    mean = first[area].mean(axis=0, dtype=float)
    if second is not None:
        difference = (second - first)[area]
        gain = second[area].mean(axis=0, dtype=float) / mean  # drift of the lamp is not noise
        sigma = (difference - mean * (gain - 1)).std(axis=0, dtype=float) / np.sqrt(2)
    else:
        # The mean absolute value of a Gaussian is sqrt(2 / pi) sigma.
        sigma = np.sqrt(np.pi / 2) * fine_structure(first)[area].mean(axis=0, dtype=float) / KERNEL_NORM
    with np.errstate(divide="ignore"):
        return np.asarray(20 * np.log10(mean / sigma))
