"""Machine-vision cameras over GigE Vision and USB3 Vision, through Aravis and GObject introspection."""

from __future__ import annotations

import math
import time
import traceback
from dataclasses import replace
from pathlib import Path
from typing import Any

from chromaperture.capture.device_clock import FrameNumbers
from chromaperture.capture.genicam_settings import Node, apply_settings
from chromaperture.capture.pixel_formats import unpack
from chromaperture.capture.source import Frame, FrameCounts
from chromaperture.capture.threaded_source import Arrival, DeviceLostError, not_there
from chromaperture.system.errors import InputError, MissingDependencyError

_BUFFERS = 8  # frames in flight; chosen by hand, not tuned
_PACKET_BYTES = (576, 65535)  # of GigE Vision, and of UDP
_LATEST_S = 10.0  # a frame waits no longer for the host: its time is wrong. Chosen by hand, not tuned
_RESEND = ("always", "never")


def load_aravis() -> Any:
    """Import Aravis; raises MissingDependencyError with what to install."""
    try:
        import gi

        gi.require_version("Aravis", "0.8")
        from gi.repository import Aravis
    except (ImportError, ValueError):
        raise MissingDependencyError(
            "machine-vision cameras need Aravis: apt install gir1.2-aravis-0.8 libgirepository1.0-dev libcairo2-dev, "
            "then pip install 'chromaperture[cameras]'"
        ) from None
    return Aravis


