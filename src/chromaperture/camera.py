"""The whole method on one screen: one photograph in, millimetres out."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

import numpy as np

from chromaperture.camera_alignment import ChannelAlignment
from chromaperture.camera_file import Calibration
from chromaperture.camera_matching import default_config, label_maps, noise_model
from chromaperture.capture.checks import check_capture
from chromaperture.capture.files import decode, linearise
from chromaperture.config import Config, DepthConfig, ExecutionName, Quality
from chromaperture.depth.conversion import DepthModel, disparity_to_depth
from chromaperture.disparity.estimate import method_for
from chromaperture.disparity.result import Disparity
from chromaperture.frame.depth_frame import DepthFrame

StageTimer = Callable[[str], AbstractContextManager[None]]


class CodedApertureCamera:
    """A camera with a colour-coded aperture, at the focus setting it was calibrated for.

    Parameters
    ----------
    calibration : Calibration
    config : Config, optional
        Searches the calibration's working range at real-time quality when absent.
    execution : {"numba", "numpy"}
        Of the matcher: compiled, or readable and slow.
    """

    def __init__(
        self, calibration: Calibration, config: Config | None = None, *, execution: ExecutionName = "numba"
    ) -> None:
        self.calibration = calibration
        self.config = config or default_config(calibration)
        self.execution: ExecutionName = execution
        self.method = method_for(
            self.config.matcher,
            aperture=calibration.aperture,
            unmixing=calibration.unmixing,
            label_maps=label_maps(calibration, self.config.matcher),
            blur=calibration.field_blur(),
            noise=noise_model(calibration),
            execution=execution,
        )
        self.depth_model = calibration.depth_model(self.config.quality) if calibration.is_calibrated else None
        self.alignment = ChannelAlignment(calibration, self.config, self.depth_model)

    def measure(self, image: np.ndarray | str | Path, *, stage: StageTimer = lambda name: nullcontext()) -> DepthFrame:
        """Measure depth in millimetres for every pixel of one photograph.

        Parameters
        ----------
        image : (H, W, 3) float, linear RGB, 1.0 = white level; or str or Path
            From `chromaperture.read_image`; or a file, which is read with the levels of this camera, see `read`.
        stage : callable, optional
            ``with stage(name):`` is entered around each stage, for timing and progress.

        Returns
        -------
        DepthFrame

        Raises
        ------
        InputError
            The image cannot be used, or is not of this camera's size.
        """
        sensor = self.calibration.sensor
        if isinstance(image, str | Path):
            with stage("read"):
                image = self.read(image)
        with stage("check"):
            image = check_capture(image, sensor.width_px, sensor.height_px)
        with stage("disparity"):  # Eq. (1) and section 3.1
            disparity = self.method.match(image)
        with stage("depth"):  # Eq. (10)
            depth_mm, sigma_mm = millimetres(disparity, self.depth_model, self.config.depth)
        with stage("color"):  # section 5.1
            color = self.alignment.align(image, disparity.value_px)
        maps = (depth_mm, sigma_mm, disparity.value_px, disparity.sigma_px, disparity.confidence, color)
        return DepthFrame(*maps, image, self.calibration, self.config)

    def read(
        self, path: str | Path, *, black_level: float | None = None, white_level: float | None = None
    ) -> np.ndarray:
        """Read a photograph with the given levels, else this camera's where the file can hold its counts.

        Returns
        -------
        (H, W, 3) float32, linear RGB

        Raises
        ------
        InputError
            As `chromaperture.read_image`.
        """
        sensor = self.calibration.sensor
        levels = (sensor.black_level, sensor.white_level) if self.calibration.is_calibrated else None
        decoded = decode(path, size_px=(sensor.width_px, sensor.height_px))
        return linearise(decoded, black_level=black_level, white_level=white_level, camera_levels=levels)

    def __repr__(self) -> str:
        return f"CodedApertureCamera({self.calibration.title}, quality {self.config.quality})"


def millimetres(disparity: Disparity, model: DepthModel | None, config: DepthConfig) -> tuple[np.ndarray, np.ndarray]:
    """Depth and its standard deviation in mm; all NaN for a camera that was never calibrated; two (H, W) float32."""
    if model is None:
        unknown = np.full(disparity.value_px.shape, np.nan, np.float32)
        return unknown, unknown.copy()
    return disparity_to_depth(disparity.value_px, model, sigma_px=disparity.sigma_px, max_depth_mm=config.max_depth_mm)


def load_camera(
    path: str | Path, *, quality: Quality = "real-time", execution: ExecutionName = "numba"
) -> CodedApertureCamera:
    """Open a camera file; raises InputError when it is missing, damaged or of a newer format."""
    calibration = Calibration.load(path)
    return CodedApertureCamera(calibration, default_config(calibration, quality), execution=execution)
