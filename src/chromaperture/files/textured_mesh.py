"""A depth map as a surface with the photograph on it, seen by the camera that took it."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from chromaperture.system.errors import InputError

# Relative step of distance between corners of a triangle at which the surface ends: that from which a pixel is a flying
# one in the reconstruction.
_EDGE_JUMP = 0.04
_MOST_VERTICES = 1_000_000  # chosen by hand: 24 megapixels become every fifth column and row, 40 MB of file


@dataclass(frozen=True)
class TexturedMesh:
    """Triangles in the camera frame: mm, origin at the entrance pupil, x right, y down, z forward."""

    vertices_mm: np.ndarray  # (N, 3) float32
    texture: np.ndarray  # (N, 2) float32: place in the picture, 0 to 1 from its left and its upper edge
    triangles: np.ndarray  # (M, 3) uint32: seen from the camera, corners go round against the clock
    picture: np.ndarray  # (H, W, 3) uint8: sRGB
    camera_matrix: np.ndarray  # (3, 3) float, px: of the pinhole that saw it, distortion removed


def textured_mesh(
    z_mm: np.ndarray, picture: np.ndarray, *, camera_matrix: np.ndarray, distortion: np.ndarray
) -> TexturedMesh:
    """Join neighbouring pixels to triangles where no edge of depth is between them.

    ``z_mm`` (H, W) float, mm from the entrance pupil along the axis, NaN unknown; ``picture`` (H, W, 3) uint8, sRGB;
    ``camera_matrix`` (3, 3) float, px; ``distortion`` (5,) float: OpenCV's k1, k2, p1, p2, k3; vertices are where the
    rays of the lens lead, the picture stays as it is. Raises InputError: no two neighbouring pixels are known.
    """
    height, width = z_mm.shape
    step = 1
    while -(-height // step) * -(-width // step) > _MOST_VERTICES:
        step += 1
    rows, columns = np.arange(0, height, step), np.arange(0, width, step)
    z = z_mm[::step, ::step].astype(np.float64)
    known = np.isfinite(z) & (z > 0)
    number = np.full(z.shape, -1, np.int64)
    corners = [(slice(a, -1 if a == 0 else None), slice(b, -1 if b == 0 else None)) for a, b in
               ((0, 0), (0, 1), (1, 0), (1, 1))]  # fmt: skip
    kept = [np.zeros(tuple(max(n - 1, 0) for n in z.shape), bool) for _ in range(2)]
    order = ((0, 2, 1), (1, 2, 3))  # against the clock for the camera, for which y goes down
    for keep, triangle in zip(kept, order, strict=True):
        depths = np.stack([z[corners[i]] for i in triangle])
        with np.errstate(invalid="ignore"):
            near, far = depths.min(axis=0), depths.max(axis=0)
            keep[:] = np.all([known[corners[i]] for i in triangle], axis=0) & (far - near < _EDGE_JUMP * near)
    used = np.zeros(z.shape, bool)
    for keep, triangle in zip(kept, order, strict=True):
        for i in triangle:
            used[corners[i]] |= keep
    if not used.any():
        raise InputError("no surface was found: too few neighbouring pixels are known; widen --max-relative-sigma")
    number[used] = np.arange(int(used.sum()))
    triangles = np.concatenate([
        np.stack([number[corners[i]][keep] for i in triangle], axis=1)
        for keep, triangle in zip(kept, order, strict=True)
    ]).astype(np.uint32)  # fmt: skip
    v, u = np.nonzero(used)
    pixels = np.stack([columns[u], rows[v]], axis=1).astype(np.float64)
    rays = cv2.undistortPoints(pixels[:, None], np.asarray(camera_matrix, float), np.asarray(distortion, float))[:, 0]
    points = np.concatenate([rays * z[used][:, None], z[used][:, None]], axis=1).astype(np.float32)
    texture = ((pixels + 0.5) / (width, height)).astype(np.float32)
    return TexturedMesh(points, texture, triangles, picture, np.asarray(camera_matrix, float))
