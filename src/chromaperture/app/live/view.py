"""What the page of ``chromaperture live`` shows, and what its buttons and sliders do."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from chromaperture.app.free_space import require_space
from chromaperture.app.live.loop import LiveLoop, Measured
from chromaperture.app.messages import Packing, pack_frame
from chromaperture.camera.camera import CodedApertureCamera, DepthFrame
from chromaperture.depth.error_limit import MAX_RELATIVE_SIGMA, within_error
from chromaperture.effects.edge_aware import filter_disparity
from chromaperture.effects.layered_model import radius_per_disparity
from chromaperture.effects.refocusing import Focus, compositor_of, refocus
from chromaperture.effects.restore import focus_radius
from chromaperture.model.scale import reduced_size
from chromaperture.products.measure_file import write_maps
from chromaperture.reconstruction.fusion import Placed
from chromaperture.reconstruction.tracking import near_steps
from chromaperture.reconstruction.volume import Mesh
from chromaperture.system.errors import InputError
from chromaperture.system.storage import staged

# Chosen by hand: the page must leave the processor to depth and tracking.
_MOST_PX = 200_000  # of the maps that are sent
_REFOCUS_REST = 3.0  # pause after a refocused picture, in units of its duration
_MIN_PERIOD_S = 0.1  # shortest interval of two frames
_REST = 2.0  # pause after a frame, in units of its duration: on a busy machine it yields to depth and tracking
_LOOK_S = 0.2  # between two looks at ``until`` while no frame comes, chosen by hand
_LOOKING_S = 3.0  # after its last request a page is gone, chosen by hand: it asks once a second at least
_SNAPSHOT_BYTES_PX = 48  # at most: three float maps, two PNG without compression, a point of 27 bytes
_RANGE = 2.0  # distances on the sliders reach from half the nearest to twice the farthest; chosen by hand
_MAX_STEPS = 1000  # of a slider of distances, chosen by hand: finer than its pixels
_REFOCUS_SCALE = 2  # reduction of the sides of a refocused picture; a quarter of the pixels


@dataclass(frozen=True)
class Limits:
    """Lowest, highest and initial value of a slider: a message can hold anything, whatever a slider allows."""

    lowest: float
    highest: float
    initial: float

    def bounded(self, value: object) -> float:
        """Return a number within the limits: the nearest one, or the initial value for what is no number."""
        if isinstance(value, bool) or not isinstance(value, int | float) or value != value:  # NaN
            return self.initial
        return float(min(max(value, self.lowest), self.highest))  # before float(), which refuses huge integers


@dataclass(frozen=True)
class ControlLimits:
    """Limits of every slider of the page; distances in mm, ``percent`` of the distance, ``pupil`` of the camera's."""

    percent: Limits
    near: Limits
    far: Limits
    focus: Limits
    pupil: Limits = Limits(0.5, 4.0, 2.0)  # chosen by hand: smaller removes all blur, larger blurs all
    step_mm: float = 10.0

    @classmethod
    def of_camera(cls, near_mm: float, far_mm: float, max_relative_sigma: float) -> ControlLimits:
        """Choose the limits for a camera's working range."""
        lowest, highest = near_mm / _RANGE, far_mm * _RANGE
        step = 10.0 ** math.ceil(math.log10((highest - lowest) / _MAX_STEPS))
        low, high, near, far, middle = (
            max(step, round(mm / step) * step) for mm in (lowest, highest, near_mm, far_mm, math.sqrt(near_mm * far_mm))
        )
        percent = 100 * max_relative_sigma
        most = max(50.0, min(percent, 1000.0))  # "inf" has no place on a slider
        return cls(
            percent=Limits(0.1, most, min(max(percent, 0.1), most)),
            near=Limits(low, high, near),
            far=Limits(low, high, far),
            focus=Limits(low, high, middle),
            step_mm=step,
        )


