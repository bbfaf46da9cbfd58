"""The addresses of the cameras that the computer itself holds."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from typing import Any

from chromaperture.app.camera_feed import CameraFeed, preview_jpeg
from chromaperture.system.errors import InputError


class CameraAnswers:
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
        from starlette.responses import JSONResponse

        return JSONResponse([{"name": feed.name, "live": feed.live} for feed in self.feeds])

    async def picture(self, request: Any) -> Any:
        """Return the newest picture of a live camera, the next one of another."""
        from starlette.responses import Response

        feed = self.feed(request.path_params["number"])
        content = await asyncio.to_thread(lambda: preview_jpeg(feed.next_frame()))
        return Response(content, media_type="image/jpeg", headers={"Cache-Control": "no-store"})

    async def release(self, request: Any) -> Any:
        """Release a camera for other programs."""
        from starlette.responses import JSONResponse

        await asyncio.to_thread(self.feed(request.path_params["number"]).close)
        return JSONResponse({})
