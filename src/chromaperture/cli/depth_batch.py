"""``chromaperture depth`` for several photographs on this machine: progress, failures, what is complete already."""

from __future__ import annotations

import contextlib
import json as json_text
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from chromaperture.capture.shots import counted
from chromaperture.cli.console import announce_duration, out, print_json, print_reports, progress, say_error
from chromaperture.frame.frame_files import OUTPUTS
from chromaperture.products.archive import Failure, Kept, measure_files
from chromaperture.products.archive_cluster import Recipe, RecipeOrigin, measure_in_processes
from chromaperture.products.archive_store import absolute
from chromaperture.products.measure_file import Written
from chromaperture.system.errors import CaptureWarning, ChromapertureError

if TYPE_CHECKING:
    from chromaperture.camera.camera import CodedApertureCamera


from chromaperture.products.archive_cluster import Outcome, measure_on_cluster
from chromaperture.system.errors import InputError

MOST_COLUMNS = 6  # photographs in a table of results; more are counted. Six fit a line of 160 letters

CameraOf = Callable[[Path], "CodedApertureCamera"]


@dataclass
class Batch:
    """What became of the photographs so far."""

    reports: list[Written] = field(default_factory=list)  # of all that are complete
    kept: list[str] = field(default_factory=list)
    failed: list[tuple[str, str]] = field(default_factory=list)  # photograph and error


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
    **options: Any,
) -> None:
    """Measure photographs, report them, and end with 1 where some could not be measured, with 2 where none could.

    ``recipe`` is there for a camera that was calibrated: results that it made before are kept. ``left_out`` are files
    that are no photographs, see `one_of_each`.
    """
    batch, began = Batch(), time.monotonic()
    with contextlib.suppress(ChromapertureError):  # a photograph without a size, where the camera is made for its size
        announce_duration(camera_of(images[0]), len(images), quiet=quiet)
    with progress(quiet=quiet) as update:
        if jobs > 1 and len(images) > 1 and recipe is not None:
            states = _in_processes(images, recipe, jobs, batch)
        else:
            states = _here(images, camera_of, recipe, batch, update, options)
        for what, done in states:
            update(f"{what} ({len(batch.failed)} failed)" if batch.failed else what, done, len(images))
    seconds = time.monotonic() - began
    if json:
        reports = [report.summary | {"files": [str(path) for path in report.files]} for report in batch.reports]
        print_json(reports + [{"image": path.name, "left_out": reason} for path, reason in left_out.items()])
    elif not quiet:
        _print(batch, len(images), seconds, note)
        print_left_out(left_out)
    if batch.failed:
        if len(images) > 1:
            names = ", ".join(Path(image).name for image, _ in batch.failed)
            say_error(f"{len(batch.failed)} of {len(images)} photographs could not be measured: {names}")
        raise typer.Exit(1 if batch.reports else 2)


def print_left_out(left_out: Mapping[Path, str]) -> None:
    """Say which files of folders were not measured; nothing where all were."""
    if left_out:
        out.print(f"Left out: {counted(left_out)}", soft_wrap=True, markup=False, highlight=False)


def _here(
    images: Sequence[Path],
    camera_of: CameraOf,
    recipe: Recipe | None,
    batch: Batch,
    update: Callable[[str, int, int], None],
    options: dict[str, Any],
) -> Iterator[tuple[str, int]]:
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
            batch.reports.append(_read(result.image, recipe))
        else:
            batch.reports.append(result)
        yield "photographs", done


def _in_processes(images: Sequence[Path], recipe: Recipe, jobs: int, batch: Batch) -> Iterator[tuple[str, int]]:
    yield "photographs", 0
    reports: dict[str, Written] = {}
    names = [absolute(str(image)) for image in images]
    for done, outcome in enumerate(measure_in_processes(names, recipe, jobs=jobs), 1):
        for text in outcome.warnings:
            warnings.warn(text, CaptureWarning, stacklevel=2)
        if outcome.error:
            batch.failed.append((outcome.image, outcome.error))
            name = Path(outcome.image).name
            say_error(outcome.error if name in outcome.error else f"{name}: {outcome.error}")
        else:
            reports[outcome.image] = _read(outcome.image, recipe)
            if outcome.kept:
                batch.kept.append(outcome.image)
        yield "photographs", done
    batch.reports += [reports[name] for name in names if name in reports]
    batch.kept.sort(key=names.index)  # processes end in any order
    batch.failed.sort(key=lambda failed: names.index(failed[0]))


def _read(image: str, recipe: Recipe) -> Written:
    """Read the summary of results that are complete."""
    path = Path(image)
    folder = path.parent if recipe.out is None else Path(recipe.out)
    files = [folder / (path.stem + OUTPUTS[name].suffix) for name in recipe.outputs]
    return Written(json_text.loads((folder / (path.stem + OUTPUTS["json"].suffix)).read_bytes()), files)


def _print(batch: Batch, count: int, seconds: float, note: str) -> None:
    if count <= MOST_COLUMNS:
        if batch.reports:
            print_reports(batch.reports, note=note)
    else:
        measured = len(batch.reports) - len(batch.kept)
        counts = f"{measured} measured, {len(batch.kept)} complete before, {len(batch.failed)} failed"
        out.print(f"{count} photographs in {seconds:.0f} s: {counts}")
        folders = {file.parent for report in batch.reports for file in report.files}
        for folder in sorted(folders):
            out.print(f"Wrote to {folder}", soft_wrap=True, markup=False, highlight=False)
    if batch.kept:
        names = ", ".join(Path(image).name for image in batch.kept)
        said = names if len(batch.kept) <= MOST_COLUMNS else f"{len(batch.kept)} photographs"
        out.print(f"Complete before, not measured again: {said} (--again measures them)", soft_wrap=True, markup=False)


def measure_archive(
    images: Sequence[str], recipe: Recipe, address: str, *, left_out: Mapping[Path, str], json: bool, quiet: bool
) -> None:
    """Measure photographs on a cluster, print each failure as it happens and a summary.

    The exit code is 1 where some could not be measured, 2 where none could.

    Raises InputError: see `measure_on_cluster`; what is complete is kept.
    """
    failed: list[Outcome] = []
    measured = kept = 0
    began = time.monotonic()
    try:
        with progress(quiet=quiet) as update:
            update("waiting for the cluster", 0, len(images))
            for done, outcome in enumerate(measure_on_cluster(images, recipe, address), 1):
                for text in outcome.warnings:
                    warnings.warn(text, CaptureWarning, stacklevel=2)
                if outcome.error:
                    failed.append(outcome)
                    say_error(f"{outcome.image}: {outcome.error}")
                elif outcome.kept:
                    kept += 1
                else:
                    measured += 1
                update(f"photographs ({len(failed)} failed)" if failed else "photographs", done, len(images))
    except InputError as error:
        raise InputError(f"{error} ({_counts(measured, kept, len(failed))}, of {len(images)})") from None
    seconds = time.monotonic() - began
    if json:
        failures = [{"image": outcome.image, "error": outcome.error} for outcome in failed]
        others = [{"image": path.name, "left_out": reason} for path, reason in left_out.items()]
        counts = {"measured": measured, "kept": kept, "failed": failures, "left_out": others}
        print_json(counts | {"seconds": round(seconds, 1)})
    elif not quiet:
        out.print(f"{len(images)} photographs in {seconds:.0f} s: {_counts(measured, kept, len(failed))}")
        print_left_out(left_out)
    if failed:
        raise typer.Exit(1 if measured or kept else 2)


def _counts(measured: int, kept: int, failed: int) -> str:
    return f"{measured} measured, {kept} complete before, {failed} failed"
