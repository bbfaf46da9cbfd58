"""The app's server: addresses, answers, and one measurement at a time."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable, Sequence
from functools import cache, partial
from importlib import resources
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar

import cv2

from chromaperture.app.assistant_routes import AssistantRoutes
from chromaperture.app.camera_feed import CameraFeed, CameraRoutes
from chromaperture.app.device_plan import color_tables
from chromaperture.app.gate import Access, Gate, Refused
from chromaperture.app.listening import require_extra
from chromaperture.app.messages import File, number, pack_frame, saved, whole
from chromaperture.app.state import DEPTH_INSIDE, AppState, split_file
from chromaperture.frame.frame_files import OUTPUTS
from chromaperture.optics.aperture import DESIGNS
from chromaperture.system.errors import ChromapertureError, InputError, lacks_memory

T = TypeVar("T")
UPLOADS = ("/api/frames", "/api/photos", "/api/cameras", "/api/sessions")  # whose bodies may be large
MOST_WAITING = 6  # measurements that wait for the one under way; more are told to come again
_TYPES = {
    ".html": "text/html; charset=utf-8", ".css": "text/css; charset=utf-8", ".js": "text/javascript; charset=utf-8",
    ".webmanifest": "application/manifest+json", ".png": "image/png", ".svg": "image/svg+xml",
}  # fmt: skip


class Busy(Exception):
    """More measurements wait than will be taken."""


class WorkQueue:
    """Give one task at a time to a thread, because the matcher uses all cores."""

    def __init__(self) -> None:
        self._lock, self._waiting = asyncio.Lock(), 0

    async def run(self, work: Callable[[], T]) -> T:
        """Run a task when it is its turn; raises Busy when too many wait."""
        if self._waiting >= MOST_WAITING:
            raise Busy
        self._waiting += 1
        try:
            async with self._lock:
                return await asyncio.to_thread(work)
        finally:
            self._waiting -= 1


@cache
def static_files() -> dict[str, tuple[bytes, str]]:
    """Return the files of the page with their types, by name; nothing else on the disk is ever served."""
    folder = resources.files("chromaperture.app") / "static"
    return {
        entry.name: (entry.read_bytes(), _TYPES[Path(entry.name).suffix])
        for entry in folder.iterdir()
        if Path(entry.name).suffix in _TYPES
    }


def page_file(name: str, *, live: bool = False) -> File:
    """Return a file of the page; of a live loop the page says so."""
    if name not in static_files():
        return File(b"there is no such page\n", "text/plain", status=404)
    content, kind = static_files()[name]
    if live and name == "index.html":
        content = content.replace(b"<html ", b"<html data-live ", 1)
    return File(content, kind, {"Cache-Control": "no-cache"})


async def page(request: Any) -> Any:
    """Return a file of the page."""
    return page_file(request.path_params.get("name") or "index.html")


async def colors(request: Any) -> Any:
    """Return the 257 colours of each map, the last for unknown pixels, so that every picture has the same."""
    return {n: t.tolist() for n, t in zip(("depth", "sigma"), color_tables(), strict=True)}


class Routes:
    """The answer to each address, without the token."""

    def __init__(self, app_state: AppState, certificate: Path | None = None) -> None:
        self.app_state, self.certificate = app_state, certificate
        self.queue = WorkQueue()
        self.is_calibrating: Callable[[], bool] = lambda: False

    async def about(self, request: Any) -> Any:
        """Return what the page needs to know at its start."""
        cameras = await self.queue.run(self.app_state.describe_cameras)
        return {
            "version": version("chromaperture"),
            "cameras": cameras,
            "designs": {name: design.title for name, design in DESIGNS.items() if design.views},
            "folder": str(self.app_state.folder),
            "certificate": self.certificate is not None,
        }  # fmt: skip

    async def add_camera(self, request: Any) -> Any:
        """Keep a camera file."""
        async with self.app_state.upload(request, ".asdf") as path:
            kept = partial(self.app_state.add_camera, request.query_params.get("name", "camera"), path)
            return {"name": await self.queue.run(kept)}

    async def camera(self, request: Any) -> Any:
        """Return a camera file."""
        path = self.app_state.camera_path(request.path_params["name"])
        return saved(path.read_bytes(), f"{path.stem}.asdf")

    async def plan(self, request: Any) -> Any:
        """Return the plan by which the page measures on its own device."""
        asked = request.query_params
        size = (whole(asked, "width"), whole(asked, "height"))
        exchange = asked.get("exchange", "shared")
        packed = await self.queue.run(partial(self.app_state.plan, request.path_params["name"], size, exchange))
        return packed

    async def points(self, request: Any) -> Any:
        """Return what makes points of the maps of a camera."""
        asked = request.query_params
        size, quality = (whole(asked, "width"), whole(asked, "height")), asked.get("quality", "real-time")
        packed = await self.queue.run(partial(self.app_state.points, request.path_params["name"], size, quality))
        return packed

    async def frame(self, request: Any) -> Any:
        """Measure one frame of the page's camera."""
        self._free()
        asked = request.query_params
        size = (whole(asked, "width"), whole(asked, "height"))
        data = await request.body()

        def work() -> bytes:
            began = time.perf_counter()
            frame, notes = self.app_state.measure_pixels(
                data, size, camera=asked.get("camera", ""), quality=asked.get("quality", "real-time")
            )
            return pack_frame(frame, {"seconds": time.perf_counter() - began, "notes": notes})

        return await self.queue.run(work)

    async def photo(self, request: Any) -> Any:
        """Measure a photograph's file."""
        self._free()
        asked = request.query_params
        async with self.app_state.upload(request, asked.get("name", "photo.png")) as path:
            right = None
            if "right" in asked:  # the body is two files, one after the other
                right = split_file(path, asked["right"], number(asked, "left_bytes"))

            def work() -> bytes:
                began = time.perf_counter()
                key, photo = self.app_state.measure_photo(
                    path, right=right, camera=asked.get("camera", ""), quality=asked.get("quality", "real-time")
                )
                facts = {
                    "seconds": time.perf_counter() - began, "notes": photo.notes, "photo": key,
                    "turn_degrees": photo.measured.turn_degrees, "f_number": photo.camera.calibration.lens.f_number,
                }  # fmt: skip
                return pack_frame(photo.measured.frame, facts)

            return await self.queue.run(work)

    def _free(self) -> None:
        """Refuse to measure beside a calibration: it uses all cores for minutes."""
        if self.is_calibrating():
            raise InputError("the computer is calibrating; it measures again when that is done")

    async def refocus(self, request: Any) -> Any:
        """Return a photograph with another focus and f-number."""
        asked = request.query_params
        at = (number(asked, "x"), number(asked, "y")) if "x" in asked else None

        def work() -> bytes:
            f_number = number(asked, "f_number") if "f_number" in asked else None
            picture = self.app_state.refocused(
                request.path_params["photo"], at=at, f_number=f_number,
                background=asked.get("background", "keep"), sharpness=asked.get("sharpness", "preview"),
            )  # fmt: skip
            return bytes(cv2.imencode(".png", picture[..., ::-1])[1])

        return File(await self.queue.run(work), "image/png")

    async def photo_files(self, request: Any) -> Any:
        """Return the files of a photograph."""
        key = request.path_params["photo"]
        packed = await self.queue.run(partial(self.app_state.photo_files, key))
        return saved(packed, f"{self.app_state.photo(key).measured.stem}.zip", "application/zip")

    async def embedded(self, request: Any) -> Any:
        """Return a photograph with its depth inside."""
        key = request.path_params["photo"]
        output = request.query_params.get("format", DEPTH_INSIDE[0])
        content = await self.queue.run(partial(self.app_state.with_depth_inside, key, output))
        name = self.app_state.photo(key).measured.stem + OUTPUTS[output].suffix
        return saved(content, name, "image/jpeg")

    async def trust(self, request: Any) -> Any:
        """Return the certificate, which a phone is told to trust."""
        if self.certificate is None:
            return File(b"this server needs no certificate\n", "text/plain", status=404)
        return saved(self.certificate.read_bytes(), "chromaperture.crt", "application/x-x509-ca-cert")


