"""Estimate the pose of a view against a keyframe, by brightness and distance.

A keyframe has its own picture, as the model's colours are only as sharp as its voxels, and the distances of the model,
which parallax between the frames refines: measured depth errs alike over whole regions, and bends the path with it.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np

from chromaperture.depth.error_limit import within_error
from chromaperture.products.rectified import View
from chromaperture.reconstruction.direct_alignment import MODEL_SHARE, Level, align, pyramid, select_points
from chromaperture.reconstruction.settings import ReconstructionConfig


def cleaned(view: View, config: ReconstructionConfig) -> View:
    """Remove wide error bars, far points and pixels at a step of depth: they become NaN."""
    z = view.z_mm
    certain = within_error(z, view.sigma_mm, config.max_relative_sigma)
    with np.errstate(invalid="ignore"):
        kept = (certain > 0) & (certain <= config.max_distance_mm)
    kept &= ~near_steps(z, jump=config.edge_jump, reach_px=config.edge_px)
    nan = np.float32(np.nan)
    return View(view.color, np.where(kept, z, nan), np.where(kept, view.sigma_mm, nan), view.time_s, view.index)


def near_steps(z_mm: np.ndarray, *, jump: float, reach_px: int) -> np.ndarray:
    """Find flying pixels: those within ``reach_px`` of a step by ``jump`` of the distance; (H, W) bool."""
    known = np.isfinite(z_mm) & (z_mm > 0)
    inverse = np.where(known, 1.0 / np.where(known, z_mm, 1.0), np.nan).astype(np.float32)  # planes are linear in 1 / z
    window = np.ones((2 * reach_px + 1, 2 * reach_px + 1), np.uint8)
    nearest = cv2.dilate(np.where(known, inverse, -1.0), window, borderType=cv2.BORDER_REPLICATE)
    farthest = cv2.erode(np.where(known, inverse, 1e9), window, borderType=cv2.BORDER_REPLICATE)
    return known & (nearest - farthest > jump * np.where(known, inverse, 1.0))


def scaled(camera_matrix: np.ndarray, scale: int) -> np.ndarray:
    """Return the camera matrix of the reduced picture, whose pixel centres lie at (scale - 1) / 2 of the full one's."""
    matrix = np.array(camera_matrix, float)
    matrix[:2] /= scale
    matrix[:2, 2] -= (scale - 1) / (2 * scale)
    return matrix


_THUMBNAIL = (40, 30)  # px; chosen by hand
MIN_KNOWN = 0.02  # fraction of a view that must have depth to be tracked or to begin a submap; chosen by hand
NO_DEPTH = "hardly any pixel has a depth that can be trusted; light, texture or range?"


@dataclass(frozen=True)
class Track:
    """Estimated pose of a view."""

    pose: np.ndarray  # (4, 4) float64, camera to world, mm
    overlap: float  # fraction of the keyframe's points that are visible at their distance
    correlation: float  # of the view's brightness with the keyframe's, -1..1
    lost: str  # why the pose is not reliable; empty when it is
    points: np.ndarray | None = None  # the keyframe's, of the finest scale, refined
    keyframe: Keyframe | None = None

    @property
    def score(self) -> float:
        """Overlap times correlation, higher is better; 0 when lost."""
        return 0.0 if self.lost else self.overlap * self.correlation


@dataclass
class Keyframe:
    """A past view that others are aligned with: its reduced picture; distances of the model, or refined."""

    pose: np.ndarray  # (4, 4) float64, camera to world, mm
    thumbnail: np.ndarray  # (30, 40) float32
    grey: np.ndarray  # (H, W) uint8
    z_mm: np.ndarray  # (H, W) float32, NaN unknown
    sigma_mm: np.ndarray  # (H, W) float32, of the view's own distances, or of refined ones
    matrix: np.ndarray  # (3, 3) float64, of the reduced picture
    _points: list[np.ndarray] | None = field(default=None, repr=False)
    _refined: np.ndarray | None = field(default=None, repr=False)  # (H, W) bool: pixels of refined distance

    @property
    def points(self) -> list[np.ndarray]:
        """Points to align, the finest scale first."""
        if self._points is None:
            levels = pyramid(self.grey.astype(np.float32), self.z_mm, self.sigma_mm, self.matrix)
            self._points = [select_points(level) for level in levels]
        return self._points

    def set_distances(self, z_mm: np.ndarray) -> None:
        """Replace distances by the model's where it has them (NaN unknown), and parallax has not refined them."""
        news = np.isfinite(z_mm)
        if self._refined is not None:
            news &= ~self._refined
        self.z_mm = np.where(news, z_mm, self.z_mm)
        self._points = None

    def refine(self, points: np.ndarray) -> None:
        """Take the distances of refined points of the finest scale."""
        pixels = points[:, :2] / points[:, 2:3] * self.matrix[[0, 1], [0, 1]] + self.matrix[:2, 2]
        columns, rows = np.rint(pixels).astype(int).T
        self.z_mm[rows, columns] = points[:, 2]
        self.sigma_mm[rows, columns] = points[:, 6] * points[:, 2] / MODEL_SHARE
        if self._refined is None:
            self._refined = np.zeros(self.grey.shape, bool)
        self._refined[rows, columns] = True
        if self._points is not None:
            self._points[0] = points

    def free_points(self) -> None:
        """Free the memory of `points`, which are computed again when needed."""
        self._points = None

    def distance_to(self, pose: np.ndarray, depth_mm: float) -> float:
        """Return how far the picture's middle moves, and scales, towards a camera at ``pose``, in picture widths."""
        moved = np.linalg.inv(pose) @ self.pose @ np.array([0.0, 0.0, depth_mm, 1.0])
        if moved[2] <= 0.1 * depth_mm:
            return np.inf
        scale = abs(np.log(moved[2] / depth_mm))
        return float(np.hypot(*(self.matrix[0, 0] * moved[:2] / moved[2])) / self.grey.shape[1] + scale)


