"""Where a camera stands against a keyframe: brightness and distance of its points, by Gauss-Newton from coarse to fine.

A point X of the keyframe is seen by the camera at T X. Left there are the difference of brightness, the camera's minus
gain times the keyframe's plus offset, and the camera's distance minus that of T X. Its motion is xi: T <- exp(xi) T.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numba as nb
import numpy as np

_UNKNOWNS = 8  # three of place, three of turn, gain, offset
_MAX_POINTS = 8_000
_LEAST_SIDE_PX = 40
_LEVELS = 4
_ROUNDS = 12
_ENOUGH_PX = 0.02  # a smaller step ends the search
_HUBER, _TUKEY = 1.345, 4.685  # both lose 5 % where errors are normal
_MAD = 1.4826
_LEAST_GREY = 0.5  # grey levels: rounding alone
_AGREES, _DIFFERS = 1, 2
_DAMPING = 1e-4
_CONDITION = 1e-7
_ALIKE = 0.7  # correlation of the coarsest pictures from which a guess is near enough
_TURN_PX, _TURNS = 1.5, 4  # guesses turned that far, so many times to each side, px of the coarsest picture


@dataclass(frozen=True)
class Level:
    """One scale of a picture: (H, W) float32 grey and its gradients, distance and its sigma (mm, NaN), the matrix."""

    grey: np.ndarray
    across: np.ndarray
    down: np.ndarray
    z_mm: np.ndarray
    sigma_mm: np.ndarray
    matrix: np.ndarray


@dataclass(frozen=True)
class Fit:
    """What was found: motion (4, 4) keyframe to camera, shares of points seen and fitting, likeness, if solved."""

    motion: np.ndarray
    seen: float
    fitting: float
    likeness: float
    solved: bool


def pyramid(grey: np.ndarray, z_mm: np.ndarray, sigma_mm: np.ndarray, matrix: np.ndarray) -> list[Level]:
    """Reduce a picture step by step, the finest first; distances are taken as they are, never averaged."""
    levels = []
    for _ in range(_LEVELS):
        across = cv2.Scharr(grey, cv2.CV_32F, 1, 0, scale=1 / 32)
        down = cv2.Scharr(grey, cv2.CV_32F, 0, 1, scale=1 / 32)
        levels.append(Level(grey, across, down, z_mm, sigma_mm, matrix))
        if min(grey.shape) < 2 * _LEAST_SIDE_PX:
            break
        rows, columns = (side // 2 * 2 for side in grey.shape)
        grey = cv2.resize(grey[:rows, :columns], (columns // 2, rows // 2), interpolation=cv2.INTER_AREA)
        z_mm, sigma_mm = (np.ascontiguousarray(m[1:rows:2, 1:columns:2]) for m in (z_mm, sigma_mm))
        matrix = matrix.copy()
        matrix[:2] /= 2
        matrix[:2, 2] -= 0.25
    return levels


def points_of(level: Level) -> np.ndarray:
    """Points that say most: X (mm), grey, its gradients; (N, 6) float32."""
    known = np.isfinite(level.z_mm)
    known[[0, -1]] = known[:, [0, -1]] = False
    slope = np.hypot(level.across, level.down)
    if known.sum() > _MAX_POINTS:
        known &= slope >= np.quantile(slope[known], max(0.5, 1 - 2 * _MAX_POINTS / known.sum()))
    rows, columns = np.nonzero(known)
    step = max(1, math.ceil(len(rows) / _MAX_POINTS))
    rows, columns = rows[::step], columns[::step]
    z = level.z_mm[rows, columns]
    m = level.matrix
    x, y = (columns - m[0, 2]) / m[0, 0] * z, (rows - m[1, 2]) / m[1, 1] * z
    parts = (x, y, z, level.grey[rows, columns], level.across[rows, columns], level.down[rows, columns])
    return np.ascontiguousarray(np.stack(parts, axis=1), np.float32)


def align(
    points: list[np.ndarray], camera: list[Level], motion: np.ndarray, *, depth_weight: float, outlier_mm: float
) -> Fit:
    """Find the motion from keyframe to camera.

    Parameters
    ----------
    points : list of (N, 6) float32
        `points_of` the keyframe's levels, the finest first.
    camera : list of Level
    motion : (4, 4) float
        Where to begin, keyframe to camera, mm.
    depth_weight : float
        Weight of a pixel's distance beside its brightness; below 1 because neighbours err alike.
    outlier_mm : float
        Points farther from the keyframe's in distance do not pull and do not fit.

    Returns
    -------
    Fit
        Not `solved` where brightness and distances leave the motion undetermined.
    """
    motion = np.array(motion, float)
    brightness, solved = np.array([1.0, 0.0]), True
    seen = fitting = like = 0.0
    motion = _turned(points[-1], camera[len(points) - 1], motion, outlier_mm)
    for cloud, level in reversed(list(zip(points, camera, strict=False))):
        if len(cloud) < 50:
            continue
        grey_sigma, distance_mm = 20.0, float(np.median(cloud[:, 2]))
        residual = np.empty(len(cloud), np.float32)
        matched = np.empty(len(cloud), np.float32)
        close = np.empty(len(cloud), np.uint8)
        for round_ in range(_ROUNDS):
            sums = normal_equations(
                cloud, level.grey, level.across, level.down, level.z_mm, level.sigma_mm, level.matrix, motion,
                brightness, grey_sigma, depth_weight, outlier_mm, residual, matched, close,
            )  # fmt: skip
            here = np.isfinite(residual)
            seen = float(here.mean())
            if here.sum() < 50:
                return Fit(motion, seen, 0.0, 0.0, solved=False)
            grey_sigma = max(_MAD * float(np.median(np.abs(residual[here]))), _LEAST_GREY)
            if round_ == 0:
                continue  # the first looks how far apart the pictures are
            normal = np.zeros((_UNKNOWNS, _UNKNOWNS))
            normal[np.triu_indices(_UNKNOWNS)] = sums[:-_UNKNOWNS]
            normal += np.triu(normal, 1).T
            update, solved = _solved(normal, sums[-_UNKNOWNS:])
            if not solved:
                return Fit(motion, seen, 0.0, 0.0, solved=False)
            motion = _moved(update[:6]) @ motion
            brightness += update[6:]
            step_px = level.matrix[0, 0] * (np.abs(update[:3]).max() / distance_mm + np.abs(update[3:6]).max())
            if step_px < _ENOUGH_PX:
                break
        agrees, differs = int((close == _AGREES).sum()), int((close == _DIFFERS).sum())
        fitting = seen * agrees / max(agrees + differs, 1)  # nothing is known of the rest
        like = _correlation(cloud[here, 3], matched[here])
    return Fit(motion, seen, fitting, like, solved)


def _turned(cloud: np.ndarray, level: Level, motion: np.ndarray, outlier_mm: float) -> np.ndarray:
    """Turn the guess to where the coarsest pictures look most alike, if they do not yet: Gauss-Newton reaches a px."""
    if len(cloud) < 50:
        return motion
    found, best = motion, _alike(cloud, level, motion, outlier_mm)
    if best >= _ALIKE:
        return motion
    for right in range(-_TURNS, _TURNS + 1):
        for down in range(-_TURNS, _TURNS + 1):
            turn = np.array([0, 0, 0, -down * _TURN_PX, right * _TURN_PX, 0]) / level.matrix[0, 0]
            turned = _moved(turn) @ motion
            if (alike := _alike(cloud, level, turned, outlier_mm)) > best:
                found, best = turned, alike
    return found


def _alike(cloud: np.ndarray, level: Level, motion: np.ndarray, outlier_mm: float) -> float:
    """Correlation of the cloud's grey with what it meets, less where little of it is seen."""
    residual, matched = np.empty(len(cloud), np.float32), np.empty(len(cloud), np.float32)
    normal_equations(
        cloud, level.grey, level.across, level.down, level.z_mm, level.sigma_mm, level.matrix, motion,
        np.array([1.0, 0.0]), 20.0, 0.0, outlier_mm, residual, matched, np.empty(len(cloud), np.uint8),
    )  # fmt: skip
    here = np.isfinite(residual)
    if here.sum() < 50:
        return 0.0
    return _correlation(cloud[here, 3], matched[here]) * float(here.mean()) ** 0.5


