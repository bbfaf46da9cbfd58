"""The addresses of the calibration assistant."""

from __future__ import annotations

import asyncio
import json
import shutil
import threading
import time
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from chromaperture.app.assistant import check_shot, shown_check, state
from chromaperture.app.camera_feed import CameraRoutes, write_frame
from chromaperture.app.free_space import require_space
from chromaperture.app.messages import File, number, whole
from chromaperture.app.session_folder import Holding, Kind, SessionFolder
from chromaperture.app.state import NAME, AppState
from chromaperture.calibration.calibrate_session import calibrate_session
from chromaperture.calibration.options import CalibrationConfig
from chromaperture.evaluation.report import write_report
from chromaperture.evaluation.verdict import sentences, unusable, with_accurate_noise
from chromaperture.system.errors import ChromapertureError, InputError, lacks_memory
from chromaperture.system.validation import checked

if TYPE_CHECKING:
    from chromaperture.app.server import WorkQueue

_MOST_SESSIONS = 200  # chosen by hand
_KINDS = get_args(Kind)
# Of the report: it has its styles inside, and no script.
_REPORT = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; frame-ancestors 'none'; base-uri 'none'"


class _Stopped(Exception):
    pass


@dataclass
class CalibrationJob:
    """One run."""

    folder: Path  # the session
    camera: Path  # to write, as the report
    report: Path
    lens_blur: bool = True  # fit the blur of the lens, which takes most of the time
    holding: Holding | None = None  # of the device that took the photographs; the camera file keeps it
    step: str = "starting"
    done: int = 0
    total: int = 0
    error: str = ""
    result: dict[str, Any] = field(default_factory=dict)
    began: float = field(default_factory=time.monotonic)
    _stop: threading.Event = field(default_factory=threading.Event)
    _thread: threading.Thread | None = None

    def start(self) -> None:
        """Begin; `as_shown` tells how far it is."""
        self._thread = threading.Thread(target=self._run, name="calibration", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End it at the next step; what is measured is kept for the next run."""
        self._stop.set()

    @property
    def is_running(self) -> bool:
        """Whether it works."""
        return self._thread is not None and self._thread.is_alive()

    def as_shown(self) -> dict[str, Any]:
        """Return what the page shows."""
        return {
            "running": self.is_running,
            "step": self.step,
            "done": self.done,
            "total": self.total,
            "seconds": round(time.monotonic() - self.began, 1),
            "error": self.error,
            "result": self.result if not self.is_running else {},
        }

    def wait(self) -> None:
        """Wait until it has ended."""
        if self._thread is not None:
            self._thread.join()

    def _progress(self, what: str, done: int, total: int) -> None:
        if self._stop.is_set():
            raise _Stopped
        self.step, self.done, self.total = what, done, total

    def _run(self) -> None:
        kept = self.camera.parent / f".{self.camera.stem}.calibrating"
        try:
            config = CalibrationConfig(lens_blur=self.lens_blur)
            command = f"chromaperture calibrate {self.folder.name}"
            result = calibrate_session(self.folder, config, command=command, progress=self._progress, keep_in=kept)
            result = with_accurate_noise(result, progress=self._progress)
            self.step = "report"
            write_report(self.report, result)
            camera = result.camera
            if self.holding is not None:
                camera = replace(camera, provenance={**camera.provenance, "holding": self.holding.model_dump()})
            camera.save(self.camera)
            shutil.rmtree(kept, ignore_errors=True)
            self.result = {
                "camera": self.camera.stem,
                "unusable": unusable(result),
                "sentences": [{"text": s.text, "tone": s.tone} for s in sentences(result)],
                "summary": {
                    "focal_length_mm": float(result.camera.lens.focal_length_mm),
                    "in_focus": result.camera.in_focus_text,
                    "baseline_mm": float(result.camera.baseline_mm),
                },
            }
        except _Stopped:
            self.error = "stopped; it goes on from here when it is started again"
        except ChromapertureError as error:
            self.error = " ".join(str(error).split())
        except Exception as error:
            if lacks_memory(error):
                self.error = "the computer has not enough memory for this calibration; close other programs"
            else:
                self.error = f"the calibration failed ({type(error).__name__}: {error}); please report this"


class AssistantRoutes:
    """The answer to each address of the assistant."""

    def __init__(self, app_state: AppState, queue: WorkQueue, cameras: CameraRoutes | None = None) -> None:
        self.app_state, self.queue, self.cameras = app_state, queue, cameras or CameraRoutes()
        self.jobs: dict[str, CalibrationJob] = {}

    def table(self) -> list[tuple[str, str, Any]]:
        """Return method, address and answer of each."""
        one = "/api/sessions/{name}"
        return [
            ("GET", "/api/sessions", self.sessions),
            ("POST", "/api/sessions", self.create),
            ("GET", one, self.session),
            ("POST", f"{one}/shots", self.shot),
            ("DELETE", f"{one}/shots/{{kind}}/{{file}}", self.remove),
            ("POST", f"{one}/calibration", self.calibrate),
            ("GET", f"{one}/calibration", self.progress),
            ("DELETE", f"{one}/calibration", self.stop),
            ("GET", f"{one}/report", self.report),
        ]

    def folder(self, name: str) -> Path:
        """Return a session's folder; raises InputError for a name that could lead elsewhere."""
        if not NAME.fullmatch(name):
            raise InputError("a session's name has letters, digits, - and _ only, 60 at most")
        return self.app_state.folder / "sessions" / name

    def is_calibrating(self) -> bool:
        """Whether a calibration runs."""
        return any(job.is_running for job in self.jobs.values())

    async def sessions(self, request: Any) -> Any:
        """List the sessions."""
        return await asyncio.to_thread(self._names)

    def _names(self) -> list[str]:
        folders = (self.app_state.folder / "sessions").iterdir()
        return sorted(p.name for p in folders if NAME.fullmatch(p.name) and (p / "assistant.json").is_file())

    async def create(self, request: Any) -> Any:
        """Begin a session."""
        asked = await _json(request)
        folder = self.folder(str(asked.get("name", "")))
        if len(self._names()) >= _MOST_SESSIONS:
            raise InputError(f"there are {_MOST_SESSIONS} sessions already; remove some from {folder.parent}")
        require_space(folder, 0, self.app_state.reserve_bytes)
        made = await self.queue.run(partial(SessionFolder.create, folder, asked.get("facts")))
        return await self.queue.run(partial(state, made))

    async def session(self, request: Any) -> Any:
        """Return the state of a session."""
        folder = self.folder(request.path_params["name"])
        return await self.queue.run(lambda: state(_opened(folder)))

    async def shot(self, request: Any) -> Any:
        """Check a photograph; keep it where the page asks for that and no check warns, or it insists."""
        asked = request.query_params
        kind, folder = asked.get("kind", ""), self.folder(request.path_params["name"])
        if kind not in _KINDS:
            raise InputError("a photograph is of a board, of a tilted board or of a white sheet")
        ruler = number(asked, "ruler_mm") if asked.get("ruler_mm") else None
        exposure = number(asked, "exposure_ms") if asked.get("exposure_ms") else None
        sheet, keep, holding = asked.get("sheet", ""), asked.get("keep", ""), _holding(asked)
        if self.is_calibrating():
            raise InputError("the computer is calibrating; photographs are taken again when it is done")

        frame = None
        if "source" in asked:  # of a camera of the computer; nothing is sent
            frame = await asyncio.to_thread(self.cameras.feed(asked["source"]).shown_frame)
            taken_us = frame.metadata.get("exposure_us")
            exposure = exposure or (float(taken_us) / 1000 if taken_us else None)
        async with self.app_state.upload(request, asked.get("name", "photo.png"), is_sent=frame is None) as path:

            def work() -> dict[str, Any]:
                session = _opened(folder)
                if frame is not None:
                    write_frame(frame, path, session)
                found = check_shot(session, path, kind, ruler_mm=ruler, sheet=sheet, exposure_ms=exposure)
                kept = keep == "always" or (keep == "good" and found.is_usable)
                file = None
                if kept:
                    file = session.keep(path, kind, found.reading, found.checks, sheet=sheet, holding=holding).file
                corners = found.reading.corners_px
                working = session.session()
                return {
                    "kept": file,
                    "usable": found.is_usable,
                    "checks": [shown_check(check) for check in found.checks],
                    "corners": [] if corners is None or working is None else (
                        corners / [working.sensor.width_px, working.sensor.height_px]
                    ).round(5).tolist(),
                    "state": state(session),
                }  # fmt: skip

            return await self.queue.run(work)

    async def remove(self, request: Any) -> Any:
        """Delete a kept photograph."""
        asked = request.path_params
        folder, file = self.folder(asked["name"]), f"{asked['kind']}/{asked['file']}"

        def work() -> dict[str, Any]:
            session = _opened(folder)
            session.remove(file)
            return state(session)

        return await self.queue.run(work)

    async def calibrate(self, request: Any) -> Any:
        """Start the calibration."""
        folder = self.folder(request.path_params["name"])
        session = _opened(folder)
        if self.is_calibrating():
            raise InputError("a calibration is running already; wait for it, or stop it")
        require_space(folder, 0, self.app_state.reserve_bytes)
        cameras = self.app_state.folder / "cameras"
        job = CalibrationJob(
            folder, cameras / f"{folder.name}.asdf", cameras / f"{folder.name}.report.html",
            lens_blur=request.query_params.get("lens_blur", "1") != "0", holding=session.holding,
        )  # fmt: skip
        self.jobs[folder.name] = job
        job.start()
        return job.as_shown()

    async def progress(self, request: Any) -> Any:
        """Return how far the calibration is."""
        return self._job(request).as_shown()

    async def stop(self, request: Any) -> Any:
        """End the calibration."""
        job = self._job(request)
        job.stop()
        return job.as_shown()

    async def report(self, request: Any) -> Any:
        """Return the report of the last calibration."""
        path = self.app_state.folder / "cameras" / f"{self.folder(request.path_params['name']).name}.report.html"
        if not path.is_file():
            raise InputError("there is no report yet; calibrate first")
        return File(await asyncio.to_thread(path.read_bytes), "text/html", {"Content-Security-Policy": _REPORT})

    def _job(self, request: Any) -> CalibrationJob:
        job = self.jobs.get(self.folder(request.path_params["name"]).name)
        if job is None:
            raise InputError("no calibration was started")
        return job


def _opened(folder: Path) -> SessionFolder:
    if not (folder / "assistant.json").is_file():
        raise InputError("there is no such session; start a new one")
    return SessionFolder(folder)


def _holding(asked: Any) -> Holding | None:
    """Read how the device is held whose camera took a photograph; None of a file."""
    if "angle" not in asked:
        return None
    values = {name: asked.get(name, "") for name in ("orientation", "facing")}
    return checked(Holding, {"angle_deg": whole(asked, "angle"), **values}, where="how the device is held")


async def _json(request: Any) -> dict[str, Any]:
    """Read a JSON object; raises InputError for anything else."""
    try:
        asked = json.loads(await request.body())
    except (ValueError, RecursionError):
        asked = None
    if not isinstance(asked, dict):
        raise InputError("the page sent something that is not understood; reload it")
    return asked
