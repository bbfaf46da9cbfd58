"""Cameras that the computer itself holds, for the page: one frame at a time, and never one that it did not ask for."""

from __future__ import annotations

import asyncio
import math
import threading
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from chromaperture.app.messages import File
from chromaperture.app.session_folder import SessionFolder
from chromaperture.capture.open import open_source
from chromaperture.capture.source import Event, Frame
from chromaperture.color.encoding import CENTRED, Encoding, develop_counts
from chromaperture.color.srgb import linear_to_srgb_bytes
from chromaperture.system.errors import ChromapertureError, InputError

_WAIT_S = 8.0  # for a frame: a tethered camera takes and sends a RAW file in some 4 s; chosen by hand
_IDLE_S = 60.0  # without a request, after which the camera is released for other programs; chosen by hand
_PREVIEW_PX = 960  # most columns of a preview: more than a phone shows; chosen by hand
_JPEG_QUALITY = 85
_LEAST_SPAN = 250.0  # counts from black to white below which rounding to whole counts would add noise
_WIDE = (2048.0, 63488.0)  # levels that such counts are stored with: room for noise below black and above white


class CameraFeed:
    """One source of `capture/`, opened when the page first asks for a picture, and released when it asks no more.

    Live cameras give their newest frame. All others give the next one when asked for it, so that a tethered camera
    takes no photograph by itself. ``spec``, as for ``chromaperture live``, is from the command line, never from a page;
    raises InputError for an unknown one.
    """

    def __init__(self, spec: str, *, wait_s: float = _WAIT_S, idle_s: float = _IDLE_S) -> None:
        self.spec, self.wait_s, self.idle_s = spec, wait_s, idle_s
        source = open_source(spec)
        self.live = source.live
        self.name = _shown_name(spec)
        self._state = threading.Condition()
        self._turn = threading.Lock()  # one request at a time
        self._thread: threading.Thread | None = None
        self._source: Any = None
        self._frame: Frame | None = None
        self._count, self._wanted, self._asked_s = 0, 0, 0.0
        self._leave = False
        self._failure = self._event = ""

    def next_frame(self) -> Frame:
        """Return the newest frame of a live camera, the next one of another source; raises InputError without one."""
        if not self._turn.acquire(timeout=self.wait_s):
            raise InputError(f"{self.name} is still busy with the picture before; try again")
        try:
            with self._state:
                leaving = self._thread if self._leave else None
            if leaving is not None:
                leaving.join(timeout=self.wait_s)
            with self._state:
                self._wanted, self._asked_s = self._count + 1, math.inf  # not idle while somebody waits
                if self._thread is None or not self._thread.is_alive():
                    self._begin()
                self._state.notify_all()
                self._state.wait_for(self._is_answered, timeout=self.wait_s)
                if self._count >= self._wanted and self._frame is not None:
                    return self._frame
                failure, self._failure = self._failure, ""
                raise InputError(
                    failure or f"{self.name} gives no picture{self._event}; is it connected and switched on?"
                )
        finally:
            with self._state:
                self._wanted, self._asked_s = self._count, time.monotonic()
            self._turn.release()

    def shown_frame(self) -> Frame:
        """Return the frame that the page saw last, of a live camera a new one; raises like `next_frame`."""
        with self._state:
            frame = self._frame
        return self.next_frame() if self.live or frame is None else frame

    def close(self) -> None:
        """Release the camera; the next request opens it again."""
        with self._state:
            self._leave, thread, source = True, self._thread, self._source
            self._state.notify_all()
        if hasattr(source, "stop"):
            source.stop()
        if thread is not None:
            thread.join(timeout=self.wait_s)

    def _is_answered(self) -> bool:
        return self._count >= self._wanted or bool(self._failure)

    def _begin(self) -> None:
        self._leave, self._failure, self._event, self._frame = False, "", "", None
        self._thread = threading.Thread(target=self._run, name=f"feed {self.name}", daemon=True)
        self._thread.start()

    def _on_event(self, event: Event) -> None:
        with self._state:
            self._event = "" if event.kind == "reconnected" else f" ({event.message})"

    def _run(self) -> None:
        ended = f"{self.name} has no more pictures; asked again, it begins anew"
        watch = threading.Thread(target=self._release_when_idle, name=f"idle {self.name}", daemon=True)
        try:
            with open_source(self.spec, listener=self._on_event) as source:
                with self._state:
                    self._source = source
                watch.start()
                for frame in source:
                    with self._state:
                        self._frame, self._count = frame, self._count + 1
                        self._state.notify_all()
                        if not source.live:
                            self._state.wait_for(lambda: self._leave or self._wanted > self._count)
                        if self._leave:
                            return
        except ChromapertureError as error:
            ended = " ".join(str(error).split())
        except Exception as error:  # drivers raise anything; the page is told, and the server goes on
            ended = f"{self.name} failed ({type(error).__name__}: {error}); connect it again"
        finally:
            with self._state:
                self._source, self._frame = None, None
                if not self._leave:
                    self._failure = ended
                self._leave = True
                self._state.notify_all()

    def _release_when_idle(self) -> None:
        while True:
            with self._state:
                if self._state.wait_for(lambda: self._leave, timeout=min(max(self._rest_s(), 0.01), self.idle_s)):
                    return
                if self._rest_s() > 0:
                    continue
                self._leave, source = True, self._source
                self._state.notify_all()
            if hasattr(source, "stop"):
                source.stop()
            return

    def _rest_s(self) -> float:
        return self._asked_s + self.idle_s - time.monotonic()


