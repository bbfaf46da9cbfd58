"""Depth in millimetres, for every pixel, from one photograph through a colour-coded aperture.

>>> import chromaperture as cap
>>> camera = cap.load_camera("camera.asdf")                                        # doctest: +SKIP
>>> frame = camera.measure(cap.read_image("photo.png", black_level=16, white_level=1016))  # doctest: +SKIP
>>> frame.depth_mm, frame.sigma_mm, frame.color                                    # doctest: +SKIP
"""

from chromaperture.camera import CodedApertureCamera, DepthFrame, load_camera
from chromaperture.camera_file import Calibration
from chromaperture.capture.files import read_image
from chromaperture.config import AccurateConfig, Config, DepthConfig, MatcherConfig, PaperConfig, RealTimeConfig
from chromaperture.depth.conversion import DepthModel, depth_to_disparity, disparity_to_depth
from chromaperture.disparity.estimate import estimate_disparity
from chromaperture.disparity.result import Disparity
from chromaperture.errors import CaptureWarning, ChromapertureError, InputError, MissingDependencyError
from chromaperture.optics.aperture import DESIGNS, Aperture, design_named

__version__ = "0.1.0"

__all__ = [
    "DESIGNS",
    "AccurateConfig",
    "Aperture",
    "Calibration",
    "CaptureWarning",
    "ChromapertureError",
    "CodedApertureCamera",
    "Config",
    "DepthConfig",
    "DepthFrame",
    "DepthModel",
    "Disparity",
    "InputError",
    "MatcherConfig",
    "MissingDependencyError",
    "PaperConfig",
    "RealTimeConfig",
    "depth_to_disparity",
    "design_named",
    "disparity_to_depth",
    "estimate_disparity",
    "load_camera",
    "read_image",
]
