"""From light to counts: photon noise, read noise, black and white level, quantisation, colour mosaic."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from chromaperture.system.errors import InputError

Pattern = Literal["RGGB", "BGGR", "GRBG", "GBRG"]


@dataclass(frozen=True)
class SensorModel:
    """A linear sensor."""

    full_well_electrons: float = 5000.0  # electrons at white level
    read_noise_electrons: float = 4.0  # standard deviation
    black_level: int = 16  # counts at no light
    white_level: int = 1016  # counts at 1.0
    bits: int = 10  # counts are clipped at 2^bits - 1

    def __post_init__(self) -> None:
        if not (self.full_well_electrons > 0 and self.read_noise_electrons >= 0):
            raise InputError("a sensor needs a positive full_well_electrons and a read_noise_electrons of at least 0")
        if not 0 <= self.black_level < self.white_level < 2**self.bits <= 2**16:
            raise InputError(
                f"black level {self.black_level} and white level {self.white_level} must rise and fit {self.bits} bits"
            )


def expose(image: np.ndarray, sensor: SensorModel, *, seed: int, exposure: float = 1.0) -> np.ndarray:
    """Simulate counts (H, W, 3) uint16 of linear light; 1.0 at exposure 1.0 reaches white level."""
    electrons = np.asarray(image, np.float64) * exposure * sensor.full_well_electrons
    if not (np.isfinite(electrons).all() and electrons.min() >= 0):
        raise InputError("an exposure needs finite light of at least 0 everywhere")
    rng = np.random.default_rng(seed)
    read = rng.normal(0, sensor.read_noise_electrons, electrons.shape)
    signal = (rng.poisson(electrons) + read) / sensor.full_well_electrons
    counts = sensor.black_level + signal * (sensor.white_level - sensor.black_level)
    return np.clip(np.rint(counts), 0, 2**sensor.bits - 1).astype(np.uint16)


def develop(counts: np.ndarray, sensor: SensorModel) -> np.ndarray:
    """Convert counts to linear light; (H, W, ...) float32, 1.0 = white level."""
    span = np.float32(sensor.white_level - sensor.black_level)
    return (np.asarray(counts, np.float32) - np.float32(sensor.black_level)) / span
