"""``chromaperture depth``: photographs one after the other, several at a time, or on a cluster."""

from __future__ import annotations

import contextlib
import json as json_text
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from chromaperture.cli.console import (
    FINISHED,
    announce_duration,
    compile_kernels,
    duration,
    other_quality,
    print_json,
    print_reports,
    progress,
    say_error,
)
from chromaperture.cli.console import out as console
from chromaperture.cli.options import (
    Anyway,
    BlackLevel,
    CameraOrDesign,
    ChromaSiting,
    CropOrigin,
    Design,
    Device,
    Json,
    Left,
    MaxRelativeSigma,
    Mosaic,
    PhotographQuality,
    Primaries,
    Quiet,
    Right,
    Scale,
    Verbose,
    WhiteLevel,
    check_film,
    left_of_pair,
    working_scale,
)
from chromaperture.cli.options import crop_origin as crop_from
from chromaperture.depth.error_limit import MAX_RELATIVE_SIGMA
from chromaperture.system.errors import CaptureWarning, ChromapertureError, InputError

if TYPE_CHECKING:
    from chromaperture.camera.camera import CodedApertureCamera
    from chromaperture.color.encoding import Halves
    from chromaperture.products.archive import Outcome, Recipe
    from chromaperture.products.measure_file import Written

_LONG_S = 30.0  # from which one photograph's wait is told; chosen by hand
MOST_COLUMNS = 6  # photographs in a table of results; more are counted. Six fit a line of 160 letters

