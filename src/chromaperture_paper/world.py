"""The simulated camera, a 50 mm f/2 lens focused at 2 m as the paper's, and scenes for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from chromaperture.optics.aperture import DESIGNS, Aperture, channel_transmission, made_of
from chromaperture.optics.pinhole import PupilCamera, focused_at, pupil_camera
from chromaperture.optics.prescription import Prescription, load_lens
from chromaperture.optics.ray_table import RayTable, lens_rays, pinhole_rays
from chromaperture.optics.simulator import textures
from chromaperture.optics.simulator.render import render, render_depth
from chromaperture.optics.simulator.scene import Plane, plane
from chromaperture.optics.simulator.sensor import SensorModel, develop, expose

FOCUS_MM = 2000.0
SENSOR_WIDTH_MM = 22.3  # APS-C
FINE_PITCH_MM = SENSOR_WIDTH_MM / 480  # pixels of a full run; boards and walls are crops of this picture
EIGHT = ("rgb_circles", "rgb_squares", "cmy_squares", "cmy_circles", "cy_halves", "magenta_annulus", "cy_open", "open")
NUMERALS = dict(zip(EIGHT, ("I", "II", "III", "IV", "V", "VI", "VII", "VIII"), strict=True))
WHITE = 0.9  # of white level: white paper in the brightest channel; leaves room for noise
DIM = 0.03  # of white level: white paper through the open pupil in dim light, a thirtieth of WHITE
Triple = tuple[float, float, float]
LIGHTS = ("equal level", "equal time", "equal time, dim")

_HUES = np.array([(1, 1, 1), (1, 0.35, 0.3), (0.4, 0.9, 0.35), (0.35, 0.45, 1), (1, 0.85, 0.3), (0.9, 0.4, 0.9)])


@dataclass(frozen=True)
class Capture:
    """One photograph of a scene whose depth is known."""

    image: np.ndarray  # (H, W, 3) float32, linear
    depth_mm: np.ndarray  # (H, W) float64, from the sensor plane, for the ray through the pupil's centre
    radius_px: np.ndarray  # (H, W) float64, signed blur radius at that depth


def lens() -> Prescription:
    """Return the double Gauss of the package at the paper's focus."""
    return focused_at(load_lens("double_gauss_50"), FOCUS_MM)


def camera_of(width_px: int, height_px: int, *, pitch_mm: float | None = None) -> PupilCamera:
    """Return the first-order model of the lens on a sensor of 22.3 mm width, or of the given pitch."""
    return pupil_camera(
        lens(), width_px=width_px, height_px=height_px, pixel_pitch_mm=pitch_mm or SENSOR_WIDTH_MM / width_px
    )


def real_film(design: str) -> Aperture:
    """Return a design made of real film."""
    return made_of(DESIGNS[design], "real")


def full_name(design: str) -> str:
    """Return the paper's numeral and the name of a design."""
    return f"{NUMERALS[design]} {design}"


@cache
def pinhole_table(camera: PupilCamera, design: str, cells: int) -> RayTable:
    """Return the rays of the ideal lens through a design of real film."""
    return pinhole_rays(camera, real_film(design), cells=cells)


def traced_table(camera: PupilCamera, aperture: Aperture, cells: int) -> RayTable:
    """Return the rays of the real lens: aberrations, vignetting, curved focus."""
    size = {"width_px": camera.width_px, "height_px": camera.height_px}
    return lens_rays(lens(), aperture, **size, pixel_pitch_mm=camera.pixel_pitch_mm, cells=cells)


def photograph(table: RayTable, planes: Sequence[Plane], camera: PupilCamera, *, seed: int, exposure: float) -> Capture:
    """Photograph planes; ``exposure`` is the image level of a reflectance of 1 through an open pupil."""
    sensor = SensorModel()
    image = develop(expose(render(table, planes, seed=seed), sensor, seed=seed, exposure=exposure), sensor)
    depth = np.asarray(render_depth(table, planes), float)
    return Capture(np.asarray(image, np.float32), depth, camera.blur_radius_px(depth))


