"""State of one run that all exhibits use: output folder, data, sizes, and the calibrated camera."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

from chromaperture.calibration.calibrate_session import CalibrationResult, calibrate_session
from chromaperture.calibration.options import CalibrationConfig
from chromaperture.optics.pinhole import PupilCamera
from chromaperture.optics.simulator.scene import Plane
from chromaperture.optics.simulator.session import SessionPlan, write_session
from chromaperture_paper import world
from chromaperture_paper.sweep import Trial, sweep

T = TypeVar("T")
DESIGN = "cy_halves"  # of the session: V, the paper's choice for depth
# Distances of the boards; the paper has 31 boards from 1 to 4 m.
QUICK_MM = (1000.0, 1300.0, 1650.0, 2000.0, 2400.0, 3000.0, 4000.0)
FULL_MM = tuple(float(d) for d in range(1000, 4001, 200))


@dataclass
class Context:
    """One run."""

    out: Path  # folder of the report; out/work holds intermediate results, so that an interrupted run can continue
    data: Path | None = None  # folder of sessions and white sheets
    quick: bool = False
    workers: int = 0  # processes of a sweep; 0 is one a core
    cluster: str | None = None  # address of a Dask scheduler for sweeps
    cameras: tuple[Path, ...] = ()  # camera files, used instead of calibrating
    # Called with the current step, how much is done, and of how much.
    progress: Callable[[str, int, int], None] = lambda what, done, total: None
    _kept: dict[str, Any] = field(default_factory=dict)

    @property
    def work(self) -> Path:
        """Folder of intermediate results."""
        return self.out / "work" / ("quick" if self.quick else "full")

    @property
    def simulated(self) -> Context:
        """The same run without the data folder."""
        return self if self.data is None else replace(self, data=None, cameras=(), _kept={})

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
        """Run trials on this machine's cores or on the cluster; results are kept in the work folder."""
        return sweep(
            trials,
            workers=self.workers or os.cpu_count() or 1,
            cluster=self.cluster,
            keep_in=self.work / "trials",
            progress=lambda done, total: self.progress(what, done, total),
        )

    def once(self, key: str, make: Callable[[], T]) -> T:
        """Return the result of ``make``, computed once in this run: white sheets serve three exhibits."""
        if key not in self._kept:
            self._kept[key] = make()
        kept: T = self._kept[key]
        return kept

    def traced(self, design: str, planes: Sequence[Plane], *, seed: int, exposure: float) -> world.Capture:
        """Photograph planes with the camera of the simulated session through a design, traced ray by ray."""
        camera = self.session_camera
        aperture = world.real_film(design)
        table = self.once(f"rays {design}", lambda: world.traced_table(camera, aperture, self.cells))
        return world.photograph(table, planes, camera, seed=seed, exposure=exposure)

    def session_capture(self, planes: Sequence[Plane], *, seed: int) -> world.Capture:
        """Photograph planes as the simulated session's boards are photographed."""
        return self.traced(DESIGN, planes, seed=seed, exposure=world.level_exposure(DESIGN))

    def calibrated(self) -> tuple[CalibrationResult, str]:
        """Calibrate design V from the data folder's session or a simulated one; return it and its source."""
        kept = self.work / ("calibrating-data" if self.data else "calibrating")
        config = CalibrationConfig(lens_blur=False)
        result = self.once(
            "session", lambda: calibrate_session(self._session_folder(), config, keep_in=kept, progress=self.progress)
        )
        where = "photographs in --data" if self.data else "a simulated session, traced ray by ray"
        size = f"{result.calibration.sensor.width_px}x{result.calibration.sensor.height_px} px"
        return result, f"From {where}: {len(result.boards)} boards at {size}."

    def _session_folder(self) -> Path:
        if self.data is not None:
            return self.data if (self.data / "session.toml").is_file() else self.data / DESIGN
        folder = self.work / "session" / DESIGN
        if not (folder / "session.toml").is_file():  # written last
            camera = self.session_camera
            write_session(
                folder,
                aperture=world.real_film(DESIGN),
                camera=camera,
                rays=lambda aperture: world.traced_table(camera, aperture, self.cells),
                scenes={},
                plan=SessionPlan(distances_mm=QUICK_MM if self.quick else FULL_MM, tilts=4 if self.quick else 8),
                progress=self.progress,
            )
        return folder