class LiveView:
    """What any number of pages sees of a loop: each frame is made a message once, while a page asks for it."""

    def __init__(self, loop: LiveLoop, *, out: Path, max_relative_sigma: float = MAX_RELATIVE_SIGMA) -> None:
        self.loop, self.out = loop, out  # the folder of snapshots and recordings
        self.last: Measured | None = None
        self.number, self.message = 0, b""  # of the newest frame that was made a message
        facts = loop.camera.calibration.summary()
        self.limits = ControlLimits.of_camera(facts["near_mm"], facts["far_mm"], max_relative_sigma)
        self.focus: tuple[float, float] | None = None  # distance, mm, and pupil of a lens that is focused elsewhere
        self._refocuser, self._refocused = refocuser(loop.camera), (-math.inf, np.empty(0))
        self._asked = -math.inf
        self._writing, self._packing = threading.Lock(), threading.Lock()
        self._mesh: tuple[Mesh | None, int, bytes] = (None, 0, b"")  # its number, and its message once it was asked for

    @property
    def is_looked_at(self) -> bool:
        """Whether a page is there."""
        return time.monotonic() - self._asked < _LOOKING_S

    def asked(self) -> None:
        """Note that a page is there."""
        self._asked = time.monotonic()

    def run(self, *, until: Callable[[], bool] = lambda: False) -> None:
        """Take frames until the loop ends or ``until`` returns true; what cannot be packed is left out and said."""
        meter, to_view = self.loop.meters["view"], self.loop.to_view
        while not until():
            if not to_view.wait(_LOOK_S):  # paused, or the source stalls
                continue
            if (item := to_view.take()) is None:
                return
            start = time.monotonic()
            self.last = item
            if self.is_looked_at:
                try:
                    with self.loop.watchdog.stage("draw"):
                        self.draw(item)
                except Exception as error:  # nothing that a page sends or a frame holds may end the loop
                    self.loop.say_rarely(f"this frame could not be drawn: {_line(error)}")
                self.loop.want_mesh.set()
            now = time.monotonic()
            meter.record(now - start, now - item.arrived)
            time.sleep(max(_REST * (now - start), _MIN_PERIOD_S - (now - start)))

    def draw(self, item: Measured) -> None:
        """Make a frame the message that pages are given."""
        measured, placed = item.measurement, self.loop.placed
        height, width = measured.depth_mm.shape
        size = reduced_size((width, height), max(1, math.ceil(math.sqrt(width * height / _MOST_PX))))
        shown = within_error(measured.depth_mm, measured.sigma_mm, self.limits.percent.initial / 100)
        c = self.loop.config  # pixels between two surfaces are no points, as in the model
        flying = near_steps(shown, jump=c.edge_jump, reach_px=c.edge_px)
        pose = None if placed is None or placed.pose is None else placed.pose.ravel().tolist()
        facts = {"number": self.number + 1, "notes": [], "pose": pose, "lost": placed is not None and pose is None}
        self.message = pack_frame(measured, facts, size=size, color=self._color(measured), hidden=flying)
        self.number += 1

    def _color(self, measured: DepthFrame) -> np.ndarray | None:
        """Return the picture of a lens that is focused elsewhere, None without a wish; the last one during a rest."""
        if self.focus is None:
            return None
        start = time.monotonic()
        if start >= self._refocused[0]:
            color = self._refocuser(measured, *self.focus)
            now = time.monotonic()
            self._refocused = (now + _REFOCUS_REST * (now - start), color)
        return self._refocused[1]

    def focus_at(self, distance_mm: object, pupil: object) -> None:
        """Show the colours as a lens focused at a distance has them, of a pupil in units of the camera's own."""
        self.focus = self.limits.focus.bounded(distance_mm), self.limits.pupil.bounded(pupil)
        self._refocused = (-math.inf, self._refocused[1])

    def record(self, wanted: bool) -> None:
        """Begin or finish a recording; raises InputError where the disk is nearly full."""
        if wanted:
            self.loop.record(self.out / time.strftime("recording-%Y%m%d-%H%M%S"))
        else:
            self.loop.stop_recording()

    def pause(self, wanted: bool) -> None:
        """Measure no more frames, or go on."""
        (self.loop.paused.set if wanted else self.loop.paused.clear)()

    def snapshot(self, percent: object = None) -> list[Path]:
        """Write the maps of the newest frame; raises InputError on a full disk and while another is written."""
        last = self.last
        if last is None:
            raise InputError("there is no frame yet")
        if not self._writing.acquire(blocking=False):
            raise InputError("a snapshot is being written already")
        try:
            require_space(self.out, _SNAPSHOT_BYTES_PX * last.measurement.depth_mm.size, self.loop.reserve_bytes)
            stem = time.strftime("snapshot-%Y%m%d-%H%M%S") + f"-{last.frame.index}"
            with staged(self.out) as stage:
                limit = self.limits.percent.bounded(percent) / 100
                write_maps(stage.path, stem, self.loop.camera, last.measurement, max_relative_sigma=limit)
                names = list(stage.names)
        finally:
            self._writing.release()
        self.loop.say(f"wrote {stem}.* to {self.out}")
        return [self.out / name for name in names]

    def about(self) -> dict[str, Any]:
        """Return what the page needs to know at its start."""
        return {"limits": asdict(self.limits), "model": self.loop.track}

    def state(self) -> dict[str, Any]:
        """Return what the page shows beside the pictures; ``path`` has x, y, z of each place in mm."""
        loop = self.loop
        path = loop.trail.points_mm
        hanging = loop.watchdog.hanging()
        return {
            "recording": loop.recording, "recorded": loop.recorded, "paused": loop.paused.is_set(),
            "tracking": tracking_line(loop.placed) if loop.track else "", "hanging": hanging,
            "latest": "" if hanging else loop.latest,  # which would be the same line, with fewer seconds
            "stages": loop.figures(), "focus": self.focus, "mesh": self.mesh_number,
            "path": np.rint(path).astype(int).ravel().tolist() if path else [],
        }  # fmt: skip

    @property
    def mesh_number(self) -> int:
        """How many meshes of the growing model there were; 0 before the first."""
        mesh = self.loop.mesh
        with self._packing:
            if mesh is not None and mesh is not self._mesh[0] and len(mesh.triangles):
                self._mesh = (mesh, self._mesh[1] + 1, b"")
            return self._mesh[1]

    def mesh_message(self) -> bytes:
        """Return the newest mesh as packed arrays: coordinate after coordinate, so that neighbours are alike."""
        number = self.mesh_number
        with self._packing:
            mesh, _, message = self._mesh
            if mesh is None:
                raise InputError("there is no model yet")
            if not message:
                packing = Packing()
                vertices, triangles = (
                    packing.put(np.ascontiguousarray(part.T)) for part in (mesh.vertices_mm, mesh.triangles)
                )
                red, green, blue = (mesh.colors[:, i].astype(np.uint32) for i in range(3))
                text = {"vertices": vertices, "triangles": triangles, "mesh": number,
                        "colors": packing.put(red | green << 8 | blue << 16)}  # fmt: skip
                message = packing.message(text)
                self._mesh = (mesh, number, message)
            return message


