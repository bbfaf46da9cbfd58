"""Reconstruct view by view: clean, track, fuse; relocalise a lost camera, begin submaps and join them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from chromaperture.products.rectified import View
from chromaperture.reconstruction.settings import ReconstructionConfig
from chromaperture.reconstruction.tracking import (
    MIN_KNOWN,
    NO_DEPTH,
    Keyframe,
    PreparedView,
    Track,
    cleaned,
    prepare,
    scaled,
    track,
    turn_deg,
)
from chromaperture.reconstruction.volume import Mesh, Volume, joined

_MAX_RATIO = 3.0  # of the predicted interval to the one that the velocity was measured over; chosen by hand


class ConstantVelocity:
    """Motion of a camera between its last two poses (4, 4), mm; at rest with a single one."""

    def __init__(self, pose: np.ndarray, time_s: float) -> None:
        self._pose, self._time_s, self._interval_s = pose.copy(), time_s, 0.0
        self._step = np.zeros(6)  # rotation vector, translation, in the camera's frame

    def predict(self, time_s: float) -> np.ndarray:
        """Return the pose at a time; frames without times count as evenly spaced."""
        passed = time_s - self._time_s
        ratio = min(passed / self._interval_s, _MAX_RATIO) if passed > 0 and self._interval_s > 0 else 1.0
        moved = np.eye(4)
        moved[:3, :3] = cv2.Rodrigues(ratio * self._step[:3])[0]
        moved[:3, 3] = ratio * self._step[3:]
        return self._pose @ moved

    def update(self, pose: np.ndarray, time_s: float) -> None:
        """Add a measured pose."""
        moved = np.linalg.inv(self._pose) @ pose
        self._step = np.concatenate([cv2.Rodrigues(moved[:3, :3])[0][:, 0], moved[:3, 3]])
        self._pose, self._interval_s, self._time_s = pose.copy(), time_s - self._time_s, time_s


# Chosen by hand; docs/reconstruction.md measures the whole.
_MAX_KEYFRAMES = 300  # of a submap
_KEYFRAME_DISTANCE = 0.2  # picture widths: a view farther from every keyframe becomes one
_GOOD_SCORE, _POOR_SCORE = 0.65, 0.3  # of `Track`: from which no other guess is tried; below which all are
_CANDIDATES = 3  # most similar keyframes tried for a lost frame
_REFRESH = 4  # frames followed until the keyframe takes its distances from the model again
_CAST_PX = 2  # px of the keyframe a ray: about 1.5 voxels; a ray for every px gains nothing
_VOXELS_OF_DISTANCE, _MIN_VOXEL_MM, _MAX_VOXEL_MM = 200, 0.5, 50.0  # default edge: 1/200 of the distance, in limits
_JOIN_CORRELATION, _JOIN_OVERLAP = 0.75, 0.5  # stricter than in tracking, which has a prior
_JOIN_EVERY = 3  # frames between two searches in older submaps
_JOIN_MM, _JOIN_DEG = 40.0, 2.0  # largest difference of two poses in a row that join submaps


@dataclass(frozen=True)
class Placed:
    """Result of one frame: pose (4, 4) camera to world in mm, None when lost; overlap, correlation, submap, note."""

    index: int
    time_s: float
    pose: np.ndarray | None
    overlap: float = 1.0
    correlation: float = 1.0
    submap: int = 0
    note: str = ""


@dataclass
class Submap:
    """A model with a world frame of its own, that of its first view."""

    volume: Volume | None  # while it grows
    mesh: Mesh | None = None  # once it no longer grows
    keyframes: list[Keyframe] = field(default_factory=list)
    root: int = 0  # the submap that it was joined to, itself at first
    to_root: np.ndarray = field(default_factory=lambda: np.eye(4))  # its pose in that one's frame, (4, 4) float64

    def surface(self, *, ordered: bool = True) -> Mesh:
        """Return the mesh in the submap's own frame."""
        if self.mesh is not None:
            return self.mesh
        assert self.volume is not None
        return self.volume.mesh(ordered=ordered)


