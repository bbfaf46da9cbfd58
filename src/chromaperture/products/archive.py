"""Measure many photographs: the files of one are written beside the measurement of the next.

A photograph that cannot be measured is a `Failure` among the results, and the others are measured; one whose results
are complete is a `Kept`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from chromaperture.camera.camera import CodedApertureCamera
from chromaperture.products.measure_file import Written, measure_only
from chromaperture.system.errors import ChromapertureError
from chromaperture.system.threads import beside

# Called with the camera and the linear image of a photograph before it is measured, and its name; may raise InputError.
Inspect = Callable[[CodedApertureCamera, np.ndarray, str], None]


def measure_everything(camera: CodedApertureCamera, image: np.ndarray, name: str) -> None:
    """Refuse no photograph: what `measure_files` does unless it is given an `Inspect`."""


@dataclass(frozen=True)
class Failure:
    """A photograph that was not measured; ``error`` is one line that says what to do next."""

    image: str
    error: ChromapertureError


@dataclass(frozen=True)
class Kept:
    """A photograph whose results were complete before."""

    image: str


class Origin(Protocol):
    """Knows from what results are made, and whether they are complete; see `archive_cluster.RecipeOrigin`."""

    def made_from(self, image: Path) -> dict[str, str]:
        """Return what goes into ``STEM.json``; raises InputError."""

    def is_complete(self, image: Path, made_from: dict[str, str]) -> bool:
        """Whether results that were made from this are all there."""

    def begin(self, image: Path) -> None:
        """Take the mark of completeness from results that are about to be replaced; raises InputError."""


def measure_files(
    images: Sequence[Path],
    camera_of: Callable[[Path], CodedApertureCamera],
    *,
    listener: Callable[[str, int], None] = lambda stage, i: None,
    inspect: Inspect = measure_everything,
    origin: Origin | None = None,
    **options: Any,
) -> Iterator[Written | Failure | Kept]:
    """Measure photographs one after the other; no more than two measurements are in memory.

    ``camera_of``: from a photograph to its camera; may raise InputError; ``listener``: called with the name of each
    stage as it begins, and the index of the photograph; ``inspect``: see `Inspect`; ``origin``: with it, photographs
    whose results are complete are not measured; ``**options``: of `measure_only`, the same for all. Yields Written,
    Failure or Kept: in the order of the photographs, each as soon as its files are complete.
    """
    with beside() as start:
        before: tuple[Path, Future[Written]] | None = None  # the photograph whose files are being written
        for i, image in enumerate(images):
            result = _measured(image, i, camera_of, listener, inspect, origin, options)
            if before is not None:
                yield _result(*before)
                before = None
            if isinstance(result, Failure | Kept):
                yield result
            else:
                before = (image, start(result))
                listener("write", i)
        if before is not None:
            yield _result(*before)


def _measured(
    image: Path,
    i: int,
    camera_of: Callable[[Path], CodedApertureCamera],
    listener: Callable[[str, int], None],
    inspect: Inspect,
    origin: Origin | None,
    options: dict[str, Any],
) -> Callable[[], Written] | Failure | Kept:
    """Measure one photograph; returns the function that writes its files."""
    try:
        made_from = None if origin is None else origin.made_from(image)
        if origin is not None and made_from is not None and origin.is_complete(image, made_from):
            listener("complete before", i)
            return Kept(str(image))
        camera = camera_of(image)
        measured = measure_only(
            image,
            camera,
            listener=lambda stage: listener(stage, i),
            inspect=lambda linear: inspect(camera, linear, image.name),
            **options,
        )
    except ChromapertureError as error:
        return Failure(str(image), error)

    def write() -> Written:
        if origin is not None:
            origin.begin(image)  # first: never is the mark beside files of two measurements
        return measured.write(made_from=made_from)

    return write


def _result(image: Path, writing: Future[Written]) -> Written | Failure:
    try:
        return writing.result()
    except ChromapertureError as error:
        return Failure(str(image), error)