class AravisCamera:
    """An opened GenICam camera, acquiring; an empty ``identity`` is the first one found, settings as of `PylonCamera`.

    Of those for GigE, ``packet_size`` is by default the camera's own if such packets arrive, else the largest
    that do; ``packet_resend`` is "always" or "never", and needs a camera that can. A packet is asked for when it is
    late by ``initial_packet_timeout_ms``, again after ``packet_timeout_ms``, and a frame is given up when nothing of it
    came for ``frame_retention_ms``. ``socket_buffer_bytes`` is by default two frames; Linux gives at most
    ``net.core.rmem_max``.
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
        packet_size: int | None = None,
        packet_resend: str = "always",
        initial_packet_timeout_ms: float = 1.0,
        packet_timeout_ms: float = 10.0,  # Aravis has 20: two of them are a frame at 20 a second
        frame_retention_ms: float = 100.0,
        socket_buffer_bytes: int | None = None,
    ) -> None:
        self._aravis = load_aravis()
        self._numbers, self._since, self._underruns = FrameNumbers(), FrameCounts(), 0
        self._status, self._hint, self._resends = "", "", False  # of the last incomplete frame; of the network
        self._camera: Any = None
        self._stream: Any = None
        if packet_resend not in _RESEND:
            raise InputError(f"unknown packet_resend {packet_resend!r}: choose {' or '.join(_RESEND)}")
        timeouts_ms = (initial_packet_timeout_ms, packet_timeout_ms, frame_retention_ms)
        if not all(0 <= each <= 60_000 for each in timeouts_ms):
            raise InputError("timeouts of packets and frames must be between 0 and 60000 ms")
        if socket_buffer_bytes is not None and not 0 < socket_buffer_bytes < 2**31:
            raise InputError("socket_buffer_bytes must be between 1 and 2147483647")
        if packet_size is not None and not _PACKET_BYTES[0] <= packet_size <= _PACKET_BYTES[1]:
            raise InputError(f"packet_size must be between {_PACKET_BYTES[0]} and {_PACKET_BYTES[1]} bytes")
        try:
            self._camera = self._aravis.Camera.new(identity or None)
            if self._is_gige and not self._camera.get_device().is_controller():
                raise not_there(_named(identity), "another program controls it")
            self._settings = apply_settings(
                _Nodes(self._aravis, self._camera),
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
            self._facts = self._settings.facts
            self._open_stream(packet_size)
            if self._is_gige:
                self._set_network(packet_resend == "always", timeouts_ms, socket_buffer_bytes or 2 * self._payload)
            for _ in range(_BUFFERS):
                self._push_new()
            self._camera.start_acquisition()
        except BaseException as problem:
            traceback.clear_frames(problem.__traceback__)  # or they keep the camera, and so its control, after `close`
            self.close()
            if isinstance(problem, _glib_error()):
                raise not_there(_named(identity), str(getattr(problem, "message", problem))) from None
            raise

    def _open_stream(self, packet_size: int | None) -> None:
        camera = self._camera
        if self._is_gige and packet_size is not None:
            camera.gv_set_packet_size(packet_size)
        self._payload = camera.get_payload()
        self._stream = camera.create_stream(None, None)  # which tries whether such packets arrive, where cameras can
        if self._stream is None:
            raise InputError("the camera gives no stream")
        if self._is_gige:
            self._facts["packet_size"] = taken = camera.gv_get_packet_size()
            if packet_size not in (None, taken):
                raise InputError(f"packet_size={packet_size} is not possible: packets of {taken} bytes arrive")

    def _set_network(self, resend: bool, timeouts_ms: tuple[float, float, float], socket_buffer_bytes: int) -> None:
        never = self._aravis.GvStreamPacketResend.NEVER
        stream = self._stream
        # Aravis has set "never" where the camera cannot.
        self._resends = resend and stream.get_property("packet-resend") != never
        if not self._resends:
            stream.set_property("packet-resend", never)
        hints = [] if resend else ["packet_resend=always asks for packets again"]
        if resend and not self._resends:
            hints.append("the camera does not resend packets")
        if _largest_socket_buffer() < socket_buffer_bytes:
            hints.append(f"sysctl net.core.rmem_max={socket_buffer_bytes} makes room for packets that wait")
        self._hint = "; ".join([*hints, "larger packets (packet_size) lose fewer frames"])
        names = ("initial-packet-timeout", "packet-timeout", "frame-retention")
        for name, value_ms in zip(names, timeouts_ms, strict=True):
            stream.set_property(name, round(1000 * value_ms))
        stream.set_property("socket-buffer-size", socket_buffer_bytes)

    @property
    def _is_gige(self) -> bool:
        return bool(self._camera.is_gv_device())

    def _push(self, buffer: Any) -> None:
        """Give a buffer to the stream, without its number: it would keep it where the next frame's leader is lost."""
        buffer.set_frame_id(0)
        self._stream.push_buffer(buffer)

    def _push_new(self) -> None:
        self._stream.push_buffer(self._aravis.Buffer.new_allocate(self._payload))

    def read(self, index: int) -> Arrival | None:
        """Wait up to a second, and take the newest of the frames that are complete."""
        buffer = self._stream.timeout_pop_buffer(1_000_000)
        if buffer is None:
            self._check_alive()
            return Arrival() if self._settings.is_slow else None
        newest, since, before = None, self._since, FrameCounts()
        while buffer is not None:
            if self._is_stray(buffer):
                self._push(buffer)
            elif self._is_whole(buffer):
                if newest is not None:
                    since.skipped += 1
                    self._push(newest)
                newest, before = buffer, replace(since)
            else:
                self._push_new()  # not the same, which would keep its status
            buffer = self._stream.try_pop_buffer()
        if newest is None:
            self._since = FrameCounts()
            return self._arrival(None, since) if since.sent else None
        self._since = FrameCounts(incomplete=since.incomplete - before.incomplete, lost=since.lost - before.lost)
        try:
            return self._arrival(self._frame(newest, index), before)
        except InputError as half:
            before.incomplete, self._status = before.incomplete + 1, str(half)
            return self._arrival(None, before)
        finally:
            self._push(newest)

    def _is_stray(self, buffer: Any) -> bool:
        """Find whether a buffer comes back as it was, with its last picture: for packets that Aravis does not know."""
        status, kinds = buffer.get_status(), self._aravis.BufferStatus
        is_old = status == kinds.SUCCESS and buffer.get_frame_id() == 0 and bool(self._numbers.last)
        return is_old or bool(status == kinds.CLEARED)

    def _is_whole(self, buffer: Any) -> bool:
        """Count a frame that is not whole, and those lost before it."""
        status = buffer.get_status()
        whole = bool(status == self._aravis.BufferStatus.SUCCESS)
        self._since.lost += self._numbers.missing(buffer.get_frame_id(), whole=whole)
        if not whole:
            self._since.incomplete += 1
            self._status = status.value_nick
        return whole

    def _frame(self, buffer: Any, index: int) -> Frame:
        region = buffer.get_image_region()
        form, levels = self._settings.pixel_format, self._settings.levels
        counts, encoding = unpack(buffer.get_data(), region.width, region.height, form, *levels)
        # The host's clock when the first packet came: a device's may begin anywhere, count ticks, or be set.
        now, arrived = time.time(), buffer.get_system_timestamp() / 1e9
        facts = {"region_px": list(region), "frame_id": buffer.get_frame_id(), "device_time_ns": buffer.get_timestamp()}
        time_s = arrived if 0 <= now - arrived <= _LATEST_S else now
        return Frame(counts, encoding, time_s, index, self._facts | facts)

    def _arrival(self, frame: Frame | None, counts: FrameCounts) -> Arrival:
        advice = self._advice(counts) if counts.incomplete or counts.lost else ""
        return Arrival(frame, counts.skipped, counts.incomplete, counts.lost, advice)

    def _advice(self, counts: FrameCounts) -> str:
        """Say what became of them, and what helps."""
        said = [self._status] if counts.incomplete else []
        if (underruns := self._stream.get_info_uint64_by_name("n_underruns")) > self._underruns:
            self._underruns = underruns
            said.append("this computer takes them too slowly: lower fps, width or height")
        elif self._is_gige:
            if self._resends:
                said.append(
                    f"{self._stream.get_info_uint64_by_name('n_resent_packets')} packets were sent again in time"
                )
            said.append(self._hint)
        else:
            said.append("try another cable or port")
        return "; ".join(said)

    def _check_alive(self) -> None:
        """Raise DeviceLostError where the camera does not answer, or obeys another program."""
        try:
            self._camera.get_region()
        except _glib_error():
            raise DeviceLostError("unplugged?") from None
        if self._is_gige and not self._camera.get_device().is_controller():
            raise DeviceLostError("its control is lost: it was switched off, or another program has it")

    def close(self) -> None:
        """Stop acquisition and release the camera."""
        try:
            if self._stream is not None:
                self._camera.stop_acquisition()
            self._stream = None  # ends with a command to the camera, which needs its control
            if self._camera is not None and self._is_gige and self._camera.get_device().is_controller():
                self._camera.get_device().leave_control()
        except _glib_error():
            pass  # unplugged
        self._stream = self._camera = None


