"""Nonlinearity of shift matching from boards rendered with the blur of the lens.

Few photographed boards do not determine the nonlinearity between them. With a fitted blur, boards can be rendered at
any number of exact distances, and matched like photographs. Their texture has the spectrum of a real board and random
phases (surrogate data: Theiler et al., Physica D 58, 1992).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.fft

from chromaperture.calibration.curves import Evidence, thin
from chromaperture.calibration.fit_fields import MANY_BOARDS, fit_depth_field, ranked_curves
from chromaperture.calibration.options import DEFAULT, Cache, CalibrationConfig, Progress, reported, silent
from chromaperture.calibration.place_boards import BoardDistances
from chromaperture.calibration.read_boards import MEASURED, grid, read_board
from chromaperture.calibration.session import Session
from chromaperture.camera.method import sensor_noise
from chromaperture.depth.nonlinearity import Nonlinearity
from chromaperture.model.camera_file import Calibration
from chromaperture.optics.lens_blur import LensBlur
from chromaperture.settings.methods import Quality
from chromaperture.system.errors import InputError

_HALF_TILE_PX = 64  # tiles of twice this width are blended into one another; chosen by hand
_MARGIN_PX = 8  # around the blur, for the ringing of the cut-off at the Nyquist frequency: leaves 2e-4 of the texture
_DEGREE = 4  # of the fields


def rendered_nonlinearity(
    camera: Calibration,
    session: Session,
    evidence: Evidence,
    config: CalibrationConfig = DEFAULT,
    *,
    cache: Cache | None = None,
    progress: Progress = silent,
) -> dict[Quality, Nonlinearity]:
    """Measure the nonlinearity of the qualities that match shifted views, on boards between the nearest and farthest.

    Without qualities whose curve is not monotonic; empty without a blur or with ``MANY_BOARDS``.
    """
    blur, count, used = camera.field_blur(), config.rendered_boards, evidence.used
    if blur is None or used.sum() >= MANY_BOARDS:
        return {}
    inverse = 1 / evidence.distances.from_pupil_mm
    at_infinity, scale = blur.reference
    sharpest = int(np.argmin(np.where(used, np.abs(at_infinity - scale * inverse), np.inf)))
    path = list(session.boards)[sharpest]
    steps = np.linspace(inverse[used].max(), inverse[used].min(), count)

    def read() -> dict[str, np.ndarray]:
        pattern = session.read(path)[..., 1] / float(camera.film.aperture[1])  # the blur of green is symmetric
        rng = np.random.default_rng(0)
        readings = []
        for inverse_mm in reported(steps.tolist(), "rendered boards", progress):
            image = _photograph(camera, blur, surrogate(pattern, rng), inverse_mm, rng)
            readings.append(read_board(image, camera))
        return {quality: np.stack([reading[quality] for reading in readings]) for quality in MEASURED}

    kept = (cache or Cache()).get(
        path, ("rendered", blur.model, steps.tolist(), camera.sensor, camera.channel_moves_px is None), read
    )
    exact = replace(
        evidence.distances,
        from_pupil_mm=1 / steps,
        covariance=np.zeros((count + 1, count + 1)),
        residual_mm=np.full(count, np.nan),
        residual_sigma_mm=np.full(count, np.nan),
    )
    size = (blur.width_px, blur.height_px)
    found = {q: _fit(kept[q], exact, size) for q in reported(MEASURED, "nonlinearity of rendered boards", progress)}
    return {quality: curve for quality, curve in found.items() if curve is not None}


def surrogate(pattern: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return another pattern (H, W) of the same mean and spectrum; float32."""
    height, width = pattern.shape
    mean = float(pattern.mean())
    size = (2 * height, 2 * width)  # mirrored, it has no edge at the frame's border
    mirrored = np.pad(pattern - mean, ((0, height), (0, width)), mode="symmetric")
    phase = scipy.fft.rfft2(rng.standard_normal(size))
    spectrum = np.abs(scipy.fft.rfft2(mirrored)) * phase / np.maximum(np.abs(phase), 1e-12)
    return np.asarray(scipy.fft.irfft2(spectrum, s=size)[:height, :width] + mean, np.float32)


def render_board(blur: LensBlur, pattern: np.ndarray, inverse_mm: float) -> np.ndarray:
    """Blur a flat pattern (H, W) by the lens, whose blur varies over the frame; (H, W, 3) float32, in white light.

    The pattern is sharp, as seen from the pupil's centre; ``inverse_mm`` is 1 / z, z from the entrance pupil.
    """
    height, width = pattern.shape
    half = _HALF_TILE_PX
    radius = abs(blur.model.infinity_px - blur.model.scale_px_mm * inverse_mm)
    margin = int(np.ceil(1.5 * radius)) + _MARGIN_PX
    size = scipy.fft.next_fast_len(2 * (half + margin), real=True)
    size += size % 2
    around = ((half + margin, half + size),) * 2
    padded = np.pad(pattern, around, mode="symmetric")
    fade = np.sin(np.pi * (np.arange(2 * half) + 0.5) / (2 * half)) ** 2  # overlapping windows add up to 1
    window = np.outer(fade, fade).astype(np.float32)
    out = np.zeros((height + 4 * half, width + 4 * half, 3), np.float32)
    for y in range(-half, height, half):
        for x in range(-half, width, half):
            centre = (min(max(x + half - 0.5, 0), width - 1), min(max(y + half - 0.5, 0), height - 1))
            cut = padded[y + half : y + half + size, x + half : x + half + size]
            blurred = scipy.fft.irfft2(scipy.fft.rfft2(cut) * blur.transfer(*centre, inverse_mm, size), s=(size, size))
            core = blurred[:, margin : margin + 2 * half, margin : margin + 2 * half] * window
            out[y + half : y + 3 * half, x + half : x + 3 * half] += core.transpose(1, 2, 0)
    return out[half : half + height, half : half + width]


def _photograph(
    camera: Calibration, blur: LensBlur, pattern: np.ndarray, inverse_mm: float, rng: np.random.Generator
) -> np.ndarray:
    image = render_board(blur, pattern, inverse_mm) * np.asarray(camera.film.aperture, np.float32)
    variance = sensor_noise(image, camera)
    if variance is not None:
        image = image + rng.standard_normal(image.shape, np.float32) * np.sqrt(variance)
    return np.maximum(image, np.float32(0))


def _fit(readings: np.ndarray, distances: BoardDistances, size_px: tuple[int, int]) -> Nonlinearity | None:
    y, x = np.meshgrid(grid(size_px[1], size_px[0]), grid(size_px[0], size_px[0]), indexing="ij")
    samples = (thin(x), thin(y), thin(readings), distances)
    every = np.ones(len(readings), bool)
    for curve in ranked_curves(*samples, size_px=size_px, degree=_DEGREE, boards=every):
        try:
            return fit_depth_field(*samples, size_px=size_px, degree=_DEGREE, nonlinearity=curve)[0].nonlinearity
        except InputError:
            continue
    return None
