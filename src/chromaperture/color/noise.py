"""Noise variance of linear images, and the signal-to-noise ratio of white sheets (paper section 4.3, Table 2)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np

from chromaperture.system.errors import InputError

# Immerkaer (1996): the difference of two Laplacians, zero for linear intensities.
_IMMERKAER = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
_BLOCK_SAMPLES = 32  # along each side
KERNEL_NORM = 6.0  # root of the sum of squares of that kernel
_BLOCK_SIGMA = 0.086  # relative standard error of a block's variance, sqrt(2 / 271): 1024 correlated px act as 271
# Sides of the squares of pixels whose means are looked at. In the middle light they show 1.00, 1.00, 1.01 times the
# noise variance of a simulated sensor in linear files, 0.11, 0.66, 1.18 in JPEG of quality 95, 0.05, 0.42, 1.10 in
# quality 90, 0.01, 0.29, 0.97 in a Bayer mosaic that is interpolated bilinearly.
_SCALES_PX = (1, 2, 4)
_CLEARLY_MORE = 1.2  # noise by which a coarser scale must exceed the finer ones, which know it better; chosen by hand
_MIDDLE_LIGHT = 0.5  # of the white level, where scales are compared
_CLIPS = 0.98  # white level; blocks with a brighter pixel are left out
# Chosen by hand, not tuned:
_FEWEST_BLOCKS = 40
_LEAST_RANGE = 0.3  # of levels, as a fraction of the brightest
_BINS, _LOW_QUANTILE = 12, 0.1  # of level; of variance in each, where the fit starts
_ROUNDS = 10
# Of `noise_ratio`. Of 240 photographs with the calibration's own noise, of simulated rooms through eight cameras and
# of bench50, none has a ratio above 1.48 pixel by pixel, 3 above 1.5 in means of 2 x 2 px (docs/decisions.md).
_RATIO_SAMPLES = 16  # along each side of a block; chosen by hand
_RATIO_PERCENTILE = 5  # of the blocks' least eigenvalues: other blocks hold detail; chosen by hand
_OF_EXPECTED_NOISE = 0.61  # that percentile where there is white noise of the expected variance alone; simulated
_CLEAR_RATIO = 1.5  # a smaller one is none: it may be the scatter of blocks, or detail in several colours
_DEVELOPED = 0.5  # ratio at the finest scale of files that lack noise there: JPEG has 0.1, an interpolated mosaic 0.02
_FEWEST_OF_RATIO = 30  # blocks, for a percentile; chosen by hand
_MOST_ELECTRONS = 1e7  # no pixel holds more: quieter pictures were computed, not photographed


def photon_noise_variance(image: np.ndarray, *, full_well_electrons: float, read_noise_electrons: float) -> np.ndarray:
    """Compute the variance of shot and read noise; (H, W, 3) float32, (white level)^2."""
    # Smoothed first: the variance of a noisy pixel would correlate with its noise. Sigma chosen by hand.
    smooth = cv2.GaussianBlur(np.asarray(image, np.float32), (0, 0), 2.0)
    # In place: of many megapixels a copy takes as long as the rest.
    variance = np.divide(np.maximum(smooth, 0, out=smooth), np.float32(full_well_electrons), out=smooth)
    return np.add(variance, np.float32((read_noise_electrons / full_well_electrons) ** 2), out=variance)


def fine_structure(image: np.ndarray) -> np.ndarray:
    """Compute the absolute response to Immerkaer's kernel, of norm 6: mostly noise; of the image's shape."""
    return np.abs(cv2.filter2D(np.asarray(image, np.float32), cv2.CV_32F, _IMMERKAER))


def estimate_noise_variance(image: np.ndarray) -> np.ndarray:
    """Estimate the noise variance per channel from the median Immerkaer response; (H, W, 3), constant."""
    image = np.asarray(image, np.float32)
    response = fine_structure(image).reshape(-1, image.shape[2])
    response = response[np.isfinite(response).all(axis=1)]
    if len(response) == 0:
        return np.zeros(image.shape, np.float32)
    sigma = np.median(response, axis=0) / (0.6745 * KERNEL_NORM)  # 0.6745: median of |x| of a unit Gaussian
    return np.broadcast_to((sigma**2).astype(np.float32), image.shape)


def noise_samples(image: np.ndarray, *, scale_px: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Return brightness and white-noise variance of unclipped blocks of ``scale_px`` means, (B,) each."""
    if min(image.shape[:2]) < scale_px * _BLOCK_SAMPLES:
        return np.empty(0), np.empty(0)
    image = _squares(np.asarray(image, np.float32), scale_px).mean(axis=(1, 3))

    def blocks(values: np.ndarray) -> np.ndarray:
        return _squares(values, _BLOCK_SAMPLES)

    level = blocks(image).mean(axis=(1, 3), dtype=float).ravel()
    of_means = (blocks(fine_structure(image)) ** 2).mean(axis=(1, 3), dtype=float).ravel() / KERNEL_NORM**2
    variance = scale_px**2 * of_means
    clips = blocks(image).max(axis=(1, 3)).ravel() >= _CLIPS
    usable = np.isfinite(level) & np.isfinite(variance) & ~clips & (level > 0)
    return level[usable], variance[usable]


