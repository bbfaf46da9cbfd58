"""Exceptions and warnings. Every message states what to do next."""

from __future__ import annotations

import contextlib
import errno
import importlib
from collections.abc import Iterator
from typing import Any


class ChromapertureError(Exception):
    """Base of all errors raised on purpose; the command line prints it as one line and exits with 2."""


class InputError(ChromapertureError):
    """An image, an option or a calibration that cannot be used as given."""


class MissingDependencyError(ChromapertureError, ImportError):
    """An optional package is needed; the message names the extra to install."""


def needed(module: str, hint: str) -> Any:
    """Import an optional package; raises MissingDependencyError with what to do."""
    try:
        return importlib.import_module(module)
    except (ImportError, OSError):  # a shared library may be missing
        raise MissingDependencyError(hint) from None


class CaptureWarning(UserWarning):
    """The capture can be used, with less accuracy."""


class OutOfMemoryError(ChromapertureError, MemoryError):
    """Something is too large for the memory that this process may use."""


# Of OpenCV: `cv::Error::StsNoMem`.
_CV_NO_MEMORY = -4
# What the loader of shared libraries, and Python, say without memory for a library or for the stack of a thread.
_LACKING = ("failed to map segment", "cannot allocate memory", "can't start new thread")


def lacks_memory(error: BaseException) -> bool:
    """Whether an error means that memory is used up: Python's, OpenCV's, of threads or of libraries."""
    if isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno == errno.ENOMEM):
        return True
    if isinstance(error, RuntimeError | ImportError | OSError):
        return any(words in str(error).lower() for words in _LACKING)
    return getattr(error, "code", None) == _CV_NO_MEMORY and type(error).__module__.startswith("cv2")


@contextlib.contextmanager
def within_memory(what: str) -> Iterator[None]:
    """Turn every lack of memory into OutOfMemoryError; ``what`` begins its message, such as "a.png, 24 megapixels"."""
    try:
        yield
    except OutOfMemoryError:
        raise
    except Exception as error:
        if not lacks_memory(error):
            raise
        reason = " ".join(str(error).split())[:200]  # characters; OpenCV reports whole paths of its sources
        raise OutOfMemoryError(f"{what}: not enough memory{f' ({reason})' if reason else ''}; {FREE_MEMORY}") from None


FREE_MEMORY = "close other programs, take smaller pictures, or set CHROMAPERTURE_THREADS=1"
