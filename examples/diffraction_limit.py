"""Find the lens size at which blur by diffraction is as wide as the disparity.

An f/2 camera is scaled down, with its pixels and focus distance. By geometric optics the disparity stays the same in
pixels; the width of the diffraction pattern in pixels grows.

python examples/diffraction_limit.py diffraction_limit.png
"""

import sys

import matplotlib
import numpy as np

matplotlib.use("Agg")
from matplotlib import pyplot

from chromaperture.optics.aperture import DESIGNS
from chromaperture.optics.pinhole import PupilCamera
from chromaperture.optics.psf import diffraction_psf, geometric_psf

SIZE = 41


def scaled_camera(focal_mm, f_number, focal_px, focus_in_focal_lengths):
    """Build a camera of a focal length with the same f-number and the same picture in pixels."""
    return PupilCamera(
        width_px=SIZE,
        height_px=SIZE,
        focal_px=focal_px,
        pupil_radius_mm=focal_mm / (2 * f_number),
        focus_mm=focus_in_focal_lengths * focal_mm,
        sensor_to_pupil_mm=focal_mm,
        pixel_pitch_mm=focal_mm / focal_px,
    )


def half_width(psf):
    """Compute the half width along x of 68 % of the light, px; the second moment diverges with the outer rings."""
    profile = np.cumsum(psf.sum(axis=0)) / psf.sum()
    x = np.arange(len(profile)) + 0.5
    low, high = np.interp([0.16, 0.84], profile, x)
    return (high - low) / 2


def main(path):
    design = DESIGNS["cy_halves"]
    sizes = np.geomspace(0.3, 16, 12)
    disparity, width, blur = [], [], []
    for focal_mm in sizes:
        camera = scaled_camera(focal_mm, 2.0, 1600.0, 40.0)
        depth = 60.0 * focal_mm
        radius = float(camera.blur_radius_px(depth))
        psf = diffraction_psf(design, camera, depth, size=SIZE)
        x = np.arange(SIZE) - SIZE // 2
        red, blue = ((psf[k].sum(axis=0) * x).sum() / psf[k].sum() for k in (0, 2))
        disparity.append((red - blue) / 2)
        width.append(half_width(psf[0]))
        blur.append(half_width(geometric_psf(design, radius, SIZE, oversampling=9)[0]) / 9)
    limit = np.interp(1.0, np.array(disparity) / np.array(width), sizes)
    figure, axes = pyplot.subplots(figsize=(7, 4.2), layout="constrained")
    axes.loglog(sizes, disparity, "k", label="half disparity between red and blue")
    axes.loglog(sizes, width, "C3", label="half width of the blur, with diffraction")
    axes.loglog(sizes, blur, "C0--", label="half width of the blur, rays only")
    axes.set(xlabel="focal length at f/2, mm (pixels and distances scale with it)", ylabel="px")
    axes.set_title("Cyan and yellow halves: a point at 60 focal lengths, focus at 40")
    axes.grid(alpha=0.3, which="both")
    axes.legend()
    figure.savefig(path, dpi=110)
    print(f"Wrote {path}; the blur is as wide as the disparity at f = {limit:.2f} mm")


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "diffraction_limit.png")
