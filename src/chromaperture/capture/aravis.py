"""Machine-vision cameras over GigE Vision and USB3 Vision, through Aravis and GObject introspection."""

from __future__ import annotations

import time
from typing import Any

from chromaperture.capture.pixel_formats import best_format, unpack
from chromaperture.capture.source import Frame
from chromaperture.capture.threaded_source import DeviceLostError, not_there
from chromaperture.system.errors import MissingDependencyError

_BUFFERS = 8  # frames in flight; chosen by hand, not tuned


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
    """An opened GenICam camera, acquiring; an empty ``identity`` is the first one found, default format the best."""

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
    ) -> None:
        self._aravis = load_aravis()
        self._levels = (black_level, white_level)
        error = _glib_error()
        try:
            self._camera = self._aravis.Camera.new(identity or None)
            camera = self._camera
            if width or height:
                _, _, w, h = camera.get_region()
                camera.set_region(0, 0, width or w, height or h)
            self._format = pixel_format or best_format(list(camera.dup_available_pixel_formats_as_strings()))
            camera.set_pixel_format_from_string(self._format)
            for value, set_value in (
                (fps, camera.set_frame_rate), (exposure_us, camera.set_exposure_time), (gain, camera.set_gain)
            ):  # fmt: skip
                if value is not None:
                    set_value(value)
            self._settings = {"camera": f"{camera.get_vendor_name()} {camera.get_model_name()}"}
            self._settings |= {"exposure_us": camera.get_exposure_time(), "gain": camera.get_gain()}
            self._stream = camera.create_stream(None, None)
            if self._stream is None:
                raise not_there(f"camera {identity}", "its stream is taken by another program")
            for _ in range(_BUFFERS):
                self._stream.push_buffer(self._aravis.Buffer.new_allocate(camera.get_payload()))
            camera.start_acquisition()
        except error as problem:
            message = str(getattr(problem, "message", problem))
            raise not_there(f"machine-vision camera {identity}".strip(), message) from None

    def read(self, index: int) -> Frame | None:
        """Wait up to a second for a frame; None when none is complete."""
        buffer = self._stream.timeout_pop_buffer(1_000_000)
        if buffer is None:
            if not self._alive():
                raise DeviceLostError("unplugged?")
            return None
        try:
            if buffer.get_status() != self._aravis.BufferStatus.SUCCESS:
                return None
            width, height = buffer.get_image_width(), buffer.get_image_height()
            counts, encoding = unpack(buffer.get_data(), width, height, self._format, *self._levels)
        finally:
            self._stream.push_buffer(buffer)
        return Frame(counts, encoding, time.time(), index, self._settings)

    def _alive(self) -> bool:
        try:
            self._camera.get_region()
        except _glib_error():
            return False
        return True

    def close(self) -> None:
        """Stop acquisition and release the camera."""
        try:
            self._camera.stop_acquisition()
        except _glib_error():
            pass  # unplugged
        self._stream = self._camera = None


def aravis_cameras() -> list[str]:
    """List the machine-vision cameras found."""
    aravis = load_aravis()
    aravis.update_device_list()
    return [aravis.get_device_id(i) for i in range(aravis.get_n_devices())]


def _glib_error() -> type[Exception]:
    from gi.repository import GLib

    error: type[Exception] = GLib.Error
    return error
