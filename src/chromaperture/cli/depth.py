"""``chromaperture depth``."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from chromaperture.cli.options import (
    Anyway,
    BlackLevel,
    CameraOrDesign,
    ChromaSiting,
    CropOrigin,
    Design,
    Device,
    Json,
    MaxRelativeSigma,
    Mosaic,
    Primaries,
    Quality,
    Quiet,
    Scale,
    WhiteLevel,
    check_film,
    working_scale,
)
from chromaperture.cli.options import crop_origin as crop_from
from chromaperture.depth.error_limit import MAX_RELATIVE_SIGMA
from chromaperture.system.errors import CaptureWarning, InputError

if TYPE_CHECKING:
    from chromaperture.camera.camera import CodedApertureCamera
    from chromaperture.products.archive_cluster import Recipe


def depth(
    images: Annotated[
        list[str] | None,
        typer.Argument(
            help="Photographs through the colour-coded aperture; folders or quoted patterns of them.",
            metavar="IMAGE...",
        ),
    ] = None,
    camera: CameraOrDesign = None,
    design: Design = None,
    out: Annotated[
        str | None, typer.Option("--out", "-o", help="Folder for the results; default beside the image.")
    ] = None,
    quality: Quality = "real-time",
    scale: Scale = "auto",
    crop_origin: CropOrigin = None,
    device: Device = "auto",
    black_level: BlackLevel = None,
    white_level: WhiteLevel = None,
    mosaic: Mosaic = None,
    siting: ChromaSiting = None,
    primaries: Primaries = None,
    max_relative_sigma: MaxRelativeSigma = MAX_RELATIVE_SIGMA,
    write: Annotated[
        str | None,
        typer.Option(
            help="Files to write: depth, sigma, disparity, depth-png, color, ply, preview, json, which is the default; "
            "gdepth, dynamic-depth, exr, glb, usdz for other programs (docs/formats.md).",
            metavar="NAME,...",
        ),
    ] = None,
    config: Annotated[
        Path | None,
        # Escaped: rich would take the names of the tables for markup.
        typer.Option(help="TOML file of settings, tables \\[matcher] and \\[depth]; docs/settings.md lists them."),
    ] = None,
    anyway: Anyway = False,
    files_from: Annotated[
        Path | None, typer.Option(help="Text file with one photograph a line, besides IMAGE; - is standard input.")
    ] = None,
    cluster: Annotated[
        str | None,
        typer.Option(help="Dask scheduler whose workers measure, such as tcp://10.0.0.1:8786; docs/archives.md."),
    ] = None,
    again: Annotated[bool, typer.Option("--again", help="Of several: measure those whose results exist, too.")] = False,
    jobs: Annotated[
        int, typer.Option("--jobs", "-j", min=1, help="Photographs at a time, as many as there is memory for.")
    ] = 1,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Measure depth in millimetres for every pixel of one or more photographs.

    chromaperture depth photo.png --camera camera.asdf --out results

    chromaperture depth photo.jpg --design rgb_squares        (no calibration: disparity in px)

    chromaperture depth holiday/ --camera camera.asdf --out results --jobs 2      (goes on where it was stopped)

    chromaperture depth archive/ --camera camera.asdf --cluster tcp://10.0.0.1:8786 --out s3://bucket/depth
    """
    from chromaperture.capture.files import format_of
    from chromaperture.capture.shots import VIDEOS
    from chromaperture.color.encoding import StatedFacts
    from chromaperture.products.archive_store import as_path, find_photographs, is_url, names_in_list

    listed = [] if files_from is None else names_in_list(files_from)
    if cluster is None and any(is_url(name) for name in (*(images or ()), *listed, out or "")):
        raise InputError("URLs are read and written by the workers of a cluster: give its scheduler with --cluster")
    left_out: dict[Path, str] = {}
    names = find_photographs(images or (), kind=partial(kind_of_files, camera), left_out=left_out) + listed
    if not names:
        raise InputError("give photographs, folders of them, or a list of them with --files-from")
    clip = next((name for name in names if Path(name).suffix.lower() in VIDEOS), None)
    if clip is not None:
        raise InputError(
            f"{clip} is a video; measure its frames with: chromaperture export {clip} OUT --camera {camera or 'CAM'}"
        )
    stated = StatedFacts(*cast(Any, (siting, primaries, mosaic)))
    if len(names) == 1 and cluster is None:  # what cannot be read is refused before anything else is loaded
        format_of(as_path(names[0]), stated)
    from chromaperture.cli.console import compile_kernels
    from chromaperture.frame.frame_files import chosen_outputs

    refuse_common_results(names, out)
    chosen_outputs(write, is_calibrated=camera is not None)  # before the work
    if device not in ("auto", "cpu") and (cluster is not None or jobs > 1):
        raise InputError("--cluster and --jobs measure on CPUs: leave --device out, or measure one at a time")
    settings: dict[str, Any] = {
        "quality": quality, "config": config, "scale": working_scale(scale), "crop_origin_px": crop_from(crop_origin),
        "device": device, "stated": stated,
    }  # fmt: skip
    options: dict[str, Any] = {
        "write": write, "black_level": black_level, "white_level": white_level,
        "max_relative_sigma": max_relative_sigma, "inspect": partial(check_film, refuse=not anyway),
    }  # fmt: skip
    if cluster is not None:
        from chromaperture.cli.depth_batch import measure_archive
        from chromaperture.cli.setup import camera_for
        from chromaperture.products.archive_cluster import recipe_for

        if camera is None or design is not None:
            raise InputError("--cluster measures depth: give the camera file with --camera, and no --design")
        opened = camera_for(Path(names[0]), camera, None, **settings | {"device": "cpu"})
        recipe = recipe_for(camera, opened, out=out, again=again, **options)
        measure_archive(names, recipe, cluster, left_out=left_out, json=json, quiet=quiet)
        return
    from chromaperture.cli.depth_batch import measure_batch

    paths = [as_path(name) for name in names]
    camera_of = cameras(paths[0], camera, design, **settings)
    made_by: Recipe | None = None
    if camera is not None:
        from chromaperture.products.archive_cluster import recipe_for

        where = None if out is None else str(as_path(out))
        made_by = recipe_for(camera, camera_of(paths[0]), out=where, again=again, **options)
        if len(paths) == 1:  # measured in any case, and no more is written than what was asked for
            made_by = replace(made_by, again=True, outputs=chosen_outputs(write))
    if jobs > 1 and len(paths) > 1 and camera is not None:
        jobs = jobs_in_memory(camera_of(paths[0]), jobs)
    compile_kernels(quality, quiet=quiet)
    note = "No calibration: disparity in px only. Depth in mm needs a camera file (--camera)."
    measure_batch(
        paths, camera_of, recipe=made_by, jobs=jobs, json=json, quiet=quiet, note=note if camera is None else "",
        left_out=left_out, out=None if out is None else as_path(out), **options,
    )  # fmt: skip


