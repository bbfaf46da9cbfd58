"""Captures of a textured plane, displaced view by view with Fourier shifts as the aperture would displace it."""

from __future__ import annotations

import numpy as np

from chromaperture.config import MatcherConfig
from chromaperture.disparity.estimate import estimate_disparity
from chromaperture.optics.aperture import DESIGNS

SIN60 = np.sqrt(3) / 2
# Which way an object beyond focus moves in the view of each film, x right, y down: towards the film.
LAYOUT = {
    "cy_halves": {"cyan": (-1, 0), "yellow": (1, 0)},
    "rgb_squares": {"red": (1, 0), "green": (0, -1), "blue": (-1, 0)},
    "cmy_circles": {"cyan": (0, -1), "magenta": (-SIN60, 0.5), "yellow": (SIN60, 0.5)},
}
MARGIN_PX = 16  # the Fourier shift wraps round, the matcher replicates
NARROW = MatcherConfig(min_disparity_px=-4.0, max_disparity_px=4.0, sigma_scale=1.0)  # these pictures are ideal


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
    found = estimate_disparity(image, aperture=design, config=config, noise_variance=variance, backend="reference")
    inner = (slice(MARGIN_PX, -MARGIN_PX), slice(MARGIN_PX, -MARGIN_PX))
    return found.value_px[inner], found.sigma_px[inner]
