"""Measure an image file and write the results. The method is in ``camera.py``."""

from __future__ import annotations

import contextlib
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from chromaperture.camera.camera import CodedApertureCamera
from chromaperture.capture.dual_pixel import shot_stem
from chromaperture.capture.exif import other_colours, read_model
from chromaperture.capture.picture_format import PictureFormat, described
from chromaperture.depth.error_limit import MAX_RELATIVE_SIGMA
from chromaperture.frame import frame_files
from chromaperture.frame.depth_frame import DepthFrame, summarise
from chromaperture.frame.frame_files import OUTPUTS, chosen_outputs
from chromaperture.system.errors import CaptureWarning, within_memory
from chromaperture.system.storage import staged, write_json


@dataclass(frozen=True)
class Written:
    """The files written of one image; ``summary`` is the content of ``STEM.json``."""

    summary: dict[str, Any]
    files: list[Path]


@dataclass(frozen=True, repr=False)
class Report(Written):
    """The files written of one image, and its measurement."""

    frame: DepthFrame

    def __repr__(self) -> str:
        return f"Report({self.summary['image']}, {self.frame!r}, {len(self.files)} files)"


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


@dataclass(frozen=True)
class MeasuredFile:
    """A measured image whose files are still to be written, perhaps while the next image is measured."""

    frame: DepthFrame
    path: Path
    folder: Path
    outputs: tuple[str, ...]
    max_relative_sigma: float
    caption: str
    depth_range_mm: tuple[float, float] | None
    seconds: dict[str, float]
    form: PictureFormat | None = None

    @property
    def turn_degrees(self) -> int:
        """By how much the photograph is to be turned, clockwise, to stand upright."""
        return 0 if self.form is None else self.form.turn_degrees

    @property
    def stem(self) -> str:
        """What the names of its files begin with."""
        camera = self.frame.calibration
        return shot_stem(self.path, None if camera is None else camera.sensor.dual_pixel)

    def write(self, *, made_from: Mapping[str, str] | None = None) -> Written:
        """Write the files, whole or not at all, ``STEM.json`` last, by which a later run knows ``made_from``."""
        clock, stem, frame = StageClock(), self.stem, self.frame
        title = self.path.name
        if frame.calibration is not None:
            title += f"   {frame.calibration.pupil_title}"
        with within_memory(_size(self.path, frame.disparity_px)), staged(self.folder) as stage:
            with clock("write"):
                frame_files.write_maps(
                    stage.path, stem, frame, self.outputs, max_relative_sigma=self.max_relative_sigma, title=title,
                    caption=self.caption, depth_range_mm=self.depth_range_mm,
                )  # fmt: skip
            summary = summarise(frame, self.seconds | clock.seconds)
            summary |= {"image": self.path.name, "max_relative_sigma": self.max_relative_sigma}
            summary |= described(self.form) | {"turn_degrees": self.turn_degrees}
            if made_from is not None:
                summary["made_from"] = dict(made_from)
            if "json" in self.outputs:
                write_json(stage.path(stem + OUTPUTS["json"].suffix), summary)
            names = list(stage.names)
        others = [stem + output.suffix for name, output in OUTPUTS.items() if name not in self.outputs]
        older = [name for name in others if (self.folder / name).exists()]
        if older:
            warnings.warn(
                f"{', '.join(older)} beside the new files of {self.path.name} may be of another measurement: what was "
                "not asked for stays as it was",
                CaptureWarning,
                stacklevel=2,
            )
        return Written(summary, [self.folder / name for name in names])


