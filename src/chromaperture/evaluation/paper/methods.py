"""Every method behind one signature, calibrated on the same boards and judged by the same depth errors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np
import scipy.fft

from chromaperture.color.alignment import channel_directions
from chromaperture.color.noise import photon_noise_variance
from chromaperture.color.unmixing import mixing_matrix, unmixing_rows, view_directions
from chromaperture.config import Quality, preset
from chromaperture.disparity.estimate import estimate_disparity
from chromaperture.disparity.labels import LabelMap
from chromaperture.disparity.result import Disparity
from chromaperture.disparity.views import view_spaces
from chromaperture.evaluation.paper import world
from chromaperture.evaluation.prior.annulus import annulus_radius
from chromaperture.evaluation.prior.colour_lines import colour_lines
from chromaperture.evaluation.prior.correlation import cross_correlation, phase_correlation
from chromaperture.evaluation.prior.stereo import stereo_sgbm
from chromaperture.optics.aperture import DESIGNS, centroids
from chromaperture.optics.metrics import aperture_figures, film_unmixing
from chromaperture.optics.pinhole import PupilCamera
from chromaperture.optics.psf import geometric_otf
from chromaperture.optics.sensor import SensorModel

NEAREST_MM, FARTHEST_MM = 1000.0, 4500.0
BOARDS_MM = (1150.0, 1350.0, 1600.0, 2050.0, 2400.0, 2900.0, 3500.0)
_STEP_PX = 0.25  # of the prior methods' layers, half disparity


@dataclass(frozen=True)
class Setting:
    """What a method may know of a camera.

    Attributes
    ----------
    design : str
    rows : (K, 3) float64
        Unmixing of its film.
    span_px : (float, float)
        Half disparities of the working range.
    blur_px : float
        Largest blur radius in it.
    """

    design: str
    rows: np.ndarray
    span_px: tuple[float, float]
    blur_px: float

    @property
    def layers_px(self) -> np.ndarray:
        """Layers of the prior methods; (D,) float64."""
        low, high = self.span_px
        return np.asarray(np.arange(np.floor(low / _STEP_PX), np.ceil(high / _STEP_PX) + 1) * _STEP_PX)

    @property
    def directions(self) -> np.ndarray:
        """How the sensor's channels move per px; leaks only scale the disparity; (3, 2) float64."""
        return channel_directions(DESIGNS[self.design], {})


Method = Callable[[np.ndarray, Setting], np.ndarray]


def setting_of(design: str, camera: PupilCamera) -> Setting:
    """Give what is known of a simulated camera."""
    reach = camera.blur_radius_px(np.array([NEAREST_MM, FARTHEST_MM]))
    rows = film_rows(design) if DESIGNS[design].views else np.zeros((0, 3))
    span = disparity_range(design, camera) if DESIGNS[design].views else (0.0, 0.0)
    return Setting(design, rows, span, float(np.abs(reach).max()))


def film_rows(design: str) -> np.ndarray:
    """Unmixing of a design's real film, as photographed sheets of it would give; (K, 3) float64."""
    real = world.real_film(design)
    colours = np.array([real.filter_named(name).transmission for name in real.views])
    return unmixing_rows(mixing_matrix(colours), len(real.views))


def disparity_range(design: str, camera: PupilCamera) -> tuple[float, float]:
    """Half disparities of the working range, with a margin; px."""
    beta = aperture_figures(DESIGNS[design], film_unmixing(DESIGNS[design])).beta
    low, high = (beta * float(r) for r in camera.blur_radius_px(np.array([NEAREST_MM, FARTHEST_MM])))
    return low - 0.75, high + 0.75


def our_disparity(image: np.ndarray, setting: Setting, *, quality: Quality) -> Disparity:
    """Match by the project's own method at a quality."""
    sensor = SensorModel()
    config = preset(quality).with_range(*setting.span_px)
    return estimate_disparity(
        image,
        aperture=DESIGNS[setting.design],
        unmixing=setting.rows,
        config=config,
        label_maps=_label_maps(setting) if quality == "accurate" else (),
        noise_variance=photon_noise_variance(
            image,
            full_well_electrons=sensor.full_well_electrons,
            read_noise_electrons=sensor.read_noise_electrons,
        ),
    )


def _label_maps(setting: Setting) -> list[LabelMap]:
    """As a calibrated camera has them: leaking film brings the pure channels closer together than the unmixed views."""
    film = world.real_film(setting.design)
    spaces = view_spaces(DESIGNS[setting.design], setting.rows, "both")
    reach = [float(np.linalg.norm(centroids(film, space.rows), axis=1).mean()) for space in spaces]
    return [LabelMap(np.zeros((1, 1), np.float32), np.full((1, 1), r / reach[0], np.float32)) for r in reach]


def _ours(quality: Quality) -> Method:
    def method(image: np.ndarray, setting: Setting) -> np.ndarray:
        return np.asarray(our_disparity(image, setting, quality=quality).value_px, float)

    return method


def _ncc(image: np.ndarray, setting: Setting) -> np.ndarray:
    return cross_correlation(image, setting.directions, setting.layers_px)


def _ncc_views(image: np.ndarray, setting: Setting) -> np.ndarray:
    return cross_correlation(image @ setting.rows.T, view_directions(DESIGNS[setting.design]), setting.layers_px)


def _phase(image: np.ndarray, setting: Setting) -> np.ndarray:
    return phase_correlation(image, setting.directions, setting.layers_px)


def _lines(image: np.ndarray, setting: Setting) -> np.ndarray:
    return colour_lines(image, setting.directions, setting.layers_px, optimised=False)