class _Nodes:
    """Settings through Aravis."""

    def __init__(self, aravis: Any, camera: Any) -> None:
        self.camera = f"{camera.get_vendor_name()} {camera.get_model_name()}"
        self.error = _glib_error()
        self._aravis, self._device = aravis, camera.get_device()

    def find(self, name: str) -> Node | None:
        """Return a setting that the camera has now."""
        node = self._device.get_feature(name)
        return _Node(node, self._aravis) if node and node.is_implemented() and node.is_available() else None


class _Node:
    def __init__(self, node: Any, aravis: Any) -> None:
        mode, modes = node.get_actual_access_mode(), aravis.GcAccessMode
        self._node, self._is_whole = node, isinstance(node, aravis.GcInteger)
        self._text = "string_" if isinstance(node, aravis.GcEnumeration) else ""
        self.is_readable = mode in (modes.RO, modes.RW)
        self.is_writable = mode in (modes.WO, modes.RW) and not node.is_locked()

    @property
    def value(self) -> Any:
        return getattr(self._node, f"get_{self._text}value")()

    @value.setter
    def value(self, value: Any) -> None:
        getattr(self._node, f"set_{self._text}value")(value)

    def limits(self) -> tuple[float, float, float]:
        return self._node.get_min(), self._node.get_max(), self._node.get_inc() if self._is_whole else 0

    def choices(self) -> list[str]:
        return list(self._node.dup_available_string_values())


def aravis_cameras() -> list[str]:
    """List the machine-vision cameras found."""
    aravis = load_aravis()
    aravis.update_device_list()
    return [aravis.get_device_id(i) for i in range(aravis.get_n_devices())]


def _largest_socket_buffer() -> float:
    """Return how many bytes Linux lets packets wait in; infinity elsewhere."""
    try:
        return int(Path("/proc/sys/net/core/rmem_max").read_text(encoding="ascii"))
    except OSError:
        return math.inf


def _named(identity: str) -> str:
    return f"machine-vision camera {identity}".strip()


def _glib_error() -> type[Exception]:
    from gi.repository import GLib

    error: type[Exception] = GLib.Error
    return error