def measure_file(
    path: str | Path,
    camera: CodedApertureCamera,
    *,
    out: str | Path | None = None,
    write: str | Iterable[str] | None = None,
    black_level: float | None = None,
    white_level: float | None = None,
    right: Path | None = None,
    max_relative_sigma: float = MAX_RELATIVE_SIGMA,
    listener: Callable[[str], None] = lambda name: None,
    inspect: Callable[[np.ndarray], None] = lambda image: None,
    caption: str = "",
    depth_range_mm: tuple[float, float] | None = None,
) -> Report:
    """Measure one image file and write the results, whole or not at all.

    Parameters
    ----------
    path : str or Path
    camera : CodedApertureCamera
    out : str or Path, optional
        Folder; that of the image when absent.
    write : str or iterable of str, optional
        Names of the files to write, see `OUTPUTS`; all that the camera can give when absent.
    black_level, white_level : float, optional
        Instead of the camera's.
    right : Path, optional
        The right picture of a dual-pixel camera, where its name does not tell it.
    max_relative_sigma : float
        Largest sigma / depth of the PNG and of the points, which carry no error bar; see `within_error`.
    listener : callable, optional
        Called with the name of each stage as it begins.
    inspect : callable, optional
        Called with the linear image before it is measured; may raise InputError.
    caption : str
        Second line over the preview.
    depth_range_mm : (float, float), optional
        Ends of the preview's colour bar, to compare it with another's.

    Returns
    -------
    Report

    Raises
    ------
    InputError
        The image or the folder cannot be used, or an output is unknown.
    """
    measured = measure_only(
        path, camera, out=out, write=write, black_level=black_level, white_level=white_level, right=right,
        max_relative_sigma=max_relative_sigma, listener=listener, inspect=inspect, caption=caption,
        depth_range_mm=depth_range_mm,
    )  # fmt: skip
    listener("write")
    written = measured.write()
    return Report(written.summary, written.files, measured.frame)


def measure_only(
    path: str | Path,
    camera: CodedApertureCamera,
    *,
    out: str | Path | None = None,
    write: str | Iterable[str] | None = None,
    black_level: float | None = None,
    white_level: float | None = None,
    right: Path | None = None,
    max_relative_sigma: float = MAX_RELATIVE_SIGMA,
    listener: Callable[[str], None] = lambda name: None,
    inspect: Callable[[np.ndarray], None] = lambda image: None,
    caption: str = "",
    depth_range_mm: tuple[float, float] | None = None,
) -> MeasuredFile:
    """Measure one image file, parameters as `measure_file`; `MeasuredFile.write` writes the results."""
    path = Path(path)
    outputs = chosen_outputs(write, is_calibrated=camera.calibration.is_calibrated)
    clock = StageClock(listener)
    with clock("read"), within_memory(path.name):
        photograph = camera.photograph(path, right=right, black_level=black_level, white_level=white_level)
        image, form = photograph.image, photograph.form
        if form is not None and form.reduction > 1 and camera.shows_frame_at(form.read_size_px):
            camera = camera.at_size(*form.read_size_px)  # as expected: nothing to warn of
    _check_model(path, camera)
    if form is not None and form.turn_degrees:
        warnings.warn(
            "a photograph in portrait orientation, or upside down: the results stay as the sensor delivers them, "
            f"like the calibration; turn_degrees in {OUTPUTS['json'].suffix} says how far to turn them clockwise",
            CaptureWarning,  # names no file: it is said once
            stacklevel=3,
        )
    with within_memory(_size(path, image)):
        inspect(image)
        frame = camera.measure(image, stage=clock)
    folder = path.parent if out is None else Path(out)
    preview = (caption, depth_range_mm)
    return MeasuredFile(frame, path, folder, outputs, max_relative_sigma, *preview, clock.seconds, form)


def _check_model(path: Path, camera: CodedApertureCamera) -> None:
    """Warn of a photograph of another camera than the calibration's photographs, or in other colours."""
    calibrated = camera.calibration.provenance.get("camera_model")
    model = read_model(path) if calibrated else None
    if model and model != calibrated:
        warnings.warn(
            f"taken with a {model}, but the camera file was made with a {calibrated}: another camera has another "
            "sensor and another place for the lens, and its distances will be wrong; calibrate it",
            CaptureWarning,
            stacklevel=4,
        )
    differs = other_colours(path, camera.calibration.provenance)
    if differs:
        warnings.warn(differs, CaptureWarning, stacklevel=4)


def _size(path: Path, pixels: np.ndarray) -> str:
    return f"{path.name}, {pixels.shape[0] * pixels.shape[1] / 1e6:.3g} megapixels"


def write_maps(
    target: Callable[[str], Path],
    stem: str,
    camera: CodedApertureCamera,
    frame: DepthFrame,
    *,
    max_relative_sigma: float = MAX_RELATIVE_SIGMA,
) -> None:
    """Write every map of a frame; depth and points only where calibrated, PNG and points `within_error`."""
    outputs = chosen_outputs(None, is_calibrated=camera.calibration.is_calibrated)
    maps = [name for name in outputs if name not in ("preview", "json")]
    frame_files.write_maps(target, stem, frame, maps, max_relative_sigma=max_relative_sigma)
