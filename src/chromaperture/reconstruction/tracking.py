"""Pose of one view against a keyframe, whose distances are those of the model: brightness and distance together.

The model's own colours are no sharper than its voxels, the keyframe's are as sharp as the camera's.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np

from chromaperture.products.rectified import View
from chromaperture.reconstruction.direct_alignment import Level, align, points_of, pyramid
from chromaperture.reconstruction.settings import ReconstructionConfig

_THUMBNAIL = (40, 30)
_MIN_KNOWN = 0.02  # share of a picture with depth, below which nothing can be said


@dataclass(frozen=True)
class Track:
    """Where the camera was found.

    Attributes
    ----------
    pose : (4, 4) float64
        Camera to world, mm.
    overlap : float
        Share of the keyframe's points that the view shows at their distance.
    likeness : float
        Correlation of the view's brightness with the keyframe's there, -1..1.
    lost : str
        Why the pose is not to be trusted; empty when it is.
    seen : float
        Share of the keyframe's points that fall into the view.
    """

    pose: np.ndarray
    overlap: float
    likeness: float
    lost: str
    seen: float = 0.0

    @property
    def score(self) -> float:
        """How much speaks for it: 0 when lost."""
        return 0.0 if self.lost else self.overlap * self.likeness


@dataclass
class Keyframe:
    """A place that tracking works against: its picture, small, and its distances, from the model once there is one.

    Attributes
    ----------
    pose : (4, 4) float64, camera to world, mm
    thumbnail : (30, 40) float32
    grey : (H, W) uint8
    z_mm : (H, W) float32, NaN unknown
    matrix : (3, 3) float64
        Of the small picture.
    """

    pose: np.ndarray
    thumbnail: np.ndarray
    grey: np.ndarray
    z_mm: np.ndarray
    matrix: np.ndarray
    _points: list[np.ndarray] | None = field(default=None, repr=False)

    @property
    def points(self) -> list[np.ndarray]:
        """Points to be found again, the finest scale first."""
        if self._points is None:
            levels = pyramid(self.grey.astype(np.float32), self.z_mm, self.z_mm, self.matrix)
            self._points = [points_of(level) for level in levels]
        return self._points

    def see(self, z_mm: np.ndarray) -> None:
        """Take distances from the model (NaN unknown), where it has them."""
        self.z_mm = np.where(np.isfinite(z_mm), z_mm, self.z_mm)
        self._points = None

    def forget_points(self) -> None:
        """Free what can be made again."""
        self._points = None

    def apart(self, pose: np.ndarray, depth_mm: float) -> float:
        """How far its middle lies from the middle of a camera at ``pose``, as a share of the picture's width."""
        moved = np.linalg.inv(pose) @ self.pose @ np.array([0.0, 0.0, depth_mm, 1.0])
        if moved[2] <= 0.1 * depth_mm:
            return np.inf
        scale = abs(np.log(moved[2] / depth_mm))
        return float(np.hypot(*(self.matrix[0, 0] * moved[:2] / moved[2])) / self.grey.shape[1] + scale)


@dataclass(frozen=True)
class Sight:
    """A view made ready for tracking."""

    levels: list[Level]
    thumbnail: np.ndarray
    known: float
    median_mm: float

    def keyframe(self, pose: np.ndarray) -> Keyframe:
        """Make a keyframe of the view."""
        fine = self.levels[0]
        grey = np.rint(fine.grey).astype(np.uint8)
        return Keyframe(pose.copy(), self.thumbnail, grey, fine.z_mm.copy(), fine.matrix)


def sight(view: View, camera_matrix: np.ndarray, config: ReconstructionConfig) -> Sight:
    """Make a cleaned view ready for tracking."""
    small = shrunk(view, config.tracking_scale)
    grey = cv2.cvtColor(small.color, cv2.COLOR_RGB2GRAY).astype(np.float32)
    levels = pyramid(grey, small.z_mm, small.sigma_mm, scaled(camera_matrix, config.tracking_scale))
    known = np.isfinite(small.z_mm)
    median_mm = float(np.median(small.z_mm[known])) if known.any() else float("nan")
    return Sight(levels, thumbnail(grey), float(known.mean()), median_mm)


