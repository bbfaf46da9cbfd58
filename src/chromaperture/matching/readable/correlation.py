"""Correlation of shifted views for every layer, in plain NumPy: the oracle of ``compiled/correlation.py``.

The views are moved by a layer's disparity and correlated in an exponentially weighted window. Beyond its border the
picture is continued by the border's value: windows and shifts then commute and a correlation stays in [-1, 1].
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from chromaperture.matching.integer_light import plane_variance, whole_taps
from chromaperture.matching.views import ViewNoise, Views, view_pairs
from chromaperture.settings.stages import SAMPLED_PX2, CorrelationConfig

Taps = Callable[[float], tuple[float, float, float, float]]

MIN_VARIANCE_FRACTION = 0.05  # of a variance that debiasing always leaves: an estimated noise may be too high
NEGLIGIBLE = 1e-6  # fraction of a window's weight that may be missed: products have means far above their variances
RELATIVE_EPSILON = 1e-6  # of a view's overall variance: even areas score 0, not noise / noise
# As much of a cell's: that of a view with bright spots outweighs a dark wall's texture and noise, and walls are lost
# whole (docs/decisions.md, *Weak texture through three filters*).
CELL_EPSILON = 1e-8
MIN_WEIGHT = 1e-4  # keeps the sum of weights positive where a whole line is unusable
CELL_TAPS = (1, 2, 3, 2, 1)  # of a cell's window along x and along y; docs/decisions.md compares windows
LEAST_FLOOR = 1e-12  # squared units, added to the variance of a cell: an even picture scores 0, too
LEAST_PRODUCT = np.float32(1e-37)  # of two variances: no division by 0
SCORE_PARTS = 32000  # of a cell's score: 16 bits with a sign
CONTRARY = 0.8  # correlation from which on a cell counts negative ones; docs/decisions.md compares


def correlate(views: Views, layers_px: np.ndarray, *, config: CorrelationConfig) -> np.ndarray:
    """Score every layer: the correlation of two views, or 1 - sqrt(det) of the correlation matrix of three.

    Cells of two views count by the sign of their strongest correlation, see `of_own_sign`.

    Parameters
    ----------
    views : Views
    layers_px : (D,) float, px
        Equally spaced.
    config : CorrelationConfig

    Returns
    -------
    (H, W, D) float64; (ceil(H / 2), ceil(W / 2), D) for cells of 2 px
    """
    if config.cell_px == 2:
        return _cell_scores(views, layers_px, config)
    height, width, view_count = views.pictures.shape
    pad = padding(layers_px, views.directions, config.sampling)
    padded = _pad(views.pictures.astype(np.float64), pad)
    known = sampled_noise(views, config)
    variances, covariances = (_pad(maps.astype(np.float64), pad) for maps in _noise(views, known, config))
    overlap = None if known is None else known.overlap(layers_px, views.directions)
    epsilon = variance_floor(views.pictures)
    taps_of = SAMPLING[config.sampling]

    volume = np.empty((height, width, len(layers_px)))
    for s, d in enumerate(layers_px):
        moved = [shift(padded[..., k], d * views.directions[k], taps_of=taps_of) for k in range(view_count)]
        means = [exponential_window(m, config.window_decay) for m in moved]
        gains = []
        for k in range(view_count):
            variance = exponential_window(moved[k] ** 2, config.window_decay) - means[k] ** 2
            noise = shift(variances[..., k], d * views.directions[k], taps_of=taps_of)
            clean = np.maximum(variance - noise, MIN_VARIANCE_FRACTION * variance)
            gains.append(1 / np.sqrt(clean + epsilon[k]))
        rho = []
        for p, (k, m) in enumerate(view_pairs(view_count)):
            cross = exponential_window(moved[k] * moved[m], config.window_decay) - means[k] * means[m]
            cross -= 0 if overlap is None else covariances[..., p] * overlap[s, p]
            rho.append(np.clip(cross * gains[k] * gains[m], -1, 1))
        layer = rho[0] if view_count == 2 else three_view_score(*rho)
        volume[..., s] = layer[pad[1] : pad[1] + height, pad[0] : pad[0] + width]
    return volume


def cells_of(maps: np.ndarray) -> np.ndarray:
    """Return maps (H, W, ...) at the pixels after which cells of 2 px are named; contiguous."""
    return np.ascontiguousarray(maps[::2, ::2])


def _cell_scores(views: Views, layers_px: np.ndarray, config: CorrelationConfig) -> np.ndarray:
    """Score cells: cell (x, y) is the 5 x 5 px about pixel (2 x, 2 y), weighted by `CELL_TAPS` both ways.

    In whole units of light, in which sums are exact (`integer_light.py`); scores are rounded to 1 / `SCORE_PARTS`. All
    executions take the same steps in 32 bits.
    """
    height, width, view_count = views.pictures.shape
    x, y = padding(layers_px, views.directions, config.sampling)
    pad = (x + 2, y + 2)
    scale = 1 / views.unit if views.unit else 1.0
    padded, floors = _pad(np.float32(scale) * views.pictures, pad), cell_variance_floor(views)
    inside = np.s_[pad[1] : pad[1] + height : 2, pad[0] : pad[0] + width : 2]

    volume = []
    for d in layers_px:
        windows = [
            _CellWindow.of(
                _whole_shift(padded[..., k], d * views.directions[k], SAMPLING[config.sampling], rounds=views.unit > 0)
            )
            for k in range(view_count)
        ]
        variances = [np.maximum(w.covariance(w), 0)[inside] + floor for w, floor in zip(windows, floors, strict=True)]
        rho = [
            np.clip(
                windows[k].covariance(windows[m])[inside]
                / np.sqrt(np.maximum(variances[k] * variances[m], LEAST_PRODUCT)),
                -1,
                1,
            )
            for k, m in view_pairs(view_count)
        ]
        volume.append(rho[0] if view_count == 2 else _three_view_score(*rho))
    scores = np.asarray(np.round(np.float32(SCORE_PARTS) * np.stack(volume, axis=-1)) / SCORE_PARTS, float)
    return of_own_sign(scores) if view_count == 2 else scores


def of_own_sign(scores: np.ndarray) -> np.ndarray:
    """Turn the signs of the scores (H, W, D) of cells whose strongest one is negative.

    Where orange meets blue, one view rises as the other falls: where they agree in depth their correlation is negative,
    and positive where an edge meets the next one, at a wrong depth. A cell has one sign for all depths, so that the
    others offer it no second choice. Noise is as often of either sign, but seldom beyond `CONTRARY`. Three views need
    none of this: their determinant is the same whichever of them is turned.
    """
    least, most = scores.min(axis=-1, keepdims=True), scores.max(axis=-1, keepdims=True)
    return np.where((least < -CONTRARY) & (least < -most), -scores, scores)


class _CellWindow(NamedTuple):
    """The windows of a view about every pixel; whole numbers in single precision."""

    # List of four (H, W): samples of a row less the one in its middle: 2 and 1 px before it, 1 and 2 px behind it.
    apart: list[np.ndarray]
    total: np.ndarray  # (H, W): their weighted sum
    # List of five (H, W): nine times the means of the rows, less the whole number next to the mean of these.
    means: list[np.ndarray]
    left: np.ndarray  # (H, W): what is left of their weighted sum

    @classmethod
    def of(cls, view: np.ndarray) -> _CellWindow:
        apart = [np.roll(view, -x, axis=1) - view for x in (-2, -1, 1, 2)]
        total = _weighed(apart[0] + apart[3], apart[1] + apart[2], 0)
        rows = _rows_of(9 * view + total)
        sums = _weighed(rows[0] + rows[4], rows[1] + rows[3], rows[2])
        middle = np.round(sums / 9)
        return cls(apart, total, [row - middle for row in rows], sums - 9 * middle)

    def covariance(self, other: _CellWindow) -> np.ndarray:
        """Return 9^4 times the covariance: that within rows, and that of their means. Products are exact."""
        products = [a * b for a, b in zip(self.apart, other.apart, strict=True)]
        of_row = _weighed(products[0] + products[3], products[1] + products[2], 0)
        within = _rows_of((8 * of_row + of_row) - self.total * other.total)
        between = [a * b for a, b in zip(self.means, other.means, strict=True)]
        ends, inside = (within[i] + within[4 - i] + between[i] + between[4 - i] for i in (0, 1))
        joined = _weighed(ends, inside, within[2] + between[2])
        return np.asarray((8 * joined + joined) - self.left * other.left)


def _weighed(ends: np.ndarray, inside: np.ndarray, middle: np.ndarray | int) -> np.ndarray:
    """Weights 1 2 3 2 1 by sums of two."""
    return np.asarray((ends + middle) + 2 * (inside + middle))


def _rows_of(maps: np.ndarray) -> list[np.ndarray]:
    """Return what lies 2 px above every pixel, to 2 px below it."""
    return [np.roll(maps, -y, axis=0) for y in (-2, -1, 0, 1, 2)]


def _three_view_score(r01: np.ndarray, r02: np.ndarray, r12: np.ndarray) -> np.ndarray:
    """As `three_view_score`, of single numbers, without sums whose parts cancel."""
    one = np.float32(1)
    determinant = (one - r01**2) * (one - r02**2) - (r12 - r01 * r02) ** 2
    return np.asarray(one - np.sqrt(np.maximum(determinant, np.float32(0))))


def cell_variance_floor(views: Views) -> np.ndarray:
    """Return what is added to 9^4 times a window's variance in whole units; (K,) float32."""
    scale = 1 / views.unit if views.unit else 1.0
    planes = np.moveaxis(views.pictures, 2, 0)
    variances = np.array([plane_variance(np.ascontiguousarray(plane, np.float32)) for plane in planes])
    floors = np.asarray(sum(CELL_TAPS) ** 4 * (scale**2 * CELL_EPSILON * variances + LEAST_FLOOR), np.float32)
    # Of few digits, which are the same whatever the order in which the picture was summed up.
    return (floors.view(np.uint32) & np.uint32(0xFFF00000)).view(np.float32)