def _lines_optimised(image: np.ndarray, setting: Setting) -> np.ndarray:
    return colour_lines(image, setting.directions, setting.layers_px)


def _sgbm(image: np.ndarray, setting: Setting) -> np.ndarray:
    return stereo_sgbm(image[..., [0, 2]], setting.directions[[0, 2]], setting.layers_px)


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
    "normalised cross-correlation, RGB": _ncc,
    "normalised cross-correlation, unmixed": _ncc_views,
    "phase correlation": _phase,
    "colour lines, box window": _lines,
    "colour lines, optimised": _lines_optimised,
    "OpenCV StereoSGBM": _sgbm,
    "annulus": _annulus,
}


def applies(method: str, design: str) -> bool:
    """Tell whether a method can read a design: the annulus its own only, stereo pairs that move along x."""
    if (method == "annulus") != (design == "magenta_annulus"):
        return False
    if method == "OpenCV StereoSGBM":
        red, _, blue = channel_directions(DESIGNS[design], {})
        return bool(abs(red[1]) < 1e-6 and abs(blue[1]) < 1e-6 and red[0] * blue[0] < 0)
    return bool(DESIGNS[design].views) or method == "annulus"


@dataclass(frozen=True)
class Curve:
    """A method's reading on flat boards over their blur radius: straight between the boards and beyond them.

    Attributes
    ----------
    radius_px : (N,) float64
        Rising.
    reading : (N,) float64
        Rising; empty where fewer than two boards were read.
    """

    radius_px: np.ndarray
    reading: np.ndarray

    def radius_of(self, value: np.ndarray) -> np.ndarray:
        """Blur radius from a reading; (H, W) float64, px."""
        value = np.asarray(value, float)
        if len(self.reading) < 2:
            return np.full(value.shape, np.nan)
        inside = np.interp(value, self.reading, self.radius_px)
        low, high = (
            (self.radius_px[j] - self.radius_px[i]) / (self.reading[j] - self.reading[i]) for i, j in ((0, 1), (-2, -1))
        )
        beyond = np.maximum(value - self.reading[-1], 0) * high + np.minimum(value - self.reading[0], 0) * low
        return np.asarray(inside + beyond)


@cache
def calibrate(method: str, design: str, camera: PupilCamera, cells: int) -> Curve:
    """Read boards at known distances in good light; every method gets the same ones."""
    distances = np.array([d for d in BOARDS_MM if method != "annulus" or d > world.FOCUS_MM])
    read = []
    for distance in distances:
        image, small = _board(design, camera, float(distance), cells)
        read.append(float(np.nanmedian(METHODS[method](image, setting_of(design, small))[30:-30, 30:-30])))
    known = np.isfinite(read)
    return rising(camera.blur_radius_px(distances)[known], np.array(read)[known])


@lru_cache(maxsize=64)
def _board(design: str, camera: PupilCamera, distance_mm: float, cells: int) -> tuple[np.ndarray, PupilCamera]:
    """Photograph a board with the middle of a camera's sensor; the picture and that smaller camera."""
    width, height = min(camera.width_px, 200), min(camera.height_px, 140)
    small = world.camera_of(width, height, pitch_mm=camera.pixel_pitch_mm)
    seed = 1000 + BOARDS_MM.index(distance_mm)
    planes = world.board(small, distance_mm, seed=seed)
    table, exposure = world.pinhole_table(small, design, cells), world.level_exposure(design)
    return world.photograph(table, planes, small, seed=seed, exposure=exposure).image, small


def rising(radius_px: np.ndarray, reading: np.ndarray) -> Curve:
    """Make a curve of boards, without those that read no more than a nearer one."""
    order = np.argsort(radius_px)
    radius, value = radius_px[order], reading[order]
    before = np.concatenate([[-np.inf], np.maximum.accumulate(value)[:-1]])
    keep = value > before
    return Curve(radius[keep], value[keep])


def depth_of(radius_px: np.ndarray, camera: PupilCamera) -> np.ndarray:
    """Depth from the sensor plane at a signed blur radius; (H, W) float64, mm, NaN beyond infinity."""
    inverse = 1 / (camera.focus_mm - camera.sensor_to_pupil_mm) - radius_px / (camera.focal_px * camera.pupil_radius_mm)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(inverse > 0, 1 / inverse + camera.sensor_to_pupil_mm, np.nan)


def scores(depth_mm: np.ndarray, truth_mm: np.ndarray) -> dict[str, float]:
    """Judge a depth map.

    Parameters
    ----------
    depth_mm, truth_mm : (H, W) float, NaN unknown

    Returns
    -------
    dict
        Shares of ALL pixels with known truth: fill, within_2, within_5, within_10; and median_error, the median of
        |error| / truth where there is an answer; bias, the median of error / truth, and spread, 1.4826 times the
        median deviation from it.
    """
    known = np.isfinite(truth_mm)
    signed = (depth_mm - truth_mm)[known] / truth_mm[known]
    error = np.abs(signed)
    answered = np.isfinite(error)
    shares = {f"within_{p}": float((error[answered] < p / 100).sum() / len(error)) for p in (2, 5, 10)}
    if not answered.any():
        return {"fill": 0.0, **shares, "median_error": np.nan, "bias": np.nan, "spread": np.nan}
    bias = float(np.median(signed[answered]))
    spread = 1.4826 * float(np.median(np.abs(signed[answered] - bias)))
    middle = float(np.median(error[answered]))
    return {"fill": float(answered.mean()), **shares, "median_error": middle, "bias": bias, "spread": spread}
