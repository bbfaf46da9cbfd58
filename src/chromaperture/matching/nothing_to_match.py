"""Errors of pictures in which there is nothing to match, on whatever device."""

from __future__ import annotations

from chromaperture.system.errors import InputError


def no_usable_pixel() -> InputError:
    """Return the error of a picture without usable pixels."""
    return InputError(
        "no usable pixel: the whole image is saturated or not finite; lower the exposure, or check "
        "--black-level and --white-level"
    )


def constant_view() -> InputError:
    """Return the error of a picture without texture."""
    return InputError(
        "the image is constant in at least one view of the aperture: nothing to match. A lens cap, an even "
        "wall, a grey-scale file and a wrong aperture design look like this"
    )
