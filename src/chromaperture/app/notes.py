"""Warnings about captures as sentences for the page."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Callable, Iterator

from chromaperture.errors import CaptureWarning


@contextlib.contextmanager
def heard() -> Iterator[Callable[[], list[str]]]:
    """Collect the sentences of warnings about captures; what is yielded returns them."""
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        yield lambda: list(dict.fromkeys(str(w.message) for w in found if issubclass(w.category, CaptureWarning)))