def _squares(values: np.ndarray, side: int) -> np.ndarray:
    """Return squares of pixels, (H / side, side, W / side, side, C), without what is left over at the end."""
    rows, columns = (n // side for n in values.shape[:2])
    return values[: rows * side, : columns * side].reshape(rows, side, columns, side, values.shape[2])


def photon_noise_of_sheets(sheets: Iterable[np.ndarray]) -> tuple[float, float] | None:
    """Fit full well and read noise to even surfaces, at the scale with most of the noise."""
    samples: list[list[tuple[np.ndarray, np.ndarray]]] = [[] for _ in _SCALES_PX]
    for sheet in sheets:
        for of_scale, scale in zip(samples, _SCALES_PX, strict=True):
            of_scale.append(noise_samples(sheet, scale_px=scale))
    best, most = None, 0.0
    for of_scale in filter(None, samples):
        found = fit_photon_noise(*(np.concatenate(part) for part in zip(*of_scale, strict=True)))
        if found is not None:
            variance = _MIDDLE_LIGHT / found[0] + (found[1] / found[0]) ** 2
            if variance > _CLEARLY_MORE * most:
                best, most = found, variance
    return best


def noise_ratio(image: np.ndarray, variance: np.ndarray) -> float:
    """Return a photograph's noise variance over the expected one, 1 where it is not clearly more; (H, W, 3)."""
    image = np.asarray(image, np.float32)
    finest = _ratio_at(image, variance, 1)
    # Means of 4 x 4 px show texture, too: they are looked at where finer ones lack noise.
    coarser = _SCALES_PX[1:] if finest < _DEVELOPED else _SCALES_PX[1:2]
    ratio = max(finest, *(_ratio_at(image, variance, scale) for scale in coarser))
    return ratio if ratio >= _CLEAR_RATIO else 1.0


def _ratio_at(image: np.ndarray, variance: np.ndarray, scale_px: int) -> float:
    """Return `noise_ratio` in means of squares of pixels; 1 where blocks are too few."""
    height, width = (n // scale_px for n in image.shape[:2])
    if min(height, width) < _RATIO_SAMPLES:
        return 1.0
    means, expected = (_means(part, (height, width), scale_px) for part in (image, variance))
    known = np.ones((height, width), bool)
    for light, noise in zip(means, expected, strict=True):
        known &= (np.abs(light) < _CLIPS) & (noise > 0)  # what is not a number is not below
    usable = _squares(known[..., None], _RATIO_SAMPLES).all(axis=(1, 3, 4))
    if np.count_nonzero(usable) < _FEWEST_OF_RATIO:
        return 1.0
    responses = [
        cv2.filter2D(np.where(known, light, np.float32(0)), cv2.CV_32F, _IMMERKAER)
        / np.sqrt(np.where(known, noise, np.float32(1)))
        for light, noise in zip(means, expected, strict=True)
    ]
    covariance = np.empty((np.count_nonzero(usable), 3, 3), np.float32)
    for a, b in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)):
        of_blocks = _means(responses[a] * responses[b], usable.shape, _RATIO_SAMPLES)[0]
        covariance[:, a, b] = covariance[:, b, a] = of_blocks[usable]
    least = np.linalg.eigvalsh(covariance * np.float32(scale_px / KERNEL_NORM) ** 2)[:, 0]
    return float(np.percentile(least, _RATIO_PERCENTILE)) / _OF_EXPECTED_NOISE


def _means(values: np.ndarray, size: tuple[int, int], side_px: int) -> list[np.ndarray]:
    """Return the means of so many rows and columns of squares, for every channel; (h, w) float32 each."""
    height, width = size
    whole = np.asarray(values, np.float32)[: height * side_px, : width * side_px]
    return [cv2.resize(part, (width, height), interpolation=cv2.INTER_AREA) for part in cv2.split(whole)]


def fit_photon_noise(level: np.ndarray, variance: np.ndarray) -> tuple[float, float] | None:
    """Fit full well and read noise, electrons, to the flattest blocks of photographs (photon transfer, Janesick 2007).

    Texture only adds to a block's variance: the line ``level / full_well + (read_noise / full_well)^2`` is the lower
    edge of the scatter plot of `noise_samples`. None when variance does not grow with brightness: too few levels, or
    denoised photographs.
    """
    level, variance = np.asarray(level, float), np.asarray(variance, float)
    if len(level) < _FEWEST_BLOCKS or np.ptp(level) < _LEAST_RANGE * level.max(initial=0):
        return None
    order = np.array_split(np.argsort(level), _BINS)
    rows = np.array([(np.median(level[i]), np.quantile(variance[i], _LOW_QUANTILE)) for i in order])
    line = _line(rows[:, 0], rows[:, 1], np.ones(len(rows)))
    for _ in range(_ROUNDS):
        expected = line[0] * level + line[1]
        if not np.all(expected > 0):
            return None
        flat = np.abs(variance / expected - 1) < 3 * _BLOCK_SIGMA
        if flat.sum() < _FEWEST_BLOCKS:
            return None
        line = _line(level[flat], variance[flat], expected[flat])
    if line[0] * _MOST_ELECTRONS < 1:
        return None
    full_well = 1 / line[0]
    return float(full_well), float(np.sqrt(line[1]) * full_well)


def _line(level: np.ndarray, variance: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Fit a slope and offset, neither negative, to variances with errors proportional to ``scale``; (2,) float64."""
    from scipy.optimize import nnls  # here: it takes 0.15 s to load

    unit = float(np.mean(variance / scale)) or 1.0  # the solver's tolerances are absolute, variances small
    found, _ = nnls(np.stack([level, np.ones_like(level)], axis=1) / scale[:, None], variance / scale / unit)
    return np.asarray(found * unit)


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