def track(seen: Sight, keyframe: Keyframe, guess: np.ndarray, *, config: ReconstructionConfig) -> Track:
    """Find the camera from a guess of its pose.

    Parameters
    ----------
    seen : Sight
    keyframe : Keyframe
    guess : (4, 4) float, camera to world, mm
    config : ReconstructionConfig

    Returns
    -------
    Track
        Never raises because of what is in the picture: `Track.lost` says what is wrong.
    """
    if seen.known < _MIN_KNOWN:
        return Track(guess, 0.0, 0.0, "hardly any pixel has a depth that can be trusted; light, texture or range?")
    outlier_mm = config.outlier_mm * max(1.0, seen.median_mm / 2000)
    found = align(
        keyframe.points,
        seen.levels,
        np.linalg.inv(guess) @ keyframe.pose,
        depth_weight=config.depth_weight,
        outlier_mm=outlier_mm,
    )
    if not found.solved or not np.isfinite(found.motion).all():
        return Track(guess, 0.0, 0.0, "surface and texture do not determine the pose")
    pose = keyframe.pose @ np.linalg.inv(found.motion)
    moved = np.linalg.inv(guess) @ pose
    step, turn = float(np.linalg.norm(moved[:3, 3])), turn_deg(moved)
    if step > config.max_step_mm or turn > config.max_turn_deg:
        lost = f"a jump of {step:.0f} mm and {turn:.0f} degrees"
    elif found.fitting < config.min_overlap:
        lost = f"only {found.fitting:.0%} of what was there is seen"
    elif found.likeness < config.min_likeness:
        lost = f"the picture does not look like the model (correlation {found.likeness:.2f})"
    else:
        return Track(pose, found.fitting, found.likeness, "", found.seen)
    return Track(guess, found.fitting, found.likeness, lost, found.seen)


def turn_deg(pose: np.ndarray) -> float:
    """Angle of a rotation."""
    return float(np.degrees(np.arccos(np.clip((np.trace(pose[:3, :3]) - 1) / 2, -1, 1))))


def thumbnail(grey: np.ndarray) -> np.ndarray:
    """Small grey picture of mean 0 and norm 1, blurred enough to forgive some motion."""
    small = cv2.resize(grey, _THUMBNAIL, interpolation=cv2.INTER_AREA)
    small = cv2.GaussianBlur(small, (0, 0), 1.0)
    small -= small.mean()
    return small / max(float(np.linalg.norm(small)), 1e-6)


def shrunk(view: View, scale: int) -> View:
    """Reduce a view; colours are averaged, depths and error bars taken as they are."""
    if scale == 1:
        return view
    size = (view.color.shape[1] // scale, view.color.shape[0] // scale)
    half = scale // 2
    rows, columns = slice(half, half + size[1] * scale, scale), slice(half, half + size[0] * scale, scale)
    whole = view.color[: size[1] * scale, : size[0] * scale]
    color = cv2.resize(whole, size, interpolation=cv2.INTER_AREA)
    z_mm, sigma_mm = (np.ascontiguousarray(m[rows, columns]) for m in (view.z_mm, view.sigma_mm))
    return View(color, z_mm, sigma_mm, view.time_s, view.index)


def scaled(camera_matrix: np.ndarray, scale: int) -> np.ndarray:
    """Camera matrix of the reduced picture, whose pixel centres lie at (scale - 1) / 2 of the full one's."""
    matrix = np.array(camera_matrix, float)
    matrix[:2] /= scale
    matrix[:2, 2] -= (scale - 1) / (2 * scale)
    return matrix
