"""Whether the tests of shaders can run here, loudly where they cannot; and plans as a browser reads them."""

from __future__ import annotations

import json
import os
import struct
import zlib

import numpy as np
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


def unpack_array(data, dtype=np.float32):
    """What `chromaperture.app.messages.pack_array` packed, flat."""
    planes = np.frombuffer(zlib.decompress(data), np.uint8).reshape(4, -1)
    folded = np.ascontiguousarray(planes.T).view("<u4").ravel().astype(np.uint32)
    twice = (folded >> np.uint32(1)) ^ (np.uint32(0) - (folded & np.uint32(1)))
    return np.cumsum(np.cumsum(twice, dtype=np.uint32), dtype=np.uint32).view(dtype)


def unpacked(message):
    """The text of a plan, and its arrays by their place in it."""
    length = struct.unpack("<I", message[:4])[0]
    text = json.loads(zlib.decompress(message[4 : 4 + length]))

    def array(values):
        kind = np.dtype(values["kind"]).type
        if "numbers" in values:
            return np.array(values["numbers"], kind)
        start = 4 + length + values["at"]
        return unpack_array(message[start : start + values["bytes"]], kind)

    return text, array