def _shown_name(spec: str) -> str:
    """Return a source's name without the folders that lead to it."""
    text, kind = spec.partition("?")[0], spec.partition(":")[0]
    if kind in ("replay", "simulate"):
        return f"{kind}:{Path(text.partition(':')[2]).name}"
    return text if kind in ("webcam", "aravis", "pylon", "gentl", "picamera2", "gphoto2") else Path(text).name or text


def preview_jpeg(frame: Frame) -> bytes:
    """Return a frame as exposed, in sRGB and no more than 960 columns, as JPEG."""
    step = -(-frame.counts.shape[1] // _PREVIEW_PX)
    some = np.ascontiguousarray(frame.counts[::step, ::step])
    light = develop_counts(some, replace(frame.encoding, channel_offsets_px=CENTRED))
    picture = linear_to_srgb_bytes(light)[..., ::-1]
    return bytes(cv2.imencode(".jpg", picture, (cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY))[1])


def write_frame(frame: Frame, path: Path, session: SessionFolder) -> None:
    """Write a frame as a PNG of a session, which states the levels of frames that are no 8-bit sRGB."""
    encoding, facts = frame.encoding, session.facts
    if facts.white_level is None and not session.shots and encoding.curve != "srgb":
        session.use_levels(*_levels(encoding))
        facts = session.facts
    if facts.white_level is not None:
        black, white = facts.black_level or 0.0, facts.white_level
    else:
        black, white = 0.0, 65535.0
    if facts.white_level is None and (session.is_encoded or not session.shots):
        is_srgb = encoding.curve == "srgb" and frame.counts.dtype == np.uint8
        counts = frame.counts if is_srgb else linear_to_srgb_bytes(frame.image)
    else:
        counts = np.rint(black + frame.image * (white - black)).clip(0, 65535).astype(np.uint16)
    path.write_bytes(bytes(cv2.imencode(".png", np.ascontiguousarray(counts[..., ::-1]))[1]))


def _levels(encoding: Encoding) -> tuple[float, float]:
    """Return the levels of linear frames: the sensor's, of which superpixels hold twice, or wider ones."""
    factor = 1 if encoding.channel_offsets_px == CENTRED else 2
    black, white = encoding.black_level / factor, encoding.white_level / factor
    return (black, white) if white - black >= _LEAST_SPAN and black >= 0 and white <= 65535 else _WIDE


class CameraRoutes:
    """The answer to each address of the cameras that the command line names: a page chooses one by its number."""

    def __init__(self, feeds: Sequence[CameraFeed] = ()) -> None:
        self.feeds = tuple(feeds)

    def table(self) -> list[tuple[str, str, Any]]:
        """Return method, address and answer of each."""
        return [
            ("GET", "/api/sources", self.sources),
            ("GET", "/api/sources/{number}/picture", self.picture),
            ("DELETE", "/api/sources/{number}", self.release),
        ]

    def feed(self, number: str) -> CameraFeed:
        """Return a camera by its number; raises InputError for one that is not there."""
        if not (number.isascii() and number.isdigit() and len(number) < 4 and int(number) < len(self.feeds)):
            raise InputError("this computer has no such camera: start 'chromaperture serve' with --source")
        return self.feeds[int(number)]

    async def sources(self, request: Any) -> Any:
        """List them."""
        return [{"name": feed.name, "live": feed.live} for feed in self.feeds]

    async def picture(self, request: Any) -> Any:
        """Return the newest picture of a live camera, the next one of another."""
        feed = self.feed(request.path_params["number"])
        content = await asyncio.to_thread(lambda: preview_jpeg(feed.next_frame()))
        return File(content, "image/jpeg")

    async def release(self, request: Any) -> Any:
        """Release a camera for other programs."""
        await asyncio.to_thread(self.feed(request.path_params["number"]).close)
        return {}
