"""The files of one frame, each with a name by which it can be chosen."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from chromaperture.color.srgb import linear_to_srgb_bytes
from chromaperture.depth.error_limit import MAX_RELATIVE_SIGMA, rows_within_error, within_error
from chromaperture.depth.pointcloud import write_depth_ply
from chromaperture.files.pictures import write_color_png, write_depth_png, write_float_tiff
from chromaperture.frame.depth_frame import DepthFrame, summarise
from chromaperture.system.errors import InputError
from chromaperture.system.memory import Rows
from chromaperture.system.storage import staged, write_json
from chromaperture.system.threads import parallel_map


@dataclass(frozen=True)
class Output:
    """One kind of file."""

    suffix: str  # how its name ends
    needs_depth: bool = False  # whether it needs depth in mm
    by_default: bool = True  # whether it is written where nobody says what to write


OUTPUTS = {
    "depth": Output(".depth.tiff", needs_depth=True),
    "sigma": Output(".sigma.tiff", needs_depth=True),
    "disparity": Output(".disparity.tiff"),
    "depth-png": Output(".depth.png", needs_depth=True),
    "color": Output(".color.png"),
    "ply": Output(".ply", needs_depth=True),
    "preview": Output(".preview.png"),
    "json": Output(".json"),
    # Formats of other programs, docs/formats.md:
    "gdepth": Output(".gdepth.jpg", needs_depth=True, by_default=False),
    "dynamic-depth": Output(".dynamic-depth.jpg", needs_depth=True, by_default=False),
    "exr": Output(".exr", needs_depth=True, by_default=False),
    "exr-layers": Output(".layers.exr", needs_depth=True, by_default=False),
    "glb": Output(".glb", needs_depth=True, by_default=False),
    "usdz": Output(".usdz", needs_depth=True, by_default=False),
}

EXR = ("exr", "exr-layers")


def chosen_outputs(write: str | Iterable[str] | None, *, is_calibrated: bool = True) -> tuple[str, ...]:
    """Check names of outputs; returns them, or all defaults of such a camera, in the order of `OUTPUTS`."""
    possible = [name for name, output in OUTPUTS.items() if is_calibrated or not output.needs_depth]
    if write is None:
        return tuple(name for name in possible if OUTPUTS[name].by_default)
    names = [name.strip() for name in (write.split(",") if isinstance(write, str) else write)]
    unknown = [name for name in names if name not in OUTPUTS]
    if unknown or not names:
        raise InputError(f"cannot write {', '.join(unknown) or 'nothing'}: choose from {', '.join(OUTPUTS)}")
    impossible = [name for name in names if name not in possible]
    if impossible:
        raise InputError(
            f"{', '.join(impossible)} cannot be written without a calibrated camera; choose from {', '.join(possible)}"
        )
    if set(EXR) & set(names):
        from chromaperture.files.depth_exr import openexr

        openexr()  # before the work: the extra may be missing
    if "usdz" in names:
        from chromaperture.files.textured_mesh import usd

        usd()
    return tuple(name for name in OUTPUTS if name in names)


def write_maps(
    target: Callable[[str], Path],
    stem: str,
    frame: DepthFrame,
    outputs: Iterable[str],
    *,
    max_relative_sigma: float = MAX_RELATIVE_SIGMA,
    title: str = "",
    caption: str = "",
    depth_range_mm: tuple[float, float] | None = None,
) -> None:
    """Write the chosen files of a frame but its JSON, several at a time.

    ``target``: from a file's final name to the path to write to; ``stem``: what the names begin with; ``outputs``: from
    `chosen_outputs`; ``max_relative_sigma``: largest sigma / depth of what carries no error bar; the TIFF and EXR files
    are whole; ``title``, ``caption``: of the preview; ``depth_range_mm`` (float, float): ends of the preview's colour
    bar.
    """
    wanted = set(outputs)
    nothing = np.empty(0, np.uint8)
    # What two files have in common.
    srgb = small = nothing
    if wanted & {"color", "ply", "preview"}:
        from chromaperture.frame.preview import color_pictures  # its libraries are not always needed

        srgb, small = color_pictures(frame)
    certain_mm: Rows = nothing
    if wanted & {"depth-png", "ply"}:
        certain_mm = rows_within_error(frame.depth_mm, frame.sigma_mm, max_relative_sigma)

    def write(job: tuple[str, Path]) -> None:
        name, path = job
        match name:
            case "depth":
                write_float_tiff(path, frame.depth_mm)
            case "sigma":
                write_float_tiff(path, frame.sigma_mm)
            case "disparity":
                write_float_tiff(path, frame.disparity_px)
            case "depth-png":
                write_depth_png(path, certain_mm)
            case "color":
                write_color_png(path, srgb)
            case "ply":
                write_depth_ply(path, certain_mm, srgb, **frame.rays())
            case "preview":
                from chromaperture.frame.preview import write_preview

                texts = {"title": title or stem, "caption": caption}
                write_preview(path, frame.image, frame, color=small, depth_range_mm=depth_range_mm, **texts)
            case _:
                write_format(name, path, frame, max_relative_sigma=max_relative_sigma)

    jobs = [(name, target(stem + OUTPUTS[name].suffix)) for name in OUTPUTS if name in wanted and name != "json"]
    parallel_map(write, jobs)


def save(
    frame: DepthFrame, target: Path, *, write: str | Iterable[str] | None, max_relative_sigma: float
) -> list[Path]:
    """Write the files of a frame, see `DepthFrame.save`."""
    folder, stem = (target, "frame") if target.is_dir() else (target.parent, target.name)
    outputs = chosen_outputs(write, is_calibrated=frame.is_calibrated)
    with staged(folder) as stage:
        write_maps(stage.path, stem, frame, outputs, max_relative_sigma=max_relative_sigma)
        if "json" in outputs:
            summary = summarise(frame, {}) | {"max_relative_sigma": max_relative_sigma}
            write_json(stage.path(stem + OUTPUTS["json"].suffix), summary)
        names = list(stage.names)
    return [folder / name for name in names]


def write_format(name: str, path: Path, frame: DepthFrame, *, max_relative_sigma: float) -> None:
    """Write one of the formats of other programs; all but OpenEXR only within ``max_relative_sigma``."""
    if frame.calibration is None or frame.config is None or not frame.calibration.is_calibrated:
        raise InputError(f"{name} needs a frame of a calibrated camera; make one with 'chromaperture calibrate'")
    lens = frame.calibration.lens
    matrix, to_pupil_mm = lens.camera_matrix, frame.calibration.depth[frame.config.quality].sensor_to_pupil_mm
    if name in EXR:
        from chromaperture.files.depth_exr import write_exr

        write_exr(
            path, color=frame.color, depth_mm=frame.depth_mm, sigma_mm=frame.sigma_mm, confidence=frame.confidence,
            camera_matrix=matrix, sensor_to_pupil_mm=to_pupil_mm, layers=name == "exr-layers",
        )  # fmt: skip
        return
    z_mm = within_error(frame.depth_mm, frame.sigma_mm, max_relative_sigma) - np.float32(to_pupil_mm)
    color = linear_to_srgb_bytes(frame.color)
    if name in ("gdepth", "dynamic-depth"):
        from chromaperture.files.depth_photo import dynamic_depth_jpeg, encode_depth, gdepth_jpeg

        encoded = encode_depth(z_mm, frame.confidence)
        is_gdepth = name == "gdepth"
        path.write_bytes(
            gdepth_jpeg(color, encoded) if is_gdepth else dynamic_depth_jpeg(color, encoded, camera_matrix=matrix)
        )
        return
    from chromaperture.files.textured_mesh import textured_mesh

    mesh = textured_mesh(z_mm, color, camera_matrix=matrix, distortion=lens.distortion)
    if name == "glb":
        from chromaperture.files.textured_mesh import glb_bytes

        path.write_bytes(glb_bytes(mesh))
    else:
        from chromaperture.files.textured_mesh import write_usdz

        write_usdz(path, mesh)
