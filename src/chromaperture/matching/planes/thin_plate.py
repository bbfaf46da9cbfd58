"""A thin plate through the evidence of blocks: flat where nothing says otherwise, bent where the evidence bends it.

A map u of labels, one a block, minimises ::

    sum_b -l_b(u_b) + bend / 2 sum w2 r(second differences of u) + slope / 2 sum w1 r(first differences of u)

with the log-likelihoods l of the blocks, less where windows see two surfaces; weights w of the links between blocks,
which fall to nothing where the photograph shows a depth edge; and the loss of Geman and McClure, r(d) = d^2 / (1 +
d^2 / s^2), under which a few strong folds and jumps cost less than bending everywhere. A plane costs nothing but its
slope: from a start of planes the plate leaves them as far as the evidence pays for the bend.

Every round replaces the loss by the quadratic that touches it, and the evidence, smoothed over a label, by a parabola
at u, and solves the linear equations.

References
----------
S. Geman, D. McClure: Statistical methods for tomographic image reconstruction. Bull. Int. Stat. Inst. 52, 1987.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import cv2
import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from chromaperture.matching.planes.depth_edges import strongest_links
from chromaperture.settings.stages import PlateConfig

_LEAST_CURVATURE = 1e-4  # nats a label^2: a block without evidence follows its neighbours
_LEAST_STEEP = 1e-3  # nats a label^2, below which a step along the evidence is not trusted
_LONGEST_STEP = 1.5  # labels a round: the parabola holds no farther
_LEAST_LINK = 1e-4


class _Term(NamedTuple):
    """Differences of one kind, as a matrix on a flattened map: their weights, and the scale of their loss."""

    matrix: sparse.csr_array
    weights: np.ndarray
    scale: float

    def stiffness(self, flat: np.ndarray) -> sparse.csr_array:
        """Return the quadratic that touches the loss at a map."""
        touching = self.weights / (1 + (self.matrix @ flat / self.scale) ** 2) ** 2
        return self.matrix.T @ sparse.diags_array(touching) @ self.matrix


def thin_plate(nats: np.ndarray, start: np.ndarray, log_odds: np.ndarray, *, config: PlateConfig) -> np.ndarray:
    """Fit a plate to blocks.

    ``nats`` (h, w, N) float32: sums of log-likelihoods over blocks; ``start`` (h, w) float, labels; ``log_odds`` (2, h,
    w) float: as `edge_log_odds`. Returns (h, w) float64, labels: within 0 and N - 1.
    """
    evidence = smoothed_labels(tempered(nats, log_odds, config=config), config.smoothed_labels)
    terms = _terms(link_weights(log_odds, config.edge_log_odds), config)
    label = np.asarray(start, float)
    for _ in range(config.rounds):
        slope, curvature = at_labels(evidence, label)
        step = np.clip(slope / np.maximum(curvature, _LEAST_STEEP), -_LONGEST_STEP, _LONGEST_STEP)
        # A step that was cut pulls as strongly as the evidence does here.
        weight = np.where(np.abs(step) < _LONGEST_STEP, curvature, np.abs(slope) / _LONGEST_STEP)
        weight = np.maximum(weight, _LEAST_CURVATURE)
        matrix = sparse.diags_array(weight.ravel()) + sum(term.stiffness(label.ravel()) for term in terms)
        # Panels of 4 columns take 0.9 of the time of 20, SuperLU's own, at 120 x 180 blocks.
        solver = splu(
            matrix.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0, panel_size=4,
            options={"SymmetricMode": True},
        )  # fmt: skip
        found = solver.solve((weight * (label + step)).ravel()).reshape(label.shape)
        label = np.clip(found, 0, nats.shape[2] - 1)
    return label


def tempered(nats: np.ndarray, log_odds: np.ndarray, *, config: PlateConfig) -> np.ndarray:
    """Return what sums of overlapping windows are worth, bounded below the best label's; (h, w, N) float32."""
    share = np.where(beside_edges(log_odds), config.evidence_share * config.edge_block_weight, config.evidence_share)
    below = (nats - nats.max(axis=2, keepdims=True)) * share[..., None].astype(np.float32)
    most = np.float32(config.max_block_nats)
    return np.asarray(most * np.exp(below / most), np.float32)


def beside_edges(log_odds: np.ndarray) -> np.ndarray:
    """Return which blocks a likely depth edge touches; (h, w) bool."""
    return strongest_links(log_odds) > 0


def smoothed_labels(nats: np.ndarray, sigma: float) -> np.ndarray:
    """Smooth a volume along its labels, which repeat beyond the ends; (h, w, N) float32."""
    flat = np.ascontiguousarray(nats.reshape(-1, nats.shape[2]), np.float32)
    kernel, one = cv2.getGaussianKernel(2 * round(4 * sigma) + 1, sigma), np.ones((1, 1))
    return np.asarray(cv2.sepFilter2D(flat, -1, kernel, one, borderType=cv2.BORDER_REPLICATE)).reshape(nats.shape)


def at_labels(nats: np.ndarray, label: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return slope and downward curvature of log-likelihoods at labels, by the parabola through the nearest three."""
    nearest = np.clip(np.rint(label).astype(np.intp), 1, nats.shape[2] - 2)
    before, here, after = (np.take_along_axis(nats, (nearest + k)[..., None], axis=2)[..., 0] for k in (-1, 0, 1))
    bend = before - 2 * here + after
    return (after - before) / 2 + bend * np.clip(label - nearest, -1, 1), np.maximum(-bend, 0)


def link_weights(log_odds: np.ndarray, shift: float) -> np.ndarray:
    """Return the probability of no depth edge at every link, by log odds that are that much higher; (2, h, w)."""
    return np.maximum(1 / (1 + np.exp(log_odds + shift)), _LEAST_LINK)


def _terms(links: np.ndarray, config: PlateConfig) -> list[_Term]:
    """Return first and second differences of every kind."""
    down, across = links[0, :-1], links[1, :, :-1]
    both = np.minimum(across[:-1], across[1:]) * np.minimum(down[:, :-1], down[:, 1:])
    bends = across[:, :-1] * across[:, 1:], down[:-1] * down[1:], 2 * both
    matrices = _differences(*links.shape[1:])
    return [
        *(_Term(m, config.bend_penalty * w.ravel(), config.bend_labels) for m, w in zip(matrices, bends, strict=False)),
        *(_Term(m, config.slope_penalty * w.ravel(), config.slope_labels)
          for m, w in zip(matrices[3:], (across, down), strict=True)),
    ]  # fmt: skip


@cache
def _differences(height: int, width: int) -> tuple[sparse.csr_array, ...]:
    """Return second differences across, down and of both, then first ones across and down, of a flattened map."""

    def along(count: int, order: int) -> sparse.csr_array:
        return sparse.csr_array(np.diff(np.eye(count), order, axis=0)) if order else sparse.eye_array(count).tocsr()

    orders = (0, 2), (2, 0), (1, 1), (0, 1), (1, 0)
    return tuple(sparse.kron(along(height, down), along(width, across), "csr") for down, across in orders)
