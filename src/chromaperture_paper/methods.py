"""All methods behind one signature, calibrated on the same boards and scored by the same depth errors."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any, TypeVar

import numpy as np
import scipy.fft

from chromaperture.color.alignment import channel_directions
from chromaperture.color.noise import photon_noise_variance
from chromaperture.color.unmixing import mixing_matrix, unmixing_rows, view_directions
from chromaperture.matching.estimate import estimate_disparity
from chromaperture.matching.labels import LabelMap
from chromaperture.matching.result import Disparity
from chromaperture.matching.views import view_spaces
from chromaperture.optics.aperture import DESIGNS, aperture_figures, centroids, film_unmixing
from chromaperture.optics.depth_error_bound import expected_accuracy
from chromaperture.optics.pinhole import PupilCamera
from chromaperture.optics.psf import geometric_otf
from chromaperture.optics.simulator.sensor import SensorModel
from chromaperture.settings.methods import Quality, preset
from chromaperture.system.robust import robust_sigma
from chromaperture_paper import world
from chromaperture_paper.prior_methods import (
    annulus_radius,
    colour_lines,
    cross_correlation,
    phase_correlation,
    stereo_sgbm,
)

T = TypeVar("T")
RANGE_MM = np.array([1000.0, 4500.0])  # working range; the scenes are at 1.15 to 3.3 m
BOARDS_MM = (1150.0, 1350.0, 1600.0, 2050.0, 2400.0, 2900.0, 3500.0)
HALVES_BETA = 0.42  # half disparity of two halves over the blur radius: centroid of a half disc, 4 / (3 pi)
_MARGIN_PX = 0.75  # searched beyond the disparities of the working range; chosen by hand
_STEP_PX = 0.25  # between the prior methods' layers, half disparity; chosen by hand


@dataclass(frozen=True)
class Setting:
    """Properties of a camera that a method may use."""

    design: str
    rows: np.ndarray  # (K, 3) float64, unmixing of its film
    span_px: tuple[float, float]  # half disparities of the working range
    blur_px: float  # largest blur radius in it

    @property
    def layers_px(self) -> np.ndarray:
        """Layers of the prior methods; (D,) float64."""
        low, high = self.span_px
        return np.asarray(np.arange(np.floor(low / _STEP_PX), np.ceil(high / _STEP_PX) + 1) * _STEP_PX)

    @property
    def directions(self) -> np.ndarray:
        """Displacement of R, G, B per px of disparity; leaks of the film only scale it; (3, 2) float64."""
        return channel_directions(DESIGNS[self.design], {})


Method = Callable[[np.ndarray, Setting], np.ndarray]


def setting_of(design: str, camera: PupilCamera) -> Setting:
    """Return the setting of a simulated camera."""
    blur_px = float(np.abs(camera.blur_radius_px(RANGE_MM)).max())
    if not DESIGNS[design].views:
        return Setting(design, np.zeros((0, 3)), (0.0, 0.0), blur_px)
    return Setting(design, film_rows(design), disparity_range(design, camera), blur_px)


def film_rows(design: str) -> np.ndarray:
    """Return the unmixing of a design's real film, as calibrated from photographed sheets; (K, 3) float64."""
    real = world.real_film(design)
    colours = np.array([real.filter_named(name).transmission for name in real.views])
    return unmixing_rows(mixing_matrix(colours), len(real.views))


def disparity_range(design: str, camera: PupilCamera) -> tuple[float, float]:
    """Return the half disparities of the working range with a margin, px."""
    beta = aperture_figures(DESIGNS[design], film_unmixing(DESIGNS[design])).beta
    low, high = (beta * float(r) for r in camera.blur_radius_px(RANGE_MM))
    return low - _MARGIN_PX, high + _MARGIN_PX


def noise_variance(image: np.ndarray) -> np.ndarray:
    """Return the noise variance of a simulated image; (H, W, 3) float32, (white level)^2."""
    sensor = SensorModel()
    return photon_noise_variance(
        image, full_well_electrons=sensor.full_well_electrons, read_noise_electrons=sensor.read_noise_electrons
    )