def json_errors(answer: Callable[[Any], Awaitable[Any]]) -> Callable[[Any], Awaitable[Any]]:
    """Make an answer of bytes, a `File`, or plain values as JSON, and a sentence of what is raised on purpose."""

    async def with_sentence(request: Any) -> Any:
        from starlette.responses import JSONResponse, Response

        try:
            given = await answer(request)
            if isinstance(given, bytes):
                given = File(given)
            if isinstance(given, File):
                return Response(given.content, given.status, given.headers, given.kind)
            return JSONResponse(given)
        except Refused as refused:  # by the size or the time of its body; the rest of it is not read
            more = {"Connection": "close"}
            return JSONResponse({"error": str(refused)}, status_code=int(refused.status), headers=more)
        except Busy:
            line, status = "the computer is still measuring; it will take the next picture in a moment", 503
        except ChromapertureError as error:
            line, status = " ".join(str(error).split()), 400
        except OSError as error:
            line, status = f"the computer reports: {error.strerror or error}; free some space or choose --out", 507
        except Exception as error:
            if not lacks_memory(error):
                raise
            line, status = "the computer has not enough memory for this; choose a smaller picture", 507
        return JSONResponse({"error": line}, status_code=status)

    return with_sentence


def make_app(
    app_state: AppState, access: Access, *, certificate: Path | None = None, feeds: Sequence[CameraFeed] = ()
) -> Gate:
    """Put the server's application together, behind its checks; raises MissingDependencyError."""
    require_extra()
    from starlette.applications import Starlette
    from starlette.routing import Route

    answers = Routes(app_state, certificate)
    cameras = CameraRoutes(feeds)
    assistant = AssistantRoutes(app_state, answers.queue, cameras)
    answers.is_calibrating = assistant.is_calibrating
    table = [
        *assistant.table(),
        *cameras.table(),
        ("GET", "/api/about", answers.about),
        ("GET", "/api/colors", colors),
        ("GET", "/api/certificate", answers.trust),
        ("POST", "/api/cameras", answers.add_camera),
        ("GET", "/api/cameras/{name}", answers.camera),
        ("GET", "/api/cameras/{name}/plan", answers.plan),
        ("GET", "/api/cameras/{name}/points", answers.points),
        ("POST", "/api/frames", answers.frame),
        ("POST", "/api/photos", answers.photo),
        ("GET", "/api/photos/{photo}/refocused", answers.refocus),
        ("GET", "/api/photos/{photo}/files", answers.photo_files),
        ("GET", "/api/photos/{photo}/embedded", answers.embedded),
        ("GET", "/", page),
        ("GET", "/{name}", page),
    ]
    routes = [Route(path, json_errors(answer), methods=[method]) for method, path, answer in table]
    return Gate(Starlette(routes=routes), access, uploads=UPLOADS)
