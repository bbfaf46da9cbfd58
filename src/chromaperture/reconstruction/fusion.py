"""The loop: clean a view, find the camera, fuse; say when it is lost, find it again, or begin a submap."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import cv2
import numpy as np

from chromaperture.reconstruction.settings import ReconstructionConfig
from chromaperture.reconstruction.tracking import track
from chromaperture.reconstruction.views import cleaned
from chromaperture.reconstruction.volume import Mesh, Volume
from chromaperture.views import View

_KEYFRAME_MM, _KEYFRAME_DEG, _KEYFRAMES = 80.0, 5.0, 500
_THUMBNAIL = (40, 30)
_TRIES = 3  # keyframes tried a lost frame
_VOXELS_OF_DISTANCE = 200
_MIN_KNOWN = 0.02


@dataclass(frozen=True)
class Placed:
    """What became of one frame: pose (4, 4) camera to world in mm, None when lost; overlap, likeness, submap, words."""

    index: int
    time_s: float
    pose: np.ndarray | None
    overlap: float = 1.0
    likeness: float = 1.0
    submap: int = 0
    note: str = ""


@dataclass
class _Keyframe:
    pose: np.ndarray
    thumbnail: np.ndarray


@dataclass
class Submap:
    """A volume with its own world frame, that of its first view."""

    volume: Volume
    keyframes: list[_Keyframe] = field(default_factory=list)


class Reconstruction:
    """A growing model.

    Parameters
    ----------
    camera_matrix : (3, 3) float, px
    config : ReconstructionConfig
    listener : callable, optional
        Told in one line when tracking is lost or found again, a submap begins, or the volume is full.
    verify : bool
        Check every pose by the model's picture from it.
    """

    def __init__(
        self,
        camera_matrix: np.ndarray,
        config: ReconstructionConfig | None = None,
        *,
        listener: Callable[[str], None] = lambda line: None,
        verify: bool = True,
    ) -> None:
        self.camera_matrix, self.config = np.asarray(camera_matrix, float), config or ReconstructionConfig()
        self.listener, self.verify = listener, verify
        self.placed: list[Placed] = []
        self.finished: list[Mesh] = []
        self.current: Submap | None = None
        self.lost_in_row = 0
        self._pose, self._motion = np.eye(4), np.eye(4)
        self._said_full = False

    @property
    def submap(self) -> int:
        """Number of the submap that grows."""
        return len(self.finished)

    def add(self, view: View) -> Placed:
        """Track and fuse one view; never raises because of what it shows."""
        clean = cleaned(view, self.config)
        if self.current is None or self.lost_in_row >= self.config.submap_after:
            placed = self._begin(clean)
        else:
            placed = self._follow(clean, self.current)
        self.placed.append(placed)
        return placed

    def meshes(self) -> list[Mesh]:
        """Give one mesh a submap, the first first; empty ones are there too."""
        return [*self.finished, *([self.current.volume.mesh()] if self.current else [])]

    def _begin(self, view: View) -> Placed:
        known = np.isfinite(view.z_mm)
        if known.mean() < _MIN_KNOWN:
            return self._lost(view, "hardly any pixel has a depth that can be trusted; light, texture or range?")
        if self.current is not None:
            self.finished.append(self.current.volume.mesh())
            self.listener(f"frame {view.index}: still lost, so a new submap begins (number {self.submap})")
        self.lost_in_row = 0
        c = self.config
        voxel_mm = c.voxel_mm or float(np.clip(np.median(view.z_mm[known]) / _VOXELS_OF_DISTANCE, 0.5, 50.0))
        volume = Volume(
            voxel_mm=voxel_mm,
            truncation_voxels=c.truncation_voxels,
            memory_mb=c.memory_mb,
            max_distance_mm=c.max_distance_mm,
        )
        self.current = Submap(volume)
        self._pose, self._motion = np.eye(4), np.eye(4)
        self._fuse(view, self.current)
        return Placed(view.index, view.time_s, self._pose.copy(), submap=self.submap, note="origin")

    def _follow(self, view: View, submap: Submap) -> Placed:
        options = {"camera_matrix": self.camera_matrix, "config": self.config}
        verify = self.verify or self.lost_in_row > 0
        guess = self._pose if self.lost_in_row else self._pose @ self._motion
        found = track(view, submap.volume, guess, verify=verify, **options)  # type: ignore[arg-type]
        if found.lost and not self.lost_in_row:
            again = track(view, submap.volume, self._pose, verify=True, **options)  # type: ignore[arg-type]
            found = again if not again.lost else found
        if found.lost and self.lost_in_row:
            for pose in self._similar(view, submap):
                again = track(view, submap.volume, pose, verify=True, **options)  # type: ignore[arg-type]
                if not again.lost:
                    found = again
                    break
        if found.lost:
            return self._lost(view, found.lost)
        if self.lost_in_row:
            self.listener(f"frame {view.index}: tracking found again after {self.lost_in_row} frames")
            self._motion = np.eye(4)
        else:
            self._motion = np.linalg.inv(self._pose) @ found.pose
        self.lost_in_row = 0
        self._pose = orthonormal(found.pose)
        self._fuse(view, submap)
        return Placed(view.index, view.time_s, self._pose.copy(), found.overlap, found.likeness, self.submap)

    def _lost(self, view: View, why: str) -> Placed:
        if self.lost_in_row == 0:
            self.listener(f"frame {view.index}: tracking lost ({why}); move back to where it worked")
        self.lost_in_row += 1
        return Placed(view.index, view.time_s, None, 0.0, 0.0, self.submap, f"lost: {why}")

    def _fuse(self, view: View, submap: Submap) -> None:
        submap.volume.integrate(view, self.camera_matrix, self._pose)
        if submap.volume.full and not self._said_full:
            self._said_full = True
            self.listener(
                f"frame {view.index}: the volume is full ({self.config.memory_mb} MB); new surface is NOT added. "
                "Use --memory-mb or a larger --voxel-mm"
            )
        if not any(_close(self._pose, key.pose) for key in submap.keyframes) and len(submap.keyframes) < _KEYFRAMES:
            submap.keyframes.append(_Keyframe(self._pose.copy(), thumbnail(view.color)))

    def _similar(self, view: View, submap: Submap) -> list[np.ndarray]:
        """Poses of the keyframes that look most like the view."""
        mine = thumbnail(view.color)
        likest = sorted(submap.keyframes, key=lambda key: -float((key.thumbnail * mine).sum()))
        return [key.pose for key in likest[:_TRIES]]


def thumbnail(color: np.ndarray) -> np.ndarray:
    """Small grey picture of mean 0 and norm 1, blurred enough to forgive some motion."""
    small = cv2.resize(color.astype(np.float32).mean(axis=2), _THUMBNAIL, interpolation=cv2.INTER_AREA)
    small = cv2.GaussianBlur(small, (0, 0), 1.0)
    small -= small.mean()
    return small / max(float(np.linalg.norm(small)), 1e-6)


def orthonormal(pose: np.ndarray) -> np.ndarray:
    """Take rounding out of a rotation that was multiplied many times."""
    u, _, vt = np.linalg.svd(pose[:3, :3])
    clean = pose.copy()
    clean[:3, :3] = u @ vt
    return clean


def _close(a: np.ndarray, b: np.ndarray) -> bool:
    moved = np.linalg.inv(a) @ b
    turn = np.degrees(np.arccos(np.clip((np.trace(moved[:3, :3]) - 1) / 2, -1, 1)))
    return float(np.linalg.norm(moved[:3, 3])) < _KEYFRAME_MM and turn < _KEYFRAME_DEG
