"""A simulated camera with a coded aperture, in an RGB-D sequence or moving through a scene file."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from chromaperture.capture.source import FileSource, Frame, checked_fps
from chromaperture.color.encoding import Encoding
from chromaperture.optics.pinhole import PupilCamera
from chromaperture.optics.printing.aperture_file import load_made
from chromaperture.optics.ray_table import pinhole_rays
from chromaperture.optics.simulator.layer_renderer import read_rgbd, render_layers, rgbd_pairs
from chromaperture.optics.simulator.render import render
from chromaperture.optics.simulator.scene import load_scene
from chromaperture.optics.simulator.sensor import SensorModel, expose
from chromaperture.system.errors import InputError

_KINECT = 585 / 640  # focal length over width, of a Kinect
_PITCH_MM = 0.02  # has no effect on the picture: geometry is in px
_TUM_UNIT_MM = 0.2  # 5000 counts a metre
_TURN = 48  # frames per turn of the path through a scene; chosen by hand, not tuned


@dataclass(kw_only=True, eq=False)
class SimulatedSource(FileSource):
    """Frames of the simulator, 10-bit counts with photon and read noise, reproducible by seed.

    The place is a folder of NAME.color.* with NAME.depth.png (and NAME.pose.txt), a folder with rgb/ and depth/, or a
    scene file (.toml), through which the camera moves in a circle square to its axis.
    """

    kind = "simulate"

    focal_px: float | None = None  # default `_KINECT` of the width
    design: str = "cy_halves"  # aperture and its film, as for `chromaperture simulate`
    film: str = "lee"
    pupil_radius_mm: float = 12.5
    focus_mm: float = 2000.0
    sensor_to_pupil_mm: float = 50.0
    depth_unit_mm: float | None = None  # default 0.2 in a TUM RGB-D sequence, which has depth.txt, else 1
    exposure: float = 0.9
    orbit_mm: float = 100.0  # radius of the circle through a scene
    width: int = 640  # of pictures of a scene
    height: int = 480
    cells: int = 8  # rays across the pupil, even, for a scene; fewer make blur coarser
    count: int | None = None  # of frames; default the sequence, or one turn
    fps: float = 30.0  # for the times of the frames
    seed: int = 0

    def __post_init__(self) -> None:
        checked_fps(self.fps)
        self.path, self.sensor, self.pairs = Path(self.place), SensorModel(), list[tuple[Path, Path]]()

    def open(self) -> None:
        """Find the pictures; check design and scene."""
        load_made(self.design, self.film)
        if self.cells < 4 or self.cells % 2:
            raise InputError(f"cells must be even and at least 4, got {self.cells}")
        if self.path.suffix == ".toml":
            load_scene(self.path)
            return
        self.pairs = rgbd_pairs(self.path)[: self.count]

    def frames(self) -> Iterator[Frame]:
        """Yield one photograph per position."""
        yield from self._through_scene() if self.path.suffix == ".toml" else self._through_pictures()

    def _through_pictures(self) -> Iterator[Frame]:
        unit_mm = self.depth_unit_mm or (_TUM_UNIT_MM if (self.path / "depth.txt").is_file() else 1.0)
        for index, (color, depth) in enumerate(self.pairs):
            picture, depth_mm = read_rgbd(
                color, depth, depth_unit_mm=unit_mm, sensor_to_pupil_mm=self.sensor_to_pupil_mm
            )
            camera = self._camera(depth_mm.shape[1], depth_mm.shape[0])
            light = render_layers(picture, depth_mm, camera=camera, aperture=load_made(self.design, self.film)).image
            found: dict[str, object] = {"file": color.name, "depth_file": str(depth)}
            pose = depth.parent / depth.name.replace(".depth.png", ".pose.txt")
            if pose != depth and pose.is_file():
                found["pose_file"] = str(pose)
            yield self._frame(light, index, found)

    def _through_scene(self) -> Iterator[Frame]:
        planes, camera = load_scene(self.path), self._camera(self.width, self.height)
        rays = pinhole_rays(camera, load_made(self.design, self.film), cells=self.cells)
        for index in range(_TURN if self.count is None else self.count):
            angle = 2 * math.pi * index / _TURN
            position = self.orbit_mm * np.array([1 - math.cos(angle), math.sin(angle), 0.0])  # begins at the origin
            moved = [replace(plane, center_mm=plane.center_mm - position) for plane in planes]
            light = render(rays, moved, seed=self.seed + index)
            pose = np.eye(4)
            pose[:3, 3] = position
            yield self._frame(light, index, {"camera_to_world_mm": pose.tolist()})

    def _frame(self, light: np.ndarray, index: int, metadata: dict[str, object]) -> Frame:
        counts = expose(light, self.sensor, seed=self.seed + index, exposure=self.exposure)
        encoding = Encoding(self.sensor.black_level, self.sensor.white_level)
        return Frame(counts, encoding, index / self.fps, index, metadata)

    def _camera(self, width: int, height: int) -> PupilCamera:
        optics_mm = self.pupil_radius_mm, self.focus_mm, self.sensor_to_pupil_mm
        return PupilCamera(width, height, self.focal_px or _KINECT * width, *optics_mm, _PITCH_MM)
