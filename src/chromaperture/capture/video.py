"""A video file as a source, through the FFmpeg inside OpenCV."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2

from chromaperture.capture.source import Encoding, Event, FileSource, Frame, Listener
from chromaperture.errors import InputError

VIDEOS = {".avi", ".m4v", ".mjpeg", ".mkv", ".mov", ".mp4", ".mpg", ".ts", ".webm", ".y4m"}


class VideoSource(FileSource):
    """Frames of a clip, 8-bit sRGB. Most codecs halve the resolution of colour; FFV1 in 4:4:4 does not.

    Parameters
    ----------
    path : str
    listener : callable, optional
    """

    def __init__(self, path: str, *, listener: Listener | None = None) -> None:
        super().__init__(path, listener=listener)
        self._clip: cv2.VideoCapture | None = None

    def open(self) -> None:
        """Open the clip."""
        if not Path(self.name).is_file():
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
        promised, fps = int(clip.get(cv2.CAP_PROP_FRAME_COUNT)), clip.get(cv2.CAP_PROP_FPS) or 30.0
        index = 0
        while True:
            ok, bgr = clip.read()
            if not ok:
                break
            yield Frame(bgr[..., ::-1].copy(), Encoding(0.0, 255.0, "srgb"), index / fps, index, {})
            index += 1
        if index == 0:
            raise InputError(f"{self.name} holds no frame that can be decoded; record or convert it again")
        if index < promised:
            self.listener(Event("skipped", f"{self.name} ends after {index} of {promised} frames"))
