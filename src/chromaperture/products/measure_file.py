"""Measure an image file and write the results. The method is in ``camera.py``."""

from __future__ import annotations

import contextlib
import dataclasses
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from chromaperture.camera import CodedApertureCamera, DepthFrame
from chromaperture.capture.files import decode, linearise
from chromaperture.depth.pointcloud import depth_to_points, write_ply
from chromaperture.errors import CaptureWarning
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
    decoded = decode(path)
    black, white = _levels(path.name, decoded.bits, camera, black_level, white_level)
    return linearise(decoded, black_level=black, white_level=white)


def _levels(
    name: str, bits: int, camera: CodedApertureCamera, black: float | None, white: float | None
) -> tuple[float | None, float | None]:
    """Return the levels to read a file with; None, None for those of the file's own encoding."""
    sensor = camera.calibration.sensor
    if black is None and white is None:
        if not camera.calibration.is_calibrated:
            return None, None
        if sensor.white_level > 255 and bits == 8:
            warnings.warn(
                f"{name} has 8 bits where the camera was calibrated on linear counts up to {sensor.white_level:g}: "
                "decoded as sRGB, which costs accuracy; use the linear original",
                CaptureWarning,
                stacklevel=3,
            )
            return None, None
    return sensor.black_level if black is None else black, sensor.white_level if white is None else white


def measure_file(
    path: str | Path,
    camera: CodedApertureCamera,
    *,
    out: str | Path | None = None,
    black_level: float | None = None,
    white_level: float | None = None,
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
            write_maps(stage.path, path.stem, camera, frame)
            title = f"{path.name}   {camera.calibration.aperture.title}"
            write_preview(stage.path(f"{path.stem}.preview.png"), image, frame, title=title)
        summary = summarise(frame, camera, clock.seconds)
        summary["image"] = path.name
        write_json(stage.path(f"{path.stem}.json"), summary)
        names = list(stage.names)
    return Report(frame, summary, [folder / name for name in names])


def write_maps(target: Callable[[str], Path], stem: str, camera: CodedApertureCamera, frame: DepthFrame) -> None:
    """Write every map of a frame; depth, error bar and points only where the camera is calibrated."""
    write_float_tiff(target(f"{stem}.disparity.tiff"), frame.disparity_px)
    write_color_png(target(f"{stem}.color.png"), frame.color)
    if not camera.calibration.is_calibrated:
        return
    write_float_tiff(target(f"{stem}.depth.tiff"), frame.depth_mm)
    write_float_tiff(target(f"{stem}.sigma.tiff"), frame.sigma_mm)
    write_depth_png(target(f"{stem}.depth.png"), frame.depth_mm)
    lens = camera.calibration.lens
    cloud = depth_to_points(
        frame.depth_mm,
        frame.color,
        camera_matrix=lens.camera_matrix,
        distortion=lens.distortion,
        sensor_to_pupil_mm=camera.calibration.depth[camera.config.quality].sensor_to_pupil_mm,
    )
    write_ply(target(f"{stem}.ply"), cloud)


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
