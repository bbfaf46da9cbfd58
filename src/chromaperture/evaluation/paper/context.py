"""What exhibits share in one run: where to write, which data, how large, and the calibrated camera."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from chromaperture.calibration.calibrate_session import CalibrationResult, calibrate_session
from chromaperture.calibration.calibration_config import CalibrationConfig
from chromaperture.evaluation.paper import world
from chromaperture.evaluation.paper.sweep import sweep
from chromaperture.evaluation.paper.trial import Trial
from chromaperture.optics.pinhole import PupilCamera
from chromaperture.optics.simulated_session import SessionPlan, write_session

T = TypeVar("T")
QUICK_MM = (1000.0, 1300.0, 1650.0, 2000.0, 2400.0, 3000.0, 4000.0)
FULL_MM = tuple(float(d) for d in range(1000, 4001, 200))


@dataclass
class Context:
    """One run.

    Attributes
    ----------
    out : Path
        Folder of the report; ``out/work`` keeps what a run that was interrupted need not do again.
    data : Path or None
        Folder of sessions and white sheets.
    quick : bool
    workers : int
        Processes of a sweep; 0 is one a core.
    cluster : str or None
        Address of a Dask scheduler for sweeps.
    cameras : tuple of Path
        Camera files, used instead of calibrating.
    tell : callable
        Told what is made, how much is done, and of how much.
    """

    out: Path
    data: Path | None = None
    quick: bool = False
    workers: int = 0
    cluster: str | None = None
    cameras: tuple[Path, ...] = ()
    tell: Callable[[str, int, int], None] = lambda what, done, total: None
    _kept: dict[str, Any] = field(default_factory=dict)

    @property
    def work(self) -> Path:
        """Folder of intermediate results."""
        return self.out / "work" / ("quick" if self.quick else "full")

    @property
    def processes(self) -> int:
        """Processes of a sweep."""
        return self.workers or os.cpu_count() or 1

    @property
    def scene_size(self) -> tuple[int, int]:
        """Width and height of simulated scenes, px."""
        return (240, 160) if self.quick else (480, 320)

    @property
    def session_camera(self) -> PupilCamera:
        """The camera of the simulated session."""
        return world.camera_of(*((300, 200) if self.quick else (480, 320)))

    @property
    def cells(self) -> int:
        """Rays across the pupil."""
        return 10 if self.quick else 16

    def sweep(self, trials: Sequence[Trial], what: str) -> list[dict[str, float]]:
        """Run trials on this machine's cores or on the cluster, and keep them in the work folder."""
        return sweep(
            trials,
            workers=self.processes,
            cluster=self.cluster,
            keep_in=self.work / "trials",
            tell=lambda done, total: self.tell(what, done, total),
        )

    def once(self, key: str, make: Callable[[], T]) -> T:
        """Give what ``make`` makes, made once in this run: white sheets serve three exhibits."""
        if key not in self._kept:
            self._kept[key] = make()
        kept: T = self._kept[key]
        return kept

    def calibrated(self) -> tuple[CalibrationResult, str]:
        """Calibrate design V, from the data folder's session or a simulated one; the result and what it is from."""
        if "session" not in self._kept:
            folder = self._session_folder()
            where = "photographs in --data" if self.data else "a simulated session, traced ray by ray"
            kept = self.work / ("calibrating-data" if self.data else "calibrating")
            result = calibrate_session(folder, CalibrationConfig(lens_blur=False), keep_in=kept)
            size = f"{result.calibration.sensor.width_px}x{result.calibration.sensor.height_px} px"
            self._kept["session"] = result, f"From {where}: {len(result.boards)} boards at {size}."
        result, source = self._kept["session"]
        return result, source

    def _session_folder(self) -> Path:
        if self.data is not None:
            return self.data if (self.data / "session.toml").is_file() else self.data / "cy_halves"
        folder = self.work / "session" / "cy_halves"
        if not (folder / "session.toml").is_file():  # written last
            camera = self.session_camera
            write_session(
                folder,
                aperture=world.real_film("cy_halves"),
                camera=camera,
                rays=lambda aperture: world.traced_table(camera, aperture, self.cells),
                scenes={},
                plan=SessionPlan(distances_mm=QUICK_MM if self.quick else FULL_MM, tilts=4 if self.quick else 8),
            )
        return folder