def pinhole_capture(
    design: str, planes: Sequence[Plane], camera: PupilCamera, *, cells: int, seed: int, exposure: float | None = None
) -> Capture:
    """Photograph planes through the ideal lens and a design, at `level_exposure` unless given."""
    exposure = level_exposure(design) if exposure is None else exposure
    return photograph(pinhole_table(camera, design, cells), planes, camera, seed=seed, exposure=exposure)


def level_exposure(design: str) -> float:
    """Return the exposure at which white paper has the level WHITE in the brightest channel."""
    return WHITE / float(channel_transmission(real_film(design)).max())


def exposure_in(design: str, light: str) -> float:
    """Return the exposure of a design in one of LIGHTS."""
    return {LIGHTS[0]: level_exposure(design), LIGHTS[1]: WHITE, LIGHTS[2]: DIM}[light]


def still_life(*, seed: int = 0, saturation: float = 0.5) -> list[Plane]:
    """Build a room corner: wall, floor and six boards from 1.15 to 2.9 m; saturation 0 is grey, 1 full colours."""
    rng = np.random.default_rng(seed)
    made = [
        _speckle((0, 0, 3300.0), 2200.0, 1500.0, (0.55, 0.55, 0.55), 4.0, seed + 100, (0, 0, 0)),
        _speckle((0, 230.0, 2300.0), 2400.0, 2200.0, (0.6, 0.57, 0.5), 4.0, seed + 101, (-80.0, 0, 0)),
    ]
    depths = np.array([1150.0, 1450.0, 1750.0, 2050.0, 2450.0, 2900.0])
    positions = (-0.30, 0.32, -0.08, 0.16, -0.36, 0.36)
    for i, (z, position) in enumerate(zip(depths, positions, strict=True)):
        width = 0.11 * z
        center = (position * 0.42 * z, (0.05 - 0.10 * (i % 2)) * z, z)
        r, g, b = 0.62 * (1 - saturation + saturation * _HUES[i])
        tilt = (0.0, float(rng.uniform(-25, 25)), float(rng.uniform(-10, 10)))
        made.append(_speckle(center, width, width * 1.25, (r, g, b), 0.0005 * z, seed + i, tilt))
    return made


def board(camera: PupilCamera, distance_mm: float, *, seed: int, saturation: float = 0.0) -> list[Plane]:
    """Build a wall of speckle that fills the picture, perpendicular to the axis; grey, or in patches of colour."""
    width = 1.3 * distance_mm * camera.width_px / camera.focal_px
    shape = _texels(width, width * camera.height_px / camera.width_px, 0.5 * distance_mm / camera.focal_px)
    grey = np.repeat(textures.noise(shape, exponent=0.9, seed=seed)[..., None], 3, axis=2)
    hues = np.random.default_rng(seed).choice(_HUES, (4, 6))
    patches = hues.repeat(-(-shape[0] // 4), axis=0).repeat(-(-shape[1] // 6), axis=1)[: shape[0], : shape[1]]
    tint = 1 - saturation + saturation * patches
    return [plane(np.clip(grey * tint, 0.01, 1), center_mm=(0, 0, distance_mm), width_mm=width)]


def _speckle(center: Triple, width: float, height: float, tint: Triple, texel: float, seed: int, tilt: Triple) -> Plane:
    grey = textures.noise(_texels(width, height, texel), exponent=0.9, seed=seed)
    picture = np.clip(grey[..., None] * np.asarray(tint, np.float32) / 0.45, 0.01, 1)
    return plane(picture, center_mm=center, width_mm=width, tilt_deg=tilt)


def _texels(width: float, height: float, texel: float) -> tuple[int, int]:
    """Return the shape of a texture of at least 2 x 2 texels."""
    return max(2, round(height / texel)), max(2, round(width / texel))
