"""Show pictures, points, model and path in the browser, with viser."""

from __future__ import annotations

import contextlib
import io
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from chromaperture.app.live.access import Access, serve
from chromaperture.app.live.controls import ControlLimits, Limits
from chromaperture.app.live.focus import refocuser
from chromaperture.app.live.free_space import require_space
from chromaperture.app.live.live_scene import LiveScene, median_distance
from chromaperture.app.live.loop import LiveLoop, Measured, within_limits
from chromaperture.app.live.pictures import confidence_picture, depth_picture
from chromaperture.app.live.probe import probe_html, values_html
from chromaperture.color.srgb import linear_to_srgb_bytes
from chromaperture.depth.error_limit import MAX_RELATIVE_SIGMA
from chromaperture.products.measure_file import write_maps
from chromaperture.reconstruction.fusion import Placed
from chromaperture.system.errors import InputError
from chromaperture.system.storage import staged

# Chosen by hand: the page must leave the processor to depth and tracking.
_REFOCUS_REST = 3.0  # pause after a refocused picture, in units of its duration
_MIN_PERIOD_S = 0.1  # shortest interval of two pages
_REST = 2.0  # pause after a page, in units of its duration: on a busy machine it yields to depth and tracking
# CSS pixels, chosen by hand: at 1400 x 900 both panels show all they hold, and the scene has half of the width.
_PICTURES_WIDTH, _CONTROLS_WIDTH = 400, 320
_STATE_EVERY_S = 1.0  # pause between two states of a page without frames, chosen by hand: it counts seconds
_LOOK_S = 0.2  # between two looks at ``until`` while no frame comes, chosen by hand
_SNAPSHOT_BYTES_PX = 48  # at most: three float maps, two PNG without compression, a point of 27 bytes


