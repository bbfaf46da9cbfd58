"""The loop: clean a view, find the camera, fuse; say when it is lost, find it again, begin a submap, join it later."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from chromaperture.products.rectified import View
from chromaperture.reconstruction.clean_views import cleaned
from chromaperture.reconstruction.motion import Speed
from chromaperture.reconstruction.settings import ReconstructionConfig
from chromaperture.reconstruction.tracking import Keyframe, Sight, Track, scaled, sight, track, turn_deg
from chromaperture.reconstruction.volume import Mesh, Volume, joined

_KEYFRAMES = 300
_APART = 0.2  # of the picture's width: farther from every keyframe, a new one is made
_CLEAR, _DOUBTFUL = 0.65, 0.3  # overlap times likeness: nothing else is tried; all is
_TRIES = 3  # keyframes tried a lost frame
_REFRESH = 4  # views fused until the keyframe takes its distances from the model again
_VOXELS_OF_DISTANCE = 200
_MIN_KNOWN = 0.02
_JOIN_LIKENESS, _JOIN_OVERLAP = 0.75, 0.5  # stricter than tracking: nothing says that the place was seen before
_JOIN_EVERY = 3  # frames from one look into older submaps to the next
_JOIN_MM, _JOIN_DEG = 40.0, 2.0  # two finds in a row that agree so well are no accident


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
class Submap:
    """A model with a world frame of its own, that of its first view.

    Attributes
    ----------
    volume : Volume or None
        While it grows.
    mesh : Mesh or None
        Afterwards.
    keyframes : list of Keyframe
    root, to_root : int, (4, 4) float64
        The submap that it was joined to, itself at first, and its pose there.
    """

    volume: Volume | None
    mesh: Mesh | None = None
    keyframes: list[Keyframe] = field(default_factory=list)
    root: int = 0
    to_root: np.ndarray = field(default_factory=lambda: np.eye(4))

    def surface(self) -> Mesh:
        """Give its mesh in its own frame."""
        if self.mesh is not None:
            return self.mesh
        assert self.volume is not None
        return self.volume.mesh()


class Reconstruction:
    """A growing model.

    Parameters
    ----------
    camera_matrix : (3, 3) float, px
    config : ReconstructionConfig
    listener : callable, optional
        Told in one line when tracking is lost or found again, a submap begins or is joined, or the volume is full.
    """

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
        self._pose, self._speed = np.eye(4), Speed(np.eye(4), 0.0)
        self._said_full = False
        self._active: Keyframe | None = None
        self._fused = 0
        self._joining: tuple[int, np.ndarray] | None = None

    @property
    def current(self) -> Submap | None:
        """The submap that grows."""
        return self.submaps[-1] if self.submaps else None

    @property
    def submap(self) -> int:
        """Number of the submap that grows."""
        return max(0, len(self.submaps) - 1)

    @property
    def roots(self) -> list[int]:
        """Submaps that were not joined to an older one: each is a world frame of its own."""
        return sorted({submap.root for submap in self.submaps})

    def add(self, view: View) -> Placed:
        """Track and fuse one view; never raises because of what it shows."""
        clean = cleaned(view, self.config)
        seen = sight(clean, self.camera_matrix, self.config)
        if self.current is None or self.lost_in_row >= self.config.submap_after:
            placed = self._begin(clean, seen)
        else:
            placed = self._follow(clean, seen, self.current)
        self.placed.append(placed)
        return placed

    def in_root(self, placed: Placed) -> Placed:
        """Give a frame's pose in the frame of the submap that its own was joined to."""
        if placed.pose is None:
            return placed
        submap = self.submaps[placed.submap]
        return replace(placed, pose=submap.to_root @ placed.pose, submap=submap.root)

    def meshes(self) -> list[Mesh]:
        """Give one mesh for every world frame, the first first, each of all submaps joined to it; empty ones too."""
        return [self.mesh(root) for root in self.roots]

    def mesh(self, root: int) -> Mesh:
        """Give the mesh of all submaps joined to one."""
        return joined([(s.surface(), s.to_root) for s in self.submaps if s.root == root])

    def _begin(self, view: View, seen: Sight) -> Placed:
        known = np.isfinite(view.z_mm)
        if known.mean() < _MIN_KNOWN:
            return self._lost(view, "hardly any pixel has a depth that can be trusted; light, texture or range?")
        if self.current is not None:
            self.current.mesh, self.current.volume = self.current.surface(), None
            self.listener(f"frame {view.index}: still lost, so a new submap begins (number {len(self.submaps)})")
        self.lost_in_row = 0
        c = self.config
        voxel_mm = c.voxel_mm or float(np.clip(np.median(view.z_mm[known]) / _VOXELS_OF_DISTANCE, 0.5, 50.0))
        volume = Volume(
            voxel_mm=voxel_mm,
            truncation_voxels=c.truncation_voxels,
            memory_mb=c.memory_mb,
            max_distance_mm=c.max_distance_mm,
        )
        self.submaps.append(Submap(volume, root=len(self.submaps)))
        self._pose, self._said_full, self._joining = np.eye(4), False, None
        self._speed = Speed(self._pose, view.time_s)
        self._fuse(view, seen, self.submaps[-1])
        return Placed(view.index, view.time_s, self._pose.copy(), submap=self.submap, note="origin")

    def _follow(self, view: View, seen: Sight, submap: Submap) -> Placed:
        found, seamless = self._found(view, seen, submap)
        if found.lost:
            return self._lost(view, found.lost)
        if self.lost_in_row:
            self.listener(f"frame {view.index}: tracking found again after {self.lost_in_row} frames")
        self.lost_in_row = 0
        self._pose = orthonormal(found.pose)
        if seamless:
            self._speed.met(self._pose, view.time_s)
        else:
            self._speed = Speed(self._pose, view.time_s)
        self._fuse(view, seen, submap)
        if view.index % _JOIN_EVERY == 0:
            self._join(view, seen, submap)
        return Placed(view.index, view.time_s, self._pose.copy(), found.overlap, found.likeness, self.submap)

    def _found(self, view: View, seen: Sight, submap: Submap) -> tuple[Track, bool]:
        """Look for the camera where it should be, where it was, and from the keyframes that look most like the view.

        Gives it, and whether it went there from where it was. Far from the right pose a wrong one fits nearly as well:
        what does not fit clearly is held against what the other guesses lead to.
        """
        seamless = not self.lost_in_row
        ahead = self._speed.ahead(view.time_s) if seamless else self._pose
        first = self._keyframe(ahead, seen, submap)
        best = self._tracked(seen, first, ahead)
        nearest = self._nearest(ahead, seen, submap)
        if best.score < _CLEAR and nearest is not first:
            best = max(best, self._tracked(seen, nearest, ahead), key=lambda found: found.score)
        if best.score >= _DOUBTFUL:
            return best, seamless
        others = [(self._nearest(self._pose, seen, submap), self._pose)]
        for keyframe, guess in others + [(key, key.pose) for key in similar(seen, submap.keyframes)]:
            found = self._tracked(seen, keyframe, guess)
            if found.score > best.score:
                best, seamless = found, seamless and guess is self._pose
            if best.score >= _CLEAR:
                break
        return best, seamless

    def _tracked(self, seen: Sight, keyframe: Keyframe, guess: np.ndarray) -> Track:
        found = track(seen, keyframe, guess, config=self.config)
        if keyframe is not self._active:
            keyframe.forget_points()
        return found

    def _lost(self, view: View, why: str) -> Placed:
        if self.lost_in_row == 0:
            self.listener(f"frame {view.index}: tracking lost ({why}); move back to where it worked")
        self.lost_in_row += 1
        return Placed(view.index, view.time_s, None, 0.0, 0.0, self.submap, f"lost: {why}")

    def _fuse(self, view: View, seen: Sight, submap: Submap) -> None:
        volume = submap.volume
        assert volume is not None
        volume.integrate(view, self.camera_matrix, self._pose)
        self._fused += 1
        if volume.full and not self._said_full:
            self._said_full = True
            self.listener(
                f"frame {view.index}: the volume is full ({self.config.memory_mb} MB); new surface is NOT added. "
                "Use --memory-mb or a larger --voxel-mm"
            )
        if all(key.apart(self._pose, seen.median_mm) > _APART for key in submap.keyframes):
            submap.keyframes.append(seen.keyframe(self._pose))
            del submap.keyframes[1 : 1 + max(0, len(submap.keyframes) - _KEYFRAMES)]

    def _keyframe(self, pose: np.ndarray, seen: Sight, submap: Submap) -> Keyframe:
        """Give the oldest keyframe that sees much of what a camera there does: the older, the less it has drifted."""
        apart = [key.apart(pose, seen.median_mm) for key in submap.keyframes]
        close = [key for key, far in zip(submap.keyframes, apart, strict=True) if far <= _APART]
        chosen = close[0] if close else self._nearest(pose, seen, submap)
        if chosen is not self._active or self._fused >= _REFRESH:
            if self._active is not None:
                self._active.forget_points()
            self._active, self._fused = chosen, 0
            self._look(chosen, submap)
        return chosen

    def _nearest(self, pose: np.ndarray, seen: Sight, submap: Submap) -> Keyframe:
        return min(submap.keyframes, key=lambda key: key.apart(pose, seen.median_mm))

    def _look(self, keyframe: Keyframe, submap: Submap) -> None:
        """Give a keyframe the model's distances: frames are tracked against the model, not against one measurement."""
        assert submap.volume is not None
        height, width = keyframe.grey.shape
        z_mm = submap.volume.look(scaled(self.camera_matrix, self.config.tracking_scale), keyframe.pose, width, height)
        keyframe.see(np.where(z_mm > 0, z_mm, np.float32(np.nan)))

    def _join(self, view: View, seen: Sight, submap: Submap) -> None:
        """Look for the view in older submaps; two finds that agree join this one to theirs."""
        older = [s for s in self.submaps if s.root != submap.root]
        config = replace(self.config, min_likeness=_JOIN_LIKENESS, min_overlap=_JOIN_OVERLAP)
        for other in older:
            for keyframe in similar(seen, other.keyframes):
                found = track(seen, keyframe, keyframe.pose, config=config)
                keyframe.forget_points()
                if found.lost:
                    continue
                to_other = found.pose @ np.linalg.inv(self._pose)
                number, before = self._joining or (-1, np.eye(4))
                self._joining = (other.root, other.to_root @ to_other)
                if number == other.root and _alike(before, self._joining[1], self._pose):
                    self._placed_in(other, self._joining[1], submap, view.index)
                return

    def _placed_in(self, other: Submap, to_root: np.ndarray, submap: Submap, index: int) -> None:
        old_root, change = submap.root, orthonormal(to_root) @ np.linalg.inv(submap.to_root)
        for each in self.submaps:
            if each.root == old_root:
                each.root, each.to_root = other.root, change @ each.to_root
        self._joining = None
        self.listener(f"frame {index}: seen before; submap {old_root} is joined to submap {other.root}")


def similar(seen: Sight, keyframes: list[Keyframe]) -> list[Keyframe]:
    """Give the few keyframes that look most like the view."""
    return sorted(keyframes, key=lambda key: -float((key.thumbnail * seen.thumbnail).sum()))[:_TRIES]


def orthonormal(pose: np.ndarray) -> np.ndarray:
    """Take rounding out of a rotation that was multiplied many times."""
    u, _, vt = np.linalg.svd(pose[:3, :3])
    clean = pose.copy()
    clean[:3, :3] = u @ vt
    return clean


def _alike(a: np.ndarray, b: np.ndarray, here: np.ndarray) -> bool:
    moved = np.linalg.inv(a @ here) @ b @ here
    return float(np.linalg.norm(moved[:3, 3])) < _JOIN_MM and turn_deg(moved) < _JOIN_DEG
