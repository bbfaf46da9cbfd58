"""Textures as lines across edges see them, of all depths of a camera: made once, before its first photograph."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from chromaperture.disparity.edge_likelihood import GRID_PX, HALF, LAYER_PX, NODES, EdgeLikelihood, Texture
from chromaperture.threads import parallel_map

SAMPLES = 2 * HALF  # of a line and channel
DIFFERENCES = np.eye(SAMPLES) - np.eye(SAMPLES, k=-1)  # the first sample, then differences of neighbours
_BEYOND = 1  # layers at either end: a plane's label just beyond its border may lie outside the range


class LineTextures(NamedTuple):
    """Textures of T = 2 nodes layers: along rows and along columns, of every node of the blur, of every layer.

    Attributes
    ----------
    first_layer, layers : int
    maps : (h, w, 4) float
        Of grid points: layer of the blur at the first label, layers a label, node of the blur.
    covariances : (T, 9, 4 * 2 HALF - 1, 4) float32
        See `_covariances`.
    shares : (T, PLACES, 6 HALF) float32
        `Texture.before`.
    facts : (T, 4, 4) float32
        Of channels: `Texture.energy`, variance, sums of the squares of the first place's shares, and of 1 less these.
    """

    first_layer: int
    layers: int
    maps: np.ndarray
    covariances: np.ndarray
    shares: np.ndarray
    facts: np.ndarray


def line_textures(edges: EdgeLikelihood, shape: tuple[int, int], labels_px: np.ndarray) -> LineTextures:
    """Make the textures of a camera.

    Parameters
    ----------
    edges : EdgeLikelihood
    shape : (int, int)
        Height and width of the picture.
    labels_px : (N,) float, px
    """
    offset, scale = (np.broadcast_to(part, shape)[::GRID_PX, ::GRID_PX] for part in edges.label_map)
    step = labels_px[1] - labels_px[0]
    first, of_label = (offset + scale * labels_px[0]) / LAYER_PX, scale * step / LAYER_PX
    ends = np.stack([first, first + of_label * (len(labels_px) - 1)])
    layers = np.arange(int(np.rint(ends.min())) - _BEYOND, int(np.rint(ends.max())) + _BEYOND + 1)
    y, x = np.mgrid[: offset.shape[0], : offset.shape[1]] * GRID_PX
    maps = np.stack([first, of_label, edges.nodes(y, x), np.zeros(offset.shape)], axis=-1)
    keys = [(node, int(layer)) for node in range(NODES**2) for layer in layers]
    both = parallel_map(lambda key: [_of_texture(texture) for texture in edges.textures_at(*key)], keys)
    covariances, shares, facts = (np.stack([pair[k][i] for k in (0, 1) for pair in both]) for i in range(3))
    return LineTextures(int(layers[0]), len(layers), maps, covariances, shares, facts)


def _of_texture(texture: Texture) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    facts, before = np.zeros((4, 4), np.float32), texture.before[0]
    facts[:, :3] = texture.energy, np.diagonal(texture.covariance[:, :, 0, 0]), *(
        np.square(part).sum(axis=1) for part in (before, 1 - before)
    )  # fmt: skip
    return _covariances(texture), texture.before.reshape(len(texture.before), -1).astype(np.float32), facts


def _covariances(texture: Texture) -> np.ndarray:
    """Covariances of pairs of channels as a difference of neighbours, and the sample before it, have them.

    Of samples i and j those of both differences, of the first with the sample before the second, of the sample before
    the first with the second, of both samples before. They depend on i - j = 1 - 2 HALF ... 2 HALF - 1; behind these
    are those of i = 0, whose difference is the sample itself, with all j, and of all i with j = 0.
    """
    whole, before = texture.covariance, np.eye(SAMPLES, k=-1)
    parts = (DIFFERENCES, DIFFERENCES), (DIFFERENCES, before), (before, DIFFERENCES), (before, before)
    each = np.stack([one @ whole @ other.T for one, other in parts], axis=-1)  # (3, 3, i, j, 4)
    # Row and column 1 hold the distances without the first sample; the greatest ones are not met.
    edge = np.zeros((3, 3, 1, len(parts)))
    distances = [edge, each[:, :, 1, :0:-1], each[:, :, 2:, 1], edge]
    found = np.concatenate([*distances, each[:, :, 0], each[:, :, :, 0]], axis=2)
    return np.asarray(found.reshape(9, -1, len(parts)).astype(np.float32))
