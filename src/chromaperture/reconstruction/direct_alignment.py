"""Align a camera with a keyframe by brightness and distance of its points: Gauss-Newton from coarse to fine.

The camera sees a point X of the keyframe at T X. Residuals are the difference of brightness, the camera's minus gain
times the keyframe's minus offset, and the camera's distance minus that of T X. A step xi updates T <- exp(xi) T.
What brightness is left at the pose is parallax of points whose distance errs: it refines the distances.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from chromaperture.system.compilation import compiled, inlined
from chromaperture.system.robust import HUBER, robust_sigma

_UNKNOWNS = 8  # three of translation, three of rotation, gain, offset
_TUKEY = 4.685  # standard deviations at which Tukey's biweight falls to 0: 95 % efficient for Gaussian errors
_AGREES, _DIFFERS = 1, 2  # distance of a point: within the outlier limit, or not
# Chosen by hand; not tuned.
_MIN_POINTS = 50  # of a scale: fewer do not determine eight unknowns robustly
_LEVELS, _MIN_SIDE_PX = 4, 40  # scales of the pyramid, each half as large, and the least side of the coarsest
# Points of a scale: so many pixels of the largest gradients, evenly thinned. Twice as many points take twice the time
# and err as much (docs/reconstruction.md); fewer candidates lie on few strong edges, which may be an occluder's.
_CANDIDATES, _MAX_POINTS = 16_000, 4_000
_ROUNDS, _CONVERGED_PX = 12, 0.05  # Gauss-Newton steps of a scale; a smaller step ends them
_START_SIGMA, _MIN_SIGMA = 20.0, 0.5  # grey levels: standard deviation before the first round, and of rounding alone
# Error of a keyframe's distances, which are the model's, over that of its own view: the mean of some four views. With
# 1 fast motion errs less and slow motion more, with 0 the reverse (docs/reconstruction.md).
MODEL_SHARE = 0.5
# Standard deviation of brightness that refines distances over that of the residuals, which are alike in successive
# frames. With a least sigma of distances instead, they would drift for ever.
_CORRELATED = 2.0
_MAX_SLOPE = 0.02  # change of distance per px, of the distance, above which its gradient is that of an edge
_DAMPING = 1e-4  # added to the diagonal of the normal equations, scaled to 1
_CONDITION = 1e-7  # least eigenvalue of the scaled normal equations; below, the motion is undetermined
_MIN_CORRELATION = 0.7  # of the coarsest pictures; below, rotations of the guess are tried: Gauss-Newton reaches 1 px
_TURN_PX, _TURNS = 1.5, 4  # step of these rotations, px of the coarsest picture, and their number to each side


class Level(NamedTuple):
    """One scale of a picture: (H, W) float32 grey and gradients, distance and its sigma (mm, NaN), camera matrix."""

    grey: np.ndarray
    grad_x: np.ndarray
    grad_y: np.ndarray
    z_mm: np.ndarray
    sigma_mm: np.ndarray
    matrix: np.ndarray


@dataclass(frozen=True)
class Alignment:
    """Motion (4, 4) keyframe to camera in mm, its refined points, fraction visible, correlation, if solved."""

    motion: np.ndarray
    points: np.ndarray | None = None  # of the finest scale, see `refined`
    overlap: float = 0.0
    correlation: float = 0.0
    solved: bool = True


def pyramid(grey: np.ndarray, z_mm: np.ndarray, sigma_mm: np.ndarray, matrix: np.ndarray) -> list[Level]:
    """Reduce a picture step by step, the finest first; distances are sampled, never averaged."""
    levels = []
    for _ in range(_LEVELS):
        grad_x = cv2.Scharr(grey, cv2.CV_32F, 1, 0, scale=1 / 32)
        grad_y = cv2.Scharr(grey, cv2.CV_32F, 0, 1, scale=1 / 32)
        levels.append(Level(grey, grad_x, grad_y, z_mm, sigma_mm, matrix))
        if min(grey.shape) < 2 * _MIN_SIDE_PX:
            break
        rows, columns = (side // 2 * 2 for side in grey.shape)
        grey = cv2.resize(grey[:rows, :columns], (columns // 2, rows // 2), interpolation=cv2.INTER_AREA)
        z_mm, sigma_mm = (np.ascontiguousarray(m[1:rows:2, 1:columns:2]) for m in (z_mm, sigma_mm))
        matrix = matrix.copy()
        matrix[:2] /= 2
        matrix[:2, 2] -= 0.25
    return levels


def select_points(level: Level) -> np.ndarray:
    """Return the points with the largest gradients: X (mm), grey, its gradients, sigma / Z; (N, 7) float32."""
    known = np.isfinite(level.z_mm)
    known[[0, -1]] = known[:, [0, -1]] = False
    slope = np.hypot(level.grad_x, level.grad_y)
    if known.sum() > _CANDIDATES / 2:
        known &= slope >= np.quantile(slope[known], max(0.5, 1 - _CANDIDATES / known.sum()))
    rows, columns = np.nonzero(known)
    step = max(1, math.ceil(len(rows) / _MAX_POINTS))
    rows, columns = rows[::step], columns[::step]
    z = level.z_mm[rows, columns]
    m = level.matrix
    x, y = (columns - m[0, 2]) / m[0, 0] * z, (rows - m[1, 2]) / m[1, 1] * z
    sigma = MODEL_SHARE * level.sigma_mm[rows, columns] / z
    parts = (x, y, z, level.grey[rows, columns], level.grad_x[rows, columns], level.grad_y[rows, columns], sigma)
    return np.ascontiguousarray(np.stack(parts, axis=1), np.float32)


def align(
    points: list[np.ndarray], camera: list[Level], motion: np.ndarray, *, depth_weight: float, outlier_mm: float
) -> Alignment:
    """Find the motion, mm, from points of a keyframe's levels (finest first) to a camera's, from a guess."""
    motion = _best_rotation(points[-1], camera[len(points) - 1], np.array(motion, float), outlier_mm)
    found, brightness = Alignment(motion), np.array([1.0, 0.0])  # gain and offset
    for cloud, level in reversed(list(zip(points, camera, strict=False))):
        if len(cloud) < _MIN_POINTS:
            continue
        found = _align_level(cloud, level, found.motion, brightness, depth_weight, outlier_mm)
        if not found.solved:
            break
    return found


def _align_level(
    cloud: np.ndarray, level: Level, motion: np.ndarray, brightness: np.ndarray, depth_weight: float, outlier_mm: float
) -> Alignment:
    """Align at one scale; updates ``brightness`` in place."""
    grey_sigma, distance_mm = _START_SIGMA, float(np.median(cloud[:, 2]))
    for round_ in range(_ROUNDS):
        sums, residual, matched, close, along = normal_equations(
            cloud, level, motion, brightness, grey_sigma, depth_weight, outlier_mm
        )
        visible = np.isfinite(residual)
        if visible.sum() < _MIN_POINTS:
            return Alignment(motion, solved=False)
        grey_sigma = max(robust_sigma(residual), _MIN_SIGMA)
        if round_ == 0:
            continue  # only measures the standard deviation
        update = _step(sums)
        if update is None:
            return Alignment(motion, solved=False)
        motion = _exponential(update[:6]) @ motion
        brightness += update[6:]
        step_px = level.matrix[0, 0] * (np.abs(update[:3]).max() / distance_mm + np.abs(update[3:6]).max())
        if step_px < _CONVERGED_PX:
            break
    agrees, differs = int((close == _AGREES).sum()), int((close == _DIFFERS).sum())
    overlap = float(visible.mean()) * agrees / max(agrees + differs, 1)  # points of unknown distance do not count
    points = refined(cloud, residual, along, grey_sigma)
    return Alignment(motion, points, overlap, _correlation(cloud[visible, 3], matched[visible]))


def refined(points: np.ndarray, residual: np.ndarray, along: np.ndarray, grey_sigma: float) -> np.ndarray:
    """Move points (N, 7) by what their residuals tell of their distances, Kalman's update of one state each.

    ``along`` is the change of a residual for one standard deviation of a point's log distance, 0 where it tells none.
    """
    noise = _CORRELATED * grey_sigma
    total = np.sqrt(along**2 + noise**2)
    moved = points.copy()
    moved[:, :3] *= np.exp(-points[:, 6] * along * np.where(along == 0, 0, residual) / total**2)[:, None]
    moved[:, 6] *= noise / total
    return moved


def _best_rotation(cloud: np.ndarray, level: Level, motion: np.ndarray, outlier_mm: float) -> np.ndarray:
    """Rotate the guess to where the coarsest pictures correlate best, unless they correlate well already."""
    if len(cloud) < _MIN_POINTS:
        return motion
    found, best = motion, _visible_correlation(cloud, level, motion, outlier_mm)
    if best >= _MIN_CORRELATION:
        return motion
    for right in range(-_TURNS, _TURNS + 1):
        for down in range(-_TURNS, _TURNS + 1):
            turn = np.array([0, 0, 0, -down * _TURN_PX, right * _TURN_PX, 0]) / level.matrix[0, 0]
            turned = _exponential(turn) @ motion
            if (correlation := _visible_correlation(cloud, level, turned, outlier_mm)) > best:
                found, best = turned, correlation
    return found


def _visible_correlation(cloud: np.ndarray, level: Level, motion: np.ndarray, outlier_mm: float) -> float:
    """Return the correlation of the points' grey with the picture's, reduced where few points are visible."""
    even = np.array([1.0, 0.0])
    _, residual, matched, *_ = normal_equations(cloud, level, motion, even, _START_SIGMA, 0.0, outlier_mm)
    visible = np.isfinite(residual)
    if visible.sum() < _MIN_POINTS:
        return 0.0
    return _correlation(cloud[visible, 3], matched[visible]) * float(visible.mean()) ** 0.5


def _step(sums: np.ndarray) -> np.ndarray | None:
    """Solve the normal equations; None where they are singular."""
    normal = np.zeros((_UNKNOWNS, _UNKNOWNS))
    normal[np.triu_indices(_UNKNOWNS)] = sums[:-_UNKNOWNS]
    normal += np.triu(normal, 1).T
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-12))
    unit = normal / np.outer(scale, scale)
    if not np.isfinite(unit).all() or np.linalg.eigvalsh(unit)[0] < _CONDITION:
        return None
    return np.asarray(-np.linalg.solve(unit + _DAMPING * np.eye(_UNKNOWNS), sums[-_UNKNOWNS:] / scale) / scale)


def _exponential(step: np.ndarray) -> np.ndarray:
    """Return the (4, 4) motion of a step: translation, then rotation vector."""
    pose = np.eye(4)
    pose[:3, :3] = cv2.Rodrigues(step[3:6])[0]
    pose[:3, 3] = step[:3]
    return pose


def _correlation(a: np.ndarray, b: np.ndarray) -> float:
    a, b = a - a.mean(), b - b.mean()
    power = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / power if power > len(a) else 0.0  # contrast below one grey level is noise


@inlined()
def _interpolated(picture, row, column, s, t):  # type: ignore[no-untyped-def]
    """Interpolate linearly between four pixels, ``s`` to the right and ``t`` below a pixel."""
    above = (1 - s) * (1 - t) * picture[row, column] + s * (1 - t) * picture[row, column + 1]
    return above + (1 - s) * t * picture[row + 1, column] + s * t * picture[row + 1, column + 1]


@inlined()
def _add(total, j, weight, residual, unknowns):  # type: ignore[no-untyped-def]
    """Add a residual, whose Jacobian is 0 beyond the first unknowns, to the sums of `normal_equations`."""
    k = 0
    for a in range(unknowns):
        wa = weight * j[a]
        for b in range(a, _UNKNOWNS):
            if b < unknowns:
                total[k] += wa * j[b]
            k += 1
        total[36 + a] += wa * residual


@compiled()
def normal_equations(points, level, motion, brightness, grey_sigma, depth_weight, outlier_mm):  # type: ignore[no-untyped-def]
    """Linearise the points' residuals: sums (44,); each one's residual, grey, depth agreement and `refined`'s along."""
    residual, matched = np.empty(len(points), np.float32), np.empty(len(points), np.float32)
    close, tells = np.zeros(len(points), np.uint8), np.zeros(len(points), np.float32)
    rows, columns = level.grey.shape
    total, j = np.zeros(44), np.zeros(_UNKNOWNS)
    m = level.matrix
    fx, fy, cx, cy = m[0, 0], m[1, 1], m[0, 2], m[1, 2]
    gain, offset = brightness[0], brightness[1]
    for n in range(len(points)):
        residual[n] = np.nan
        px, py, pz = points[n, 0], points[n, 1], points[n, 2]
        x = motion[0, 0] * px + motion[0, 1] * py + motion[0, 2] * pz + motion[0, 3]
        y = motion[1, 0] * px + motion[1, 1] * py + motion[1, 2] * pz + motion[1, 3]
        z = motion[2, 0] * px + motion[2, 1] * py + motion[2, 2] * pz + motion[2, 3]
        if z <= 1.0:
            continue
        u, v = fx * x / z + cx, fy * y / z + cy
        if not (0 <= u < columns - 1 and 0 <= v < rows - 1):
            continue
        column, row = int(u), int(v)
        s, t = u - column, v - row
        near_column, near_row = int(u + 0.5), int(v + 0.5)
        apart = level.z_mm[near_row, near_column] - z
        if apart < -outlier_mm:  # another surface hides it now
            close[n] = _DIFFERS
            continue
        value = _interpolated(level.grey, row, column, s, t)
        gx = _interpolated(level.grad_x, row, column, s, t)
        gy = _interpolated(level.grad_y, row, column, s, t)
        r = value - gain * points[n, 3] - offset
        residual[n], matched[n] = r, value
        # Mean of both gradients: second-order convergence where they are similar (Malis 2004).
        gx, gy = 0.5 * (gx + gain * points[n, 4]) * fx / z, 0.5 * (gy + gain * points[n, 5]) * fy / z
        gz = -(gx * x + gy * y) / z
        j[0], j[1], j[2] = gx, gy, gz
        j[3], j[4], j[5] = y * gz - z * gy, z * gx - x * gz, x * gy - y * gx
        j[6], j[7] = -points[n, 3], -1.0
        # Where the point's own distance errs by its sigma its image moves, and with it the grey there.
        along = points[n, 6] * (gx * (x - motion[0, 3]) + gy * (y - motion[1, 3]) + gz * (z - motion[2, 3]))
        noise = np.sqrt(grey_sigma * grey_sigma + along * along)
        ratio = abs(r) / noise
        # An occluder of unknown distance is a one-sided outlier: its weight must fall to 0 (docs/decisions.md).
        weight = (1.0 - (ratio / _TUKEY) ** 2) ** 2 / (noise * noise) if ratio < _TUKEY else 0.0
        _add(total, j, weight, r, _UNKNOWNS)
        if ratio < _TUKEY:
            tells[n] = along
        if not abs(apart) <= outlier_mm:  # unknown, or another surface
            close[n] = _DIFFERS if apart > outlier_mm else 0
            continue
        close[n] = _AGREES
        sigma = level.sigma_mm[near_row, near_column]
        if not (1 <= near_column < columns - 1 and 1 <= near_row < rows - 1 and sigma > 0):
            continue
        dx = 0.5 * (level.z_mm[near_row, near_column + 1] - level.z_mm[near_row, near_column - 1])
        dy = 0.5 * (level.z_mm[near_row + 1, near_column] - level.z_mm[near_row - 1, near_column])
        if not (abs(dx) < _MAX_SLOPE * z and abs(dy) < _MAX_SLOPE * z):
            continue
        dx, dy = dx * fx / z, dy * fy / z
        dz = -(dx * x + dy * y) / z - 1.0
        j[0], j[1], j[2] = dx, dy, dz
        j[3], j[4], j[5] = y * dz - z * dy, z * dx - x * dz, x * dy - y * dx
        ratio = abs(apart) / sigma
        weight = depth_weight * (1.0 if ratio <= HUBER else HUBER / ratio) / (sigma * sigma)
        _add(total, j, weight, apart, 6)
    return total, residual, matched, close, tells
