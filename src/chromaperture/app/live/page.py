"""The app's page in front of a live loop, served to its owner."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

from chromaperture.app.device_plan import make_points
from chromaperture.app.gate import Access, Gate
from chromaperture.app.listening import NEXT_PORTS, make_server, require_extra
from chromaperture.app.live.loop import LiveLoop
from chromaperture.app.live.view import LiveView
from chromaperture.app.messages import File, number, whole
from chromaperture.app.server import colors, json_errors, page_file
from chromaperture.depth.error_limit import MAX_RELATIVE_SIGMA
from chromaperture.model.scale import resized

_PATIENCE_S = 1.0  # that a request waits for the next frame, chosen by hand: the page asks again
_LOOK_S = 0.02  # between two looks whether there is one, chosen by hand
_START_S, _END_S = 20.0, 5.0  # for the server; chosen by hand


class LivePage:
    """A view of a loop and the server of its page, at ``url``, which holds a random token."""

    def __init__(
        self, loop: LiveLoop, *, host: str, port: int, out: Path, max_relative_sigma: float = MAX_RELATIVE_SIGMA
    ) -> None:
        require_extra()
        self.loop, self.access = loop, Access(host)
        self.view = LiveView(loop, out=out, max_relative_sigma=max_relative_sigma)
        ready = threading.Event()
        application = make_live_app(self.view, self.access)
        self._server = make_server(application, host=host, port=port, ports=NEXT_PORTS, ready=ready.set)
        self.port: int = self._server.port
        self.url = self.access.url(self.port)
        self._thread = threading.Thread(target=self._server.run, name="page", daemon=True)
        self._thread.start()
        ready.wait(_START_S)

    def run(self, *, until: Callable[[], bool] = lambda: False) -> None:
        """Show frames until the loop ends or ``until`` returns true."""
        self.view.run(until=until)

    def close(self) -> None:
        """Stop serving."""
        self._server.should_exit = True
        self._thread.join(_END_S)


class LiveRoutes:
    """The answer to each address of the page of a live loop, without the token."""

    def __init__(self, view: LiveView) -> None:
        self.view = view

    def table(self) -> list[tuple[str, str, Any]]:
        """Return method, address and answer of each."""
        return [
            ("GET", "/api/colors", colors),
            ("GET", "/api/live", self.about),
            ("GET", "/api/live/frame", self.frame),
            ("GET", "/api/live/state", self.state),
            ("GET", "/api/live/mesh", self.mesh),
            ("POST", "/api/live/focus", self.focus),
            ("POST", "/api/live/record", self.record),
            ("POST", "/api/live/pause", self.pause),
            ("POST", "/api/live/snapshot", self.snapshot),
            ("GET", "/api/cameras/live/points", self.points),
            ("GET", "/", self.page),
            ("GET", "/{name}", self.page),
        ]

    async def page(self, request: Any) -> Any:
        """Return a file of the page, which begins with the live loop."""
        return page_file(request.path_params.get("name") or "index.html", live=True)

    async def about(self, request: Any) -> Any:
        """Return what the page needs to know at its start."""
        return {"version": version("chromaperture"), **self.view.about()}

    async def frame(self, request: Any) -> Any:
        """Return the newest frame, once it is another than the page has; 204 where there is none for a while."""
        seen, end = whole(request.query_params, "after"), time.monotonic() + _PATIENCE_S
        self.view.asked()
        while self.view.number == seen or not self.view.message:
            if time.monotonic() > end:
                return File(b"", None, status=204)
            await asyncio.sleep(_LOOK_S)
        return self.view.message

    async def state(self, request: Any) -> Any:
        """Return what is shown beside the pictures."""
        return await asyncio.to_thread(self.view.state)

    async def mesh(self, request: Any) -> Any:
        """Return the growing model."""
        packed = await asyncio.to_thread(self.view.mesh_message)
        return packed

    async def points(self, request: Any) -> Any:
        """Return what makes points of the maps."""
        camera = self.view.loop.camera
        size = (whole(request.query_params, "width"), whole(request.query_params, "height"))
        packed = make_points(resized(camera.calibration, *size), camera.config.quality)
        return packed

    async def focus(self, request: Any) -> Any:
        """Focus the colours elsewhere, or, without a distance, show them as they are."""
        asked = request.query_params
        if "distance_mm" in asked:
            self.view.focus_at(number(asked, "distance_mm"), number(asked, "pupil"))
        else:
            self.view.focus = None
        return await self.state(request)

    async def record(self, request: Any) -> Any:
        """Begin or finish a recording."""
        await asyncio.to_thread(self.view.record, bool(whole(request.query_params, "on")))
        return await self.state(request)

    async def pause(self, request: Any) -> Any:
        """Pause, or go on."""
        self.view.pause(bool(whole(request.query_params, "on")))
        return await self.state(request)

    async def snapshot(self, request: Any) -> Any:
        """Write the maps of the newest frame."""
        await asyncio.to_thread(self.view.snapshot, number(request.query_params, "percent"))
        return await self.state(request)


def make_live_app(view: LiveView, access: Access) -> Gate:
    """Put the application together, behind its checks."""
    from starlette.applications import Starlette
    from starlette.routing import Route

    routes = [Route(path, json_errors(answer), methods=[method]) for method, path, answer in LiveRoutes(view).table()]
    return Gate(Starlette(routes=routes), access)