class LivePage:
    """One server for any number of browsers.

    Parameters
    ----------
    loop : LiveLoop
    host, port
        127.0.0.1 is this machine only. Only the address ``url``, which holds a random token, opens the page.
    out : Path
        Folder of snapshots and recordings.
    max_relative_sigma : float
        Where the slider of the error bar begins, which limits cloud and snapshots; see `within_error`.
    """

    def __init__(
        self, loop: LiveLoop, *, host: str, port: int, out: Path, max_relative_sigma: float = MAX_RELATIVE_SIGMA
    ) -> None:
        self.loop, self.out = loop, out
        self.last: Measured | None = None
        facts = loop.camera.calibration.summary()
        self.limits = ControlLimits.of_camera(facts["near_mm"], facts["far_mm"], max_relative_sigma)
        self._refocuser, self._refocus_at = refocuser(loop.camera), 0.0
        self._writing = threading.Lock()
        self.access = Access(host)
        self.server = serve(self.access, port, listener=loop.say)
        self.url = self.access.url(self.server.get_port())
        self.scene = LiveScene(self.server, loop)
        self.scene.look_at(self.limits.focus.initial)
        self._looked, self._depth_line = False, ""
        self._build()
        self._handled, self._closed = time.monotonic(), threading.Event()
        self._states = threading.Thread(target=self._keep_state, name="page state", daemon=True)
        self._states.start()

    def _build(self) -> None:
        gui = self.server.gui
        gui.configure_theme(dark_mode=True, show_share_button=False, show_logo=False)
        gui.set_panel_label("chromaperture")
        pictures = gui.add_panel()
        with pictures.add_tab("Pictures"):
            self._build_pictures()
        pictures.dock_left()
        pictures.set_width(_PICTURES_WIDTH)
        gui.main_panel.dock_right()
        gui.main_panel.set_width(_CONTROLS_WIDTH)
        self.state = gui.add_markdown("waiting for the first frame")
        self._build_buttons()
        self._build_sliders()
        self.figures = gui.add_markdown("")

    def _build_pictures(self) -> None:
        gui, sensor = self.server.gui, self.loop.camera.calibration.sensor
        black = np.zeros((sensor.height_px // 2, sensor.width_px // 2, 3), np.uint8)
        self.depth = gui.add_image(black, label="distance from the sensor, mm", format="jpeg")
        self.color = gui.add_image(black, label="restored colour", format="jpeg")
        self.confidence = gui.add_image(black, label="confidence, white is 1", format="jpeg")
        self.values = gui.add_html("")
        gui.add_html(probe_html())

    def _build_buttons(self) -> None:
        gui = self.server.gui
        self.record, self.pause = gui.add_button("record"), gui.add_button("pause")
        self.shot = gui.add_button("snapshot")

        @self.pause.on_click
        def _(event: Any) -> None:
            paused = self.loop.paused
            (paused.clear if paused.is_set() else paused.set)()
            self.pause.label = "go on" if paused.is_set() else "pause"

        @self.shot.on_click
        def _(event: Any) -> None:
            self._attempt(self.snapshot)

        @self.record.on_click
        def _(event: Any) -> None:
            if self.loop.recording:
                self._attempt(self.loop.stop_recording)
            else:
                folder = self.out / time.strftime("recording-%Y%m%d-%H%M%S")
                self._attempt(lambda: self.loop.record(folder))

    def _build_sliders(self) -> None:
        gui, at = self.server.gui, self.limits

        def slider(label: str, limits: Limits, step: float, hint: str) -> Any:
            ends = {"min": limits.lowest, "max": limits.highest, "initial_value": limits.initial}
            return gui.add_slider(label, step=step, hint=hint, **ends)

        self.max_sigma = slider("error bar, %", at.percent, 0.1, "Longest error bar shown, % of the distance")
        self.near = slider("nearest, mm", at.near, at.step_mm, "Nearer pixels are left out")
        self.far = slider("farthest, mm", at.far, at.step_mm, "Farther pixels are left out")
        self.refocus = gui.add_checkbox("focus elsewhere", initial_value=False)
        self.focus = slider("focus at, mm", at.focus, at.step_mm, "Where the restored colour is in focus")
        self.pupil = slider("pupil", at.pupil, 0.1, "Diameter of the new pupil, in units of the camera's")

    def _attempt(self, work: Callable[[], Any]) -> None:
        try:
            work()
        except Exception as error:  # a click must not end the loop
            self.loop.say(_line(error))
        self._show_state()  # frames may have paused

    def snapshot(self) -> list[Path]:
        """Write the maps of the frame shown; refused while another is being written, or the disk is nearly full."""
        last = self.last
        if last is None:
            raise InputError("there is no frame yet")
        if not self._writing.acquire(blocking=False):
            raise InputError("a snapshot is being written already")
        try:
            require_space(self.out, _SNAPSHOT_BYTES_PX * last.measurement.depth_mm.size, self.loop.reserve_bytes)
            stem = time.strftime("snapshot-%Y%m%d-%H%M%S") + f"-{last.frame.index}"
            with staged(self.out) as stage:
                limit = self.limits.percent.bounded(self.max_sigma.value) / 100
                write_maps(stage.path, stem, self.loop.camera, last.measurement, max_relative_sigma=limit)
                names = list(stage.names)
        finally:
            self._writing.release()
        self.loop.say(f"wrote {stem}.* to {self.out}")
        return [self.out / name for name in names]

    def run(self, *, until: Callable[[], bool] = lambda: False) -> None:
        """Show frames until the loop ends or ``until`` returns true; nothing is drawn while no browser is connected.

        What cannot be drawn is left out and said, on the page too; each different message once a minute.
        """
        meter, to_view = self.loop.meters["view"], self.loop.to_view
        while not until():
            if not to_view.wait(_LOOK_S):  # paused, or the source stalls
                continue
            if (item := to_view.take()) is None:
                return
            start = time.monotonic()
            self.last = item
            if self.server.get_clients():
                try:
                    with self.loop.watchdog.stage("draw"):
                        self.show(item)
                except Exception as error:  # nothing that a browser sends or a frame holds may end the loop
                    self._report(error)
                self._handled = time.monotonic()
                self.loop.want_mesh.set()
            now = time.monotonic()
            meter.record(now - start, now - item.arrived)
            time.sleep(max(_REST * (now - start), _MIN_PERIOD_S - (now - start)))

    def _report(self, error: Exception) -> None:
        line = f"this frame could not be drawn: {_line(error)}"
        with contextlib.suppress(Exception):  # the page itself may be what fails
            self.state.content = _escaped(line)
        self.loop.say_rarely(line)

    def _keep_state(self) -> None:
        """Show messages and the stage that hangs although no frame is drawn."""
        while not self._closed.wait(_STATE_EVERY_S):
            if self.server.get_clients() and time.monotonic() - self._handled >= _STATE_EVERY_S:
                with contextlib.suppress(Exception):  # as for a frame; the next one says so
                    self._show_state()

    def show(self, item: Measured) -> None:
        """Show one frame and the state of the model."""
        near, far = self.limits.distances(self.near.value, self.far.value)
        percent = self.limits.percent.bounded(self.max_sigma.value)
        shown = within_limits(item, max_sigma=percent / 100, near_mm=near, far_mm=far)
        depth, measured = shown.measurement.depth_mm, item.measurement
        if not self._looked and np.isfinite(depth).any():
            self._looked = True
            self.scene.look_at(median_distance(depth))
        half = slice(None, None, 2)
        self.depth.image = depth_picture(depth[half, half], near_mm=near, far_mm=far)
        if self.refocus.value:
            self._show_refocused(item)
        else:
            self.color.image = linear_to_srgb_bytes(measured.color[half, half])
        self.confidence.image = confidence_picture(measured.confidence[half, half])
        # Not cut at the error bar, which is shown beside it.
        self.values.content = values_html(measured.depth_mm[half, half], measured.sigma_mm[half, half])
        self._depth_line = depth_line(depth[half, half], measured.sigma_mm[half, half])
        self._show_state()
        with self.server.atomic():
            self.scene.draw(shown)
        self.server.flush()

    def _show_refocused(self, item: Measured) -> None:
        start = time.monotonic()
        if start < self._refocus_at:
            return
        focus, pupil = self.limits.focus.bounded(self.focus.value), self.limits.pupil.bounded(self.pupil.value)
        self.color.image = linear_to_srgb_bytes(self._refocuser(item.measurement, focus, pupil))
        now = time.monotonic()
        self._refocus_at = now + _REFOCUS_REST * (now - start)

    def _show_state(self) -> None:
        self.record.label = "stop recording" if self.loop.recording else "record"
        tracking = tracking_line(self.loop.placed) if self.loop.track else ""
        recorded = f"{self.loop.recorded} frames recorded" if self.loop.recorded else ""
        hanging = [f"**{_escaped(line)}**" for line in self.loop.watchdog.hanging()]
        latest = "" if hanging else _escaped(self.loop.latest)  # which would be the same line, with fewer seconds
        lines = (*hanging, tracking, self._depth_line, recorded, latest)
        self.state.content = "\n\n".join(line for line in lines if line)
        rows = ["| stage | 1/s | ms | behind | lost |", "| --- | ---: | ---: | ---: | ---: |"]
        for name, stage in self.loop.figures().items():
            rate, taken, behind = stage["per_second"], stage["milliseconds"], stage["latency_ms"]
            rows.append(f"| {name} | {rate:.1f} | {taken:.0f} | {behind:.0f} | {stage['dropped']} |")
        self.figures.content = "\n".join([*rows, "", "*behind: ms since the frame arrived; lost: frames left out*"])

    def close(self) -> None:
        """Stop serving."""
        self._closed.set()
        self._states.join()
        with contextlib.redirect_stdout(io.StringIO()):  # viser says that it stopped
            self.server.stop()


def tracking_line(placed: Placed | None) -> str:
    """Say in Markdown how well the last frame fits the model."""
    if placed is None:
        return "tracking: **not yet**"
    if placed.pose is None:
        return f"tracking **{_escaped(placed.note)}**"
    if placed.note:  # the first frame of a submap
        return f"tracking: **{_escaped(placed.note)}**"
    return f"tracking: **{placed.overlap:.0%}** of the keyframe seen again, correlation **{placed.correlation:.2f}**"


def depth_line(depth_mm: np.ndarray, sigma_mm: np.ndarray) -> str:
    """Say in Markdown how far away and how certain the pixels shown are, whose depth is not NaN."""
    shown = np.isfinite(depth_mm)
    if not shown.any():
        return "no pixel is within these limits"
    distance, error = float(np.median(depth_mm[shown])), float(np.median(sigma_mm[shown]))
    return f"median of what is shown **{distance:.0f} ± {error:.0f} mm**; {shown.mean():.0%} of the pixels"


def _line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__


def _escaped(text: str) -> str:
    """Escape what Markdown and HTML would not show as it is."""
    return "".join(f"\\{c}" if c in "\\`*_{}[]<>#|~!" else c for c in text)
