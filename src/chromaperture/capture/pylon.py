"""Basler cameras over GigE Vision, USB3 Vision and CoaXPress, through their driver pylon."""

from __future__ import annotations

import contextlib
import time
import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np

from chromaperture.capture.device_clock import DeviceClock, FrameNumbers
from chromaperture.capture.genicam_settings import Node, apply_settings
from chromaperture.capture.pixel_formats import unpack
from chromaperture.capture.source import Frame
from chromaperture.capture.threaded_source import Arrival, DeviceLostError, not_there
from chromaperture.system.errors import InputError, MissingDependencyError

_WAIT_MS = 1000
_NO_NUMBER = 2**64 - 1  # of a camera that does not number its frames


def load_pylon() -> Any:
    """Import pypylon's two modules; raises MissingDependencyError with what to install."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of its types, which must not become errors
            from pypylon import genicam, pylon
    except ImportError:
        raise MissingDependencyError("Basler cameras need pypylon: pip install 'chromaperture[pylon]'") from None
    return pylon, genicam


class PylonCamera:
    """An opened Basler camera, acquiring; only its newest frame is kept.

    The identity is a serial number, the name that the user gave it or an IP address; empty is the first one found. A
    part of the sensor lies about its centre. ``gain`` is in the camera's unit (dB). ``trigger`` is the line that starts
    a frame. Without ``black_level`` the camera's own is taken.
    """

    def __init__(
        self,
        identity: str = "",
        *,
        exposure_us: float | None = None,
        gain: float | None = None,
        fps: float | None = None,
        width: int | None = None,
        height: int | None = None,
        pixel_format: str | None = None,
        trigger: str | None = None,
        black_level: float | None = None,
        white_level: float | None = None,
    ) -> None:
        self._pylon, self._genicam = load_pylon()
        self._name = f"Basler camera {identity}".strip()
        found = self._found(identity)
        try:
            self._camera = self._pylon.InstantCamera(self._pylon.TlFactory.GetInstance().CreateDevice(found))
            self._camera.Open()
        except self._genicam.GenericException as error:
            raise not_there(self._name, _line(error)) from None
        self._nodes = _Nodes(found, self._camera.GetNodeMap(), self._genicam)
        try:
            self._settings = apply_settings(
                self._nodes,
                exposure_us=exposure_us,
                gain=gain,
                fps=fps,
                width=width,
                height=height,
                pixel_format=pixel_format,
                trigger=trigger,
                black_level=black_level,
                white_level=white_level,
                states_white_level=found.GetDeviceClass() != "BaslerCamEmu",  # which states that of another format
            )
            self._clock, self._numbers = DeviceClock(self._settings.ticks_per_s), FrameNumbers()
            self._camera.StartGrabbing(self._pylon.GrabStrategy_LatestImageOnly)
        except self._genicam.GenericException as error:
            self.close()
            raise not_there(self._name, _line(error)) from None
        except InputError:
            self.close()
            raise

    def read(self, index: int) -> Arrival | None:
        """Wait up to a second for a frame; of a slow or triggered camera that is there, an empty arrival."""
        try:
            result = self._camera.RetrieveResult(_WAIT_MS, self._pylon.TimeoutHandling_Return)
        except self._genicam.GenericException as error:
            raise DeviceLostError(_line(error)) from None
        arrived_s = time.time()
        with result:
            if self._camera.IsCameraDeviceRemoved() or not self._camera.IsGrabbing():
                raise DeviceLostError("unplugged?")
            if not result.IsValid():
                return Arrival() if self._settings.is_slow else None
            skipped = int(result.GetNumberOfSkippedImages())
            number = result.GetBlockID()
            whole = result.GrabSucceeded()
            lost = max(self._numbers.missing(number, whole=whole) - skipped, 0) if number != _NO_NUMBER else 0
            if not whole:  # the error code may be 0, and the array a picture
                advice = f"the driver says: {_line(result.GetErrorDescription())}; try a lower fps, cable and port"
                return Arrival(skipped=skipped, incomplete=1, lost=lost, advice=advice)
            frame = self._frame(result, arrived_s, index)
        return Arrival(frame, skipped, lost=lost, clock=self._clock.report)

    def _frame(self, result: Any, arrived_s: float, index: int) -> Frame:
        """Make a frame of a buffer, which the driver takes back."""
        width, height = result.GetWidth(), result.GetHeight()
        if result.GetPaddingX():
            raise InputError(f"{self._name} pads its rows by {result.GetPaddingX()} bytes: choose another width")
        data = np.frombuffer(result.GetMemoryView(), np.uint8)
        counts, encoding = unpack(data, width, height, self._settings.pixel_format, *self._settings.levels)
        time_s = self._clock.time_s(result.GetTimeStamp(), arrived_s)
        facts = {
            "region_px": [result.GetOffsetX(), result.GetOffsetY(), width, height],
            "timed_by": "camera" if self._clock.is_camera_time else "arrival",
        }
        return Frame(counts, encoding, time_s, index, self._settings.facts | facts)

    def close(self) -> None:
        """Stop and release the camera."""
        for end in (self._camera.StopGrabbing, self._camera.Close, self._camera.DestroyDevice):
            with contextlib.suppress(self._genicam.GenericException):  # unplugged
                end()

    def _found(self, identity: str) -> Any:
        """Look for a camera; raises InputError."""
        try:
            devices = list(self._pylon.TlFactory.GetInstance().EnumerateDevices())
        except self._genicam.GenericException as error:
            raise not_there(self._name, _line(error)) from None
        for device in devices:
            if not identity or identity in _names(device):
                return device
        raise not_there(self._name, f"there is none among the {len(devices)} that pylon finds")


class _Nodes:
    """Settings through pylon."""

    def __init__(self, found: Any, nodes: Any, genicam: Any) -> None:
        self.camera = f"{found.GetVendorName()} {found.GetModelName()} {found.GetSerialNumber()}"
        self.error: type[Exception] = genicam.GenericException
        self._nodes, self._genicam = nodes, genicam

    def find(self, name: str) -> Node | None:
        """Return a setting that the camera has now."""
        node = self._nodes.GetNode(name)
        return _Node(node, self._genicam) if node is not None and self._genicam.IsAvailable(node) else None


class _Node:
    def __init__(self, node: Any, genicam: Any) -> None:
        self._node, self._genicam = node, genicam
        self.is_readable, self.is_writable = genicam.IsReadable(node), genicam.IsWritable(node)

    @property
    def value(self) -> Any:
        return self._node.GetValue()

    @value.setter
    def value(self, value: Any) -> None:
        self._node.SetValue(value)

    def limits(self) -> tuple[float, float, float]:
        is_whole = isinstance(self._node.GetValue(), int)
        return self._node.GetMin(), self._node.GetMax(), self._node.GetInc() if is_whole else 0

    def choices(self) -> list[str]:
        names = self._node.GetSymbolics()
        return [name for name in names if self._genicam.IsAvailable(self._node.GetEntryByName(name))]


def pylon_cameras() -> list[str]:
    """List the serial numbers of the cameras found."""
    pylon, _ = load_pylon()
    return [device.GetSerialNumber() for device in pylon.TlFactory.GetInstance().EnumerateDevices()]


def _names(device: Any) -> Iterator[str]:
    """Yield what a camera may be called."""
    yield device.GetSerialNumber()
    yield device.GetUserDefinedName()
    if device.IsIpAddressAvailable():
        yield device.GetIpAddress()


def _line(error: Exception | str) -> str:
    """Return what the driver says, without the place in its code."""
    return str(error).partition(" : ")[0].strip().rstrip(".")
