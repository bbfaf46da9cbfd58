"""The whole method on one screen: one photograph in, millimetres out."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from chromaperture.camera_alignment import ChannelAlignment
from chromaperture.camera_file import Calibration
from chromaperture.camera_matching import default_config, label_maps, noise_model
from chromaperture.capture.checks import check_capture
from chromaperture.config import Config, DepthConfig, ExecutionName, Quality
from chromaperture.depth.conversion import DepthModel, disparity_to_depth
from chromaperture.disparity.estimate import method_for
from chromaperture.disparity.result import Disparity

StageTimer = Callable[[str], AbstractContextManager[None]]


@dataclass(frozen=True)
class DepthFrame:
    """What is measured from one photograph, every map in the view of the pupil's centre; (H, W) arrays.

    Attributes
    ----------
    depth_mm, sigma_mm : float32, mm
        Distance from the sensor plane along the axis and its standard deviation; NaN unknown.
    disparity_px, disparity_sigma_px : float32, px
        Signed half disparity, 0 in focus, + beyond, and its standard deviation; NaN unknown.
    confidence : float32 in [0, 1]
    color : (H, W, 3) float32
        Linear RGB with the channels aligned and white balanced.
    """

    depth_mm: np.ndarray
    sigma_mm: np.ndarray
    disparity_px: np.ndarray
    disparity_sigma_px: np.ndarray
    confidence: np.ndarray
    color: np.ndarray

    @property
    def valid(self) -> np.ndarray:
        """(H, W) bool: where the depth is known."""
        return np.isfinite(self.depth_mm)


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

    def measure(self, image: np.ndarray, *, stage: StageTimer = lambda name: nullcontext()) -> DepthFrame:
        """Measure depth in millimetres for every pixel of one photograph.

        Parameters
        ----------
        image : (H, W, 3) float, linear RGB, 1.0 = white level
            From `chromaperture.read_image`.
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
        with stage("check"):
            image = check_capture(image, sensor.width_px, sensor.height_px)
        with stage("disparity"):  # Eq. (1) and section 3.1
            disparity = self.method.match(image)
        with stage("depth"):  # Eq. (10)
            depth_mm, sigma_mm = millimetres(disparity, self.depth_model, self.config.depth)
        with stage("color"):  # section 5.1
            color = self.alignment.align(image, disparity.value_px)
        return DepthFrame(depth_mm, sigma_mm, disparity.value_px, disparity.sigma_px, disparity.confidence, color)


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
