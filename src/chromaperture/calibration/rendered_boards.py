"""What a shift matcher reads besides the shift, told by the camera's own blur instead of by boards.

Where few boards stand, a curve through them guesses between them. Once the lens's blur is known, photographs of boards
can be computed for as many distances as one likes, exactly known, and the matcher reads them as it reads real ones.
Their texture is the spectrum of a real board with random phases (surrogate data: Theiler et al., Physica D 58, 1992).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.fft

from chromaperture.calibration.board_distances import BoardDistances
from chromaperture.calibration.choose_curve import ranked_curves
from chromaperture.calibration.curves import thin
from chromaperture.calibration.fit_blur import Progress
from chromaperture.calibration.fit_fields import fit_depth_field
from chromaperture.calibration.measurement_cache import Store
from chromaperture.calibration.read_boards import MEASURED, grid, read_board
from chromaperture.calibration.session import Session
from chromaperture.camera_file import Calibration
from chromaperture.camera_matching import sensor_noise
from chromaperture.config import Quality
from chromaperture.depth.nonlinearity import Nonlinearity
from chromaperture.errors import InputError
from chromaperture.optics.lens_blur import LensBlur

_COUNT = 24  # three for each of the eight terms that a curve may have
_HALF_TILE_PX = 64  # blur is blended from tile to tile, twice this wide
_MARGIN_PX = 8  # around the blur: what the cut-off at the pixels' own frequency rings over
_DEGREE = 4


def rendered_nonlinearity(
    calibration: Calibration,
    session: Session,
    distances: BoardDistances,
    believed: np.ndarray,
    *,
    store: Store | None = None,
    progress: Progress = lambda what, done, total: None,
) -> dict[Quality, Nonlinearity]:
    """Find the nonlinearity of the qualities that match shifted views, on rendered boards.

    Parameters
    ----------
    calibration : Calibration
        With the lens's blur.
    session : Session
    distances : BoardDistances
        Of the session's boards: the rendered ones stand between the nearest and the farthest.
    believed : (N,) bool
        Which boards to use.
    store : Store, optional
        Keeps what was read.
    progress : callable, optional

    Returns
    -------
    dict of quality to Nonlinearity
        Without those whose readings turn back.
    """
    blur = calibration.field_blur()
    if blur is None:
        return {}
    inverse = 1 / distances.from_pupil_mm
    at_infinity, scale = blur.reference
    sharpest = int(np.argmin(np.where(believed, np.abs(at_infinity - scale * inverse), np.inf)))
    path = list(session.boards)[sharpest]
    steps = np.linspace(inverse[believed].max(), inverse[believed].min(), _COUNT)

    def read() -> dict[str, np.ndarray]:
        pattern = session.read(path)[..., 1] / float(calibration.film.aperture[1])  # green's blur is symmetric
        rng = np.random.default_rng(0)
        readings = []
        for number, inverse_mm in enumerate(steps):
            progress("rendered boards", number, _COUNT)
            image = _photograph(calibration, blur, surrogate(pattern, rng), float(inverse_mm), rng)
            readings.append(read_board(image, calibration))
        progress("rendered boards", _COUNT, _COUNT)
        return {quality: np.stack([reading[quality] for reading in readings]) for quality in MEASURED}

    kept = (store or Store()).arrays(path, ("rendered", blur.model, steps.tolist(), calibration.sensor), read)
    there = replace(
        distances,
        from_pupil_mm=1 / steps,
        covariance=np.zeros((_COUNT + 1, _COUNT + 1)),
        residual_mm=np.full(_COUNT, np.nan),
        residual_sigma_mm=np.full(_COUNT, np.nan),
    )
    found = {quality: _fit(kept[quality], there, (blur.width_px, blur.height_px)) for quality in MEASURED}
    return {quality: curve for quality, curve in found.items() if curve is not None}


def surrogate(pattern: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Give another pattern of the same mean and spectrum; (H, W) float32.

    Parameters
    ----------
    pattern : (H, W) float
    rng : numpy.random.Generator
    """
    height, width = pattern.shape
    mean = float(pattern.mean())
    size = (2 * height, 2 * width)  # continued by its mirror image, it has no edges that would count as texture
    mirrored = np.pad(pattern - mean, ((0, height), (0, width)), mode="symmetric")
    phase = scipy.fft.rfft2(rng.standard_normal(size))
    spectrum = np.abs(scipy.fft.rfft2(mirrored)) * phase / np.maximum(np.abs(phase), 1e-12)
    return np.asarray(scipy.fft.irfft2(spectrum, s=size)[:height, :width] + mean, np.float32)


def render_board(blur: LensBlur, pattern: np.ndarray, inverse_mm: float) -> np.ndarray:
    """Blur a flat pattern as the lens does, at every place of the frame.

    Parameters
    ----------
    blur : LensBlur
    pattern : (H, W) float32
        Sharp, as seen from the pupil's centre; H and W are the blur's.
    inverse_mm : float, 1/mm
        1 / z, z from the entrance pupil.

    Returns
    -------
    (H, W, 3) float32, white light through an even film
    """
    height, width = pattern.shape
    half = _HALF_TILE_PX
    radius = abs(blur.model.infinity_px - blur.model.scale_px_mm * inverse_mm)
    margin = int(np.ceil(1.5 * radius)) + _MARGIN_PX
    size = scipy.fft.next_fast_len(2 * (half + margin), real=True)
    size += size % 2
    around = ((half + margin, half + size),) * 2
    padded = np.pad(pattern, around, mode="symmetric")
    fade = np.sin(np.pi * (np.arange(2 * half) + 0.5) / (2 * half)) ** 2  # neighbours' squares add up to 1
    window = np.outer(fade, fade).astype(np.float32)
    out = np.zeros((height + 4 * half, width + 4 * half, 3), np.float32)
    for y in range(-half, height, half):
        for x in range(-half, width, half):
            place = (min(max(x + half - 0.5, 0), width - 1), min(max(y + half - 0.5, 0), height - 1))
            cut = padded[y + half : y + half + size, x + half : x + half + size]
            blurred = scipy.fft.irfft2(scipy.fft.rfft2(cut) * blur.transfer(*place, inverse_mm, size), s=(size, size))
            core = blurred[:, margin : margin + 2 * half, margin : margin + 2 * half] * window
            out[y + half : y + 3 * half, x + half : x + 3 * half] += core.transpose(1, 2, 0)
    return out[half : half + height, half : half + width]


def _photograph(
    calibration: Calibration, blur: LensBlur, pattern: np.ndarray, inverse_mm: float, rng: np.random.Generator
) -> np.ndarray:
    image = render_board(blur, pattern, inverse_mm) * np.asarray(calibration.film.aperture, np.float32)
    variance = sensor_noise(image, calibration)
    if variance is not None:
        image = image + rng.standard_normal(image.shape, np.float32) * np.sqrt(variance)
    return np.maximum(image, np.float32(0))


def _fit(readings: np.ndarray, distances: BoardDistances, size_px: tuple[int, int]) -> Nonlinearity | None:
    y, x = np.meshgrid(grid(size_px[1], size_px[0]), grid(size_px[0], size_px[0]), indexing="ij")
    where = (thin(x), thin(y), thin(readings), distances)
    every = np.ones(len(readings), bool)
    for curve in ranked_curves(*where, size_px=size_px, degree=_DEGREE, boards=every):
        try:
            return fit_depth_field(*where, size_px=size_px, degree=_DEGREE, nonlinearity=curve)[0].nonlinearity
        except InputError:
            continue
    return None
