"""Files played like a live camera: frames arrive at their times, whether they are read or not."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace

from chromaperture.capture.source import FileSource, Frame, Listener
from chromaperture.capture.threaded_source import LiveSource, StreamEndedError
from chromaperture.system.errors import InputError

_KEPT_BYTES = 512 << 20  # frames of a loop that are cached: 290 of VGA in 16 bits
_INTERVAL_S = 1 / 30  # of a loop of one picture: the frame rate that other sources assume
_LONGEST_WAIT_S = 5.0  # a gap of the recording lasts no longer: closing waits for it. Chosen by hand, not tuned


class Playback:
    """A device that plays a file source.

    Parameters
    ----------
    source : FileSource
    speed : float
        1 is the recorded speed; inf is as fast as frames can be read.
    loop : bool
        Restart at the end; frames are cached if they fit into half a gigabyte.
    """

    def __init__(self, source: FileSource, *, speed: float, loop: bool) -> None:
        self._source, self._speed, self._loop = source, speed, loop
        source.__enter__()
        self._frames: Iterator[Frame] = source.frames()
        self._kept: list[Frame] = []
        self._keeping = loop  # in the first round, while there is room
        self._due = time.monotonic()  # when the last frame was to be delivered
        self._is_first = True
        self._last_s, self._interval_s, self._rest_s = 0.0, _INTERVAL_S, 0.0  # the last frame of a round lasts too

    def read(self, index: int) -> Frame | None:
        """Wait for the next frame's time."""
        frame = self._next()
        step_s = frame.time_s - self._last_s
        if self._is_first:
            self._is_first, self._due, step_s = False, time.monotonic(), self._rest_s
        elif step_s > 0:
            self._interval_s = min(step_s, _LONGEST_WAIT_S)
        self._last_s = frame.time_s
        # Step by step: a clock that was set during the recording, by a day or back, must not delay all that follows.
        self._due += min(max(step_s / self._speed, 0.0), _LONGEST_WAIT_S)
        time.sleep(max(0.0, self._due - time.monotonic()))
        return replace(frame, index=index, time_s=time.time())

    def _next(self) -> Frame:
        for _ in range(2):
            frame = next(self._frames, None)
            if frame is not None:
                self._keep(frame)
                return frame
            if not self._loop:
                break
            self._frames, self._keeping, self._is_first = iter(self._kept or self._source.frames()), False, True
            self._rest_s = self._interval_s
        raise StreamEndedError

    def _keep(self, frame: Frame) -> None:
        if self._keeping:
            self._kept.append(frame)
            if len(self._kept) * frame.counts.nbytes > _KEPT_BYTES:
                self._kept, self._keeping = [], False

    def close(self) -> None:
        """Close the files."""
        self._source.close()


def played(
    source: FileSource, *, speed: float = 1.0, loop: bool = False, listener: Listener | None = None
) -> LiveSource:
    """Make a live source of files: the newest frame wins.

    Raises
    ------
    InputError
        A speed that is not positive.
    """
    if not speed > 0:
        raise InputError(f"the speed of playback must be positive, got {speed:g}")
    return LiveSource(source.name, lambda: Playback(source, speed=speed, loop=loop), listener=listener)