def _whole_shift(view: np.ndarray, offset_px: np.ndarray, taps_of: Taps, *, rounds: bool) -> np.ndarray:
    """As `shift`, along y and then along x, by weights of whole parts and to whole units where it ``rounds``."""
    for axis in (0, 1):
        offset = offset_px[1 - axis]
        whole = math.floor(offset + 1e-9)  # 1e-9: a whole shift but for rounding is whole
        index = np.arange(view.shape[axis]) + whole
        places = [np.clip(index + i, 0, view.shape[axis] - 1) for i in (-1, 0, 1, 2)]
        taps = whole_taps(taps_of(max(offset - whole, 0.0))).astype(np.float32)
        view = sum(tap * np.take(view, place, axis=axis) for tap, place in zip(taps, places, strict=True))
        view = np.round(view) if rounds else view
    return view


def sampled_noise(views: Views, config: CorrelationConfig) -> ViewNoise | None:
    """Return the noise of the views as the correlation samples them."""
    return None if views.noise is None else views.noise.sampled(config.sampling_variance_px2)


def _noise(views: Views, known: ViewNoise | None, config: CorrelationConfig) -> tuple[np.ndarray, np.ndarray]:
    """Noise variance of the views and covariance of their pairs that is to be subtracted; 0 without debiasing."""
    if known is not None and config.noise_debiasing:
        return known.variance, known.covariance
    count = views.pictures.shape[2]
    return np.zeros((*views.mask.shape, count)), np.zeros((*views.mask.shape, len(view_pairs(count))))


