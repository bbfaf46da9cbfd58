"""Captures of textured surfaces, displaced view by view as the aperture would displace them."""

from __future__ import annotations

import cv2
import numpy as np

from chromaperture.color.unmixing import ideal_unmixing, view_directions
from chromaperture.config import PaperConfig
from chromaperture.disparity.estimate import estimate_disparity
from chromaperture.disparity.views import ViewSpace, view_spaces
from chromaperture.optics.aperture import DESIGNS
from chromaperture.stage_config import BilateralConfig, CorrelationConfig, LayersConfig

SIN60 = np.sqrt(3) / 2
# Which way an object beyond focus moves in the view of each film, x right, y down: towards the film.
LAYOUT = {
    "cy_halves": {"cyan": (-1, 0), "yellow": (1, 0)},
    "rgb_squares": {"red": (1, 0), "green": (0, -1), "blue": (-1, 0)},
    "cmy_circles": {"cyan": (0, -1), "magenta": (-SIN60, 0.5), "yellow": (SIN60, 0.5)},
}
MARGIN_PX = 16  # the Fourier shift wraps round, the matcher replicates
# The paper's method with everything that known noise and pure channels gain; these pictures are ideal.
NARROW = PaperConfig(
    layers=LayersConfig(min_px=-4.0, max_px=4.0),
    space="pure",
    correlation=CorrelationConfig(noise_debiasing=True),
    bilateral=BilateralConfig(texture_weighting=True),
    sigma_scale=1.0,
)


def texture(rng, height=80, width=96, blur_px=1.5):
    """Periodic Gaussian texture around 0.5, band-limited by a Gaussian; (H, W)."""
    fy, fx = np.fft.fftfreq(height)[:, None], np.fft.fftfreq(width)
    spectrum = np.fft.fft2(rng.normal(size=(height, width))) * np.exp(-2 * (np.pi * blur_px) ** 2 * (fx**2 + fy**2))
    field = np.fft.ifft2(spectrum).real
    return 0.5 + 0.09 * field / field.std()


def moved(picture, dx, dy):
    """The picture displaced by (dx, dy) px, exactly, for a periodic band-limited one."""
    fy, fx = np.fft.fftfreq(picture.shape[0])[:, None], np.fft.fftfreq(picture.shape[1])
    return np.fft.ifft2(np.fft.fft2(picture) * np.exp(-2j * np.pi * (fx * dx + fy * dy))).real


def capture(picture, design, disparity_px):
    """What the sensor records of a grey plane: every film adds its colour times its displaced view."""
    aperture = DESIGNS[design]
    image = np.zeros((*picture.shape, 3))
    for name, (ux, uy) in LAYOUT[design].items():
        view = moved(picture, disparity_px * ux, disparity_px * uy)
        image += view[..., None] * np.array(aperture.filter_named(name).transmission)
    return (0.9 * image / image.max()).astype(np.float32)


def measured(image, design, config=NARROW, noise=0.0):
    variance = np.full(image.shape, noise**2, np.float32)
    found = estimate_disparity(image, aperture=design, config=config, noise_variance=variance, execution="numpy")
    inner = (slice(MARGIN_PX, -MARGIN_PX), slice(MARGIN_PX, -MARGIN_PX))
    return found.value_px[inner], found.sigma_px[inner]


def space_of(design: str) -> ViewSpace:
    """The unmixed views of a design in ideal film."""
    return view_spaces(DESIGNS[design], None, "unmixed")[0]


def wavy_capture(
    design: str, *, shape: tuple[int, int] = (61, 83), seed: int = 7, saturated: bool = True
) -> np.ndarray:
    """A noisy capture of a wavy surface with a step, an even area and a saturated one; (H, W, 3) float32."""
    rng = np.random.default_rng(seed)
    height, width = shape
    margin = 16
    big = (height + 2 * margin, width + 2 * margin)
    texture = sum(cv2.GaussianBlur(rng.normal(size=big).astype(np.float32), (0, 0), s) * s for s in (1.2, 4.0))
    texture = 0.5 + 0.12 * texture / texture.std()
    y, x = np.mgrid[:height, :width].astype(np.float32)
    disparity = 2.5 * np.sin(x / 17) * np.cos(y / 13)
    disparity[height // 3 : height // 2, width // 4 : width // 2] -= 1.5
    aperture = DESIGNS[design]
    x, y = x + margin, y + margin
    views = [
        cv2.remap(texture, x - disparity * np.float32(u), y - disparity * np.float32(v), cv2.INTER_CUBIC)
        for u, v in view_directions(aperture)
    ]
    image = np.stack(views, axis=-1) @ np.linalg.pinv(ideal_unmixing(aperture)).T
    image = image * (0.8 / image.max()) + rng.normal(0, 0.006, image.shape)
    image[-20:, -25:] = 0.3  # an even area without even noise
    if saturated:
        image[5:15, 40:50] = 1.0
    return image.astype(np.float32)
