"""Where Numba and the readable stages part in `real-time`: python benchmarks/numba_rounding.py PHOTO CAMERA

Numba keeps scores and log-likelihoods in 16 bits and takes windows as mean squares. Here the readable stages do so, one
after the other; the figures are shares of the pixels whose depth is within 0.1 %, or unknown in both.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from unittest import mock

import numpy as np

from chromaperture.camera import CodedApertureCamera, load_camera
from chromaperture.disparity import cpu
from chromaperture.disparity.stages import correlation, four_paths

AGREEING = 1e-3
SCORE_UNIT = 32000  # `cpu/layout.py`, SCORE_SCALE
NATS_UNIT = SCORE_UNIT / (-0.5 * np.log(four_paths.LEAST_DETERMINANT))  # `cpu/label_scores.py`
NOISE = 3e-7  # of a score: the resolution of 32 bits next to 1
OFF_BY_ONE = 1e-3  # of the scores, where two executions had the same windows and rounded what they made of them
# `cpu/simd.py`, logarithm: to 2e-5, and a log-likelihood is kept to 1.8e-4.
LOGARITHM = np.polynomial.chebyshev.Chebyshev.interpolate(lambda t: np.log(1.5 + t), 6, domain=[-0.5, 0.5])

correlate = four_paths.correlate


def rounded(score: np.ndarray) -> np.ndarray:
    return np.round(score * SCORE_UNIT) / SCORE_UNIT


def rounded_likelihood(score: np.ndarray, *, view_count: int) -> np.ndarray:
    """`four_paths.log_likelihood` by Numba's logarithm, in Numba's 16 bits."""
    clipped = np.clip(score, 0, 1)
    determinant = 1 - clipped**2 if view_count == 2 else (1 - clipped) ** 2
    mantissa, exponent = np.frexp(np.maximum(determinant, four_paths.LEAST_DETERMINANT))
    logarithm = (exponent - 1) * np.log(2) + LOGARITHM(2 * mantissa - 1.5)
    return np.round(-0.5 * logarithm * NATS_UNIT) / NATS_UNIT


def in_32_bits(maps: np.ndarray, decay: float) -> np.ndarray:
    """`stages.correlation.exponential_window` by recursions of 32 bits, as Numba's but for their order."""
    a, maps = np.float32(decay), maps.astype(np.float32)
    for axis in (0, 1):
        lines = np.moveaxis(maps, axis, 0)
        out, state = np.empty_like(lines), lines[0] / (1 - a)
        for i, line in enumerate(lines):
            out[i] = state = a * state + line if i else state
        state = state / ((1 + a) * (1 - a)) + a / ((1 + a) * (1 - a) ** 2) * lines[-1]
        for i in range(len(lines) - 1, -1, -1):
            out[i] = state = a * state + out[i] if i < len(lines) - 1 else state
        maps = np.moveaxis(out * (1 - a) ** 2, 0, axis)
    return maps


def agreeing(one: np.ndarray, other: np.ndarray) -> float:
    known = np.isfinite(one) & np.isfinite(other)
    near = np.zeros(known.shape, bool)
    near[known] = np.abs(one[known] / other[known] - 1) < AGREEING
    return float((near | (np.isnan(one) & np.isnan(other))).mean())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("photo", type=Path)
    parser.add_argument("camera", type=Path)
    arguments = parser.parse_args()
    compiled = load_camera(arguments.camera, scale=1, device="cpu")
    image = compiled.read(arguments.photo)
    readable = CodedApertureCamera(compiled.calibration, compiled.config, execution="numpy")

    def depth(scores=correlate, *, rounds: bool = False) -> np.ndarray:
        """Depth by the readable stages with other scores, and with all that follows in 16 bits or not."""
        changes = {"correlate": scores}
        if rounds:
            changes["log_likelihood"] = rounded_likelihood
        with mock.patch.multiple(four_paths, **changes):
            return readable.measure(image).depth_mm

    def in_16_bits(*parts, config, noise: float = 0.0) -> np.ndarray:
        exact = correlate(*parts, config=config)
        return rounded(exact + noise * np.random.default_rng(0).normal(size=exact.shape))

    def by_numba(*parts, config) -> np.ndarray:
        return cpu.correlate(*parts, config=config).astype(float)

    def noisy(*parts, config) -> np.ndarray:
        exact = correlate(*parts, config=config)
        return exact + NOISE * np.random.default_rng(0).normal(size=exact.shape)

    def off_by_one(*parts, config) -> np.ndarray:
        exact, drawn = rounded(correlate(*parts, config=config)), np.random.default_rng(0)
        off = drawn.random(exact.shape) < OFF_BY_ONE
        return exact + off * drawn.choice([-1, 1], exact.shape) / SCORE_UNIT

    def mean_squares(*parts, config) -> np.ndarray:
        with mock.patch.object(correlation, "exponential_window", in_32_bits):
            found = rounded(correlate(*parts, config=config))
        print(f"of them other than Numba's: {(found != rounded(by_numba(*parts, config=config))).mean():.3f}")
        return found

    reference, numba = depth(), compiled.measure(image).depth_mm
    all_rounded = depth(in_16_bits, rounds=True)
    rows = {
        "Numba to NumPy": (numba, reference),
        "NumPy, scores in 16 bits, to NumPy": (depth(in_16_bits), reference),
        "NumPy, Numba's scores, to NumPy": (depth(by_numba), reference),
        "NumPy, Numba's scores, 16 bits, to Numba": (depth(by_numba, rounds=True), numba),
        "NumPy, 16 bits, to Numba": (all_rounded, numba),
        "NumPy, 16 bits, to itself with noise": (
            depth(lambda *parts, config: in_16_bits(*parts, config=config, noise=NOISE), rounds=True), all_rounded
        ),
        "NumPy, 16 bits, to itself, 0.1 % off by one": (depth(off_by_one, rounds=True), all_rounded),
        "NumPy, mean squares, 16 bits, to Numba": (depth(mean_squares, rounds=True), numba),
        "NumPy to itself with noise": (depth(noisy), reference),
    }  # fmt: skip
    for name, pair in rows.items():
        print(f"{name:42s} {agreeing(*pair):.4f}")


if __name__ == "__main__":
    main()