def kind_of_files(camera: Path | None) -> str:
    """Return the suffix of the photographs that a camera was calibrated on; empty where it does not tell."""
    from chromaperture.capture.shots import is_photograph
    from chromaperture.model.camera_file import Calibration

    files = {} if camera is None else Calibration.load(camera).provenance.get("files", {})
    return next((path.suffix.lower() for path in map(Path, files) if is_photograph(path)), "")


def jobs_in_memory(camera: CodedApertureCamera, jobs: int) -> int:
    """Return how many photographs at a time have memory; warns where these are fewer than asked for."""
    from chromaperture.camera.memory import fitting_jobs, needed_bytes

    fitting = fitting_jobs(camera.calibration, camera.config, jobs)
    if fitting < jobs:
        each = needed_bytes(camera.calibration, camera.config) / 1e9
        warnings.warn(
            f"--jobs {jobs}: there is memory for {fitting} at a time, {each:.1f} GB each, so {fitting} at a time are "
            "measured; close other programs, or match at a coarser --scale",
            CaptureWarning,
            stacklevel=2,
        )
    return fitting


def refuse_common_results(names: Sequence[str], out: str | None) -> None:
    """Refuse photographs whose results would have the same names; raises InputError."""
    from chromaperture.frame.frame_files import OUTPUTS
    from chromaperture.products.archive_store import absolute, folder_of, joined, stem_of

    first: dict[str, str] = {}  # photograph by the path that its results begin with
    for name in names:
        begin = absolute(joined(folder_of(name) if out is None else out, stem_of(name)))
        if begin in first:
            raise InputError(
                f"{first[begin]} and {name} would write the same files; measure only one of them, or into different "
                "--out folders"
            )
        first[begin] = name
    given = {absolute(name): name for name in names}
    for begin, name in first.items():
        replaced = next((given[begin + o.suffix] for o in OUTPUTS.values() if begin + o.suffix in given), None)
        if replaced is not None:
            raise InputError(f"a result of {name} would replace the photograph {replaced}; choose another --out folder")


def cameras(
    first: Path, camera: Path | None, design: str | None, **settings: Any
) -> Callable[[Path], CodedApertureCamera]:
    """Return the function from an image to its camera: the file's, read once, or one for each size for a design.

    ``settings`` are those of `camera_for`.
    """
    from chromaperture.capture.files import image_size
    from chromaperture.cli.setup import camera_for
    from chromaperture.color.encoding import NOTHING_STATED

    if design is None or camera is not None:
        same = camera_for(first, camera, design, **settings)
        return lambda image: same
    of_sizes: dict[tuple[int, int], CodedApertureCamera] = {}

    def of_size(image: Path) -> CodedApertureCamera:
        size = image_size(image, settings.get("stated", NOTHING_STATED))
        if size not in of_sizes:
            of_sizes[size] = camera_for(image, None, design, **settings)
        return of_sizes[size]

    return of_size
