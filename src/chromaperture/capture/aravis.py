"""Machine-vision cameras over GigE Vision and USB3 Vision, through Aravis and GObject introspection."""

from __future__ import annotations

import math
import time
import traceback
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from chromaperture.capture.pixel_formats import best_format, unpack
from chromaperture.capture.source import Frame, FrameCounts
from chromaperture.capture.threaded_source import Arrival, DeviceLostError, not_there
from chromaperture.system.errors import InputError, MissingDependencyError

_BUFFERS = 8  # frames in flight; chosen by hand, not tuned
_BLOCKS = 65535  # GigE Vision's numbers of 16 bits: 1 to this, then 1 again
_MOST_LOST = 10_000  # at once: more than cameras send before one that is silent counts as lost; chosen by hand
_PACKET_BYTES = (576, 65535)  # of GigE Vision, and of UDP
_ROUNDING = 0.01  # of a setting: cameras count exposures in rows, gains in steps
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
    """An opened GenICam camera, acquiring; an empty ``identity`` is the first one found, default format the best.

    Of the settings for GigE, ``packet_size`` is by default the camera's own if such packets arrive, else the largest
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
        black_level: float = 0.0,
        white_level: float | None = None,
        packet_size: int | None = None,
        packet_resend: str = "always",
        initial_packet_timeout_ms: float = 1.0,
        packet_timeout_ms: float = 10.0,  # Aravis has 20: two of them are a frame at 20 a second
        frame_retention_ms: float = 100.0,
        socket_buffer_bytes: int | None = None,
    ) -> None:
        self._aravis = load_aravis()
        self._levels = (black_level, white_level)
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
        try:
            self._camera = self._aravis.Camera.new(identity or None)
            if self._is_gige and not self._camera.get_device().is_controller():
                raise not_there(_named(identity), "another program controls it")
            self._set_picture(pixel_format, width, height)
            self._set_exposure(exposure_us, gain, fps)
            self._open_stream(packet_size)
            if self._is_gige:
                self._set_network(packet_resend == "always", timeouts_ms, socket_buffer_bytes or 2 * self._payload)
            self._settings = self._described()
            for _ in range(_BUFFERS):
                self._push_new()
            self._camera.start_acquisition()
        except BaseException as problem:
            traceback.clear_frames(problem.__traceback__)  # or they keep the camera, and so its control, after `close`
            self.close()
            if isinstance(problem, _glib_error()):
                raise not_there(_named(identity), str(getattr(problem, "message", problem))) from None
            raise

    def _set_picture(self, pixel_format: str | None, width: int | None, height: int | None) -> None:
        camera = self._camera
        if width or height:
            camera.set_region(0, 0, -1, -1)  # an offset would limit the size
        self._set(
            "width",
            width,
            camera.get_width_bounds,
            lambda value: camera.set_region(-1, -1, value, -1),
            lambda: camera.get_region()[2],
        )
        self._set(
            "height",
            height,
            camera.get_height_bounds,
            lambda value: camera.set_region(-1, -1, -1, value),
            lambda: camera.get_region()[3],
        )
        offered = list(camera.dup_available_pixel_formats_as_strings())
        self._format = pixel_format or best_format(offered)
        if self._format not in offered:
            raise InputError(f"the camera does not offer pixel_format {self._format}: choose {', '.join(offered)}")
        best_format([self._format])  # raises where it is not read
        camera.set_pixel_format_from_string(self._format)
        if (taken := camera.get_pixel_format_as_string()) != self._format:
            raise InputError(f"the camera did not take pixel_format {self._format} but {taken}")

    def _set_exposure(self, exposure_us: float | None, gain: float | None, fps: float | None) -> None:
        camera, off = self._camera, self._aravis.Auto.OFF
        if exposure_us is not None and camera.is_exposure_auto_available():
            camera.set_exposure_time_auto(off)
        if gain is not None and camera.is_gain_auto_available():
            camera.set_gain_auto(off)
        bounds, put, read = camera.get_exposure_time_bounds, camera.set_exposure_time, camera.get_exposure_time
        self._set("exposure_us", exposure_us, bounds, put, read)
        self._set("gain", gain, camera.get_gain_bounds, camera.set_gain, camera.get_gain)
        self._set("fps", fps, camera.get_frame_rate_bounds, camera.set_frame_rate, camera.get_frame_rate)

    def _set(
        self,
        name: str,
        value: float | None,
        bounds: Callable[[], tuple[float, float]],
        put: Callable[[Any], None],
        read: Callable[[], float],
    ) -> None:
        """Set what the camera can; raises InputError for what it cannot, or rounds by more than a percent."""
        if value is None:
            return
        least, most = bounds()
        if not least <= value <= most:
            raise InputError(f"{name}={value:g} is not possible: the camera takes {least:g} to {most:g}")
        put(value)
        if abs((taken := read()) - value) > _ROUNDING * abs(value):
            raise InputError(f"{name}={value:g} is not possible: the camera makes it {taken:g}")

    def _described(self) -> dict[str, Any]:
        """Read back what the camera works with."""
        camera = self._camera
        facts = {"camera": f"{camera.get_vendor_name()} {camera.get_model_name()}", "pixel_format": self._format}
        facts |= {"exposure_us": camera.get_exposure_time(), "gain": camera.get_gain()}
        if self._is_gige:
            facts["packet_size"] = camera.gv_get_packet_size()
        return facts | {"region": list(camera.get_region())}

    def _open_stream(self, packet_size: int | None) -> None:
        camera = self._camera
        if self._is_gige:
            put, read = camera.gv_set_packet_size, camera.gv_get_packet_size
            self._set("packet_size", packet_size, lambda: _PACKET_BYTES, put, read)
        self._payload = camera.get_payload()
        self._stream = camera.create_stream(None, None)  # which tries whether such packets arrive, where cameras can
        if self._stream is None:
            raise InputError("the camera gives no stream")
        if self._is_gige and packet_size and (taken := camera.gv_get_packet_size()) != packet_size:
            raise InputError(f"packets of packet_size={packet_size} do not arrive; those of {taken} bytes do")

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
            return None
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
        self._since.lost += self._numbers.lost_before(buffer.get_frame_id(), whole=whole)
        if not whole:
            self._since.incomplete += 1
            self._status = status.value_nick
        return whole

    def _frame(self, buffer: Any, index: int) -> Frame:
        width, height = buffer.get_image_width(), buffer.get_image_height()
        counts, encoding = unpack(buffer.get_data(), width, height, self._format, *self._levels)
        # The host's clock when the first packet came: a device's may begin anywhere, count ticks, or be set.
        now, arrived = time.time(), buffer.get_system_timestamp() / 1e9
        metadata = self._settings | {"frame_id": buffer.get_frame_id(), "device_time_ns": buffer.get_timestamp()}
        return Frame(counts, encoding, arrived if 0 <= now - arrived <= _LATEST_S else now, index, metadata)

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


class FrameNumbers:
    """The numbers that a camera gives its frames: of 64 bits, or of 16, where 1 follows 65535; 0 is none."""

    def __init__(self) -> None:
        self.last: int | None = None
        self._unnumbered = 0  # frames since

    def lost_before(self, number: int, *, whole: bool) -> int:
        """Take the next frame's number; returns how many did not arrive between it and the one before."""
        step = 1 if self.last is None else number - self.last
        if step < _MOST_LOST - _BLOCKS:
            step += _BLOCKS
        is_ahead = 0 < step <= _MOST_LOST
        if not whole and not (is_ahead and number):
            self._unnumbered += 1
            return 0
        lost = max(0, step - 1 - self._unnumbered) if is_ahead else 0  # else the camera has begun to count anew
        self.last, self._unnumbered = number, 0
        return lost


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
