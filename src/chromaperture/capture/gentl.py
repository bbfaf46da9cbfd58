"""Machine-vision cameras through the GenTL producer (.cti) of whichever vendor, by Harvesters."""

from __future__ import annotations

import contextlib
import os
import time
from pathlib import Path
from typing import Any

import numpy as np

from chromaperture.capture.device_clock import DeviceClock, FrameNumbers
from chromaperture.capture.genicam_settings import Node, apply_settings
from chromaperture.capture.pixel_formats import unpack
from chromaperture.capture.source import Frame
from chromaperture.capture.threaded_source import Arrival, DeviceLostError, not_there
from chromaperture.system.errors import InputError, MissingDependencyError

_WAIT_S = 1.0
_NO_WAIT_S = 1e-3  # the shortest wait
_BUFFERS = 8  # frames in flight; chosen by hand, not tuned
_PATH = "GENICAM_GENTL64_PATH"  # the standard's name for the folders of producers


def load_harvesters() -> Any:
    """Import Harvesters and its GenICam; raises MissingDependencyError with what to install."""
    try:
        from genicam import genapi, gentl
        from harvesters import core
    except ImportError:
        raise MissingDependencyError("GenTL cameras need Harvesters: pip install 'chromaperture[gentl]'") from None
    return core, gentl, genapi