def our_disparity(image: np.ndarray, setting: Setting, *, quality: Quality) -> Disparity:
    """Match by the project's own method at a quality."""
    config = preset(quality).with_range(*setting.span_px)
    return estimate_disparity(
        image,
        aperture=DESIGNS[setting.design],
        unmixing=setting.rows,
        config=config,
        label_maps=_label_maps(setting, image.shape[:2]) if quality == "accurate" else (),
        noise_variance=noise_variance(image),
    )


def _label_maps(setting: Setting, shape: tuple[int, ...]) -> list[LabelMap]:
    """Return each view space's disparity relative to the first's: leaks make it smaller in pure channels."""
    film = world.real_film(setting.design)
    spaces = view_spaces(DESIGNS[setting.design], setting.rows, "both")
    reach = [float(np.linalg.norm(centroids(film, space.rows), axis=1).mean()) for space in spaces]
    zero = np.zeros(shape, np.float32)
    return [LabelMap(zero, zero + np.float32(r / reach[0])) for r in reach]


def _ours(quality: Quality) -> Method:
    return lambda image, setting: np.asarray(our_disparity(image, setting, quality=quality).value_px, float)


def _by_channels(match: Callable[..., np.ndarray], **options: bool) -> Method:
    return lambda image, setting: match(image, setting.directions, setting.layers_px, **options)


def _annulus(image: np.ndarray, setting: Setting) -> np.ndarray:
    radii = np.arange(0, setting.blur_px + 1.0, 0.5)
    height, width = (scipy.fft.next_fast_len(n + 32, real=True) for n in image.shape[:2])
    aperture = world.real_film(setting.design)
    transfer = [geometric_otf(aperture, float(r), (height, width)) for r in radii]
    return annulus_radius(image, transfer, radii, (height, width))


METHODS: dict[str, Method] = {
    "ours, paper": _ours("paper"),
    "ours, real-time": _ours("real-time"),
    "ours, accurate": _ours("accurate"),
    "normalised cross-correlation, RGB": _by_channels(cross_correlation),
    "normalised cross-correlation, unmixed": lambda image, setting: cross_correlation(
        image @ setting.rows.T, view_directions(DESIGNS[setting.design]), setting.layers_px
    ),
    "phase correlation": _by_channels(phase_correlation),
    "colour lines, box window": _by_channels(colour_lines, optimised=False),
    "colour lines, optimised": _by_channels(colour_lines),
    "OpenCV StereoSGBM": lambda image, setting: stereo_sgbm(
        image[..., [0, 2]], setting.directions[[0, 2]], setting.layers_px
    ),
    "annulus": _annulus,
}


def method_of(design: str) -> str:
    """Return the name of the paper's method for a design."""
    return "annulus" if design == "magenta_annulus" else "ours, paper"


def applies(method: str, design: str) -> bool:
    """Return whether a method can read a design: the annulus only its own, stereo matching only shifts along x."""
    if (method == "annulus") != (design == "magenta_annulus"):
        return False
    if method == "OpenCV StereoSGBM":
        red, _, blue = channel_directions(DESIGNS[design], {})
        return bool(abs(red[1]) < 1e-6 and abs(blue[1]) < 1e-6 and red[0] * blue[0] < 0)
    return bool(DESIGNS[design].views) or method == "annulus"


@dataclass(frozen=True)
class Curve:
    """A method's reading on flat boards over their blur radius: linear between the boards and beyond them."""

    radius_px: np.ndarray  # (N,) float64, rising
    reading: np.ndarray  # (N,) float64, rising; empty where fewer than two boards were read

    def radius_of(self, value: np.ndarray) -> np.ndarray:
        """Convert a reading to a blur radius; (H, W) float64, px."""
        value = np.asarray(value, float)
        if len(self.reading) < 2:
            return np.full(value.shape, np.nan)
        inside = np.interp(value, self.reading, self.radius_px)
        slope = np.diff(self.radius_px) / np.diff(self.reading)
        beyond = np.maximum(value - self.reading[-1], 0) * slope[-1] + np.minimum(value - self.reading[0], 0) * slope[0]
        return np.asarray(inside + beyond)