def three_view_score(r01: np.ndarray, r02: np.ndarray, r12: np.ndarray) -> np.ndarray:
    """Return 1 - sqrt(det R) of three views' correlation matrix; 1 on a colour line, 0 without any correlation.

    Two eigenvalues of R vanish together where the views agree, so det R has a minimum of fourth order there, whose
    parabola is biased to the layers (by 0.05 px at a step of 0.5); its root has one of second order.
    """
    determinant = 1 + 2 * r01 * r02 * r12 - r01**2 - r02**2 - r12**2
    return 1 - np.sqrt(np.maximum(determinant, 0))


def texture_weights(views: Views, *, config: CorrelationConfig) -> np.ndarray:
    """Weight every pixel by its texture against its noise, 0 where the capture is unusable; (H, W) float64.

    The geometric mean over the views of the signal's fraction of the variance in the window, of the views as layers
    sample them.
    """
    weights = np.ones(views.mask.shape)
    count = views.pictures.shape[2]
    known = sampled_noise(views, config)
    for k in range(count):
        view = shift(views.pictures[..., k].astype(np.float64), np.zeros(2), taps_of=SAMPLING[config.sampling])
        mean = exponential_window(view, config.window_decay)
        variance = exponential_window(view**2, config.window_decay) - mean**2
        noise = 0.0 if known is None else known.variance[..., k].astype(np.float64)
        signal = np.maximum(variance - noise, 0)
        weights *= (signal / (signal + noise + variance_floor(views.pictures)[k])) ** (1 / count)
    return np.maximum(weights * views.mask, MIN_WEIGHT)


