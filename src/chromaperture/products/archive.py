"""Measure many photographs: the files of one are written beside the measurement of the next.

A photograph that cannot be measured is a `Failure` among the results, and the others are measured.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from chromaperture.camera import CodedApertureCamera
from chromaperture.errors import ChromapertureError
from chromaperture.products.measure_file import MeasuredFile, Written, measure_only
from chromaperture.threads import beside

# Called with the camera and the linear image of a photograph before it is measured, and its name; may raise InputError.
Inspect = Callable[[CodedApertureCamera, np.ndarray, str], None]


def measure_everything(camera: CodedApertureCamera, image: np.ndarray, name: str) -> None:
    """Refuse no photograph: what `measure_files` does unless it is given an `Inspect`."""


@dataclass(frozen=True)
class Failure:
    """A photograph that was not measured; ``error`` is one line that says what to do next."""

    image: str
    error: ChromapertureError


def measure_files(
    images: Sequence[Path],
    camera_of: Callable[[Path], CodedApertureCamera],
    *,
    listener: Callable[[str, int], None] = lambda stage, i: None,
    inspect: Inspect = measure_everything,
    **options: Any,
) -> Iterator[Written | Failure]:
    """Measure photographs one after the other; no more than two measurements are in memory.

    Parameters
    ----------
    images : sequence of Path
    camera_of : callable
        From a photograph to its camera; may raise InputError.
    listener : callable, optional
        Called with the name of each stage as it begins, and the index of the photograph.
    inspect : callable, optional
        See `Inspect`.
    **options
        Of `measure_only`, the same for all.

    Yields
    ------
    Written or Failure
        In the order of the photographs, each as soon as its files are complete.
    """
    with beside() as start:
        before: tuple[Path, Future[Written]] | None = None  # the photograph whose files are being written
        for i, image in enumerate(images):
            result = _measured(image, i, camera_of, listener, inspect, options)
            if before is not None:
                yield _result(*before)
                before = None
            if isinstance(result, Failure):
                yield result
            else:
                before = (image, start(result.write))
                listener("write", i)
        if before is not None:
            yield _result(*before)


def _measured(
    image: Path,
    i: int,
    camera_of: Callable[[Path], CodedApertureCamera],
    listener: Callable[[str, int], None],
    inspect: Inspect,
    options: dict[str, Any],
) -> MeasuredFile | Failure:
    try:
        camera = camera_of(image)
        return measure_only(
            image,
            camera,
            listener=lambda stage: listener(stage, i),
            inspect=lambda linear: inspect(camera, linear, image.name),
            **options,
        )
    except ChromapertureError as error:
        return Failure(str(image), error)


def _result(image: Path, writing: Future[Written]) -> Written | Failure:
    try:
        return writing.result()
    except ChromapertureError as error:
        return Failure(str(image), error)
