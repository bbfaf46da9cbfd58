"""Run the calibration of a session in a thread, with progress; it can be stopped, and goes on where it stopped."""

from __future__ import annotations

import shutil
import threading
import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from chromaperture.app.session_folder import Holding
from chromaperture.calibration.calibrate_session import calibrate_session
from chromaperture.calibration.options import CalibrationConfig
from chromaperture.evaluation.report import write_report
from chromaperture.evaluation.verdict import sentences, unusable, with_accurate_noise
from chromaperture.system.errors import ChromapertureError, lacks_memory


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
