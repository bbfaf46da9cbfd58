"""Progress of a calibration."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

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