def _solved(normal: np.ndarray, right: np.ndarray) -> tuple[np.ndarray, bool]:
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-12))
    unit = normal / np.outer(scale, scale)
    if not np.isfinite(unit).all() or np.linalg.eigvalsh(unit)[0] < _CONDITION:
        return np.zeros(_UNKNOWNS), False
    return -np.linalg.solve(unit + _DAMPING * np.eye(_UNKNOWNS), right / scale) / scale, True


def _moved(step: np.ndarray) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3] = cv2.Rodrigues(step[3:6])[0]
    pose[:3, 3] = step[:3]
    return pose


def _correlation(a: np.ndarray, b: np.ndarray) -> float:
    a, b = a - a.mean(), b - b.mean()
    power = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / power if power > len(a) else 0.0  # less than one grey level says nothing


@nb.njit(cache=True, nogil=True)
def normal_equations(
    points: np.ndarray,
    grey: np.ndarray,
    across: np.ndarray,
    down: np.ndarray,
    z_mm: np.ndarray,
    sigma_mm: np.ndarray,
    matrix: np.ndarray,
    motion: np.ndarray,
    brightness: np.ndarray,
    grey_sigma: float,
    depth_weight: float,
    outlier_mm: float,
    residual: np.ndarray,
    matched: np.ndarray,
    close: np.ndarray,
) -> np.ndarray:
    """Sum J^T W J (upper triangle) and J^T W r over the points; (44,) float64.

    Fills ``residual`` (grey levels, NaN where a point is not seen), ``matched`` (grey that it meets) and ``close``
    (whether its distance agrees or differs, 0 where it is unknown).
    """
    rows, columns = grey.shape
    total, j = np.zeros(44), np.zeros(8)
    fx, fy, cx, cy = matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]
    gain, offset = brightness[0], brightness[1]
    for n in range(len(points)):
        residual[n], close[n] = np.nan, 0
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
        measured = z_mm[near_row, near_column]
        apart = measured - z
        if apart < -outlier_mm:  # something stands before it now
            close[n] = _DIFFERS
            continue
        w00, w01, w10, w11 = (1 - s) * (1 - t), s * (1 - t), (1 - s) * t, s * t
        value = (
            w00 * grey[row, column] + w01 * grey[row, column + 1]
            + w10 * grey[row + 1, column] + w11 * grey[row + 1, column + 1]
        )  # fmt: skip
        gx = (
            w00 * across[row, column] + w01 * across[row, column + 1]
            + w10 * across[row + 1, column] + w11 * across[row + 1, column + 1]
        )  # fmt: skip
        gy = (
            w00 * down[row, column] + w01 * down[row, column + 1]
            + w10 * down[row + 1, column] + w11 * down[row + 1, column + 1]
        )  # fmt: skip
        r = value - gain * points[n, 3] - offset
        residual[n], matched[n] = r, value
        # Mean of both gradients: second order in the motion, where they are alike.
        gx, gy = 0.5 * (gx + gain * points[n, 4]) * fx / z, 0.5 * (gy + gain * points[n, 5]) * fy / z
        gz = -(gx * x + gy * y) / z
        j[0], j[1], j[2] = gx, gy, gz
        j[3], j[4], j[5] = y * gz - z * gy, z * gx - x * gz, x * gy - y * gx
        j[6], j[7] = -points[n, 3], -1.0
        ratio = abs(r) / grey_sigma
        # What stands before a point where no distance is known differs one-sidedly: it must lose all its weight.
        weight = (1.0 - (ratio / _TUKEY) ** 2) ** 2 / (grey_sigma * grey_sigma) if ratio < _TUKEY else 0.0
        k = 0
        for a in range(8):
            wa = weight * j[a]
            for b in range(a, 8):
                total[k] += wa * j[b]
                k += 1
            total[36 + a] += wa * r
        if not abs(apart) <= outlier_mm:  # unknown, or another surface
            close[n] = _DIFFERS if apart > outlier_mm else 0
            continue
        close[n] = _AGREES
        sigma = sigma_mm[near_row, near_column]
        if not (1 <= near_column < columns - 1 and 1 <= near_row < rows - 1 and sigma > 0):
            continue
        dx = 0.5 * (z_mm[near_row, near_column + 1] - z_mm[near_row, near_column - 1])
        dy = 0.5 * (z_mm[near_row + 1, near_column] - z_mm[near_row - 1, near_column])
        if not (abs(dx) < 0.02 * z and abs(dy) < 0.02 * z):
            continue
        dx, dy = dx * fx / z, dy * fy / z
        dz = -(dx * x + dy * y) / z - 1.0
        j[0], j[1], j[2] = dx, dy, dz
        j[3], j[4], j[5] = y * dz - z * dy, z * dx - x * dz, x * dy - y * dx
        ratio = abs(apart) / sigma
        weight = depth_weight * (1.0 if ratio <= _HUBER else _HUBER / ratio) / (sigma * sigma)
        k = 0
        for a in range(6):
            wa = weight * j[a]
            for b in range(a, 8):
                if b < 6:
                    total[k] += wa * j[b]
                k += 1
            total[36 + a] += wa * apart
    return total