class GenTLCamera:
    """An opened camera of a GenTL producer, acquiring; only its newest frame is kept.

    The identity is a serial number, the name that the user gave it or the producer's; empty is the first one found.
    ``producer`` is the path of a .cti file; without it those of the folders in GENICAM_GENTL64_PATH are asked. Other
    settings are those of `PylonCamera`. Frames of a producer without time stamps are timed on arrival; those that
    arrive incomplete count as lost.
    """

    def __init__(
        self,
        identity: str = "",
        *,
        producer: str | None = None,
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
        core, gentl, genapi = load_harvesters()
        self._error = gentl.GenericException, genapi.GenericException
        self._camera: Any = None
        name = f"GenTL camera {identity}".strip()
        self._harvester = _harvester(core, producer)
        try:
            found = [d for d in self._harvester.device_info_list if not identity or identity in _names(d)]
            if not found:
                number = len(self._harvester.device_info_list)
                raise not_there(name, f"there is none among the {number} that the producers find")
            self._camera = self._harvester.create(found[0])
            nodes = _Nodes(_names(found[0])[-1], self._camera.remote_device.node_map, genapi)
            self._settings = apply_settings(
                nodes,
                exposure_us=exposure_us,
                gain=gain,
                fps=fps,
                width=width,
                height=height,
                pixel_format=pixel_format,
                trigger=trigger,
                black_level=black_level,
                white_level=white_level,
            )
            self._clock, self._numbers = DeviceClock(), FrameNumbers()
            self._camera.num_buffers = max(_BUFFERS, self._camera.min_num_buffers)
            self._camera.start()
        except self._error as error:
            self.close()
            raise not_there(name, _line(error)) from None
        except InputError:
            self.close()
            raise

    def read(self, index: int) -> Arrival | None:
        """Wait up to a second for a frame; of a slow or triggered camera that is there, an empty arrival."""
        skipped = 0
        try:
            buffer = self._camera.try_fetch(timeout=_WAIT_S, is_raw=True)
            if buffer is None:
                self._camera.remote_device.node_map.Width.value  # noqa: B018  raises where the camera is gone
                return Arrival() if self._settings.is_slow else None
            while (newer := self._camera.try_fetch(timeout=_NO_WAIT_S, is_raw=True)) is not None:
                buffer.parent.queue_buffer(buffer)
                buffer, skipped = newer, skipped + 1
            arrived_s = time.time()
            try:
                lost = max(self._numbers.missing(buffer.frame_id) - skipped, 0)
                if skipped + 1 >= self._camera.num_buffers:  # none was free for newer ones: this one is old
                    return Arrival(skipped=skipped + 1, lost=lost)
                return Arrival(self._frame(buffer, arrived_s, index), skipped, lost=lost, clock=self._clock.report)
            finally:
                buffer.parent.queue_buffer(buffer)
        except self._error as error:
            raise DeviceLostError(_line(error)) from None

    def _frame(self, buffer: Any, arrived_s: float, index: int) -> Frame:
        """Make a frame of a buffer."""
        if padding := self._of(buffer, "padding_x", 0):
            raise InputError(f"the camera pads its rows by {padding} bytes: choose another width")
        width, height = buffer.width, buffer.height
        data = np.frombuffer(buffer.raw_buffer, np.uint8, offset=self._of(buffer, "image_offset", 0))
        counts, encoding = unpack(data, width, height, self._settings.pixel_format, *self._settings.levels)
        time_s = self._clock.time_s(self._of(buffer, "timestamp_ns", 0), arrived_s)
        facts = {
            "region_px": [self._of(buffer, "offset_x", 0), self._of(buffer, "offset_y", 0), width, height],
            "timed_by": "camera" if self._clock.is_camera_time else "arrival",
        }
        return Frame(counts, encoding, time_s, index, self._settings.facts | facts)

    def _of(self, buffer: Any, name: str, otherwise: int) -> int:
        """Return what a producer may tell of a buffer."""
        try:
            return int(getattr(buffer, name))
        except self._error:
            return otherwise

    def close(self) -> None:
        """Stop and release the camera."""
        for end in (*((self._camera.stop, self._camera.destroy) if self._camera else ()), self._harvester.reset):
            with contextlib.suppress(*self._error):  # unplugged
                end()


class _Nodes:
    """Settings through GenApi."""

    def __init__(self, camera: str, nodes: Any, genapi: Any) -> None:
        self.camera, self.error = camera, genapi.GenericException
        self._nodes, self._genapi = nodes, genapi

    def find(self, name: str) -> Node | None:
        """Return a setting that the camera has now."""
        try:
            node = _Node(self._nodes.get_node(name), self._genapi.EAccessMode)
        except self.error:
            return None
        return node if node.is_readable or node.is_writable else None


class _Node:
    def __init__(self, node: Any, modes: Any) -> None:
        mode = node.get_access_mode()
        self._node, self._modes = node, modes
        self.is_readable, self.is_writable = mode in (modes.RO, modes.RW), mode in (modes.WO, modes.RW)

    @property
    def value(self) -> Any:
        return self._node.value

    @value.setter
    def value(self, value: Any) -> None:
        self._node.value = value

    def limits(self) -> tuple[float, float, float]:
        is_whole = isinstance(self._node.value, int)
        return self._node.min, self._node.max, self._node.inc if is_whole else 0

    def choices(self) -> list[str]:
        there = self._modes.RO, self._modes.RW
        return [n for n in self._node.symbolics if self._node.get_entry_by_name(n).get_access_mode() in there]


def gentl_cameras() -> list[str]:
    """List the cameras of the producers that the environment names."""
    core, *_ = load_harvesters()
    if not os.environ.get(_PATH):
        return []
    harvester = _harvester(core, None)
    try:
        return [_names(device)[0] for device in harvester.device_info_list]
    finally:
        harvester.reset()


def _harvester(core: Any, producer: str | None) -> Any:
    """Load producers and look for their cameras; raises InputError."""
    folders = [Path(folder) for folder in os.environ.get(_PATH, "").split(os.pathsep) if folder]
    files = [Path(producer)] if producer else sorted(path for folder in folders for path in folder.glob("*.cti"))
    if not files:
        raise InputError(f"no GenTL producer: give producer=FILE.cti, or set {_PATH} to the folder of the vendor's")
    if missing := [path for path in files if not path.is_file()]:
        raise InputError(f"there is no GenTL producer {missing[0]}")
    harvester = core.Harvester()
    for path in files:
        harvester.add_file(str(path))
    harvester.update()
    return harvester


def _names(device: Any) -> list[str]:
    """Return what a camera may be called."""
    facts = device.property_dict
    return [str(facts[key]) for key in ("serial_number", "user_defined_name", "id_", "display_name") if facts.get(key)]


def _line(error: Exception) -> str:
    """Return what the driver says, without the place in its code."""
    return str(error).partition(" : ")[0].strip().rstrip(".")
