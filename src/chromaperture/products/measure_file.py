"""Measure an image file and write the results. The method is in ``camera.py``."""

from __future__ import annotations

import contextlib
import dataclasses
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from chromaperture.camera import CodedApertureCamera, DepthFrame
from chromaperture.capture.files import decode, linearise
from chromaperture.depth.error_limit import MAX_RELATIVE_SIGMA, within_error
from chromaperture.depth.pointcloud import PointCloud, depth_to_points, write_ply
from chromaperture.products.preview import write_preview
from chromaperture.storage import staged, write_color_png, write_depth_png, write_float_tiff, write_json

_PERCENTILES = (5, 25, 50, 75, 95)  # of disparity and depth in a summary


@dataclass(frozen=True)
class Report:
    """Measurement of one image and the files written; ``summary`` is the content of ``STEM.json``."""

    frame: DepthFrame
    summary: dict[str, Any]
    files: list[Path]


class StageClock:
    """Time the stages, and call a listener with the name of each as it begins."""

    def __init__(self, listener: Callable[[str], None] = lambda name: None) -> None:
        self.seconds: dict[str, float] = {}
        self._listener = listener

    @contextlib.contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        """Time one stage."""
        self._listener(name)
        start = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start


def read_capture(
    path: Path, camera: CodedApertureCamera, *, black_level: float | None = None, white_level: float | None = None
) -> np.ndarray:
    """Read an image with the given levels, else the camera's where the file can hold its counts; (H, W, 3) linear."""
    sensor = camera.calibration.sensor
    levels = (sensor.black_level, sensor.white_level) if camera.calibration.is_calibrated else None
    decoded = decode(path, size_px=(sensor.width_px, sensor.height_px))
    return linearise(decoded, black_level=black_level, white_level=white_level, camera_levels=levels)


def measure_file(
    path: str | Path,
    camera: CodedApertureCamera,
    *,
    out: str | Path | None = None,
    black_level: float | None = None,
    white_level: float | None = None,
    max_relative_sigma: float = MAX_RELATIVE_SIGMA,
    listener: Callable[[str], None] = lambda name: None,
    inspect: Callable[[np.ndarray], None] = lambda image: None,
) -> Report:
    """Measure one image file and write all results, whole or not at all.

    Parameters
    ----------
    path : str or Path
    camera : CodedApertureCamera
    out : str or Path, optional
        Folder; that of the image when absent.
    black_level, white_level : float, optional
        Instead of the camera's.
    max_relative_sigma : float
        Largest sigma / depth of the PNG and of the points, which carry no error bar; see `within_error`.
    listener : callable, optional
        Called with the name of each stage as it begins.
    inspect : callable, optional
        Called with the linear image before it is measured; may raise InputError.

    Returns
    -------
    Report

    Raises
    ------
    InputError
        The image or the folder cannot be used.
    """
    path = Path(path)
    folder = path.parent if out is None else Path(out)
    clock = StageClock(listener)
    with clock("read"):
        image = read_capture(path, camera, black_level=black_level, white_level=white_level)
    inspect(image)
    frame = camera.measure(image, stage=clock)
    with staged(folder) as stage:
        with clock("write"):
            write_maps(stage.path, path.stem, camera, frame, max_relative_sigma=max_relative_sigma)
            title = f"{path.name}   {camera.calibration.aperture.title}"
            write_preview(stage.path(f"{path.stem}.preview.png"), image, frame, title=title)
        summary = summarise(frame, camera, clock.seconds)
        summary |= {"image": path.name, "max_relative_sigma": max_relative_sigma}
        write_json(stage.path(f"{path.stem}.json"), summary)
        names = list(stage.names)
    return Report(frame, summary, [folder / name for name in names])


def write_maps(
    target: Callable[[str], Path],
    stem: str,
    camera: CodedApertureCamera,
    frame: DepthFrame,
    *,
    max_relative_sigma: float = MAX_RELATIVE_SIGMA,
) -> None:
    """Write every map of a frame; depth, error bar and points only where the camera is calibrated.

    ``STEM.depth.tiff`` is whole, beside ``STEM.sigma.tiff``; the PNG and the points are limited by `within_error`.
    """
    write_float_tiff(target(f"{stem}.disparity.tiff"), frame.disparity_px)
    write_color_png(target(f"{stem}.color.png"), frame.color)
    if not camera.calibration.is_calibrated:
        return
    write_float_tiff(target(f"{stem}.depth.tiff"), frame.depth_mm)
    write_float_tiff(target(f"{stem}.sigma.tiff"), frame.sigma_mm)
    certain_mm = within_error(frame.depth_mm, frame.sigma_mm, max_relative_sigma)
    write_depth_png(target(f"{stem}.depth.png"), certain_mm)
    write_ply(target(f"{stem}.ply"), points(camera, certain_mm, frame.color))


def points(camera: CodedApertureCamera, depth_mm: np.ndarray, color: np.ndarray) -> PointCloud:
    """Return the points of a depth map of this camera, see `depth_to_points`."""
    lens, delta = camera.calibration.lens, camera.calibration.depth[camera.config.quality].sensor_to_pupil_mm
    matrix, distortion = lens.camera_matrix, lens.distortion
    return depth_to_points(depth_mm, color, camera_matrix=matrix, distortion=distortion, sensor_to_pupil_mm=delta)


def summarise(frame: DepthFrame, camera: CodedApertureCamera, seconds: dict[str, float]) -> dict[str, Any]:
    """Collect the figures of one frame, units in the names."""
    known, sigma = np.isfinite(frame.disparity_px), frame.sigma_mm[np.isfinite(frame.sigma_mm)]
    return {
        "fill_rate": float((frame.valid if camera.calibration.is_calibrated else known).mean()),
        "disparity_percentiles_px": _percentiles(frame.disparity_px),
        "depth_percentiles_mm": _percentiles(frame.depth_mm),
        "sigma_median_mm": float(np.median(sigma)) if sigma.size else None,
        "seconds": {name: round(value, 4) for name, value in seconds.items()},
        "config": dataclasses.asdict(camera.config),
        "camera": camera.calibration.summary(),
    }


def _percentiles(values: np.ndarray) -> dict[str, float] | None:
    known = values[np.isfinite(values)]
    if known.size == 0:
        return None
    return {str(p): float(v) for p, v in zip(_PERCENTILES, np.percentile(known, _PERCENTILES), strict=True)}
