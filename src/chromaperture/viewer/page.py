"""Show pictures, points, model and path in the browser, with viser."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from chromaperture.color.srgb import linear_to_srgb_bytes
from chromaperture.depth.error_limit import MAX_RELATIVE_SIGMA
from chromaperture.errors import InputError, MissingDependencyError
from chromaperture.products.measure_file import points as camera_points
from chromaperture.products.measure_file import write_maps
from chromaperture.reconstruction.clean_views import near_steps
from chromaperture.reconstruction.model_files import glb, quaternion
from chromaperture.storage import staged
from chromaperture.viewer.focus import refocuser
from chromaperture.viewer.loop import LiveLoop, Measured, within_limits
from chromaperture.viewer.pictures import confidence_picture, depth_picture

# Chosen by hand: the page must leave the processor to depth and tracking.
_POINTS = 40_000  # of the cloud
_REFOCUS_REST = 3.0  # pause after a refocused picture, in units of its duration
_MIN_PERIOD_S = 0.1  # shortest interval of two pages


def viser() -> Any:
    """Import viser; raises MissingDependencyError naming the extra."""
    try:
        import viser
    except ImportError:
        raise MissingDependencyError("the live page needs the extra: pip install 'chromaperture[viewer]'") from None
    return viser


class LivePage:
    """One server for any number of browsers.

    Parameters
    ----------
    loop : LiveLoop
    host, port
        127.0.0.1 is this machine only.
    out : Path
        Folder of snapshots and recordings.
    listener : callable
        Receives messages for the terminal, one line each.
    max_relative_sigma : float
        Where the slider of the error bar begins, which limits cloud and snapshots; see `within_error`.
    """

    def __init__(
        self,
        loop: LiveLoop,
        *,
        host: str,
        port: int,
        out: Path,
        listener: Callable[[str], None] = lambda line: None,
        max_relative_sigma: float = MAX_RELATIVE_SIGMA,
    ) -> None:
        self.loop, self.out, self.listener = loop, out, listener
        self.last: Measured | None = None
        self._percent = 100 * max_relative_sigma
        self._mesh: object = None
        self._refocuser, self._refocus_at = refocuser(loop.camera), 0.0
        try:
            with contextlib.redirect_stdout(sys.stderr):  # its banner is no result
                self.server = viser().ViserServer(host=host, port=port, verbose=False)
        except OSError as error:
            raise InputError(f"cannot serve on {host}:{port} ({error}); choose another --port") from None
        self.url = f"http://{host}:{self.server.get_port()}"
        self._build()

    def _build(self) -> None:
        gui, cal = self.server.gui, self.loop.camera.calibration
        facts = cal.summary()
        near, far = float(facts["near_mm"]), float(facts["far_mm"])
        self.server.scene.set_up_direction("-y")
        self.server.initial_camera.position = (0.6, -0.6, -0.9)
        self.server.initial_camera.look_at = (0.0, 0.0, 2.0)
        black = np.zeros((cal.sensor.height_px, cal.sensor.width_px, 3), np.uint8)
        self.status = gui.add_markdown("waiting for the first frame")
        self.depth = gui.add_image(black, label="depth, mm from the sensor", format="jpeg")
        self.color = gui.add_image(black, label="restored colour", format="jpeg")
        self.confidence = gui.add_image(black, label="confidence", format="jpeg")
        limit = max(50.0, min(self._percent, 1000.0))  # "inf" has no place on a slider
        self.max_sigma = gui.add_slider(
            "error bar, at most % of distance", min=0.1, max=limit, step=0.1, initial_value=min(self._percent, limit)
        )
        self.near = gui.add_slider("nearest, mm", min=100, max=5000, step=50, initial_value=round(near / 50) * 50)
        self.far = gui.add_slider("farthest, mm", min=500, max=10000, step=50, initial_value=round(far / 50) * 50)
        self.refocus = gui.add_checkbox("focus elsewhere", initial_value=False)
        middle = round((near * far) ** 0.5 / 50) * 50
        self.focus = gui.add_slider("focus at, mm", min=100, max=10000, step=50, initial_value=middle)
        self.pupil = gui.add_slider("new pupil, times the camera's", min=0.5, max=4, step=0.1, initial_value=2.0)
        pause, shot = gui.add_button("pause"), gui.add_button("snapshot")
        record = gui.add_button("record")

        @pause.on_click
        def _(event: Any) -> None:
            paused = self.loop.paused
            (paused.clear if paused.is_set() else paused.set)()
            pause.label = "go on" if paused.is_set() else "pause"

        @shot.on_click
        def _(event: Any) -> None:
            self._attempt(self.snapshot)

        @record.on_click
        def _(event: Any) -> None:
            if record.label == "record":
                folder = self.out / time.strftime("recording-%Y%m%d-%H%M%S")
                self._attempt(lambda: self.loop.record(folder))
                record.label = "stop recording"
            else:
                self.loop.stop_recording()
                record.label = "record"

    def _attempt(self, work: Callable[[], Any]) -> None:
        try:
            work()
        except Exception as error:  # a click must not end the loop
            self.listener(str(error))

    def snapshot(self) -> list[Path]:
        """Write the maps of the frame shown."""
        last = self.last
        if last is None:
            raise InputError("there is no frame yet")
        stem = time.strftime("snapshot-%Y%m%d-%H%M%S") + f"-{last.frame.index}"
        with staged(self.out) as stage:
            limit = self.max_sigma.value / 100
            write_maps(stage.path, stem, self.loop.camera, last.measurement, max_relative_sigma=limit)
            names = list(stage.names)
        self.listener(f"wrote {stem}.* to {self.out}")
        return [self.out / name for name in names]

    def run(self, *, until: Callable[[], bool] = lambda: False) -> None:
        """Show frames until the loop ends or ``until`` returns true; nothing is drawn while no browser is connected."""
        meter = self.loop.meters["view"]
        while not until() and (item := self.loop.to_view.take()) is not None:
            start = time.monotonic()
            self.last = item
            if self.server.get_clients():
                self.show(item)
                self.loop.want_mesh.set()
            now = time.monotonic()
            meter.record(now - start, now - item.arrived)
            time.sleep(max(0.0, _MIN_PERIOD_S - (now - start)))

    def show(self, item: Measured) -> None:
        """Show one frame and the state of the model."""
        near, far = self.near.value, max(self.far.value, self.near.value + 50)
        shown = within_limits(item, max_sigma=self.max_sigma.value / 100, near_mm=near, far_mm=far)
        half = slice(None, None, 2)  # half size is enough for the panel
        self.depth.image = depth_picture(shown.measurement.depth_mm[half, half], near_mm=near, far_mm=far)
        if self.refocus.value:
            self._show_refocused(item)
        else:
            self.color.image = linear_to_srgb_bytes(item.measurement.color[half, half])
        self.confidence.image = confidence_picture(item.measurement.confidence[half, half])
        self.status.content = self._status()
        with self.server.atomic():
            self._scene(shown)
        self.server.flush()

    def _show_refocused(self, item: Measured) -> None:
        start = time.monotonic()
        if start < self._refocus_at:
            return
        color = self._refocuser(item.measurement, self.focus.value, self.pupil.value)
        self.color.image = linear_to_srgb_bytes(color)
        now = time.monotonic()
        self._refocus_at = now + _REFOCUS_REST * (now - start)

    def _scene(self, item: Measured) -> None:
        scene, placed = self.server.scene, self.loop.placed
        pose = placed.pose if placed is not None and placed.pose is not None else None
        turn = np.eye(3) if pose is None else pose[:3, :3]
        shift = np.zeros(3) if pose is None else pose[:3, 3]
        lens, measured = self.loop.camera.calibration.lens, item.measurement
        step = max(1, round((measured.depth_mm.size / _POINTS) ** 0.5))
        thin = np.full_like(measured.depth_mm, np.nan)
        c = self.loop.config  # pixels between two surfaces are removed, as in the model
        flying = near_steps(measured.depth_mm, jump=c.edge_jump, reach_px=c.edge_px)
        thin[::step, ::step] = np.where(flying, np.float32(np.nan), measured.depth_mm)[::step, ::step]
        cloud = camera_points(self.loop.camera, thin, measured.color)
        points = (cloud.points_mm @ turn.T + shift) / 1000
        scene.add_point_cloud("/points", points.astype(np.float32), cloud.colors, point_size=0.004)
        x, y, z, w = quaternion(turn)
        height, width = measured.depth_mm.shape
        scene.add_camera_frustum(
            "/camera",
            fov=float(2 * np.arctan(height / 2 / lens.camera_matrix[1, 1])),
            aspect=width / height,
            scale=0.1,
            wxyz=(w, x, y, z),
            position=shift / 1000,
            color=(220, 60, 40) if placed is not None and placed.pose is None else (40, 120, 220),
        )
        path = np.array([*self.loop.trail.points_mm, shift]) / 1000
        if len(path) > 2:
            pairs = np.stack([path[:-1], path[1:]], axis=1)
            scene.add_line_segments("/path", pairs, (40, 120, 220), thickness=2, thickness_units="screen")
        mesh = self.loop.mesh
        if mesh is not None and mesh is not self._mesh and len(mesh.triangles):
            self._mesh = mesh
            # Not through trimesh: its objects are reference cycles that hold many megabytes until the collector runs.
            scene.add_glb("/model", glb(mesh), wxyz=(0, 1, 0, 0))  # the file's y points up and its z backward

    def _status(self) -> str:
        rows = ["| stage | frames/s | ms | behind, ms | dropped |", "| --- | --- | --- | --- | --- |"]
        for name, stage in self.loop.figures().items():
            rate, taken, behind = stage["per_second"], stage["milliseconds"], stage["latency_ms"]
            rows.append(f"| {name} | {rate:.1f} | {taken:.0f} | {behind:.0f} | {stage['dropped']} |")
        placed = self.loop.placed
        words = "" if placed is None else (placed.note or "tracking")
        recorded = f", {self.loop.recorded} frames recorded" if self.loop.recorded else ""
        return "\n".join([*rows, "", f"{words}{recorded}"])

    def close(self) -> None:
        """Stop serving."""
        with contextlib.redirect_stdout(sys.stderr):
            self.server.stop()
