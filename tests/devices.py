"""Whether the tests of shaders can run here, and loudly where they cannot."""

from __future__ import annotations

import os

import pytest

from chromaperture.matching.device import device as device_file
from chromaperture.matching.device.device import Device, DeviceError, adapters, has_extra, open_device

# Set where a driver was installed for these tests: then its absence is a failure.
EXPECTED = "CHROMAPERTURE_EXPECT_DEVICE"

needs_device = pytest.mark.skipif(
    has_extra() and not adapters() and not os.environ.get(EXPECTED),
    reason="no driver for Vulkan, Metal or Direct3D 12 (Debian: mesa-vulkan-drivers): shaders are NOT tested",
)


def any_device() -> Device:
    """Any device: a rasteriser in software where there is no GPU."""
    try:
        return open_device("gpu")
    except DeviceError as error:
        if os.environ.get(EXPECTED):
            raise
        pytest.skip(f"{error}: this is NOT tested")


def device_of_its_own() -> Device:
    """A device that a test may destroy."""
    return device_file._opened(*device_file._found_adapters()[0])
