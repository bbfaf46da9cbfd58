"""Whether the tests of shaders can run here, loudly where they cannot; and plans as a browser reads them."""

from __future__ import annotations

import json
import os
import struct
import warnings
import zlib
from typing import Any

import cv2
import numpy as np
import pytest

from chromaperture.camera.camera import CodedApertureCamera
from chromaperture.matching.device import device as device_file
from chromaperture.matching.device.device import Device, DeviceError, adapters, has_extra, open_device
from chromaperture.model.camera_file import Calibration
from chromaperture.products.samples import open_sample
from chromaperture.system.errors import CaptureWarning

# Set where a driver was installed for these tests: then its absence is a failure.
EXPECTED = "CHROMAPERTURE_EXPECT_DEVICE"

needs_device = pytest.mark.skipif(
    has_extra() and not adapters() and not os.environ.get(EXPECTED),
    reason="no driver for Vulkan, Metal or Direct3D 12 (Debian: mesa-vulkan-drivers): shaders are NOT tested",
)


def with_device(test: Any) -> Any:
    """Mark a test that needs the extra and a device."""
    return pytest.mark.extra("gpu", "wgpu")(needs_device(test))


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


def camera_on(device: str, calibration: Calibration, config: Any = None) -> CodedApertureCamera:
    """A camera that measures on a device, without the warning that it is software."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", CaptureWarning)
        return CodedApertureCamera(calibration, config, device=device)


def small_sample(name: str, width: int, height: int, *, quality: str) -> tuple[CodedApertureCamera, np.ndarray]:
    """A bundled capture and its camera, on the CPU, in fewer pixels: software devices are slow."""
    camera, image = open_sample(name, quality=quality, device="cpu")
    return camera.at_size(width, height), cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)


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
