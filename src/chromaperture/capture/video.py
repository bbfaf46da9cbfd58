"""A video file as a source, through the FFmpeg inside OpenCV."""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import Any

import cv2

from chromaperture.capture.source import Event, FileSource, Frame, Listener, checked_fps, choose_encoding
from chromaperture.color.encoding import Encoding, format_encoding
from chromaperture.errors import InputError


class VideoSource(FileSource):
    """Frames of a clip, 8-bit sRGB. Most codecs halve the resolution of colour; FFV1 in 4:4:4 does not.

    Parameters
    ----------
    path : str
    fps : float, optional
        For the times of the frames; default the clip's.
    black_level, white_level : float, optional
        Of linear counts; without them, counts are sRGB.
    camera_encoding : Encoding, optional
        See `choose_encoding`.
    listener : callable, optional
    """

    def __init__(
        self,
        path: str,
        *,
        fps: float | None = None,
        black_level: float | None = None,
        white_level: float | None = None,
        camera_encoding: Encoding | None = None,
        listener: Listener | None = None,
    ) -> None:
        super().__init__(path, listener=listener)
        self.fps = None if fps is None else checked_fps(fps)
        self.levels: dict[str, Any] = {"black_level": black_level, "white_level": white_level}
        self.levels["camera_encoding"] = camera_encoding
        self._clip: cv2.VideoCapture | None = None

    def open(self) -> None:
        """Open the clip."""
        if not os.path.isfile(self.name):
            raise InputError(f"no video at {self.name}")
        self._clip = cv2.VideoCapture(self.name, cv2.CAP_FFMPEG)
        if not self._clip.isOpened():
            raise InputError(
                f"{self.name} is damaged or not a video that FFmpeg reads; convert it, for instance to FFV1"
            )

    def close(self) -> None:
        """Close the clip."""
        if self._clip is not None:
            self._clip.release()
        self._clip = None

    def frames(self) -> Iterator[Frame]:
        """Yield all frames; report when there are fewer than the file declares."""
        clip = self._clip
        if clip is None:
            raise InputError(f"{self.name} is not open: use the source in a with statement")
        promised = int(clip.get(cv2.CAP_PROP_FRAME_COUNT))
        fps = self.fps or clip.get(cv2.CAP_PROP_FPS) or 30.0
        index = 0
        while True:
            ok, bgr = clip.read()
            if not ok:
                break
            encoding = choose_encoding(format_encoding(bgr.dtype), bgr, **self.levels)
            yield Frame(bgr[..., ::-1].copy(), encoding, index / fps, index, {})
            index += 1
        if index == 0:
            raise InputError(f"{self.name} holds no frame that can be decoded; record or convert it again")
        if index < promised:
            self.listener(Event("skipped", f"{self.name} ends after {index} of {promised} frames"))
