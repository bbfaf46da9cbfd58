"""Send what the live loop measures to robotics tools, beside the page or without it."""

from __future__ import annotations

import threading
from typing import Self

from chromaperture.app.live.loop import LiveLoop, Measured, one_line
from chromaperture.app.live.slots import Slot
from chromaperture.products.foxglove_stream import FoxgloveStream
from chromaperture.products.rectified import undistorter

_JOIN_S = 5.0  # for the last message at the end; chosen by hand


class Streaming:
    """Take every measurement of a loop and send it; a context manager entered before the loop runs.

    A live source is never slowed down: frames that come faster than they are sent are left out.
    """

    def __init__(self, loop: LiveLoop, stream: FoxgloveStream) -> None:
        self.loop, self.stream = loop, stream
        self._slot = loop.to_stream = Slot[Measured]()
        self._thread = threading.Thread(target=self._run, name="stream", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._slot.close()
        self._thread.join(timeout=_JOIN_S)

    def _run(self) -> None:
        to_view, posed = None, None
        while (item := self._slot.take()) is not None:
            try:
                to_view = to_view or undistorter(self.loop.camera)  # by now it has the size of the frames
                self.stream.send(to_view(item.measurement, item.frame.time_s, item.frame.index))
                placed = self.loop.placed
                if placed is not None and placed.pose is not None and placed is not posed:
                    self.stream.send_pose(placed.pose, placed.time_s)
                    posed = placed
            except Exception as error:  # of one frame, or of the disk: the loop goes on
                self.loop.say_rarely(f"frame {item.frame.index} was not streamed: {one_line(error)}")
