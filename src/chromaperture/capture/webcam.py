"""Webcams through V4L2."""

from __future__ import annotations

import time
from pathlib import Path

import cv2

from chromaperture.capture.source import Frame, choose_encoding
from chromaperture.capture.threaded_source import DeviceLostError, not_there
from chromaperture.color.encoding import Encoding, format_encoding
from chromaperture.errors import InputError


class Webcam:
    """An opened webcam, with automatic focus and white balance off, and automatic exposure off if one is given.

    Parameters
    ----------
    device : str
        Number or path: "0", "/dev/video0".
    width, height : int, optional
    fps : float, optional
    exposure_us, gain : float, optional
    camera_encoding : Encoding, optional
        See `choose_encoding`.
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
        camera_encoding: Encoding | None = None,
    ) -> None:
        self._camera_encoding = camera_encoding
        path = f"/dev/video{device}" if device.isdigit() else device
        if not Path(path).exists():
            raise not_there(f"webcam {device}", f"there is no {path}")
        self._camera = cv2.VideoCapture(path, cv2.CAP_V4L2)
        if not self._camera.isOpened():
            raise not_there(f"webcam {device}", "another program uses it, or you may not (group video)")
        wanted = {
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
        ok, bgr = self._camera.read()
        if not ok:
            raise DeviceLostError("unplugged?")
        if bgr.ndim != 3 or bgr.shape[2] != 3:
            raise InputError("the webcam delivers grey frames; depth is in the colours, so choose a colour format")
        metadata = {
            "exposure_us": 100 * self._camera.get(cv2.CAP_PROP_EXPOSURE),
            "gain": self._camera.get(cv2.CAP_PROP_GAIN),
        }
        counts = bgr[..., ::-1].copy()
        encoding = choose_encoding(format_encoding(counts.dtype), counts, camera_encoding=self._camera_encoding)
        return Frame(counts, encoding, time.time(), index, metadata)

    def close(self) -> None:
        """Release the webcam."""
        self._camera.release()


def webcams() -> list[str]:
    """List the video devices of this machine."""
    return [str(path).removeprefix("/dev/video") for path in sorted(Path("/dev").glob("video[0-9]*"))]