def refocuser(camera: CodedApertureCamera) -> Callable[[DepthFrame, float, float], np.ndarray]:
    """Return a function that focuses the frames of one camera elsewhere, as another lens would, without restoration.

    It takes the frame, the new focus (mm from the sensor plane), and the diameter of the new pupil in units of the
    camera's own; returns (H / 2, W / 2, 3) float32, linear RGB, the colours unchanged where refocusing is impossible.
    """
    compositor = compositor_of(camera)
    per_disparity = np.float32(radius_per_disparity(camera.calibration, camera.config.quality))

    def refocused(frame: DepthFrame, focus_mm: float, strength: float) -> np.ndarray:
        part = slice(None, None, _REFOCUS_SCALE)
        color = np.ascontiguousarray(frame.color[part, part], np.float32)
        disparity, sigma = (
            values[part, part] / _REFOCUS_SCALE for values in (frame.disparity_px, frame.disparity_sigma_px)
        )
        try:
            radius = filter_disparity(disparity, sigma, color)[0] * per_disparity
            lens = Focus(focus_radius(camera, focus_mm) / _REFOCUS_SCALE, strength)
            return refocus(color, radius, lens, compositor=compositor)
        except InputError:  # no depth is known, or the blur fills the picture
            return color

    return refocused


def tracking_line(placed: Placed | None) -> str:
    """Say how well the last frame fits the model."""
    if placed is None:
        return "tracking: not yet"
    if placed.pose is None:
        return f"tracking {placed.note}"
    if placed.note:  # the first frame of a submap
        return f"tracking: {placed.note}"
    return f"tracking: {placed.overlap:.0%} of the keyframe seen again, correlation {placed.correlation:.2f}"


def _line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__
