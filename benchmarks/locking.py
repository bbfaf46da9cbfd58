"""Bias of the disparity of flat textures as they move past the layers: python benchmarks/locking.py [--design D]

The truth is exact: textures of amplitudes 1/f, with noise, are displaced by the Fourier shift theorem in steps of
0.05 px. "accurate" is that of shifted views; with a lens's own blur, boards are measured by calibration.py.
"""

from __future__ import annotations

import argparse
import json

import numpy as np
import scipy.fft

from chromaperture.color.unmixing import view_directions
from chromaperture.matching.estimate import estimate_disparity
from chromaperture.optics.aperture import Aperture, design_named
from chromaperture.settings.methods import preset

SIZE, BORDER, NOISE, CONTRAST = (240, 320), 24, 0.003, 0.15
STEP_PX, REACH_PX, TEXTURES = 0.05, 2.0, 3


def texture(rng: np.random.Generator) -> np.ndarray:
    """Spectrum of a periodic texture whose amplitudes fall as 1 / f; (H, W / 2 + 1) complex."""
    fy, fx = scipy.fft.fftfreq(SIZE[0])[:, None], scipy.fft.rfftfreq(SIZE[1])
    frequency = np.hypot(fy, fx)
    frequency[0, 0] = 1.0
    spectrum = scipy.fft.rfft2(rng.normal(size=SIZE)) / frequency * np.exp(-2 * (np.pi * frequency * 0.7) ** 2)
    spectrum[0, 0] = 0
    return spectrum * CONTRAST / scipy.fft.irfft2(spectrum, SIZE).std()


def capture(spectrum: np.ndarray, aperture: Aperture, disparity_px: float, rng: np.random.Generator) -> np.ndarray:
    """What the sensor records of a grey plane: every film adds its colour times its displaced view; (H, W, 3)."""
    fy, fx = scipy.fft.fftfreq(SIZE[0])[:, None], scipy.fft.rfftfreq(SIZE[1])
    image = np.zeros((*SIZE, 3))
    for name, (u, v) in zip(aperture.views, view_directions(aperture), strict=True):
        shifted = spectrum * np.exp(-2j * np.pi * disparity_px * (u * fx + v * fy))
        view = 0.5 + scipy.fft.irfft2(shifted, SIZE)
        image += view[..., None] * np.array(aperture.filter_named(name).transmission) / len(aperture.views)
    return (image + rng.normal(0, NOISE, image.shape)).astype(np.float32)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--design", default="cy_halves")
    parser.add_argument("--quality", nargs="+", default=["paper", "real-time", "accurate"])
    args = parser.parse_args()
    aperture = design_named(args.design)
    disparities = np.round(np.arange(-REACH_PX, REACH_PX + STEP_PX / 2, STEP_PX), 3)
    inner = np.s_[BORDER:-BORDER, BORDER:-BORDER]
    report = {}
    for quality in args.quality:
        config = preset(quality)
        bias = np.zeros((TEXTURES, len(disparities)))
        for seed in range(TEXTURES):
            rng = np.random.default_rng(seed)
            spectrum = texture(rng)
            for i, d in enumerate(disparities):
                image = capture(spectrum, aperture, float(d), rng)
                found = estimate_disparity(image, aperture=aperture, config=config).value_px[inner]
                bias[seed, i] = np.nanmedian(found) - d
        mean = bias.mean(axis=0)
        report[quality] = {
            "worst_bias_px": round(float(np.abs(mean).max()), 4),
            "rms_px": round(float(np.sqrt((mean**2).mean())), 4),
            "worst_of_one_texture_px": round(float(np.abs(bias).max()), 4),
        }
    print(json.dumps(report, indent=1))


if __name__ == "__main__":
    main()