@cache
def calibrate(method: str, design: str, camera: PupilCamera, cells: int) -> Curve:
    """Read boards at known distances in good light, the same ones for every method."""
    distances = np.array([d for d in BOARDS_MM if method != "annulus" or d > world.FOCUS_MM])
    read = []
    for distance in distances:
        image, small = _board(design, camera, float(distance), cells)
        read.append(float(np.nanmedian(METHODS[method](image, setting_of(design, small))[30:-30, 30:-30])))
    known = np.isfinite(read)
    return increasing_curve(camera.blur_radius_px(distances)[known], np.array(read)[known])


@lru_cache(maxsize=64)
def _board(design: str, camera: PupilCamera, distance_mm: float, cells: int) -> tuple[np.ndarray, PupilCamera]:
    """Photograph a board with the middle of a camera's sensor; return the image and the smaller camera."""
    width, height = min(camera.width_px, 200), min(camera.height_px, 140)
    small = world.camera_of(width, height, pitch_mm=camera.pixel_pitch_mm)
    seed = 1000 + BOARDS_MM.index(distance_mm)
    planes = world.board(small, distance_mm, seed=seed)
    return world.pinhole_capture(design, planes, small, cells=cells, seed=seed).image, small


def increasing_curve(radius_px: np.ndarray, reading: np.ndarray) -> Curve:
    """Make a curve of boards, without those whose reading does not exceed all nearer ones."""
    order = np.argsort(radius_px)
    radius, value = radius_px[order], reading[order]
    before = np.concatenate([[-np.inf], np.maximum.accumulate(value)[:-1]])
    keep = value > before
    return Curve(radius[keep], value[keep])


def depth_of(radius_px: np.ndarray, camera: PupilCamera) -> np.ndarray:
    """Convert a signed blur radius to depth from the sensor plane; (H, W) float64, mm, NaN beyond infinity."""
    inverse = 1 / (camera.focus_mm - camera.sensor_to_pupil_mm) - radius_px / (camera.focal_px * camera.pupil_radius_mm)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(inverse > 0, 1 / inverse + camera.sensor_to_pupil_mm, np.nan)


def relative_bound(design: str, light: str, camera: PupilCamera, distances_mm: np.ndarray) -> np.ndarray:
    """Return the Cramer-Rao bound of a grey wall's depth over its distance; (N,) float64, infinite without views."""
    exposure = world.exposure_in(design, light)
    return expected_accuracy(world.real_film(design), camera, distances_mm, exposure=exposure).sigma_mm / distances_mm


def scores(depth_mm: np.ndarray, truth_mm: np.ndarray) -> dict[str, float]:
    """Compute the errors of a depth map.

    ``depth_mm``, ``truth_mm`` (H, W) float, NaN unknown. Returns fractions of ALL pixels with known truth: fill,
    within_2, within_5, within_10 per cent. Where there is a depth: median_error of |error| / truth; bias, the median of
    error / truth, and scatter, its robust standard deviation.
    """
    known = np.isfinite(truth_mm)
    signed = (depth_mm - truth_mm)[known] / truth_mm[known]
    measured = signed[np.isfinite(signed)]
    error = np.abs(measured)
    bias = float(np.median(measured)) if measured.size else np.nan
    return {
        "fill": measured.size / len(signed),
        **{f"within_{p}": float((error < p / 100).sum() / len(signed)) for p in (2, 5, 10)},
        "median_error": float(np.median(error)) if measured.size else np.nan,
        "bias": bias,
        "scatter": robust_sigma(measured - bias),
    }


def timed(run: Callable[..., T], *arguments: Any) -> tuple[T, float]:
    """Return a result and the seconds that it took."""
    start = time.perf_counter()
    result = run(*arguments)
    return result, time.perf_counter() - start
