"""Warnings about captures as sentences for the page."""

from __future__ import annotations

import contextlib
import threading
import warnings
from collections.abc import Callable, Iterator

from chromaperture.system.errors import CaptureWarning

# Python's list of filters is one for all threads, and two that record at once would restore each other's.
_ONE_AT_A_TIME = threading.RLock()


@contextlib.contextmanager
def heard() -> Iterator[Callable[[], list[str]]]:
    """Collect the sentences of warnings about captures; what is yielded returns them."""
    with _ONE_AT_A_TIME, warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        yield lambda: list(dict.fromkeys(str(w.message) for w in found if issubclass(w.category, CaptureWarning)))