class Reconstruction:
    """A growing model, whose listener hears when tracking is lost, submaps begin or join, or it is full."""

    def __init__(
        self,
        camera_matrix: np.ndarray,
        config: ReconstructionConfig | None = None,
        *,
        listener: Callable[[str], None] = lambda line: None,
    ) -> None:
        self.camera_matrix, self.config = np.asarray(camera_matrix, float), config or ReconstructionConfig()
        self.listener = listener
        self.placed: list[Placed] = []
        self.submaps: list[Submap] = []
        self.lost_in_row = 0
        self._pose, self._motion = np.eye(4), ConstantVelocity(np.eye(4), 0.0)
        self._reported_full = False
        self._active: Keyframe | None = None
        self._followed = self._cast_at = 0  # frames tracked, and how many when distances were last cast
        self._join_candidate: tuple[int, np.ndarray] | None = None

    @property
    def current(self) -> Submap | None:
        """The growing submap."""
        return self.submaps[-1] if self.submaps else None

    @property
    def submap(self) -> int:
        """Number of the growing submap."""
        return max(0, len(self.submaps) - 1)

    @property
    def roots(self) -> list[int]:
        """Submaps not joined to an older one: each has a world frame of its own."""
        return sorted({submap.root for submap in self.submaps})

    def add(self, view: View) -> Placed:
        """Track and fuse one view; never raises because of its content."""
        clean = cleaned(view, self.config)
        prepared = prepare(clean, self.camera_matrix, self.config)
        if self.current is None or self.lost_in_row >= self.config.submap_after:
            placed = self._begin(clean, prepared)
        else:
            placed = self._follow(clean, prepared, self.current)
        self.placed.append(placed)
        return placed

    def in_root(self, placed: Placed) -> Placed:
        """Return a result whose pose is in the world frame of the submap that its own was joined to."""
        if placed.pose is None:
            return placed
        submap = self.submaps[placed.submap]
        return replace(placed, pose=submap.to_root @ placed.pose, submap=submap.root)

    def meshes(self) -> list[Mesh]:
        """Return one mesh for every world frame, in the order of `roots`, each of all its submaps; empty ones too."""
        return [self.mesh(root) for root in self.roots]

    def mesh(self, root: int, *, ordered: bool = True) -> Mesh:
        """Return the mesh of all submaps joined to one; not ``ordered``, its vertices come as in no other run."""
        return joined([(s.surface(ordered=ordered), s.to_root) for s in self.submaps if s.root == root])

    def _begin(self, view: View, prepared: PreparedView) -> Placed:
        known = np.isfinite(view.z_mm)
        if known.mean() < MIN_KNOWN:
            return self._lost(view, NO_DEPTH)
        if self.current is not None:
            self.current.mesh, self.current.volume = self.current.surface(), None
            self.listener(f"frame {view.index}: still lost, so a new submap begins (number {len(self.submaps)})")
        self.lost_in_row = 0
        c = self.config
        default = np.median(view.z_mm[known]) / _VOXELS_OF_DISTANCE
        voxel_mm = c.voxel_mm or float(np.clip(default, _MIN_VOXEL_MM, _MAX_VOXEL_MM))
        volume = Volume(
            voxel_mm=voxel_mm,
            truncation_voxels=c.truncation_voxels,
            memory_mb=c.memory_mb,
            max_distance_mm=c.max_distance_mm,
        )
        self.submaps.append(Submap(volume, root=len(self.submaps)))
        self._pose, self._reported_full, self._join_candidate = np.eye(4), False, None
        self._motion = ConstantVelocity(self._pose, view.time_s)
        self._fuse(view, prepared, self.submaps[-1])
        return Placed(view.index, view.time_s, self._pose.copy(), submap=self.submap, note="origin")

    def _follow(self, view: View, prepared: PreparedView, submap: Submap) -> Placed:
        found, continuous = self._found(view, prepared, submap)
        if found.lost:
            return self._lost(view, found.lost)
        if self.lost_in_row:
            self.listener(f"frame {view.index}: tracking found again after {self.lost_in_row} frames")
        self.lost_in_row = 0
        if found.keyframe is not None and found.points is not None:
            found.keyframe.refine(found.points)
        self._pose = orthonormal(found.pose)
        if continuous:
            self._motion.update(self._pose, view.time_s)
        else:
            self._motion = ConstantVelocity(self._pose, view.time_s)
        self._fuse(view, prepared, submap)
        if view.index % _JOIN_EVERY == 0:
            self._join(view, prepared, submap)
        return Placed(view.index, view.time_s, self._pose.copy(), found.overlap, found.correlation, self.submap)

    def _found(self, view: View, prepared: PreparedView, submap: Submap) -> tuple[Track, bool]:
        """Track from the predicted, last and most similar poses, as wrong ones fit nearly as well; the best."""
        continuous = not self.lost_in_row
        predicted = self._motion.predict(view.time_s) if continuous else self._pose
        first = self._keyframe(predicted, prepared, submap)
        best = self._tracked(prepared, first, predicted)
        nearest = self._nearest(predicted, prepared, submap)
        if best.score < _GOOD_SCORE and nearest is not first:
            best = max(best, self._tracked(prepared, nearest, predicted), key=lambda found: found.score)
        if best.score >= _POOR_SCORE:
            return best, continuous
        others = [(self._nearest(self._pose, prepared, submap), self._pose)]
        for keyframe, guess in others + [(key, key.pose) for key in similar(prepared, submap.keyframes)]:
            found = self._tracked(prepared, keyframe, guess)
            if found.score > best.score:
                best, continuous = found, continuous and guess is self._pose
            if best.score >= _GOOD_SCORE:
                break
        return best, continuous

    def _tracked(self, prepared: PreparedView, keyframe: Keyframe, guess: np.ndarray) -> Track:
        found = track(prepared, keyframe, guess, config=self.config)
        if keyframe is not self._active:
            keyframe.free_points()
        return found

    def _lost(self, view: View, why: str) -> Placed:
        if self.lost_in_row == 0:
            self.listener(f"frame {view.index}: tracking lost ({why}); move back to where it worked")
        self.lost_in_row += 1
        return Placed(view.index, view.time_s, None, 0.0, 0.0, self.submap, f"lost: {why}")

    def _fuse(self, view: View, prepared: PreparedView, submap: Submap) -> None:
        volume = submap.volume
        assert volume is not None
        self._followed += 1
        is_far = all(key.distance_to(self._pose, prepared.median_mm) > _KEYFRAME_DISTANCE for key in submap.keyframes)
        if not is_far and self._followed % self.config.fuse_every:
            return
        volume.integrate(view, self.camera_matrix, self._pose)
        if volume.full and not self._reported_full:
            self._reported_full = True
            self.listener(
                f"frame {view.index}: the volume is full ({self.config.memory_mb} MB); new surface is NOT added. "
                "Use --memory-mb or a larger --voxel-mm"
            )
        if is_far:
            submap.keyframes.append(prepared.keyframe(self._pose))
            del submap.keyframes[1 : 1 + max(0, len(submap.keyframes) - _MAX_KEYFRAMES)]

    def _keyframe(self, pose: np.ndarray, prepared: PreparedView, submap: Submap) -> Keyframe:
        """Return the oldest keyframe close to a pose: the older, the less it has drifted."""
        close = (key for key in submap.keyframes if key.distance_to(pose, prepared.median_mm) <= _KEYFRAME_DISTANCE)
        chosen = next(close, None) or self._nearest(pose, prepared, submap)
        if chosen is not self._active or self._followed - self._cast_at >= _REFRESH:
            if self._active is not None:
                self._active.free_points()
            self._active, self._cast_at = chosen, self._followed
            assert submap.volume is not None
            # The model's distances: frames are tracked against it, not against one measurement.
            matrix = scaled(self.camera_matrix, self.config.tracking_scale)
            height, width = chosen.grey.shape
            chosen.set_distances(submap.volume.ray_cast(matrix, chosen.pose, width, height, reduced=_CAST_PX))
        return chosen

    def _nearest(self, pose: np.ndarray, prepared: PreparedView, submap: Submap) -> Keyframe:
        return min(submap.keyframes, key=lambda key: key.distance_to(pose, prepared.median_mm))

    def _join(self, view: View, prepared: PreparedView, submap: Submap) -> None:
        """Track the view in older submaps; two poses in a row that agree join this submap to theirs."""
        config = replace(self.config, min_correlation=_JOIN_CORRELATION, min_overlap=_JOIN_OVERLAP)
        for other in (s for s in self.submaps if s.root != submap.root):
            for keyframe in similar(prepared, other.keyframes):
                found = track(prepared, keyframe, keyframe.pose, config=config)
                keyframe.free_points()
                if found.lost:
                    continue
                to_other = found.pose @ np.linalg.inv(self._pose)
                number, before = self._join_candidate or (-1, np.eye(4))
                self._join_candidate = (other.root, other.to_root @ to_other)
                if number == other.root and _agree(before, self._join_candidate[1], self._pose):
                    self._attach(other, self._join_candidate[1], submap, view.index)
                return

    def _attach(self, other: Submap, to_root: np.ndarray, submap: Submap, index: int) -> None:
        old_root, change = submap.root, orthonormal(to_root) @ np.linalg.inv(submap.to_root)
        for each in self.submaps:
            if each.root == old_root:
                each.root, each.to_root = other.root, change @ each.to_root
        self._join_candidate = None
        self.listener(f"frame {index}: seen before; submap {old_root} is joined to submap {other.root}")


def similar(prepared: PreparedView, keyframes: list[Keyframe]) -> list[Keyframe]:
    """Return the few keyframes whose thumbnails correlate most with the view's."""
    return sorted(keyframes, key=lambda key: -float((key.thumbnail * prepared.thumbnail).sum()))[:_CANDIDATES]


def orthonormal(pose: np.ndarray) -> np.ndarray:
    """Remove rounding errors from a rotation that was multiplied many times."""
    u, _, vt = np.linalg.svd(pose[:3, :3])
    clean = pose.copy()
    clean[:3, :3] = u @ vt
    return clean


def _agree(a: np.ndarray, b: np.ndarray, here: np.ndarray) -> bool:
    moved = np.linalg.inv(a @ here) @ b @ here
    return float(np.linalg.norm(moved[:3, 3])) < _JOIN_MM and turn_deg(moved) < _JOIN_DEG