CameraOf = Callable[[Path], "CodedApertureCamera"]


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
    quality: PhotographQuality = None,
    scale: Scale = "auto",
    crop_origin: CropOrigin = None,
    device: Device = "auto",
    black_level: BlackLevel = None,
    white_level: WhiteLevel = None,
    mosaic: Mosaic = None,
    siting: ChromaSiting = None,
    primaries: Primaries = None,
    left: Left = None,
    right: Right = None,
    max_relative_sigma: MaxRelativeSigma = MAX_RELATIVE_SIGMA,
    write: Annotated[
        str | None,
        typer.Option(
            help="Files to write: depth, sigma, disparity, depth-png, color, ply, preview, json, which is the default; "
            "gdepth, dynamic-depth, exr, exr-layers, glb, usdz for other programs (docs/formats.md).",
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
    verbose: Verbose = False,
) -> None:
    """Measure depth in millimetres for every pixel of one or more photographs.

    chromaperture depth photo.png --camera camera.asdf --out results

    chromaperture depth photo.jpg --design rgb_squares        (no calibration: disparity in px)

    chromaperture depth holiday/ --camera camera.asdf --out results --jobs 2      (goes on where it was stopped)

    chromaperture depth --left a.png --right b.png --camera dual_pixel.asdf       (pairs called NAME_left and NAME_right
    are found by name)

    chromaperture depth archive/ --camera camera.asdf --cluster tcp://10.0.0.1:8786 --out s3://bucket/depth
    """
    from chromaperture.capture.dual_pixel import half_of, pairs
    from chromaperture.capture.files import format_of
    from chromaperture.capture.shots import VIDEOS
    from chromaperture.color.encoding import StatedFacts
    from chromaperture.products.archive_store import as_path, find_photographs, is_url, names_in_list

    listed = [] if files_from is None else names_in_list(files_from)
    if cluster is None and any(is_url(name) for name in (*(images or ()), *listed, out or "")):
        raise InputError("URLs are read and written by the workers of a cluster: give its scheduler with --cluster")
    left_out: dict[Path, str] = {}
    if left or right:
        images = [*(images or ()), str(left_of_pair(left, right, (*(images or ()), *listed)))]
    names = find_photographs(images or (), kind=partial(kind_of_files, camera), left_out=left_out) + listed
    are_halves = any(half_of(Path(name)) for name in names)
    halves = halves_of(camera) if are_halves and camera is not None else None
    if halves is not None and right is None:
        names = pairs(names, left_out)
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
    from chromaperture.frame.frame_files import chosen_outputs
    from chromaperture.products.archive import recipe_for

    refuse_common_results(names, out, halves)
    if out is not None and not is_url(out) and Path(out).exists() and not Path(out).is_dir():
        raise InputError(f"cannot write to {out}, which is a file; choose another folder with --out")
    chosen_outputs(write, is_calibrated=camera is not None)  # before the work
    if device not in ("auto", "cpu") and (cluster is not None or jobs > 1):
        raise InputError("--cluster and --jobs measure on CPUs: leave --device out, or measure one at a time")
    settings: dict[str, Any] = {
        "quality": quality, "config": config, "scale": working_scale(scale), "crop_origin_px": crop_from(crop_origin),
        "device": device, "stated": stated,
    }  # fmt: skip
    options: dict[str, Any] = {
        "write": write, "black_level": black_level, "white_level": white_level, "right": right,
        "max_relative_sigma": max_relative_sigma, "inspect": partial(check_film, refuse=not anyway),
    }  # fmt: skip
    if cluster is not None:
        from chromaperture.cli.setup import camera_for

        if camera is None or design is not None:
            raise InputError("--cluster measures depth: give the camera file with --camera, and no --design")
        opened = camera_for(Path(names[0]), camera, None, **settings | {"device": "cpu"})
        recipe = recipe_for(camera, opened, out=out, again=again, **options)
        measure_archive(names, recipe, cluster, left_out=left_out, json=json, quiet=quiet)
        return
    paths = [as_path(name) for name in names]
    camera_of = cameras(paths[0], camera, design, **settings)
    made_by: Recipe | None = None
    if camera is not None:
        where = None if out is None else str(as_path(out))
        made_by = recipe_for(camera, camera_of(paths[0]), out=where, again=again, **options)
        if len(paths) == 1:  # measured in any case, and no more is written than what was asked for
            made_by = replace(made_by, again=True, outputs=chosen_outputs(write))
    if jobs > 1 and len(paths) > 1 and camera is not None:
        jobs = jobs_in_memory(camera_of(paths[0]), jobs)
    own = "real-time" if camera is None else camera_of(paths[0]).config.quality
    compile_kernels(quality or own, quiet=quiet)
    note = "No calibration: disparity in px only. Depth in mm needs a camera file (--camera)."
    if camera is not None:
        note = other_quality(camera_of(paths[0]))
    measure_batch(
        paths, camera_of, recipe=made_by, jobs=jobs, json=json, quiet=quiet, note=note,
        left_out=left_out, verbose=verbose, out=None if out is None else as_path(out), **options,
    )  # fmt: skip


def halves_of(camera: Path) -> Halves | None:
    """Return how the photographs of a dual-pixel camera are paired; None of one with film."""
    from chromaperture.model.camera_file import Calibration

    return Calibration.load(camera).sensor.dual_pixel


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


def refuse_common_results(names: Sequence[str], out: str | None, halves: Halves | None = None) -> None:
    """Refuse photographs whose results would have the same names; raises InputError."""
    from chromaperture.capture.dual_pixel import shot_stem
    from chromaperture.frame.frame_files import OUTPUTS
    from chromaperture.products.archive_store import absolute, as_path, folder_of, joined

    first: dict[str, str] = {}  # photograph by the path that its results begin with
    for name in names:
        begin = absolute(joined(folder_of(name) if out is None else out, shot_stem(as_path(name), halves)))
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


def cameras(first: Path, camera: Path | None, design: str | None, **settings: Any) -> CameraOf:
    """Return the function from an image to its camera: the file's, or one for each size for a design."""
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


@dataclass
class Batch:
    """What became of the photographs so far."""

    reports: list[Written] = field(default_factory=list)  # of the first that are complete, for a table
    folders: set[Path] = field(default_factory=set)  # of all results
    kept: list[str] = field(default_factory=list)
    failed: list[tuple[str, str]] = field(default_factory=list)  # photograph and error
    measured: int = 0

    waiting: str = ""  # for what, where one takes long

    @property
    def stage(self) -> str:
        """What the progress says is being done."""
        notes = [f"{len(self.failed)} failed"] if self.failed else []
        notes += [self.waiting] if self.waiting else []
        return f"{FINISHED} ({'; '.join(notes)})" if notes else FINISHED

    def keep(self, report: Written) -> None:
        """Keep what is printed of a photograph: thousands of reports would fill the memory."""
        self.folders |= {file.parent for file in report.files}
        if len(self.reports) < MOST_COLUMNS:
            self.reports.append(report)

    def wait(self, image: str, where: str, seconds: float) -> None:
        """Note what has been waited for."""
        since = f"waiting for {Path(image).name} on {where} since {duration(seconds)}"
        self.waiting = since if seconds > _LONG_S else ""

    @property
    def counts(self) -> str:
        """How many were measured, kept, and failed."""
        return f"{self.measured} measured, {len(self.kept)} complete before, {len(self.failed)} failed"

    def take(self, outcome: Outcome) -> None:
        """Count what another process reports, and pass its warnings on."""
        self.waiting = ""
        for text in outcome.warnings:
            warnings.warn(text, CaptureWarning, stacklevel=2)
        if outcome.error:
            self.failed.append((outcome.image, outcome.error))
        elif outcome.kept:
            self.kept.append(outcome.image)
        else:
            self.measured += 1

    def summary(self, left_out: Mapping[Path, str], seconds: float) -> dict[str, Any]:
        """Return the figures of many photographs; those of each are in its NAME.json."""
        return {
            "measured": self.measured,
            "kept": len(self.kept),
            "failed": [{"image": image, "error": error} for image, error in self.failed],
            "left_out": [{"image": path.name, "left_out": reason} for path, reason in left_out.items()],
            "seconds": round(seconds, 1),
        }

    def exit_if_failed(self) -> None:
        """End with 1 where some could not be measured, with 2 where none could."""
        if self.failed:
            raise typer.Exit(1 if self.measured or self.kept else 2)


def measure_batch(
    images: Sequence[Path],
    camera_of: CameraOf,
    *,
    recipe: Recipe | None,
    jobs: int,
    json: bool,
    quiet: bool,
    note: str,
    left_out: Mapping[Path, str],
    verbose: bool,
    **options: Any,
) -> None:
    """Measure photographs here, keeping what ``recipe`` made before, and end with the batch's exit code."""
    batch, began = Batch(), time.monotonic()
    with contextlib.suppress(ChromapertureError):  # a photograph without a size, where the camera is made for its size
        announce_duration(camera_of(images[0]), len(images), quiet=quiet)
    with progress(quiet=quiet) as update:
        if jobs > 1 and len(images) > 1 and recipe is not None:
            states = _in_processes(images, recipe, jobs, batch, update)
        else:
            states = _here(images, camera_of, recipe, batch, update, options)
        for done in states:
            update(batch.stage, done, len(images))
    seconds = time.monotonic() - began
    if json and len(images) > MOST_COLUMNS:
        print_json(batch.summary(left_out, seconds))
    elif json:
        reports = [report.summary | {"files": [str(path) for path in report.files]} for report in batch.reports]
        failures = [{"image": Path(image).name, "error": error} for image, error in batch.failed]
        print_json(reports + failures + [{"image": path.name, "left_out": why} for path, why in left_out.items()])
    elif not quiet:
        _print(batch, len(images), seconds, note, verbose=verbose)
        print_left_out(left_out)
    if batch.failed and len(images) > 1:
        names = ", ".join(Path(image).name for image, _ in batch.failed)
        say_error(f"{len(batch.failed)} of {len(images)} photographs could not be measured: {names}")
    batch.exit_if_failed()


def print_left_out(left_out: Mapping[Path, str]) -> None:
    """Say which files of folders were not measured; nothing where all were."""
    from chromaperture.capture.shots import counted

    if left_out:
        console.print(f"Left out: {counted(left_out)}", soft_wrap=True, markup=False, highlight=False)


def _here(
    images: Sequence[Path],
    camera_of: CameraOf,
    recipe: Recipe | None,
    batch: Batch,
    update: Callable[[str, int, int], None],
    options: dict[str, Any],
) -> Iterator[int]:
    """Measure one photograph after the other; yields how many are done."""
    from chromaperture.products.archive import Failure, Kept, RecipeOrigin, measure_files

    def show(stage: str, i: int) -> None:
        update(f"{images[i].name}: {stage}", i, len(images))

    if recipe is not None:
        options = options | {"origin": RecipeOrigin(recipe), "write": recipe.outputs}
    for done, result in enumerate(measure_files(images, camera_of, listener=show, **options), 1):
        if isinstance(result, Failure):
            batch.failed.append((result.image, str(result.error)))
            say_error(result.error)
        elif isinstance(result, Kept):
            batch.kept.append(result.image)
            assert recipe is not None
            batch.keep(_read(result.image, recipe))
        else:
            batch.keep(result)
            batch.measured += 1
        yield done


def _in_processes(
    images: Sequence[Path], recipe: Recipe, jobs: int, batch: Batch, update: Callable[[str, int, int], None]
) -> Iterator[int]:
    """Measure several photographs at a time; yields how many are done."""
    from chromaperture.products.archive import measure_in_processes
    from chromaperture.products.archive_store import absolute

    done = 0

    def wait(image: str, where: str, seconds: float) -> None:
        batch.wait(image, where, seconds)
        update(batch.stage, done, len(images))

    yield 0
    names = [absolute(str(image)) for image in images]
    complete: set[str] = set()
    for outcome in measure_in_processes(names, recipe, jobs=jobs, waiting_for=wait):
        batch.take(outcome)
        if outcome.error:
            name = Path(outcome.image).name
            say_error(outcome.error if name in outcome.error else f"{name}: {outcome.error}")
        else:
            complete.add(outcome.image)
        done += 1
        yield done
    for name in filter(complete.__contains__, names):  # processes end in any order
        batch.keep(_read(name, recipe))
    batch.kept.sort(key=names.index)
    batch.failed.sort(key=lambda failed: names.index(failed[0]))


def _read(image: str, recipe: Recipe) -> Written:
    """Read the summary of results that are complete."""
    from chromaperture.frame.frame_files import OUTPUTS
    from chromaperture.products.measure_file import Written

    path = Path(image)
    folder = path.parent if recipe.out is None else Path(recipe.out)
    stem = recipe.stem(path)
    files = [folder / (stem + OUTPUTS[name].suffix) for name in recipe.outputs]
    return Written(json_text.loads((folder / (stem + OUTPUTS["json"].suffix)).read_bytes()), files)


def _print(batch: Batch, count: int, seconds: float, note: str, *, verbose: bool) -> None:
    if count <= MOST_COLUMNS:
        if batch.reports:
            print_reports(batch.reports, note=note, verbose=verbose)
    else:
        console.print(f"{count} photographs in {seconds:.0f} s: {batch.counts}")
        if batch.reports:
            console.print(f"Quality {batch.reports[0].summary['config']['quality']}. {note}".rstrip(), soft_wrap=True)
        for folder in sorted(batch.folders):
            console.print(f"Wrote to {folder}", soft_wrap=True, markup=False, highlight=False)
    if batch.kept:
        names = ", ".join(Path(image).name for image in batch.kept)
        said = names if len(batch.kept) <= MOST_COLUMNS else f"{len(batch.kept)} photographs"
        console.print(
            f"Complete before, not measured again: {said} (--again measures them)", soft_wrap=True, markup=False
        )


def measure_archive(
    images: Sequence[str], recipe: Recipe, address: str, *, left_out: Mapping[Path, str], json: bool, quiet: bool
) -> None:
    """Measure photographs on a cluster, print each failure as it happens and a summary; ends as `measure_batch`."""
    from chromaperture.products.archive import measure_on_cluster

    batch, began = Batch(), time.monotonic()
    try:
        with progress(quiet=quiet) as update:
            update("waiting for the cluster", 0, len(images))
            done = 0

            def wait(image: str, where: str, seconds: float) -> None:
                batch.wait(image, where, seconds)
                update(batch.stage, done, len(images))

            for outcome in measure_on_cluster(images, recipe, address, waiting_for=wait):
                batch.take(outcome)
                if outcome.error:
                    say_error(f"{outcome.image}: {outcome.error}")
                done += 1
                update(batch.stage, done, len(images))
    except InputError as error:
        raise InputError(f"{error} ({batch.counts}, of {len(images)})") from None
    seconds = time.monotonic() - began
    if json:
        print_json(batch.summary(left_out, seconds))
    elif not quiet:
        console.print(f"{len(images)} photographs in {seconds:.0f} s: {batch.counts}")
        print_left_out(left_out)
    batch.exit_if_failed()
