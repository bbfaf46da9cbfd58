"""Check by a neutral and a coloured print that chroma lies where files are taken to have it, and say what is wrong.

Chroma that is taken for d px beside its place moves a channel C against luma Y by d (1 - Y/C), and so R against B by
d (Y/B - Y/R): nothing on grey, 0.93 px on an orange for half a pixel. Lateral colour of the lens and parallax move both
prints alike, so that the difference between the two is the siting's. Y/C is that of the texture, not of the mean:
orange ink on white paper varies most in blue.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from chromaperture.capture.files import decode
from chromaperture.capture.picture_format import FORM, LUMA_WEIGHTS, PictureFormat
from chromaperture.capture.shots import VIDEOS
from chromaperture.color.encoding import SITINGS, Siting, StatedFacts
from chromaperture.color.unmixing import view_reach
from chromaperture.depth.conversion import depth_to_disparity, disparity_to_depth
from chromaperture.evaluation.checks import Check
from chromaperture.model.camera_file import Calibration
from chromaperture.optics.aperture import centroids
from chromaperture.system.errors import InputError
from chromaperture.system.robust import MEDIAN_INEFFICIENCY, robust_sigma

_NAME = "chroma siting"
_WHERE = {"centre": "in the middle", "left": "at the left", "top-left": "at the top left"}
_TOLERANCE_PX = 0.15  # sitings are half a pixel apart; codecs and parallax of 3 px leave 0.06
_MOST_SIGMA_PX = 0.05  # three of them are the tolerance
_SHOWN_MM = 1000.0  # distance at which the error is told, where the camera's range holds it
_LEAST_CONTRAST = 0.4  # of Y/B - Y/R: half a pixel of chroma is then 0.2 px of R against B
_LEAST_WINDOWS = 4
_SIDES_PX = 128, 64  # of windows; the smaller where the picture has fewer than three of the larger
_BANDS = 0.05, 0.12  # cycles a px: the first tells displacements of up to 8 px from their wraps, the second is precise
_LEAST_COHERENCE = 0.8  # of R and B of a print: below, noise is half as strong as the texture
_LEAST_ASPECT = 0.1  # of the band's moments: stripes tell nothing along themselves
_NOTHING = (np.nan, np.nan, np.nan)


class ChromaError(NamedTuple):
    """By how far chroma lies beside its place, (x, y) px of luma, and its error; ``contrast`` of the prints."""

    error_px: np.ndarray
    sigma_px: np.ndarray
    contrast: float
    windows: int


def check_siting(neutral: Path, coloured: Path, calibration: Calibration) -> Check:
    """Compare a neutral and a coloured print to find out where the chroma of a camera's files lies.

    ``neutral``, ``coloured``: photographs, or clips whose first frames are taken, of prints full of texture at the same
    place of the frame and the same distance; ``calibration``: with what is stated of the files, `with_stated`. Returns
    "ok" also for files without subsampled chroma. Figures: ``error_x_px``, ``error_y_px`` and their ``sigma_..``, px of
    luma by which chroma lies beside its place; ``contrast``, Y/B - Y/R of the prints; ``windows``. Raises InputError: a
    file cannot be read, or the two are not of one format.
    """
    (first, form), (second, other) = (_read(path, calibration.sensor.encoding.stated) for path in (neutral, coloured))
    kinds = [(f.kind, f"{f.size_px[0]}x{f.size_px[1]} px", f.chroma, f.siting) for f in (form, other)]
    if kinds[0] != kinds[1]:
        texts = (f"{p.name} is {', '.join(k)}" for p, k in zip((neutral, coloured), kinds, strict=True))
        raise InputError(f"{' and '.join(texts)}; take both prints in one format")
    if form.luma_weights is None or form.reduction == 1:
        return Check(_NAME, "ok", f"{neutral.name} stores every colour in every pixel: there is nothing to check")
    found = find_chroma_error(first, second, form)
    if (siting := siting_without_error(found, form)) is None:
        return _unknown(found)
    if siting == form.siting:
        finding = f"chroma lies where it is taken for (siting {siting})"
        return Check(_NAME, "ok", finding, _calibrated_otherwise(siting, calibration), _figures(found))
    wrong_px = found.error_px * found.contrast
    apart = f"{np.hypot(*wrong_px):.2f} px for this colour{_in_mm(wrong_px, form, calibration)}"
    finding = f"chroma lies {_WHERE[siting]}, not {_WHERE[form.siting]}: R against B is wrong by {apart}"
    advice = f'say --siting {siting} (session.toml, [sensor]: siting = "{siting}") and calibrate again'
    return Check(_NAME, "warn", finding, advice, _figures(found))


def siting_without_error(found: ChromaError, form: PictureFormat) -> Siting | None:
    """Return the siting by which files of that form are read without error; None where none is known."""
    if (found.sigma_px <= _MOST_SIGMA_PX).all():
        for siting in (form.siting, *SITINGS):  # of those that are the same, as left and top-left of 4:2:2, the stated
            apart_px = _place_px(form, form.siting) - _place_px(form, siting)
            if np.abs(found.error_px - apart_px).max() < _TOLERANCE_PX:
                return siting
    return None


def _place_px(form: PictureFormat, siting: Siting) -> np.ndarray:
    """Return where the first chroma sample lies by a siting: x and y in px of luma."""
    across, down = ((n - 1) / 2 for n in form.chroma_factors)
    return np.array([across if siting == "centre" else 0.0, 0.0 if siting == "top-left" else down])


def _read(path: Path, stated: StatedFacts) -> tuple[np.ndarray, PictureFormat]:
    """Return the encoded colours of a photograph, or of the first frame of a clip, and what the file is."""
    if path.suffix.lower() in VIDEOS:
        from chromaperture.capture.video import VideoSource  # FFmpeg takes 0.1 s to load

        settings = {"siting": stated.siting, "primaries": stated.primaries}
        with VideoSource(str(path), listener=lambda event: None, **settings) as clip:  # type: ignore[arg-type]
            counts, form = next(iter(clip)).counts, clip.form
    else:
        decoded = decode(path, stated=stated)
        counts, form = decoded.array, decoded.form
    assert form is not None
    return counts, form


def _unknown(found: ChromaError) -> Check:
    """Say why nothing is known, and what to do."""
    if not np.isfinite(found.contrast):
        finding, advice = "the prints have no texture", "photograph prints full of texture, sharp and well exposed"
    elif not np.isfinite(found.error_px).all():
        enough = f"by {_LEAST_CONTRAST:g} and more in {found.windows} windows of the frame"
        finding = f"the prints differ too little in colour: Y/B - Y/R by {found.contrast:+.2f} in the median, {enough}"
        advice = "take a print of strong orange, yellow, green or blue, large in the picture"
    else:
        (x, y), (sigma_x, sigma_y) = found.error_px, found.sigma_px
        finding = f"chroma is off by {x:+.2f} +-{sigma_x:.2f} px in x, {y:+.2f} +-{sigma_y:.2f} in y: no siting"
        advice = "put both prints at one place and distance, in focus, large in the picture; original files only"
    return Check(_NAME, "cannot tell", finding, advice, _figures(found))


def _figures(found: ChromaError) -> dict[str, float]:
    """Return what was measured; what is unknown is left out, for JSON has no NaN."""
    (x, y), (sigma_x, sigma_y) = found.error_px, found.sigma_px
    known = {"error_x_px": x, "error_y_px": y, "sigma_x_px": sigma_x, "sigma_y_px": sigma_y}
    known |= {"contrast": found.contrast, "windows": found.windows}
    return {name: float(value) for name, value in known.items() if np.isfinite(value)}


def _calibrated_otherwise(siting: Siting, calibration: Calibration) -> str:
    """Say what to do where the camera file's own photographs were read by another siting."""
    read = calibration.provenance.get(FORM, {}).get("siting", siting)
    return "" if read == siting else f"the camera file was made with siting {read}: calibrate again with {siting}"


