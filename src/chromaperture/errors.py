"""Exceptions and warnings. Every message states what to do next."""

from __future__ import annotations


class ChromapertureError(Exception):
    """Base of all errors raised on purpose; the command line prints it as one line and exits with 2."""


class InputError(ChromapertureError):
    """An image, an option or a calibration that cannot be used as given."""


class MissingDependencyError(ChromapertureError, ImportError):
    """An optional package is needed; the message names the extra to install."""


class CaptureWarning(UserWarning):
    """The capture can be used, with less accuracy."""
