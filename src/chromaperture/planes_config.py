"""Defaults of the planes and of the plate that explain the evidence of blocks (quality "accurate")."""

from __future__ import annotations

from dataclasses import dataclass

from chromaperture.stage_config import all_finite, require


@dataclass(frozen=True)
class PlanesConfig:
    """Planes between depth edges, from which the plate starts; see ``disparity/plane_regions.py``.

    Attributes
    ----------
    tiles_px : tuple of int
        Sizes of the squares to which planes are fitted.
    plane_penalty : float
        Nats that a plane costs.
    border_nats : float
        Nats that a border between two blocks costs, a unit of the log odds of no depth edge between them.
    slope_penalty : float
        Nats a block of a slope of one label a block; it grows with the square.
    outside_penalty : float
        Nats a pixel where a plane leaves the search range.
    max_block_nats : float
        Upper bound of the nats by which a plane is worse than the best one at a block; 0 is no bound.
    edge_block_weight : float
        How much blocks count there that a likely depth edge touches, in [0, 1]: their windows see both sides.
    known_from_nats : float
        Nats a pixel by which the evidence of a region must fall when its surface is shifted for all of its pixels to be
        known. Shifted views of noise alone reach .012, blurred ones .00012.
    """

    tiles_px: tuple[int, ...] = (48, 96, 192, 480)
    plane_penalty: float = 60.0
    border_nats: float = 1.25
    slope_penalty: float = 0.3
    outside_penalty: float = 0.05
    max_block_nats: float = 3.0
    edge_block_weight: float = 0.3
    known_from_nats: float = 0.02

    def __post_init__(self) -> None:
        require(bool(self.tiles_px) and min(self.tiles_px) >= 8, "tiles_px must hold sizes of at least 8 px")
        numbers = (
            self.plane_penalty, self.border_nats, self.slope_penalty, self.outside_penalty, self.max_block_nats,
            self.edge_block_weight, self.known_from_nats,
        )  # fmt: skip
        require(all_finite(*numbers) and min(numbers) >= 0, "penalties, nats and weights must be finite and >= 0")
        require(self.edge_block_weight <= 1, "edge_block_weight must be at most 1")


@dataclass(frozen=True)
class PlateConfig:
    """The plate that follows the evidence from a start of planes; see ``disparity/thin_plate.py``.

    Labels are half a layer apart: 0.15 px of blur where the blur is known. docs/decisions.md has the alternatives.

    Attributes
    ----------
    rounds : int
    evidence_share : float
        Share of the pixels' nats that counts: windows overlap, so that neighbours say much the same.
    edge_block_weight : float
        Share of that for blocks that a likely depth edge touches.
    max_block_nats : float
        Upper bound of what a block earns at its best label.
    bend_penalty : float
        Nats a block, for a second difference of one label; it grows with the square up to ``bend_labels``.
    bend_labels : float
        Second difference from which on a bend is a fold, whose cost grows no more.
    slope_penalty, slope_labels : float
        The same for first differences.
    edge_log_odds : float
        Added to the log odds of depth edges: the plate is better cut once too often.
    smoothed_labels : float
        Sigma by which evidence is smoothed along the labels before a parabola is laid through it.
    own_evidence_nats : float
        By which blocks within a window must earn more on the surface of the paths than on their plane for the plate to
        start from that surface.
    """

    rounds: int = 3
    evidence_share: float = 0.15
    edge_block_weight: float = 0.3
    max_block_nats: float = 3.0
    bend_penalty: float = 3000.0
    bend_labels: float = 0.006
    slope_penalty: float = 0.02
    slope_labels: float = 1.0
    edge_log_odds: float = 2.0
    smoothed_labels: float = 1.0
    own_evidence_nats: float = 6.4

    def __post_init__(self) -> None:
        require(1 <= self.rounds <= 100, f"rounds must lie between 1 and 100, is {self.rounds}")
        positive = (
            self.evidence_share, self.max_block_nats, self.bend_penalty, self.bend_labels, self.slope_penalty,
            self.slope_labels, self.smoothed_labels,
        )  # fmt: skip
        require(all_finite(*positive) and min(positive) > 0, "shares, penalties, nats and labels must be positive")
        others = (self.edge_block_weight, self.own_evidence_nats)
        require(all_finite(self.edge_log_odds, *others) and min(others) >= 0, "weights and nats must be >= 0")