def _in_mm(wrong_px: np.ndarray, form: PictureFormat, calibration: Calibration) -> str:
    """Return what an error of R against B, px of luma, does to distances; empty where R and B tell none."""
    if not calibration.is_calibrated:
        return ""
    rho = centroids(calibration.aperture)
    apart = (rho[0] - rho[2]) / view_reach(calibration.aperture)  # of R and B per px of disparity
    if not apart @ apart > 0.1:
        return ""
    wrong_disparity_px = wrong_px @ apart / (apart @ apart) * calibration.sensor.width_px / form.size_px[0]
    # The curve of channels, which are moved, where the camera has it: those of unmixed views have another scale.
    curve = calibration.on_axis("real-time" if "real-time" in calibration.depth else next(iter(calibration.depth)))
    distance_mm = float(np.clip(_SHOWN_MM, calibration.near_mm, calibration.far_mm))
    disparity_px = depth_to_disparity(distance_mm, curve)
    near_mm, far_mm = (disparity_to_depth(disparity_px + s * wrong_disparity_px, curve)[0] for s in (-0.5, 0.5))
    mm = abs(float(far_mm - near_mm))
    return f", about {mm:.0f} mm at {distance_mm / 1000:g} m" if np.isfinite(mm) else ""


def find_chroma_error(neutral: np.ndarray, coloured: np.ndarray, form: PictureFormat) -> ChromaError:
    """Measure by how far chroma lies beside the place that two prints' encoded RGB were read by."""
    differences = _windows(coloured, form) - _windows(neutral, form)
    differences = differences[np.isfinite(differences[:, 2])]
    typical = float(np.median(differences[:, 2])) if len(differences) else float("nan")
    differences = differences[np.abs(differences[:, 2]) >= _LEAST_CONTRAST]
    if len(differences) < _LEAST_WINDOWS:
        return ChromaError(np.full(2, np.nan), np.full(2, np.nan), typical, len(differences))
    errors = form.reduction * differences[:, :2] / differences[:, 2:]
    error = np.median(errors, axis=0)
    sigma = [MEDIAN_INEFFICIENCY * robust_sigma(rest) / len(rest) ** 0.5 for rest in (errors - error).T]
    return ChromaError(error, np.array(sigma), float(np.median(differences[:, 2])), len(differences))


