"""``chromaperture depth --cluster``: progress, failures and the summary of a run on many machines."""

from __future__ import annotations

import time
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path

import typer

from chromaperture.cli.console import out, print_json, progress, say_error
from chromaperture.cli.depth_batch import print_left_out
from chromaperture.products.archive_cluster import Outcome, Recipe, measure_on_cluster
from chromaperture.system.errors import CaptureWarning, InputError


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
