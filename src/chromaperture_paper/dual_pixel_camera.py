"""A dual-pixel camera as one with a cyan/yellow pupil: its photographs, and its calibration from a lens prescription.

The two halves of every pixel see the pupil through opposite ramps (`dual_pixel_rays.py`). Red takes the half that
sees the right of the pupil, blue the other, green their mean. What the prescription cannot know is the sensor's
crosstalk, two numbers, and how far the lens's focus is off its mark: both are taken from two flat boards.

The boards' distances are taken to count from the entrance pupil: then the focus that they show is the prescription's to
1 %; if they counted from the sensor, 40 mm farther, it would be 5 % nearer.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import scipy.optimize

from chromaperture.camera.camera import CodedApertureCamera
from chromaperture.camera.method import default_config, sensor_noise
from chromaperture.color.srgb import srgb_to_linear
from chromaperture.depth.field import DepthField, polynomials
from chromaperture.matching.estimate import estimate_disparity
from chromaperture.matching.labels import IDENTITY
from chromaperture.model.camera_file import Calibration
from chromaperture.model.camera_parts import CameraSensor, Film
from chromaperture.optics.aperture import DESIGNS
from chromaperture.optics.lens_blur import BlurModel, LensBlur
from chromaperture.optics.pinhole import centered_pinhole, focused_at, pupil_camera
from chromaperture.optics.prescription import Prescription, lens_from_dict
from chromaperture.optics.ray_table import lens_rays
from chromaperture.settings.methods import QUALITIES, AccurateConfig, Quality
from chromaperture.system.errors import InputError
from chromaperture.system.robust import huber_weights, robust_sigma
from chromaperture_paper.dual_pixel_rays import HalfPixels, fit_to_rays

SENSOR_WIDTH_MM = 36.0  # full frame
FOCUS_MM = 1000.0  # from the sensor, as the set states
NEAR_MM, FAR_MM = 350.0, 12_000.0  # where depth is searched: the lens's closest focus, and beyond the set's rooms
# By which the focus of a photograph differs from that of the boards, 1/m: of the casual scenes' medians, whose root
# mean square is .04 with the error of their truth; boxes took no part.
FOCUS_SIGMA = 0.03
# Of the field that the boards bend the prescription by: a sensor or a lens that is tilted. Degree 0 leaves a scatter of
# .025 and .015 1/m on the boards, 1 leaves .012 and .012, 2 .009 and .010.
_TILT_DEGREE = 1
_SHIFTS_PX = (-2.5, 2.5)  # half disparities of NEAR_MM to infinity, and a margin, before anything is calibrated
_START = HalfPixels(slope=0.4, half_slope_px=320.0)  # of the fit, which moves it; chosen by hand
_ROUNDS = 2  # of the fit: the second changes the slope by less than 1 %
_REACH_PX = 0.9  # layers searched around those expected of a board
_LEAST_SIGMA_PX = 0.02  # so that no single pixel of a board decides; chosen by hand
_REWEIGHTINGS = 20
# 8-bit files of the sRGB curve: steps of 1 / 255 are noise of variance (dL / dv / 255)^2 / 12, which grows as light
# does (dL / dv = 2.2 L^0.55), as if white were 12 (255 / 2.2)^2 photons; on the toe dL / dv is 1 / 12.92.
FULL_WELL_ELECTRONS = 12 * (255 / 2.2) ** 2
READ_NOISE_ELECTRONS = FULL_WELL_ELECTRONS / (12.92 * 255 * np.sqrt(12))
# Views without crosstalk: green is the mean of both halves and tells nothing more.
_PURE = {"cyan": (0.0, 0.5, 1.0), "yellow": (1.0, 0.5, 0.0)}
Curve = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Corrections:
    """What was taken from the two boards."""

    halves: HalfPixels
    # The focus surface on the axis and the scale B, from the prescription and by the boards
    designed_focus_mm: float
    focus_mm: float
    scale_ratio: float
    scatter: tuple[float, ...]  # of each board about the curve, 1/m: robust standard deviation over the frame


def capture(folder: Path, name: str, *, linear: Curve = srgb_to_linear) -> np.ndarray:
    """Photograph of a cyan/yellow pupil, linear if the files follow the curve; (H, W, 3) float32.

    Raises InputError: a file is missing or damaged.
    """
    sides = []
    for side in ("left", "right"):
        path = folder / f"{name}_{side}.png"
        stored = cv2.imread(str(path), cv2.IMREAD_COLOR)
        if stored is None:
            raise InputError(f"cannot read {path}")
        sides.append(linear(stored[..., 1].astype(np.float32) / 255))
    left, right = sides
    # With this order disparity is + beyond the focus, as for film.
    return np.dstack([right, (left + right) / 2, left]).astype(np.float32)


def lens_of_json(path: Path) -> Prescription:
    """Convert a lens of the set's format: ``roc`` radius, ``r`` semi-diameter, ``d_next`` thickness, index/Abbe.

    All light is that of the green pixels.

    Raises InputError: the file is missing or malformed.
    """
    try:
        table = json.loads(path.read_text(encoding="utf-8"))
        rows = [_surface(surface) for surface in table["surfaces"]]
        gap = rows[-1].pop("thickness_mm")
    except (OSError, ValueError, KeyError, TypeError, IndexError) as error:
        raise InputError(f"{path} is no lens prescription ({type(error).__name__}: {error})") from None
    lens = lens_from_dict({"sensor_gap_mm": gap, "surface": rows, "title": path.stem}, name=path.stem)
    return replace(lens, wavelengths_um=(lens.wavelengths_um[1],) * 3)


def _surface(surface: Mapping[str, Any]) -> dict[str, Any]:
    row: dict[str, Any] = {"thickness_mm": surface["d_next"], "clear_diameter_mm": 2 * surface["r"]}
    if surface["mat2"] != "air":
        row["index_d"], row["abbe"] = map(float, surface["mat2"].split("/"))
    if surface["type"] == "Stop":
        return row | {"stop": True}
    row["radius_mm"] = surface["roc"]
    if surface["type"] == "Aspheric":
        if surface["ai"][0]:
            raise ValueError("an asphere with a term of r^2")
        row |= {"conic": surface["k"], "coefficients": surface["ai"][1:]}
    return row


def uncalibrated(shape: tuple[int, ...], film: Mapping[str, Sequence[float]] = _PURE) -> Calibration:
    """Return a camera of which only sensor and aperture are known."""
    camera = Calibration.uncalibrated("cy_halves", width_px=shape[1], height_px=shape[0])
    sensor = CameraSensor(
        shape[1], shape[0], SENSOR_WIDTH_MM / shape[1], 0.0, 255.0, FULL_WELL_ELECTRONS, READ_NOISE_ELECTRONS
    )
    colours = {name: np.array(colour, float) for name, colour in film.items()}
    return replace(camera, sensor=sensor, film=Film(colours, np.ones(3), np.sum([*colours.values()], axis=0) / 2))


def calibrated_by_boards(boards: Mapping[float, np.ndarray], quality: Quality, *, degree: int = 2) -> Calibration:
    """Calibrate a quality by two flat boards alone: d = A(x, y) - B(x, y) / z, polynomials over the frame.

    ``boards`` mapping of float to (H, W, 3) float32: photographs by distance, mm; ``degree``: of the polynomials.
    """
    shape = next(iter(boards.values())).shape
    camera = uncalibrated(shape)
    config = default_config(camera, quality)
    eye = CodedApertureCamera(camera, replace(config, matcher=config.matcher.with_range(*_SHIFTS_PX)))
    seen = {mm: eye.measure(image) for mm, image in boards.items()}
    field = _two_board_field({mm: (f.disparity_px, f.disparity_sigma_px) for mm, f in seen.items()}, degree)
    return replace(camera, depth=dict.fromkeys(QUALITIES, field), near_mm=NEAR_MM, far_mm=FAR_MM)


def calibrated_by_prescription(
    lens: Prescription, boards: Mapping[float, np.ndarray], *, corrected: bool = True
) -> tuple[Calibration, Corrections]:
    """Calibrate quality "accurate" by the lens's prescription, and the sensor's crosstalk by two flat boards.

    ``lens``: at any focus; the sensor is moved to `FOCUS_MM`; ``boards`` mapping of float to (H, W, 3) float32:
    photographs by distance, mm; ``corrected``: take focus and scale from the boards too.
    """
    height, width = next(iter(boards.values())).shape[:2]
    optics = focused_at(lens, FOCUS_MM)
    size: dict[str, Any] = {"width_px": width, "height_px": height, "pixel_pitch_mm": SENSOR_WIDTH_MM / width}
    pupil = pupil_camera(optics, **size)
    table = lens_rays(optics, DESIGNS["open"], **size, cells=16)
    model, _ = fit_to_rays(table, pupil_radius_mm=pupil.pupil_radius_mm)

    halves = _START
    for _ in range(_ROUNDS):
        camera = _with_halves(uncalibrated((height, width), halves.film()), model, halves)
        layers = {mm: _layers(image, camera, mm) for mm, image in boards.items()}
        halves = _refitted(halves, layers, _blur(camera).reference[1])
    camera = _with_halves(uncalibrated((height, width), halves.film()), model, halves)
    layers = {mm: _layers(image, camera, mm) for mm, image in boards.items()}
    designed = _blur(camera).reference
    field = _two_board_field(layers, _TILT_DEGREE)
    infinity, scale = float(field.infinity_disparity_px[0]), float(field.scale_px_mm[0])  # in the middle
    if not corrected:
        infinity, scale = designed
        scatter = [robust_sigma(value - (infinity - scale / mm)) for mm, (value, _) in layers.items()]
        field = DepthField(np.array([infinity]), np.array([scale]), 0.0, _covariance(list(boards), scatter))
    scatter = _scatter(field, layers)
    field = with_focus_error(field)
    matrix = centered_pinhole(pupil.focal_px, (width, height))
    camera = replace(
        camera,
        lens=replace(camera.lens, focal_length_mm=pupil.image_distance_mm, camera_matrix=matrix),
        depth=dict.fromkeys(QUALITIES, field), near_mm=NEAR_MM, far_mm=FAR_MM,
        provenance={"note": f"blur from the prescription {lens.name}, crosstalk and focus from two flat boards"},
    )  # fmt: skip
    relative = tuple(float(1000 * s / scale) for s in scatter)
    return camera, Corrections(halves, designed[1] / designed[0], scale / infinity, scale / designed[1], relative)


def _scatter(field: DepthField, layers: Mapping[float, tuple[np.ndarray, np.ndarray]]) -> list[float]:
    """Robust standard deviation of every board about a curve, px."""
    height, width = next(iter(layers.values()))[0].shape
    model = field.model(width, height)
    return [
        robust_sigma(value - (model.infinity_disparity_px - model.scale_px_mm / mm))
        for mm, (value, _) in layers.items()
    ]


def with_focus_error(field: DepthField) -> DepthField:
    """Add the error of a focus that is set anew to the covariance of A."""
    covariance = field.covariance.copy()
    covariance[0, 0] += (FOCUS_SIGMA / 1000 * float(field.scale_px_mm[0])) ** 2
    return replace(field, covariance=covariance)


def _with_halves(camera: Calibration, model: BlurModel, halves: HalfPixels) -> Calibration:
    fall = camera.sensor.width_px / 2 / halves.half_slope_px
    return replace(camera, blur=replace(model, contrast_fall=fall))


def _blur(camera: Calibration) -> LensBlur:
    blur = camera.field_blur()
    assert blur is not None  # `_with_halves` gave one
    return blur


def _layers(image: np.ndarray, camera: Calibration, distance_mm: float) -> tuple[np.ndarray, np.ndarray]:
    """Measure a board with the blur, in layers, that is half disparities in the middle of the frame; value, sigma."""
    blur = _blur(camera)
    infinity, scale = blur.reference
    expected = infinity - scale / distance_mm
    config = AccurateConfig.for_blur(blur.reach, full_well_electrons=camera.sensor.full_well_electrons)
    found = estimate_disparity(
        image,
        aperture=camera.aperture,
        unmixing=camera.unmixing,
        config=config.with_range(expected - _REACH_PX, expected + _REACH_PX),
        noise_variance=sensor_noise(image, camera),
        label_maps=[IDENTITY],
        blur=blur,
    )
    return found.value_px, found.sigma_px


def _refitted(halves: HalfPixels, layers: Mapping[float, tuple[np.ndarray, np.ndarray]], scale: float) -> HalfPixels:
    """Fit the crosstalk to how far the boards seem apart in every column: as far as they are, where it is right."""
    (near, first), (far, second) = ((mm, value) for mm, (value, _) in sorted(layers.items()))
    apart = np.nanmedian(second - first, axis=0) / (scale * (1 / near - 1 / far))
    x = np.arange(len(apart)) - (len(apart) - 1) / 2
    known = np.isfinite(apart)
    target = (apart * halves.slope_at(x))[known]

    def misfit(numbers: np.ndarray) -> np.ndarray:
        slope, inverse = numbers
        return np.asarray(slope / (1 + (x[known] * inverse) ** 2) / target - 1)

    start = (halves.slope, 1 / halves.half_slope_px)
    slope, inverse = scipy.optimize.least_squares(misfit, start, loss="soft_l1", f_scale=0.05, x_scale=start).x
    return HalfPixels(float(slope), float(1 / abs(inverse)))


def _two_board_field(seen: Mapping[float, tuple[np.ndarray, np.ndarray]], degree: int) -> DepthField:
    """Curve through two boards, of which smooth disparities are fitted robustly; distances are from the pupil."""
    (near_mm, near), (far_mm, far) = sorted(seen.items())
    first, second = (_smooth(*board, degree) for board in (near, far))
    scale = (second - first) / (1 / near_mm - 1 / far_mm)
    infinity = first + scale / near_mm
    apart = [robust_sigma(v - _evaluated(c, v.shape, degree)) for c, (v, _) in ((first, near), (second, far))]
    return DepthField(infinity, scale, 0.0, _covariance([near_mm, far_mm], apart))


def _evaluated(coefficients: np.ndarray, shape: tuple[int, ...], degree: int) -> np.ndarray:
    y, x = np.mgrid[: shape[0], : shape[1]]
    return np.asarray(polynomials(x, y, shape[1], shape[0], degree) @ coefficients)


def _smooth(values: np.ndarray, sigma: np.ndarray, degree: int) -> np.ndarray:
    """Coefficients of a polynomial over the frame, fitted robustly to a map with holes."""
    height, width = values.shape
    y, x = np.mgrid[0:height:4, 0:width:4]
    known = np.isfinite(values[::4, ::4])
    design, target = polynomials(x[known], y[known], width, height, degree), values[::4, ::4][known].astype(float)
    if len(target) < 20 * design.shape[1]:
        raise InputError("a flat board could not be measured: is it in focus range, and textured?")
    weight = 1 / np.maximum(sigma[::4, ::4][known], _LEAST_SIGMA_PX)
    gain = np.ones_like(target)
    for _ in range(_REWEIGHTINGS):
        root = np.sqrt(gain) * weight
        fit = np.linalg.lstsq(design * root[:, None], target * root, rcond=None)[0]
        gain = huber_weights((target - design @ fit) * weight)
    return np.asarray(fit)


def _covariance(distances_mm: Sequence[float], scatter_px: Sequence[float]) -> np.ndarray:
    """Covariance of A, B and delta if each board may be off by its scatter anywhere in the frame; (3, 3)."""
    near, far = (1 / mm for mm in sorted(distances_mm))
    to_scale = np.array([-1.0, 1.0]) / (near - far)
    to_infinity = np.array([0.0, 1.0]) + to_scale * far
    jacobian = np.stack([to_infinity, to_scale, np.zeros(2)])
    return np.asarray(jacobian @ np.diag(np.square(scatter_px)) @ jacobian.T)


# Chosen by hand: squares small enough to lie between edges, and enough of them in a range of light for a percentile
_SQUARE_PX = 16
_PERCENTILE = 10  # of the squares' power in a range of light: the others hold detail
_RANGES_OF_LIGHT = np.linspace(0, 1, 9) ** 2
_LEAST_SQUARES = 30
_NOISIEST = 3  # ranges of light whose mean counts: where rounding leaves none of the noise the measure is too small
_TEXTURED = 2.0  # times the median of all ranges of light: such a range has no flat squares
# Red and blue share half of their noise, and green is their mean: as a pattern of all three channels, noise has 3 times
# the power that green has. The likelihood takes channels' noise to be independent, so that each gets as much.
_SHARED = 3.0
_LAPLACIAN = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32) / 6  # of unit power for white noise


def noise_scale(image: np.ndarray, calibration: Calibration) -> float:
    """Measure how many times a photograph's noise variance is that of its camera, at least 1.

    Both halves of a pixel share noise: on walls without detail, at all frequencies, the power of their sum is 2 to 3
    times that of their difference. Against a model of noise of their own, what they share is sharp detail without
    parallax, and blank walls stand at the focus.

    ``image`` (H, W, 3) float32, linear: of `capture`; ``calibration``: with the sensor's noise.
    """
    variance = sensor_noise(image, calibration)
    if variance is None:
        return 1.0
    power, light = (_squares(part) for part in (cv2.filter2D(image[..., 1], -1, _LAPLACIAN) ** 2 / variance[..., 1],
                                                image[..., 1]))  # fmt: skip
    found = []
    for low, high in pairwise(_RANGES_OF_LIGHT):
        inside = (light >= low) & (light < high)
        if inside.sum() >= _LEAST_SQUARES:
            found.append(float(np.percentile(power[inside], _PERCENTILE)))
    flat = [power for power in found if power <= _TEXTURED * np.median(found)]
    return max(1.0, _SHARED * float(np.mean(sorted(flat)[-_NOISIEST:]))) if flat else 1.0


def _squares(picture: np.ndarray) -> np.ndarray:
    """Mean of every square; flat."""
    rows, columns = (n // _SQUARE_PX for n in picture.shape)
    whole = picture[: rows * _SQUARE_PX, : columns * _SQUARE_PX]
    return np.asarray(whole.reshape(rows, _SQUARE_PX, columns, _SQUARE_PX).mean(axis=(1, 3)).ravel())


def camera_for(image: np.ndarray, calibration: Calibration, quality: Quality) -> CodedApertureCamera:
    """Return the camera with the noise of one photograph, its settings those of the calibration.

    Where it matches with the blur, the settings are those of half pixels.
    """
    config = default_config(calibration, quality)
    matcher = config.matcher
    if not isinstance(matcher, AccurateConfig) or not matcher.uses_blur:
        return CodedApertureCamera(calibration, config)
    matcher = matcher.with_half_pixels()
    config = replace(config, matcher=matcher)
    sensor, times = calibration.sensor, noise_scale(image, calibration)
    if sensor.full_well_electrons is not None and sensor.read_noise_electrons is not None:
        sensor = replace(
            sensor, full_well_electrons=sensor.full_well_electrons / times,
            read_noise_electrons=sensor.read_noise_electrons / np.sqrt(times),
        )  # fmt: skip
    return CodedApertureCamera(replace(calibration, sensor=sensor), config)
