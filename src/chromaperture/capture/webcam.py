"""Webcams through V4L2, their frames as the driver delivers them: luma and chroma, or JPEG files."""

from __future__ import annotations

import time
from pathlib import Path

import cv2
import numpy as np

from chromaperture.capture.decoded_frame import DamagedError, counts_of_frame, decode_packet, format_of_frame
from chromaperture.capture.native_planes import ENCODED_WHITE, Planes, rgb_of_planes
from chromaperture.capture.picture_format import LUMA_WEIGHTS, PictureFormat, described
from chromaperture.capture.source import Frame
from chromaperture.capture.threaded_source import DeviceLostError, not_there
from chromaperture.color.encoding import Encoding, Siting, StatedFacts, choose_encoding
from chromaperture.system.errors import InputError

_BYTES = {"YUYV": (0, 1), "YUY2": (0, 1), "UYVY": (1, 0)}  # of luma and chroma in a pixel
_FORMATS = (*_BYTES, "NV12", "MJPG")
_MOST_DAMAGED = 30  # frames in turn: a second


class Webcam:
    """An opened webcam, with automatic focus and white balance off, and automatic exposure off if one is given.

    The device is a number or a path: "0", "/dev/video0". Another pixel format than the one that the driver is asked for
    is read, too; MJPG has more frames a second. Chroma of which nothing is stated lies at every other pixel of a row.
    """

    def __init__(
        self,
        device: str,
        *,
        width: int | None = None,
        height: int | None = None,
        fps: float | None = None,
        exposure_us: float | None = None,
        gain: float | None = None,
        pixel_format: str = "YUYV",
        siting: Siting | None = None,
        camera_encoding: Encoding | None = None,
    ) -> None:
        self._camera_encoding, self._stated = camera_encoding, StatedFacts(siting)
        if pixel_format not in _FORMATS:
            raise InputError(f"unknown pixel_format {pixel_format!r}: choose {', '.join(_FORMATS)}")
        path = f"/dev/video{device}" if device.isdigit() else device
        if not Path(path).exists():
            raise not_there(f"webcam {device}", f"there is no {path}")
        self._camera = cv2.VideoCapture(path, cv2.CAP_V4L2)
        if not self._camera.isOpened():
            raise not_there(f"webcam {device}", "another program uses it, or you may not (group video)")
        wanted = {
            cv2.CAP_PROP_FOURCC: cv2.VideoWriter.fourcc(*pixel_format),
            cv2.CAP_PROP_CONVERT_RGB: 0,  # OpenCV would bring chroma up to the size of luma, and move it
            cv2.CAP_PROP_FRAME_WIDTH: width,
            cv2.CAP_PROP_FRAME_HEIGHT: height,
            cv2.CAP_PROP_FPS: fps,
            cv2.CAP_PROP_BUFFERSIZE: 1,  # frames in the driver's queue add latency
            cv2.CAP_PROP_AUTOFOCUS: 0,  # a calibration is for one focus
            cv2.CAP_PROP_AUTO_WB: 0,
            cv2.CAP_PROP_AUTO_EXPOSURE: None if exposure_us is None else 1,  # V4L2: manual
            cv2.CAP_PROP_EXPOSURE: None if exposure_us is None else exposure_us / 100,  # V4L2 counts in 100 µs
            cv2.CAP_PROP_GAIN: gain,
        }
        for setting, value in wanted.items():
            if value is not None:
                self._camera.set(setting, value)

    def read(self, index: int) -> Frame:
        """Wait for the next frame."""
        for attempt in range(_MOST_DAMAGED + 1):
            ok, data = self._camera.read()
            if not ok:
                raise DeviceLostError("unplugged?")
            try:
                counts, form = self._colours(data)
                break
            except DamagedError:  # a JPEG of which USB lost a part; the next is whole
                if attempt == _MOST_DAMAGED:
                    raise
        metadata = {
            "exposure_us": 100 * self._camera.get(cv2.CAP_PROP_EXPOSURE),
            "gain": self._camera.get(cv2.CAP_PROP_GAIN),
        } | described(form)
        encoding = choose_encoding(form.encoding(ENCODED_WHITE), counts, camera_encoding=self._camera_encoding)
        return Frame(counts, encoding, time.time(), index, metadata)

    def _colours(self, data: np.ndarray) -> tuple[np.ndarray, PictureFormat]:
        """Return R, G, B of a frame at the places of its chroma samples; raises InputError where it has no colours."""
        code = int(self._camera.get(cv2.CAP_PROP_FOURCC))
        kind = code.to_bytes(4, "little", signed=code < 0).decode("ascii", "replace")
        if kind == "MJPG":
            frame = decode_packet("mjpeg", data.tobytes())
            form = format_of_frame(frame, kind, siting="left").with_stated(self._stated)
            return counts_of_frame(frame, form)[0], form
        if data.ndim == 3 and data.shape[2] == 3:  # a driver that delivers colours of every pixel: B, G, R
            return data[..., ::-1].copy(), PictureFormat(kind, data.shape[1::-1], 8)
        if kind in _BYTES and data.ndim == 3:
            luma, chroma = (data[..., i] for i in _BYTES[kind])
            planes, factors = Planes(luma, chroma[:, ::2], chroma[:, 1::2]), (2, 1)
        elif kind == "NV12" and data.ndim == 2:
            height = data.shape[0] * 2 // 3
            planes, factors = Planes(data[:height], data[height:, ::2], data[height:, 1::2]), (2, 2)
        else:
            raise InputError(
                f"the webcam delivers frames in the format {kind}, which has no colours or is not read; "
                f"choose pixel_format={' or '.join(_FORMATS)}"
            )
        size = planes.luma.shape[1], planes.luma.shape[0]
        form = PictureFormat(kind, size, 8, factors, "left", LUMA_WEIGHTS[2], full_range=False)
        form = form.with_stated(self._stated)
        return rgb_of_planes(planes, form), form

    def close(self) -> None:
        """Release the webcam."""
        self._camera.release()


def webcams() -> list[str]:
    """List the video devices of this machine."""
    return [str(path).removeprefix("/dev/video") for path in sorted(Path("/dev").glob("video[0-9]*"))]
