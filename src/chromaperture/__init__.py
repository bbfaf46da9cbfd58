"""Depth in millimetres, for every pixel, from one photograph through a colour-coded aperture.

Begin with `load_camera` and its ``measure``::

    import chromaperture as cap

    camera = cap.load_camera("camera.asdf")        # that `calibrate` made; or cap.sample_camera("still_life_cy_halves")
    frame = camera.measure("photo.png")            # seconds; measure(..., quality="real-time") a fraction of one
    frame.depth_mm, frame.sigma_mm, frame.color    # (H, W) mm from the sensor, its error bar; (H, W, 3) linear RGB
    frame.save("results/photo")                    # depth map, preview, points: what `chromaperture depth` writes

docs/python.md is a tour. A name is imported when it is first used, so a program loads only what it needs.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from chromaperture.camera.camera import CodedApertureCamera, load_camera
    from chromaperture.capture.files import read_image
    from chromaperture.capture.open import connected_sources, open_source
    from chromaperture.depth.conversion import DepthModel, depth_to_disparity, disparity_to_depth
    from chromaperture.depth.error_limit import within_error
    from chromaperture.depth.pointcloud import PointCloud, write_ply
    from chromaperture.effects.restore import SharpPicture
    from chromaperture.files.pictures import write_color_png, write_depth_png, write_float_tiff
    from chromaperture.frame.depth_frame import DepthFrame
    from chromaperture.matching.estimate import estimate_disparity
    from chromaperture.matching.result import Disparity
    from chromaperture.model.camera_file import Calibration
    from chromaperture.optics.aperture import DESIGNS, Aperture, design_named
    from chromaperture.optics.kernel_blur import blur_from_kernels
    from chromaperture.products.mcap import write_mcap
    from chromaperture.products.measure_file import measure_file
    from chromaperture.products.posed_sequence import write_tum
    from chromaperture.products.rectified import undistorter
    from chromaperture.products.samples import open_sample, sample_camera, sample_image, samples
    from chromaperture.settings.methods import (
        AccurateConfig,
        Config,
        DepthConfig,
        MatcherConfig,
        PaperConfig,
        RealTimeConfig,
    )
    from chromaperture.system.errors import CaptureWarning, ChromapertureError, InputError, MissingDependencyError
    from chromaperture.tasks import all_in_focus, calibrate, refocus

__version__ = "0.2.0"

# The module of every public name; the same as above, where type checkers read it (tests/camera/test_python.py).
_MODULES = {
    "camera.camera": "CodedApertureCamera load_camera",
    "model.camera_file": "Calibration",
    "capture.files": "read_image",
    "capture.open": "connected_sources open_source",
    "settings.methods": "AccurateConfig Config DepthConfig MatcherConfig PaperConfig RealTimeConfig",
    "depth.conversion": "DepthModel depth_to_disparity disparity_to_depth",
    "depth.error_limit": "within_error",
    "depth.pointcloud": "PointCloud write_ply",
    "matching.estimate": "estimate_disparity",
    "matching.result": "Disparity",
    "effects.restore": "SharpPicture",
    "system.errors": "CaptureWarning ChromapertureError InputError MissingDependencyError",
    "frame.depth_frame": "DepthFrame",
    "optics.aperture": "DESIGNS Aperture design_named",
    "optics.kernel_blur": "blur_from_kernels",
    "products.mcap": "write_mcap",
    "products.measure_file": "measure_file",
    "products.posed_sequence": "write_tum",
    "products.rectified": "undistorter",
    "products.samples": "open_sample sample_camera sample_image samples",
    "files.pictures": "write_color_png write_depth_png write_float_tiff",
    "tasks": "all_in_focus calibrate refocus",
}
_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names.split()}

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
    "PointCloud",
    "RealTimeConfig",
    "SharpPicture",
    "all_in_focus",
    "blur_from_kernels",
    "calibrate",
    "connected_sources",
    "depth_to_disparity",
    "design_named",
    "disparity_to_depth",
    "estimate_disparity",
    "load_camera",
    "measure_file",
    "open_sample",
    "open_source",
    "read_image",
    "refocus",
    "sample_camera",
    "sample_image",
    "samples",
    "undistorter",
    "within_error",
    "write_color_png",
    "write_depth_png",
    "write_float_tiff",
    "write_mcap",
    "write_ply",
    "write_tum",
]

if not TYPE_CHECKING:  # type checkers would take any name for a public one

    def __getattr__(name: str) -> Any:
        if name not in _MODULE_OF:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        from importlib import import_module

        found = getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
        globals()[name] = found  # the next use finds it at once
        return found


def __dir__() -> list[str]:
    """List the public names: completion shows the product and not the modules it is made of."""
    return [*__all__, "__version__"]
