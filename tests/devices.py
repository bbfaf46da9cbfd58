"""Whether the tests of shaders can run here, and loudly where they cannot."""

from __future__ import annotations

import os

import pytest

from chromaperture.matching.device.device import adapters, has_extra

# Set where a driver was installed for these tests: then its absence is a failure.
EXPECTED = "CHROMAPERTURE_EXPECT_DEVICE"

needs_device = pytest.mark.skipif(
    has_extra() and not adapters() and not os.environ.get(EXPECTED),
    reason="no driver for Vulkan, Metal or Direct3D 12 (Debian: mesa-vulkan-drivers): shaders are NOT tested",
)
