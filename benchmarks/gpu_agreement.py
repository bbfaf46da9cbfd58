"""Depth by WGSL, Numba and the readable stages: python benchmarks/gpu_agreement.py PHOTO CAMERA [PHOTO CAMERA ...]

For both qualities the share of the pixels whose depth is within 0.1 %, or unknown in both, of each pair; and of WGSL
and Numba how far apart they are where both know it: the 99th percentile in standard deviations of the error bar.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from chromaperture.camera.camera import CodedApertureCamera, load_camera
from chromaperture.frame.depth_frame import DepthFrame
from chromaperture.settings.methods import Quality

AGREEING = 1e-3


def frames(photo: Path, camera: Path, quality: Quality, device: str) -> tuple[DepthFrame, DepthFrame, DepthFrame]:
    """Measurements by WGSL, Numba and NumPy, at the photograph's own resolution."""
    compiled = load_camera(camera, quality=quality, scale=1, device="cpu")
    image = compiled.read(photo)
    readable = CodedApertureCamera(compiled.calibration, compiled.config, execution="numpy")
    on_device = CodedApertureCamera(compiled.calibration, compiled.config, device=device)
    return on_device.measure(image), compiled.measure(image), readable.measure(image)


def agreeing(one: np.ndarray, other: np.ndarray) -> float:
    """Share of the pixels whose depths differ by less than `AGREEING`, or are unknown in both."""
    known = np.isfinite(one) & np.isfinite(other)
    near = np.zeros(known.shape, bool)
    near[known] = np.abs(one[known] / other[known] - 1) < AGREEING
    return float((near | (np.isnan(one) & np.isnan(other))).mean())


def apart_sigma(one: DepthFrame, other: DepthFrame) -> float:
    """99th percentile of the difference, in standard deviations."""
    return float(np.nanpercentile(np.abs(one.depth_mm - other.depth_mm) / other.sigma_mm, 99))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pairs", nargs="+", type=Path, metavar="PHOTO CAMERA")
    parser.add_argument("--device", default="gpu")
    arguments = parser.parse_args()
    if len(arguments.pairs) % 2:
        parser.error("every photograph needs its camera file behind it")
    qualities: tuple[Quality, ...] = ("real-time", "paper")
    print("camera               quality    WGSL:NumPy Numba:NumPy WGSL:Numba apart, sigma")
    for photo, camera in zip(arguments.pairs[::2], arguments.pairs[1::2], strict=True):
        for quality in qualities:
            wgsl, numba, numpy_ = frames(photo, camera, quality, arguments.device)
            pairs = ((wgsl, numpy_), (numba, numpy_), (wgsl, numba))
            shares = [agreeing(one.depth_mm, other.depth_mm) for one, other in pairs]
            columns = f"{shares[0]:10.4f} {shares[1]:11.4f} {shares[2]:10.4f} {apart_sigma(wgsl, numba):12.4f}"
            print(f"{camera.stem:20s} {quality:10s} {columns}", flush=True)


if __name__ == "__main__":
    main()