@dataclass(frozen=True)
class PreparedView:
    """A view prepared for tracking: its pyramid, thumbnail, fraction with depth and median distance."""

    levels: list[Level]
    thumbnail: np.ndarray
    known: float
    median_mm: float

    def keyframe(self, pose: np.ndarray) -> Keyframe:
        """Make a keyframe of the view."""
        fine = self.levels[0]
        grey = np.rint(fine.grey).astype(np.uint8)
        known = np.isfinite(fine.sigma_mm)
        sigma_mm = np.where(known, fine.sigma_mm, np.median(fine.sigma_mm[known])).astype(np.float32)
        return Keyframe(pose.copy(), self.thumbnail, grey, fine.z_mm.copy(), sigma_mm, fine.matrix)


def prepare(view: View, camera_matrix: np.ndarray, config: ReconstructionConfig) -> PreparedView:
    """Prepare a cleaned view for tracking."""
    small = shrunk(view, config.tracking_scale)
    grey = cv2.cvtColor(small.color, cv2.COLOR_RGB2GRAY).astype(np.float32)
    levels = pyramid(grey, small.z_mm, small.sigma_mm, scaled(camera_matrix, config.tracking_scale))
    known = np.isfinite(small.z_mm)
    median_mm = float(np.median(small.z_mm[known])) if known.any() else float("nan")
    return PreparedView(levels, thumbnail(grey), float(known.mean()), median_mm)


def track(view: PreparedView, keyframe: Keyframe, guess: np.ndarray, *, config: ReconstructionConfig) -> Track:
    """Estimate a view's pose, camera to world, mm, from a guess; a picture never raises, see `Track.lost`."""
    if view.known < MIN_KNOWN:
        return Track(guess, 0.0, 0.0, NO_DEPTH)
    outlier_mm = config.outlier_mm * max(1.0, view.median_mm / 2000)
    start = np.linalg.inv(guess) @ keyframe.pose
    found = align(keyframe.points, view.levels, start, depth_weight=config.depth_weight, outlier_mm=outlier_mm)
    if not found.solved or not np.isfinite(found.motion).all():
        return Track(guess, 0.0, 0.0, "surface and texture do not determine the pose")
    pose = keyframe.pose @ np.linalg.inv(found.motion)
    moved = np.linalg.inv(guess) @ pose
    step, turn = float(np.linalg.norm(moved[:3, 3])), turn_deg(moved)
    if step > config.max_step_mm or turn > config.max_turn_deg:
        lost = f"a jump of {step:.0f} mm and {turn:.0f} degrees"
    elif found.overlap < config.min_overlap:
        lost = f"only {found.overlap:.0%} of the keyframe is visible"
    elif found.correlation < config.min_correlation:
        lost = f"the picture differs from the model (correlation {found.correlation:.2f})"
    else:
        return Track(pose, found.overlap, found.correlation, "", found.points, keyframe)
    return Track(guess, found.overlap, found.correlation, lost)


def turn_deg(pose: np.ndarray) -> float:
    """Return the angle of a rotation."""
    return float(np.degrees(np.arccos(np.clip((np.trace(pose[:3, :3]) - 1) / 2, -1, 1))))


def thumbnail(grey: np.ndarray) -> np.ndarray:
    """Return a small grey picture of mean 0 and norm 1, blurred to tolerate some motion."""
    small = cv2.resize(grey, _THUMBNAIL, interpolation=cv2.INTER_AREA)
    small = cv2.GaussianBlur(small, (0, 0), 1.0)
    small -= small.mean()
    return small / max(float(np.linalg.norm(small)), 1e-6)


def shrunk(view: View, scale: int) -> View:
    """Reduce a view; colours are averaged, depths and standard deviations sampled."""
    if scale == 1:
        return view
    size = (view.color.shape[1] // scale, view.color.shape[0] // scale)
    half = scale // 2
    rows, columns = slice(half, half + size[1] * scale, scale), slice(half, half + size[0] * scale, scale)
    whole = view.color[: size[1] * scale, : size[0] * scale]
    color = cv2.resize(whole, size, interpolation=cv2.INTER_AREA)
    z_mm, sigma_mm = (np.ascontiguousarray(m[rows, columns]) for m in (view.z_mm, view.sigma_mm))
    return View(color, z_mm, sigma_mm, view.time_s, view.index)
