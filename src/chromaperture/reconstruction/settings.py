"""Every default of the reconstruction."""

from __future__ import annotations

from dataclasses import dataclass

from chromaperture.errors import InputError


@dataclass(frozen=True)
class ReconstructionConfig:
    """How views are cleaned, tracked and fused.

    Attributes
    ----------
    voxel_mm : float or None
        Edge of a voxel; None takes 1/200 of the first view's median distance.
    truncation_voxels : float
        Reach of a measurement before and behind the surface, at most; within, it is three standard deviations.
    max_distance_mm : float
        Points beyond are left out.
    max_relative_sigma : float
        Pixels whose error bar exceeds this share of their distance are left out.
    edge_jump : float
        Relative step of distance within ``edge_px`` that makes a pixel a flying one.
    edge_px : int
        Half width of the neighbourhood in which a step is looked for.
    memory_mb : int
        Memory of the volume, reserved at once and used as the model grows.
    tracking_scale : int
        Tracking works on pictures reduced by this factor.
    outlier_mm : float
        Points farther from the model than this do not pull at the pose, at 2 m; grows with the distance.
    depth_weight : float
        Weight of a pixel's distance beside its brightness in tracking; neighbours err alike, so it is far below 1.
    min_overlap : float
        Share of the keyframe's points that the view must show at their distance, else the frame counts as lost.
    min_likeness : float
        Correlation of the view's brightness with the keyframe's from the pose that was found, else lost.
    max_step_mm, max_turn_deg : float
        The most a camera moves from one frame to the next.
    submap_after : int
        Frames lost in a row after which a new submap is begun.
    """

    voxel_mm: float | None = None
    truncation_voxels: float = 8.0
    max_distance_mm: float = 6000.0
    max_relative_sigma: float = 0.08
    edge_jump: float = 0.04
    edge_px: int = 3
    memory_mb: int = 512
    tracking_scale: int = 2
    outlier_mm: float = 150.0
    depth_weight: float = 0.03
    min_overlap: float = 0.3
    min_likeness: float = 0.5
    max_step_mm: float = 300.0
    max_turn_deg: float = 20.0
    submap_after: int = 10

    def __post_init__(self) -> None:
        if self.voxel_mm is not None and not 0.1 <= self.voxel_mm <= 1000:
            raise InputError(f"a voxel must measure 0.1 to 1000 mm, got {self.voxel_mm:g}")
        positive = (self.truncation_voxels, self.max_distance_mm, self.max_relative_sigma, self.edge_jump)
        if not all(
            value > 0 for value in (*positive, self.depth_weight, self.outlier_mm, self.max_step_mm, self.max_turn_deg)
        ):
            raise InputError("lengths, jumps and error bars of the reconstruction must be positive")
        if self.memory_mb < 16 or self.tracking_scale < 1 or self.edge_px < 0 or self.submap_after < 1:
            raise InputError("memory_mb must be at least 16, tracking_scale and submap_after at least 1")