def _windows(rgb: np.ndarray, form: PictureFormat) -> np.ndarray:
    """Return `_window` of windows that overlap by half, (N, 3)."""
    height, width = rgb.shape[:2]
    side = next((side for side in _SIDES_PX if 3 * side <= min(height, width)), _SIDES_PX[-1])
    rows, columns = (range(0, length - side + 1, side // 2) for length in (height, width))
    red, blue = form.luma_weights or LUMA_WEIGHTS[2]
    weights = np.array([red, 1 - red - blue, blue])
    return np.reshape([_window(rgb[y : y + side, x : x + side], weights) for y in rows for x in columns], (-1, 3))


def _window(rgb: np.ndarray, luma_weights: np.ndarray) -> tuple[float, float, float]:
    """Return displacement of R against B, x and y in px, and Y/B - Y/R; NaN without texture."""
    side, taper = len(rgb), np.hanning(len(rgb))[:, None]
    turns = np.stack(np.meshgrid(np.fft.rfftfreq(side), np.fft.fftfreq(side)), axis=-1)
    radius = np.hypot(turns[..., 0], turns[..., 1])
    band = (radius > 1.5 / side) & (radius < _BANDS[-1]) & ((turns[..., 0] > 0) | (turns[..., 1] > 0))
    tapered = (rgb - rgb.mean(axis=(0, 1), dtype=float)) * (taper * taper.T)[..., None]
    spectrum, turns, radius = np.fft.rfft2(tapered, axes=(0, 1))[band], turns[band], radius[band]
    red, blue, luma = spectrum[:, 0], spectrum[:, 2], spectrum @ luma_weights
    power, cross, moved = [(np.abs(c) ** 2).sum() for c in (red, blue)], red * np.conj(blue), np.zeros(2)
    for most in _BANDS:  # least squares of the phase that is left, weighted by its precision
        weighted = np.where(radius < most, np.abs(cross), 0.0)[:, None] * turns
        low, high = np.linalg.eigvalsh(moments := weighted.T @ turns)
        if not low > _LEAST_ASPECT * high:
            return _NOTHING
        rest = np.angle(cross * np.exp(2j * np.pi * (turns @ moved))) / (2 * np.pi)
        moved = moved - np.linalg.solve(moments, weighted.T @ rest)
    if np.abs((cross * np.exp(2j * np.pi * (turns @ moved))).sum()) < _LEAST_COHERENCE * np.sqrt(power[0] * power[1]):
        return _NOTHING
    share_red, share_blue = ((luma * np.conj(c)).real.sum() / p for c, p in zip((red, blue), power, strict=True))
    return moved[0], moved[1], share_blue - share_red
