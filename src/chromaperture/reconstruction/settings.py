"""Settings of the reconstruction and their defaults."""

from __future__ import annotations

from dataclasses import dataclass

from chromaperture.system.errors import InputError


@dataclass(frozen=True)
class ReconstructionConfig:
    """Settings of cleaning, tracking and fusion; chosen by hand unless a measurement is stated."""

    voxel_mm: float | None = None  # edge of a voxel; None takes 1/200 of the first view's median distance
    # Upper limit of the truncation in front of and behind the surface, which is three standard deviations.
    truncation_voxels: float = 8.0
    max_distance_mm: float = 6000.0  # farther points are removed
    # Pixels whose standard deviation exceeds this fraction of their distance are removed. docs/decisions.md:
    # narrower limits do not help.
    max_relative_sigma: float = 0.08
    edge_jump: float = 0.04  # relative step of distance within ``edge_px`` from which a pixel is a flying one
    edge_px: int = 3  # half width of the neighbourhood in which a step is searched
    memory_mb: int = 512  # memory of the volume, reserved at once; fixes the number of its blocks
    tracking_scale: int = 2  # tracking works on pictures reduced by this factor
    outlier_mm: float = 150.0  # points farther from the model are outliers; at 2 m, proportional to the distance beyond
    # Weight of a pixel's distance relative to its brightness in tracking; far below 1 because errors of neighbours are
    # correlated. docs/decisions.md compares weights.
    depth_weight: float = 0.03
    # Fraction of the keyframe's points that must be visible at their distance, else the frame is lost.
    min_overlap: float = 0.3
    # Of the view's brightness with the keyframe's at the estimated pose, else the frame is lost.
    min_correlation: float = 0.5
    # ``max_step_mm``, ``max_turn_deg``: largest difference between the estimated pose and its guess, else the frame is
    # lost.
    max_step_mm: float = 300.0
    max_turn_deg: float = 20.0
    submap_after: int = 10  # frames lost in a row after which a new submap begins
    # Of frames that follow each other one in so many is fused; a new keyframe is in any case. All are tracked.
    fuse_every: int = 1

    def __post_init__(self) -> None:
        if self.voxel_mm is not None and not 0.1 <= self.voxel_mm <= 1000:
            raise InputError(f"a voxel must measure 0.1 to 1000 mm, got {self.voxel_mm:g}")
        lengths = ("truncation_voxels", "max_distance_mm", "outlier_mm", "max_step_mm", "max_turn_deg")
        for name in (*lengths, "max_relative_sigma", "edge_jump", "depth_weight"):
            if not getattr(self, name) > 0:
                raise InputError(f"{name} must be positive, got {getattr(self, name):g}")
        counts = (self.tracking_scale, self.submap_after, self.fuse_every)
        if self.memory_mb < 16 or self.edge_px < 0 or min(counts) < 1:
            raise InputError("memory_mb must be at least 16, tracking_scale, submap_after and fuse_every at least 1")
