"""The depth curve of every pixel as two smooth fields (paper section 3.4, Figure 7).

Field curvature changes A and vignetting lowers B towards the corners. The disparity d = A - B / (depth - delta) is
linear in both, so linear least squares fits both at once, as polynomials over the frame. The paper's b(i, j) and
z_of(i, j) follow from them (`model_to_paper`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.polynomial import chebyshev

from chromaperture.depth.conversion import PAIRS, CurveTable, DepthModel, curve_table, disparity_to_depth
from chromaperture.depth.nonlinearity import Nonlinearity
from chromaperture.system.errors import InputError

_NODES = 33  # a side, for the covariance over the frame: bilinear between them it is within 5 % (test_field.py)


@dataclass(frozen=True)
class LocalField:
    """Corrections to the smooth fields A and B, on a grid over the frame."""

    start_px: float  # position of the first column and row of the grid
    step_px: float  # its pitch
    # (h, w) float32 each, added to A and B: bilinear between the grid's points, constant beyond them
    infinity_disparity_px: np.ndarray
    scale_px_mm: np.ndarray
    covariance: np.ndarray  # (2, 2) float64; of the two corrections, the median over the grid

    def at(self, x_px: np.ndarray, y_px: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return both corrections at pixels; two float64 of their shape."""
        column, row = (
            np.atleast_2d((np.asarray(px, np.float32) - self.start_px) / self.step_px) for px in (x_px, y_px)
        )

        def between(values: np.ndarray) -> np.ndarray:
            found = cv2.remap(values, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            return np.asarray(found, float).reshape(np.shape(x_px))

        return between(self.infinity_disparity_px), between(self.scale_px_mm)


class FieldNumbers(NamedTuple):
    """What the curves of a frame are computed from, for a device that keeps no maps of them."""

    # ``width_px``, ``height_px``: of the frame.
    width_px: int
    height_px: int
    # ``infinity_px``, ``scale_px_mm``: (n + 1, n + 1) float64: of A and B: coefficient (i, j) is that of T_i(u) T_j(v),
    # u and v being -1 and 1 at the frame's outer pixels.
    infinity_px: np.ndarray
    scale_px_mm: np.ndarray
    pupil_mm: float
    local: np.ndarray  # (2, h, w) float32: added to A and B, bilinear on a grid, constant beyond it
    # ``local_start_px``, ``local_step_px``: position of the grid's first column and row, and its pitch.
    local_start_px: float
    local_step_px: float
    # (6, h, w) float32: AA, AB, A delta, BB, B delta, delta delta, bilinear between nodes evenly spaced over the frame.
    covariance: np.ndarray


@dataclass(frozen=True)
class DepthField:
    """The depth curve of every image position."""

    # ``infinity_disparity_px``, ``scale_px_mm``: (N,) float64: coefficients of A (px) and B (px mm): products of
    # Chebyshev polynomials in x and y over [-1, 1] of total degree up to n, ordered by the degree in x, then in y; N =
    # (n + 1)(n + 2) / 2. One number is a constant field.
    infinity_disparity_px: np.ndarray
    scale_px_mm: np.ndarray
    sensor_to_pupil_mm: float  # delta, the same in the whole frame
    # (3, 3), (2 N + 1, 2 N + 1) or (2 N + 1 + K, 2 N + 1 + K) float64: of A, B, delta in the middle of the frame; or of
    # all coefficients in the order A, B, delta, and the nonlinearity where it was fitted with them.
    covariance: np.ndarray
    # From the linear disparity of this curve to the measured one; K coefficients.
    nonlinearity: Nonlinearity | None = None
    local: LocalField | None = None  # corrections to the polynomials, independent at every point of a grid

    @classmethod
    def constant(cls, model: DepthModel) -> DepthField:
        """Return one curve for the whole frame."""
        covariance = np.asarray(model.covariance, float)
        if model.curve_covariance is not None:
            with_others, own = np.split(model.curve_covariance, [3], axis=1)
            covariance = np.block([[covariance, with_others.T], [with_others, own]])
        return cls(
            np.atleast_1d(np.asarray(model.infinity_disparity_px, float)),
            np.atleast_1d(np.asarray(model.scale_px_mm, float)),
            float(np.asarray(model.sensor_to_pupil_mm)),
            covariance,
            model.nonlinearity,
        )

    def on_axis(self, width_px: int, height_px: int) -> DepthModel:
        """Return the curve in the middle of the frame, as numbers."""
        middle = self.at(np.array((width_px - 1) / 2), np.array((height_px - 1) / 2), width_px, height_px)
        return replace(
            middle, infinity_disparity_px=float(middle.infinity_disparity_px), scale_px_mm=float(middle.scale_px_mm)
        )

    def at(self, x_px: np.ndarray, y_px: np.ndarray, width_px: int, height_px: int) -> DepthModel:
        """Return the curves at pixels; arrays of their shape."""
        basis = polynomials(x_px, y_px, width_px, height_px, degree_of(len(self.scale_px_mm)))
        return self._with_local(
            DepthModel(
                basis @ self.infinity_disparity_px,
                basis @ self.scale_px_mm,
                self.sensor_to_pupil_mm,
                self._covariance_at(basis),
                self.nonlinearity,
                self._curve_covariance(basis.reshape(-1, basis.shape[-1]).mean(axis=0)),
            ),
            x_px,
            y_px,
        )

    def model(self, width_px: int, height_px: int, rows: slice | None = None) -> DepthModel:
        """Evaluate the fields, as maps of the frame or of some rows, or as numbers where they are constant."""
        if len(self.scale_px_mm) == 1:
            return self.on_axis(width_px, height_px)
        size, band = (width_px, height_px), np.arange(height_px)[rows or slice(None)]
        # The covariance is as smooth as the fields: bilinear between nodes it is 30 times faster.
        nodes = self._nodes(*size)
        smooth = DepthModel(
            _evaluate(self.infinity_disparity_px, *size, band),
            _evaluate(self.scale_px_mm, *size, band),
            self.sensor_to_pupil_mm,
            self._covariance_map(nodes, *size, band),
            self.nonlinearity,
            self._curve_covariance(nodes.mean(axis=(0, 1))),
        )
        return smooth if self.local is None else self._with_local(smooth, *np.meshgrid(np.arange(width_px), band))

    def in_numbers(self, width_px: int, height_px: int) -> tuple[FieldNumbers, CurveTable]:
        """Return what `model` would be computed from over a frame, and the tables of the nonlinearity."""
        nodes = self._nodes(width_px, height_px)
        constant = len(self.covariance) == 3
        covariance = np.asarray(self.covariance[None, None] if constant else self._covariance_at(nodes)).copy()
        local, start, step = np.zeros((2, 1, 1), np.float32), 0.0, 1.0
        if self.local is not None:
            covariance[..., :2, :2] += self.local.covariance
            local = np.stack([self.local.infinity_disparity_px, self.local.scale_px_mm])
            start, step = float(self.local.start_px), float(self.local.step_px)
        numbers = FieldNumbers(
            width_px,
            height_px,
            _square(self.infinity_disparity_px),
            _square(self.scale_px_mm),
            float(self.sensor_to_pupil_mm),
            np.asarray(local, np.float32),
            start,
            step,
            np.stack([covariance[..., i, j] for i, j in PAIRS]).astype(np.float32),
        )
        return numbers, curve_table(self.nonlinearity, self._curve_covariance(nodes.mean(axis=(0, 1))))

    def _nodes(self, width_px: int, height_px: int) -> np.ndarray:
        """Return the polynomials at the nodes of the covariance over a frame; (nodes, nodes, N) float64."""
        x, y = np.meshgrid(*(np.linspace(0, count - 1, _NODES) for count in (width_px, height_px)))
        return polynomials(x, y, width_px, height_px, degree_of(len(self.scale_px_mm)))

    def _with_local(self, smooth: DepthModel, x_px: np.ndarray, y_px: np.ndarray) -> DepthModel:
        """Add the local corrections to the polynomials' curves at pixels."""
        if self.local is None:
            return smooth
        infinity, scale = self.local.at(x_px, y_px)
        covariance = np.asarray(smooth.covariance).copy()
        covariance[..., :2, :2] += self.local.covariance.astype(covariance.dtype)
        return replace(
            smooth,
            infinity_disparity_px=smooth.infinity_disparity_px + infinity,
            scale_px_mm=smooth.scale_px_mm + scale,
            covariance=covariance,
        )

    def _covariance_at(self, basis: np.ndarray) -> np.ndarray:
        """Return the covariance of A, B and delta where the polynomials are ``basis``, (..., N); (..., 3, 3)."""
        n = basis.shape[-1]
        if len(self.covariance) == 3 and n != 1:
            return self.covariance
        found = np.zeros((*basis.shape[:-1], 3, 3))
        parts = (slice(0, n), slice(n, 2 * n))
        for i, rows in enumerate(parts):
            for j, columns in enumerate(parts):
                found[..., i, j] = np.einsum("...m,...m->...", basis @ self.covariance[rows, columns], basis)
            found[..., i, 2] = found[..., 2, i] = basis @ self.covariance[rows, 2 * n]
        found[..., 2, 2] = self.covariance[2 * n, 2 * n]
        return found

    def _curve_covariance(self, basis: np.ndarray) -> np.ndarray | None:
        """Return the nonlinearity's covariance with A, B, delta and itself, (K, 3 + K), or None."""
        n = len(basis)
        rows = self.covariance[2 * n + 1 :]
        if not len(rows):
            return None
        return np.column_stack([rows[:, :n] @ basis, rows[:, n : 2 * n] @ basis, rows[:, 2 * n :]])

    def _covariance_map(self, basis: np.ndarray, width_px: int, height_px: int, band: np.ndarray) -> np.ndarray:
        """Interpolate the covariance between the nodes of ``basis``; (3, 3), or (rows, width, 3, 3) float32."""
        if len(self.covariance) == 3:
            return self.covariance
        nodes = self._covariance_at(basis)
        rows, columns = (np.linspace(0, _NODES - 1, n).astype(np.float32) for n in (height_px, width_px))
        shape = (len(band), width_px)
        at = (np.broadcast_to(columns, shape).copy(), np.repeat(rows[band][:, None], width_px, axis=1))
        found = np.empty((3, 3, *shape), np.float32)  # elements are read one by one: keep each contiguous
        for i, j in PAIRS:
            found[i, j] = found[j, i] = cv2.remap(np.ascontiguousarray(nodes[..., i, j]), *at, cv2.INTER_LINEAR)
        return np.moveaxis(found, (0, 1), (2, 3))


def _evaluate(coefficients: np.ndarray, width_px: int, height_px: int, rows: np.ndarray) -> np.ndarray:
    """Evaluate a field over rows of the frame; (rows, width) float64."""
    square = _square(coefficients)
    degree = len(square) - 1
    u, v = np.linspace(-1, 1, width_px), np.linspace(-1, 1, height_px)[rows]
    along_x, along_y = chebyshev.chebvander(u, degree), chebyshev.chebvander(v, degree)
    # Column after column in memory, so that maps made of it are copied where a kernel needs them row by row: kernels
    # are compiled for arrays of their own (`system/compile_ahead.py`), not for read-only views of this one.
    return np.asarray((along_x @ square @ along_y.T).T)


def _square(coefficients: np.ndarray) -> np.ndarray:
    """Return the coefficients by their degrees in x and y, 0 above the total degree; (n + 1, n + 1) float64."""
    degree = degree_of(len(coefficients))
    i, j = np.divmod(np.arange((degree + 1) ** 2), degree + 1)
    square = np.zeros((degree + 1) ** 2)
    square[i + j <= degree] = coefficients
    return square.reshape(degree + 1, degree + 1)


def degree_of(count: int) -> int:
    """Return the total degree of a polynomial in two variables with ``count`` coefficients."""
    degree = round((np.sqrt(8 * count + 1) - 3) / 2)
    if count < 1 or (degree + 1) * (degree + 2) // 2 != count:
        raise InputError(f"{count} coefficients are not a polynomial of total degree 0, 1, 2, ... (1, 3, 6, 10, 15)")
    return degree


def polynomials(x: np.ndarray, y: np.ndarray, width_px: int, height_px: int, degree: int) -> np.ndarray:
    """Evaluate the Chebyshev products of total degree up to ``degree`` at pixels; (..., N) float64."""
    u = (2 * np.asarray(x, float) - (width_px - 1)) / max(width_px - 1, 1)
    v = (2 * np.asarray(y, float) - (height_px - 1)) / max(height_px - 1, 1)
    products = chebyshev.chebvander2d(u, v, [degree, degree])
    i, j = np.divmod(np.arange((degree + 1) ** 2), degree + 1)
    return products[..., i + j <= degree].reshape(*np.broadcast(u, v).shape, -1)


def resized_field(field: DepthField, before_px: tuple[int, int], after_px: tuple[int, int]) -> DepthField:
    """Return the curves for the frame at another size, (width, height) px, polynomials expanded anew."""
    factor = before_px[0] / after_px[0]  # px before in a px after
    shares = [_share(before, after) for before, after in zip(before_px, after_px, strict=True)]
    change = _substitution(degree_of(len(field.scale_px_mm)), *shares)
    return replace(
        field,
        infinity_disparity_px=change @ field.infinity_disparity_px / factor,
        scale_px_mm=change @ field.scale_px_mm / factor,
        covariance=_covariance(field, change, factor),
        nonlinearity=None if field.nonlinearity is None else _nonlinearity(field.nonlinearity, factor),
        local=None if field.local is None else _local(field.local, factor),
    )


def _share(before: int, after: int) -> float:
    """Return how far the outermost pixels' centres lie from the middle, in the distance of those before."""
    return before / after * (after - 1) / max(before - 1, 1)


def _substitution(degree: int, along_x: float, along_y: float) -> np.ndarray:
    """Return the matrix from coefficients in (u, v) to those in (u / along_x, v / along_y); (N, N)."""
    i, j = np.divmod(np.arange((degree + 1) ** 2), degree + 1)
    kept = i + j <= degree
    i, j = i[kept], j[kept]
    x, y = _expansion(degree, along_x), _expansion(degree, along_y)
    return x[i][:, i].T * y[j][:, j].T


def _expansion(degree: int, share: float) -> np.ndarray:
    """Return the coefficients of T_n(share * u) in T_0(u), T_1(u), ..., row n; (degree + 1, degree + 1)."""
    rows = np.zeros((degree + 1, degree + 1))
    for n, unit in enumerate(np.eye(degree + 1)):
        powers = chebyshev.cheb2poly(unit)
        found = chebyshev.poly2cheb(powers * share ** np.arange(len(powers)))
        rows[n, : len(found)] = found
    return rows


def _covariance(field: DepthField, change: np.ndarray, factor: float) -> np.ndarray:
    covariance, n = np.asarray(field.covariance, float), len(change)
    if len(covariance) == 3 and n != 1:
        units = np.array([1 / factor, 1 / factor, 1])
        return covariance * np.outer(units, units)
    curve = np.eye(len(covariance) - 2 * n - 1) / factor
    whole = np.zeros_like(covariance)
    for start, block in ((0, change / factor), (n, change / factor), (2 * n, np.eye(1)), (2 * n + 1, curve)):
        stop = start + len(block)
        whole[start:stop, start:stop] = block
    return np.asarray(whole @ covariance @ whole.T)


def _nonlinearity(curve: Nonlinearity, factor: float) -> Nonlinearity:
    return Nonlinearity(curve.low_px / factor, curve.high_px / factor, np.asarray(curve.coefficients) / factor)


def _local(local: LocalField, factor: float) -> LocalField:
    shrunk = np.float32(1 / factor)
    return LocalField(
        (local.start_px + 0.5) / factor - 0.5, local.step_px / factor, local.infinity_disparity_px * shrunk,
        local.scale_px_mm * shrunk, local.covariance / factor**2,
    )  # fmt: skip


def with_scale_error(field: DepthField, relative: float) -> DepthField:
    """Add a relative error of all disparities alike to a curve's covariance: ``relative^2 c c^T``."""
    if not (np.isfinite(relative) and relative >= 0):
        raise InputError(f"the relative error of the disparity must be 0 or more, got {relative:g}")
    if relative == 0:
        return field
    covariance = np.asarray(field.covariance, float)
    count = len(field.scale_px_mm)
    if len(covariance) == 3 and count > 1:  # of A, B and delta in the middle of the frame
        middle = field.on_axis(3, 3)  # of any frame
        parts = np.array([middle.infinity_disparity_px, middle.scale_px_mm])
    else:
        parts = np.concatenate([field.infinity_disparity_px, field.scale_px_mm])
    whole = np.zeros(len(covariance))
    whole[: len(parts)] = parts
    return replace(field, covariance=covariance + relative**2 * np.outer(whole, whole))


_BAND_PX = 1_000_000  # of a band: 60 MB of curves and their covariances


def field_to_depth(
    disparity_px: np.ndarray, sigma_px: np.ndarray, field: DepthField, *, max_depth_mm: float
) -> tuple[np.ndarray, np.ndarray]:
    """Compute `disparity_to_depth` by bands of rows: curves of every pixel at once take gigabytes."""
    height, width = disparity_px.shape
    step = height if len(field.scale_px_mm) == 1 else max(1, _BAND_PX // width)
    if step >= height:
        return disparity_to_depth(disparity_px, field.model(width, height), sigma_px, max_depth_mm=max_depth_mm)
    depth, sigma = (np.empty((height, width), np.float32) for _ in range(2))
    for top in range(0, height, step):
        rows = slice(top, min(top + step, height))
        depth[rows], sigma[rows] = disparity_to_depth(
            disparity_px[rows], field.model(width, height, rows), sigma_px[rows], max_depth_mm=max_depth_mm
        )
    return depth, sigma


def field_to_tree(field: DepthField) -> dict[str, Any]:
    """Return a field as a tree of plain values, and of arrays where there are thousands of values."""
    tree = dict(plain(dataclasses.asdict(field)))
    if field.local is not None:
        maps = {name: getattr(field.local, name) for name in ("infinity_disparity_px", "scale_px_mm")}
        tree["local"] = {**tree["local"], **maps}
    return tree


def field_from_tree(tree: Mapping[str, Any]) -> DepthField:
    """Rebuild a field; raises KeyError, TypeError or ValueError where the tree holds none."""
    infinity, scale = (
        np.atleast_1d(np.array(_numbers(tree[n]), float)) for n in ("infinity_disparity_px", "scale_px_mm")
    )
    for coefficients in (infinity, scale):
        degree_of(len(coefficients))
        finite(coefficients, coefficients.shape[:1])
    if len(infinity) != len(scale):
        raise ValueError("the two depth fields differ in degree")
    (delta,) = finite([tree["sensor_to_pupil_mm"]], (1,))
    covariance = np.array(_numbers(tree["covariance"]), np.float64)
    curve = tree.get("nonlinearity")
    if curve is not None:
        (low, high) = finite([curve["low_px"], curve["high_px"]], (2,))
        curve = Nonlinearity(float(low), float(high), finite(curve["coefficients"], (len(curve["coefficients"]),)))
    terms = 0 if curve is None else len(curve.coefficients)
    sizes = (3, 2 * len(infinity) + 1, 2 * len(infinity) + 1 + terms)
    if covariance.shape not in [(size, size) for size in sizes]:
        raise ValueError(f"a covariance of shape {covariance.shape} does not fit its depth field")
    local = tree.get("local")
    if local is not None:
        shape = np.shape(local["scale_px_mm"])
        (start, step) = finite([local["start_px"], local["step_px"]], (2,))
        if len(shape) != 2 or not step > 0:
            raise ValueError("a local field is no map")
        infinities, scales = (
            finite(local[name], shape).astype(np.float32) for name in ("infinity_disparity_px", "scale_px_mm")
        )
        local = LocalField(float(start), float(step), infinities, scales, finite(local["covariance"], (2, 2)))
    return DepthField(infinity, scale, float(delta), finite(covariance, covariance.shape), curve, local)


def plain(value: Any) -> Any:
    """Turn small arrays and NumPy scalars into lists and numbers, which YAML shows as text."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    return value.item() if isinstance(value, np.generic) else value


def finite(value: Any, shape: tuple[int, ...]) -> np.ndarray:
    """Return a float64 array; raises ValueError where the shape differs or a number is not finite."""
    array = np.array(_numbers(value), dtype=np.float64)
    if array.shape != shape or not np.isfinite(array).all():
        raise ValueError(f"expected finite numbers of shape {shape}")
    return array


def _numbers(value: Any) -> np.ndarray:
    """Return an array of numbers; raises ValueError for texts and switches, which NumPy would convert."""
    array = np.asarray(value)
    if array.dtype.kind not in "fiu":
        raise ValueError("expected numbers")
    return array
