# mypy: disallow-untyped-defs=False
"""Place between the layers and error bar of quality "real-time", compiled; ``readable/place.py`` explains them."""

from __future__ import annotations

import numpy as np

from chromaperture.matching.compiled import simd as v
from chromaperture.matching.compiled.layout import ONE, ZERO, inner, kernel
from chromaperture.matching.error_bar import local_range, sigma_of_range
from chromaperture.matching.labels import LabelMap, PathWinner, Surface
from chromaperture.matching.readable.place import (
    BESIDE_NEARER,
    BIAS,
    EDGE_REACH_PX,
    EDGE_SHARE,
    FARTHEST_OF_FIVE,
    LEAST_INFORMATION,
    LEAST_UNEXPLAINED,
    LEAST_UNEXPLAINED_OF_THREE,
    SCATTER,
    WIDEST_SHARE,
    beside_nearer,
    near_usable,
)
from chromaperture.matching.readable.place import place_by_correlation as readable_place
from chromaperture.system.threads import in_parallel

_INFORMATION, _UNEXPLAINED = np.float32(LEAST_INFORMATION), np.float32(LEAST_UNEXPLAINED)
_UNEXPLAINED_OF_THREE = np.float32(LEAST_UNEXPLAINED_OF_THREE)
_BESIDE_NEARER = np.float32(BESIDE_NEARER)
_EDGE, _WIDEST = np.float32(EDGE_SHARE), np.float32(WIDEST_SHARE)
_SCATTER2, _BIAS2 = np.float32(SCATTER**2), np.float32(BIAS**2)
_FLAT = np.float32(1e-9)  # a flat top has no vertex
_TWO, _THREE, _QUARTER = np.float32(2), np.float32(3), np.float32(0.25)
_SEVENTH, _FIFTH, _LEAST_BEND = np.float32(1 / 7), np.float32(1 / 5), np.float32(1 / (2 * FARTHEST_OF_FIVE))


