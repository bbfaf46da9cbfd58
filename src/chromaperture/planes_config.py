"""Defaults of the planes that explain a surface (quality "accurate"); see `stage_config`."""

from __future__ import annotations

from dataclasses import dataclass

from chromaperture.stage_config import all_finite, require


@dataclass(frozen=True)
class PlanesConfig:
    """Planes that explain the surface (quality "accurate"), see ``disparity/planar.py``.

    Chosen on ray-traced scenes that no table shows; ``benchmarks/ablation.py --quality accurate`` measures each.

    Attributes
    ----------
    tiles_px : tuple of int
        Sizes of the squares to which planes are fitted at first.
    block_px : int
        Side of the squares of pixels that choose one plane together.
    boundary_penalty : float
        Nats that a px of boundary between two planes costs on an even guide.
    plane_penalty : float
        Nats that a plane costs: its three numbers. Joining that saves one number may lose a third.
    plane_tolerance : float
        Share of its log-likelihood that a plane may lose when it is joined to a neighbour. The blur that was
        calibrated is not exact, so the log-likelihood of a large plane never peaks where its neighbour's does.
    slope_tolerance : float
        Share of its log-likelihood that a plane may lose when its slope is taken away.
    slope_of_missed : float
        The same where regions between depth edges choose planes, as a share of what the level plane misses of its
        blocks' best labels; the larger of both counts. docs/measurements.md, "What a slope has to gain", has .06 to
        .16.
    slope_penalty : float
        Nats a pixel of a slope of one label per px; it grows with the square. Floors in view slope by 0.3.
    outside_penalty : float
        Nats a pixel where a plane leaves the search range.
    border_px : int
        Pixels closer to another plane do not count in a fit: their windows see both.
    edge_band_px : int
        Reach inwards, from the border of a nearer plane, within which the guide alone decides where its edge is;
        0 leaves edges where the evidence has them.
    edge_lines : bool
        Whether lines across borders tell where edges are, where the camera's blur is known; else the guide alone.
    rounds : int
        Of choosing and joining; 0 switches the planes off.
    sweeps : int
        Of the belief propagation in each round.
    edge_share : float
        Of the range of the disparity about a pixel, by which an error bar that is not learned widens. The edges of
        planes follow the picture: on seven ray-traced scenes 0.4 makes the bar honest in every tenth of the pixels, by
        sigma, and 1.0, as of a surface without planes, is too wide in two of them.
    vote_factors : tuple of float
        Of ``boundary_penalty``, a fit each, which vote as `plane_voting.py` has it: learned with known blur. Without
        any one fit is taken wherever the surface's error bar allows it; with shifted views votes gained nothing.
    learned_border_nats : tuple of float
        Nats that a border between two blocks costs, a unit of the log odds of no depth edge between them
        (``disparity/depth_edges.py``), a fit each; they vote in place of those of ``vote_factors``. Empty, or with
        ``block_px`` other than 4: the guide leads borders.
    most_block_nats : float
        Upper bound of the nats by which a plane is worse than the best one at a block, where regions between depth
        edges choose planes; 0 is no bound.
    share_beside_edges : float
        How much blocks count there that a likely depth edge touches, in [0, 1]: their windows see both sides.
        docs/measurements.md, "Blocks beside depth edges", has 0 to 1.
    known_from_nats : float
        Nats a pixel by which the evidence of a plane must fall when it is shifted for all of its pixels to be known,
        see `evidence_signs.known_planes`; 0: of all planes. Shifted views of noise alone reach .012 (.1 to .9 in every
        pixel and channel, 120x160 px, planes of more than seven blocks, halves, RGB circles and squares, four draws).
    """

    tiles_px: tuple[int, ...] = (48, 96, 192, 480)
    block_px: int = 4
    boundary_penalty: float = 7.5
    plane_penalty: float = 60.0
    plane_tolerance: float = 0.03
    slope_tolerance: float = 0.003
    slope_of_missed: float = 0.09
    slope_penalty: float = 0.3
    outside_penalty: float = 0.05
    border_px: int = 12
    edge_band_px: int = 8
    edge_lines: bool = True
    rounds: int = 5
    sweeps: int = 8
    edge_share: float = 0.4
    vote_factors: tuple[float, ...] = ()
    learned_border_nats: tuple[float, ...] = ()
    most_block_nats: float = 0.0
    share_beside_edges: float = 1.0
    known_from_nats: float = 0.02

    def __post_init__(self) -> None:
        require(bool(self.tiles_px) and min(self.tiles_px) >= 8, "tiles_px must hold sizes of at least 8 px")
        whole = min(self.block_px, self.border_px, self.sweeps) >= 1 and min(self.rounds, self.edge_band_px) >= 0
        require(whole, "block_px, border_px and sweeps must be >= 1, edge_band_px and rounds >= 0")
        penalties = (
            self.boundary_penalty, self.plane_penalty, self.plane_tolerance, self.slope_tolerance,
            self.slope_of_missed, self.slope_penalty, self.outside_penalty, self.edge_share, *self.vote_factors,
            *self.learned_border_nats, self.most_block_nats, self.share_beside_edges,
            self.known_from_nats,
        )  # fmt: skip
        least = all_finite(*penalties) and min(penalties) >= 0
        require(
            least,
            "penalties, tolerances, edge_share, vote_factors, learned_border_nats, most_block_nats, share_beside_edges "
            "and known_from_nats must be finite and >= 0",
        )
        require(self.share_beside_edges <= 1, "share_beside_edges must be at most 1")
