"""Every method behind one signature, calibrated on the same boards and judged by the same depth errors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
import scipy.fft

from chromaperture.color.alignment import channel_directions
from chromaperture.color.noise import photon_noise_variance
from chromaperture.color.unmixing import mixing_matrix, unmixing_rows, view_directions
from chromaperture.config import MatcherConfig, Quality
from chromaperture.disparity.estimate import Disparity, estimate_disparity
from chromaperture.evaluation.paper import world
from chromaperture.evaluation.prior.annulus import annulus_radius
from chromaperture.evaluation.prior.colour_lines import colour_lines
from chromaperture.evaluation.prior.correlation import cross_correlation, phase_correlation
from chromaperture.evaluation.prior.stereo import stereo_sgbm
from chromaperture.optics.aperture import DESIGNS
from chromaperture.optics.metrics import aperture_figures, film_unmixing
from chromaperture.optics.pinhole import PupilCamera
from chromaperture.optics.psf import geometric_otf
from chromaperture.optics.sensor import Sensor

NEAREST_MM, FARTHEST_MM = 1000.0, 4500.0
BOARDS_MM = (1150.0, 1400.0, 1700.0, 2400.0, 2900.0, 3500.0)
_STEP_PX = 0.25  # of the prior methods' layers, half disparity
Method = Callable[[np.ndarray, str, PupilCamera], np.ndarray]


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


def layers(design: str, camera: PupilCamera) -> np.ndarray:
    """Layers of the prior methods; (D,) float64, px."""
    low, high = disparity_range(design, camera)
    return np.asarray(np.arange(np.floor(low / _STEP_PX), np.ceil(high / _STEP_PX) + 1) * _STEP_PX)


def our_disparity(
    image: np.ndarray,
    design: str,
    camera: PupilCamera,
    *,
    quality: Quality,
    span_px: tuple[float, float] | None = None,
) -> Disparity:
    """Match by the project's own method at a quality, over a range of half disparities."""
    sensor = Sensor()
    return estimate_disparity(
        image,
        aperture=DESIGNS[design],
        unmixing=film_rows(design),
        config=MatcherConfig.preset(quality).with_range(*(span_px or disparity_range(design, camera))),
        noise_variance=photon_noise_variance(
            image,
            full_well_electrons=sensor.full_well_electrons,
            read_noise_electrons=sensor.read_noise_electrons,
        ),
    )


def _ours(quality: Quality) -> Method:
    def method(image: np.ndarray, design: str, camera: PupilCamera) -> np.ndarray:
        return np.asarray(our_disparity(image, design, camera, quality=quality).value_px, float)

    return method


def _channels(image: np.ndarray, design: str) -> tuple[np.ndarray, np.ndarray]:
    """Sensor channels that move, and how; their leaks only scale the disparity."""
    directions = channel_directions(DESIGNS[design], {})
    return image, directions


def _ncc(image: np.ndarray, design: str, camera: PupilCamera) -> np.ndarray:
    return cross_correlation(*_channels(image, design), layers(design, camera))


def _ncc_views(image: np.ndarray, design: str, camera: PupilCamera) -> np.ndarray:
    return cross_correlation(image @ film_rows(design).T, view_directions(DESIGNS[design]), layers(design, camera))


def _phase(image: np.ndarray, design: str, camera: PupilCamera) -> np.ndarray:
    return phase_correlation(*_channels(image, design), layers(design, camera))


def _lines(image: np.ndarray, design: str, camera: PupilCamera) -> np.ndarray:
    return colour_lines(*_channels(image, design), layers(design, camera), optimised=False)


def _lines_optimised(image: np.ndarray, design: str, camera: PupilCamera) -> np.ndarray:
    return colour_lines(*_channels(image, design), layers(design, camera))


def _sgbm(image: np.ndarray, design: str, camera: PupilCamera) -> np.ndarray:
    directions = channel_directions(DESIGNS[design], {})
    return stereo_sgbm(image[..., [0, 2]], directions[[0, 2]], layers(design, camera))


def _annulus(image: np.ndarray, design: str, camera: PupilCamera) -> np.ndarray:
    reach = camera.blur_radius_px(np.array([NEAREST_MM, FARTHEST_MM]))
    radii = np.arange(0, float(np.abs(reach).max()) + 1.0, 0.5)
    height, width = (scipy.fft.next_fast_len(n + 32, real=True) for n in image.shape[:2])
    aperture = world.real_film(design)
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
class Line:
    """A method's reading on flat boards: value = gain * blur radius + offset."""

    gain: float
    offset: float

    def radius_px(self, value: np.ndarray) -> np.ndarray:
        """Blur radius from a reading; (H, W), px."""
        return (value - self.offset) / self.gain


@cache
def calibrate(method: str, design: str, camera: PupilCamera, exposure: float, cells: int, seed: int) -> Line:
    """Read boards at known distances and fit the line; every method gets the same ones."""
    width, height = min(camera.width_px, 200), min(camera.height_px, 140)
    small = world.camera_of(width, height, pitch_mm=camera.pixel_pitch_mm)
    distances = [d for d in BOARDS_MM if method != "annulus" or d > world.FOCUS_MM]
    read = []
    for i, distance in enumerate(distances):
        planes = world.board(small, distance, seed=seed + i)
        table = world.pinhole_table(small, design, cells)
        shot = world.photograph(table, planes, small, seed=seed + i, exposure=exposure)
        value = METHODS[method](shot.image, design, small)
        read.append(float(np.nanmedian(value[30:-30, 30:-30])))
    radius = small.blur_radius_px(np.array(distances))
    known = np.isfinite(read)
    if known.sum() < 2:
        return Line(np.nan, np.nan)
    gain, offset = np.polyfit(radius[known], np.array(read)[known], 1)
    return Line(float(gain), float(offset))


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