def place_by_correlation(winner: PathWinner, layer_count: int, *, view_count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the place between the layers and its information, as `readable.place_by_correlation`."""
    shape = winner.layer.shape
    if winner.layer.size < v.LANES:
        return readable_place(winner, layer_count, view_count=view_count)
    maps = [
        np.ascontiguousarray(part, np.float32).reshape(-1)
        for part in (winner.layer, winner.far_before, winner.before, winner.at, winner.after, winner.far_after)
    ]
    place, information = np.empty((2, winner.layer.size), np.float32)

    def some(_: int, first: int, last: int) -> None:
        parts = (part[first * v.LANES :] for part in (*maps, place, information))
        _place(*parts, last - first, layer_count, view_count == 2)

    in_parallel(some, len(place) // v.LANES)
    end = len(place) - v.LANES  # the last vector overlaps the one before
    _place(*(part[end:] for part in (*maps, place, information)), 1, layer_count, view_count == 2)
    place, information = place.reshape(shape), information.reshape(shape)
    np.multiply(information, _BESIDE_NEARER, out=information, where=beside_nearer(winner.layer))
    return place, information


def halved_surface(
    winner: PathWinner,
    place: np.ndarray,
    information: np.ndarray,
    layers_px: np.ndarray,
    label_map: LabelMap,
    mask: np.ndarray,
    *,
    cell_px: int = 1,
) -> Surface:
    """Return the surface of the halved picture, as `readable.halved_surface`."""
    first, step = np.float32(layers_px[0]), np.float32(layers_px[1] - layers_px[0])
    disparity = np.asarray(label_map.disparity(first + step * place), np.float32)
    extent = local_range(disparity, -(-EDGE_REACH_PX // cell_px))
    scale = np.array(np.broadcast_to(label_map.scale, disparity.shape), np.float32)
    parts = [np.ascontiguousarray(part, np.float32) for part in (winner.layer, winner.sigma_px, winner.at, information)]
    out = Surface(disparity, *np.empty((2, *disparity.shape), np.float32))
    last, widest = np.float32(len(layers_px) - 1), np.float32(sigma_of_range(layers_px))

    def rows(_: int, top: int, bottom: int) -> None:
        band = slice(top, bottom)
        _finish(*(part[band] for part in (*parts, extent, scale)), last, step, widest, *(part[band] for part in out))

    in_parallel(rows, len(disparity))
    if not mask.all():
        np.copyto(out.disparity_px, np.float32(np.nan), where=~near_usable(mask))
    return out


@kernel
def _place(layer, far_before, before, at, after, far_after, place, information, count, layers, two_views):
    """So many vectors."""
    one, two, floor, flat = v.broadcast(ONE), v.broadcast(_TWO), v.broadcast(ZERO), v.broadcast(_FLAT)
    first, last = v.broadcast(ONE), v.broadcast(np.float32(layers - 2))
    third_last, three = v.broadcast(np.float32(layers - 3)), v.broadcast(_THREE)
    for i in range(0, count * v.LANES, v.LANES):
        low, middle, high = (
            _correlation(v.load(before, i), two_views),
            _correlation(v.load(at, i), two_views),
            _correlation(v.load(after, i), two_views),
        )
        inside = v.smaller(v.larger(v.load(layer, i), first), last)
        if two_views:
            bend = v.larger(v.sub(v.sub(v.add(middle, middle), low), high), floor)
            rise = v.sub(high, low)
            offset = v.larger(v.smaller(v.div(rise, v.fma(two, bend, flat)), one), v.broadcast(-ONE))
            peak = v.smaller(v.fma(v.mul(offset, rise), v.broadcast(_QUARTER), middle), one)
            left = v.fnma(peak, peak, one)
            found = v.div(v.mul(bend, peak), v.add(left, v.broadcast(_UNEXPLAINED)))
            found = v.mul(found, v.root(v.root(found)))
        else:
            far_low, far_high = _correlation(v.load(far_before, i), False), _correlation(v.load(far_after, i), False)
            # 1 where the range ends one layer away, else 0: there the parabola through the three others goes on.
            at_start, at_end = v.larger(v.sub(two, inside), floor), v.larger(v.sub(inside, third_last), floor)
            far_low = v.fma(at_start, v.sub(v.fma(three, v.sub(low, middle), high), far_low), far_low)
            far_high = v.fma(at_end, v.sub(v.fma(three, v.sub(high, middle), low), far_high), far_high)
            near = v.add(v.add(low, high), v.add(middle, middle))
            rise = v.mul(v.fma(two, v.sub(far_high, far_low), v.sub(high, low)), v.broadcast(_FIFTH))
            least_bend = v.mul(v.larger(rise, v.sub(floor, rise)), v.broadcast(_LEAST_BEND))
            bend = v.mul(v.fnma(two, v.add(far_low, far_high), near), v.broadcast(_SEVENTH))
            bend = v.larger(bend, least_bend)
            offset = v.div(rise, v.fma(two, bend, flat))
            found = v.div(v.mul(bend, middle), v.add(v.sub(one, middle), v.broadcast(_UNEXPLAINED_OF_THREE)))
        v.store(information, i, v.add(found, v.broadcast(_INFORMATION)))
        v.store(place, i, v.add(inside, offset))


@inner
def _correlation(likelihood, two_views):
    """Correlation of a log-likelihood."""
    less = v.sub(v.broadcast(ZERO), likelihood)
    if two_views:
        explained = v.sub(v.broadcast(ONE), v.exponential(v.add(less, less)))
        return v.root(v.larger(explained, v.broadcast(ZERO)))
    return v.sub(v.broadcast(ONE), v.exponential(less))


@kernel
def _finish(layer, posterior, at, information, extent, scale, last, step, widest, disparity, sigma, peak):
    """Error bar and peak; the disparity becomes NaN where it is not known."""
    width = layer.shape[1]
    padded = (width + v.LANES - 1) // v.LANES * v.LANES
    row = np.zeros(padded, np.float32)
    for y in range(len(layer)):
        for x in range(width):
            known_by, edge, unit = information[y, x], _EDGE * extent[y, x], scale[y, x] * step
            own = unit * unit * (_SCATTER2 + _BIAS2 / known_by) / known_by
            sigma[y, x] = min(np.sqrt(own + edge * edge), scale[y, x] * widest)
            known = layer[y, x] > ZERO and layer[y, x] < last and posterior[y, x] < _WIDEST * widest
            disparity[y, x] = disparity[y, x] if known else np.float32(np.nan)
        for x in range(width):
            row[x] = -_TWO * at[y, x]
        for x in range(0, padded, v.LANES):
            explained = v.sub(v.broadcast(ONE), v.exponential(v.load(row, x)))
            v.store(row, x, v.root(v.larger(explained, v.broadcast(ZERO))))
        for x in range(width):
            peak[y, x] = row[x]