def variance_floor(pictures: np.ndarray) -> np.ndarray:
    """Variance below which a view counts as even; (K,) float64."""
    return RELATIVE_EPSILON * pictures.astype(np.float64).var(axis=(0, 1)) + 1e-30


def window_reach(decay: float) -> int:
    """Return the px beyond which an exponential window has less than `NEGLIGIBLE` of its weight."""
    return math.ceil(math.log(NEGLIGIBLE) / math.log(decay))


def padding(layers_px: np.ndarray, directions: np.ndarray, sampling: str = "catmull-rom") -> tuple[int, int]:
    """Border (x, y) in px beyond which every shifted view is constant: the shift and two taps of the cubic.

    Along an axis without shifts an interpolating cubic has no taps; one that smooths has them everywhere.
    """
    reach = np.abs(layers_px).max() * np.abs(directions).max(axis=0)
    x, y = (math.ceil(r) + 2 if r > 0 or SAMPLED_PX2[sampling] else 0 for r in reach)
    return x, y


def _pad(maps: np.ndarray, pad: tuple[int, int]) -> np.ndarray:
    return np.pad(maps, ((pad[1], pad[1]), (pad[0], pad[0]), (0, 0)), mode="edge")


def shift(view: np.ndarray, offset_px: np.ndarray, *, taps_of: Taps | None = None) -> np.ndarray:
    """Sample ``view`` at x + offset by a cubic, Catmull and Rom's unless given, borders replicated.

    ``view`` (H, W) float; ``offset_px`` (2,) float, (x, y); ``taps_of``: one of `SAMPLING`.
    """
    for axis, offset in ((1, offset_px[0]), (0, offset_px[1])):
        whole = math.floor(offset)
        taps = (taps_of or cubic_taps)(offset - whole)
        index = np.arange(view.shape[axis])
        view = sum(
            tap * np.take(view, np.clip(index + whole + i, 0, view.shape[axis] - 1), axis=axis)
            for i, tap in zip((-1, 0, 1, 2), taps, strict=True)
        )
    return view


def cubic_taps(t: float) -> tuple[float, float, float, float]:
    """Catmull-Rom weights of the samples at -1, 0, 1, 2 for the point t in [0, 1)."""
    return (
        0.5 * (-t + 2 * t**2 - t**3),
        0.5 * (2 - 5 * t**2 + 3 * t**3),
        0.5 * (t + 4 * t**2 - 3 * t**3),
        0.5 * (-(t**2) + t**3),
    )


def smoothed_cubic_taps(t: float, *, variance_px2: float) -> tuple[float, float, float, float]:
    """Weights of the cubic through four samples, smoothed by a Gaussian; as `cubic_taps`.

    A Gaussian adds half its variance times the second derivative to a cubic. So the weights of all phases t have the
    mean t, the same variance, and third moments of 0. With 1/3 px^2 they are those of a cubic B-spline.
    """
    cubic = (-t * (t - 1) * (t - 2) / 6, (t**2 - 1) * (t - 2) / 2, -t * (t + 1) * (t - 2) / 2, t * (t**2 - 1) / 6)
    bend = (1 - t, 3 * t - 2, 1 - 3 * t, t)
    a, b, c, d = (value + variance_px2 / 2 * second for value, second in zip(cubic, bend, strict=True))
    return a, b, c, d


SAMPLING: dict[str, Taps] = {
    name: partial(smoothed_cubic_taps, variance_px2=variance) if variance else cubic_taps
    for name, variance in SAMPLED_PX2.items()
}


def exponential_window(maps: np.ndarray, decay: float) -> np.ndarray:
    """Average with the weights ((1-a)/(1+a))^2 a^(|x|+|y|), the picture continued beyond its border.

    Two first-order recursions an axis; their start values are the exact response to an endless constant border.
    """
    from scipy.signal import lfilter  # here: it takes 0.5 s, and only the oracle needs it

    for axis in (0, 1):
        first = np.take(maps, [0], axis=axis)
        last = np.take(maps, [-1], axis=axis)
        forward, _ = lfilter([1 - decay], [1, -decay], maps, axis=axis, zi=decay * first)
        end = last + (np.take(forward, [-1], axis=axis) - last) / (1 + decay)
        # Backward over the samples before the last one, started from the closed form at the last.
        body = np.flip(np.delete(forward, -1, axis=axis), axis=axis)
        back, _ = lfilter([1 - decay], [1, -decay], body, axis=axis, zi=decay * end)
        maps = np.concatenate([np.flip(back, axis=axis), end], axis=axis)
    return maps
