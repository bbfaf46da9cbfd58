"""Options of a calibration, its progress, and the cache from which an interrupted one resumes."""

from __future__ import annotations

import contextlib
import hashlib
import io
import os
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TypeVar

import numpy as np

from chromaperture.system.errors import InputError


@dataclass(frozen=True)
class CalibrationConfig:
    """Options of `calibrate_session`; the camera file records them. Defaults were chosen by hand.

    Raises InputError where a count is too small or the margins shrink the range.
    """

    lens_blur: bool = True  # fit the blur of the lens, which takes most of the time; ``accurate`` matches with it
    # Correct A and B of shift matching at every point of a grid, towards the smooth fields where boards are few
    per_pixel: bool = False
    # Total degrees of the polynomials A and B, tried in this order until B is positive all over the frame
    field_degrees: tuple[int, ...] = (4, 2)
    min_field_boards: int = 5  # fewer get one curve for the whole frame
    # Tiles, over all boards, that the blur is fitted to: time grows with it, the error falls with its root
    blur_tiles: int = 180
    layer_boards: int = 40  # most boards on which the depth curve of ``accurate`` is measured
    # Boards rendered with the fitted blur to measure the nonlinearity of shift matching, where photographed ones are
    # few: three for each of its eight terms
    rendered_boards: int = 24
    pupil_sigma_mm: float = 10.0  # of the prior that the entrance pupil lies one image distance before the sensor
    range_margin: tuple[float, float] = (0.9, 1.3)  # (near, far): the working range is that of the boards times these

    def __post_init__(self) -> None:
        least = {"min_field_boards": 3, "blur_tiles": 1, "layer_boards": 3, "rendered_boards": 3}
        for name, count in least.items():
            if getattr(self, name) < count:
                raise InputError(f"{name} must be at least {count}, is {getattr(self, name)}")
        if not (self.pupil_sigma_mm > 0 and 0 < self.range_margin[0] <= 1 <= self.range_margin[1] < float("inf")):
            raise InputError("pupil_sigma_mm must be positive, and range_margin reach beyond the boards: (0.9, 1.3)")


DEFAULT = CalibrationConfig()


T = TypeVar("T")
Progress = Callable[[str, int, int], None]  # step, number done, total number


def silent(what: str, done: int, total: int) -> None:
    """Report nothing."""


def reported(items: Sequence[T], what: str, progress: Progress) -> Iterator[T]:
    """Yield the items and report how many of them are done."""
    for done, item in enumerate(items):
        progress(what, done, len(items))
        yield item
    progress(what, len(items), len(items))


_RELEASE = version("chromaperture")


class Cache:
    """Arrays, keyed by what they were computed from, from which an interrupted calibration resumes.

    The folder is created on first use; without one, or if it cannot be written to, everything is computed again.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self.folder = folder

    def get(
        self, photograph: Path, settings: object, compute: Callable[[], Mapping[str, np.ndarray]]
    ) -> Mapping[str, np.ndarray]:
        """Return ``compute()``, from disk if this release has computed it for that photograph and those settings."""
        if self.folder is None:
            return compute()
        name = hashlib.sha256(photograph.read_bytes() + repr((_RELEASE, settings)).encode()).hexdigest()[:32]
        path = self.folder / f"{name}.npz"
        with contextlib.suppress(OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile):
            kept = np.load(io.BytesIO(path.read_bytes()))
            return {key: kept[key] for key in kept.files}
        arrays = compute()
        with contextlib.suppress(OSError):
            self.folder.mkdir(parents=True, exist_ok=True)
            part = path.with_suffix(f".{os.getpid()}.part")
            with part.open("wb") as file:
                np.savez(file, allow_pickle=False, **arrays)
            os.replace(part, path)
        return arrays
