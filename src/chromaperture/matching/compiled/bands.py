# mypy: disallow-untyped-defs=False
"""First half of the compiled matcher: a band of rows from the views to scores filtered along x.

Everything along a row is a recursion, so eight layers of one pixel are one vector and the row is walked pixel by
pixel. A band is a picture of its own: it starts ``halo`` rows early, unless it takes over the windows of the band
above, and ends as many rows late; there it is continued by its last row as the reference continues the picture.
"""

from __future__ import annotations

import numpy as np

from chromaperture.matching.compiled import simd as v
from chromaperture.matching.compiled.layout import BLOCK, GROUP, ONE, ZERO, inner, kernel
from chromaperture.matching.compiled.samples import sample, standardise, transpose_rows
from chromaperture.matching.compiled.scores import locate_row, score_three, score_two
from chromaperture.matching.compiled.windows import copy, window_end, window_rows, window_up


@kernel
def score_band(pictures, plan, band, scratch, volume, maps):
    """Fill a band of the volume of scores, filtered along x, and the maps that the filter along y needs.

    ``volume`` (blocks, H, D8 / 8, BLOCK, 8) flat; written: int16 of plain scores, float32 of filtered ones; ``maps``
    RowMaps; written.
    """
    samplings, layers, numbers = plan.samplings, plan.layers, plan.numbers
    pad_x, pad_y, halo = plan.pad_x, plan.pad_y, plan.halo
    top, bottom, begin = band.top, band.bottom, band.begin
    height, width = pictures.mask.shape
    # Rows of the cross terms; beyond pad_y rows outside the picture everything is constant. A band that follows
    # another takes over its windows and starts without a halo.
    first = max(top - halo, -pad_y) if begin else top
    last = min(bottom + halo, height + pad_y + 1)  # one row too many: below it the recursion only ends
    last += -(last - first) % GROUP
    # Rows of the samples: the layers look pad_y rows further.
    first_sample = first - pad_y
    sample_rows = last + pad_y - first_sample
    sample_rows += -sample_rows % GROUP
    sample(pictures, samplings, first_sample, sample_rows, scratch)
    standardise(pictures, plan, band, first_sample, sample_rows, scratch, maps.weights)
    layer_count, pair_count = len(layers.ceiling), len(layers.pairs)
    for y in range(bottom if numbers.plain else top, bottom):
        _weigh_row(pictures.mask[y], numbers.min_weight, len(pictures.views), maps.weights[y])
        _links_along_x(pictures.guide[y], numbers.even_link, maps.links[y])
        _filter_weights(maps.weights[y], numbers.even_link, maps.links[y], scratch.line, maps.filtered[y])
        here, above = pictures.guide[y], pictures.guide[max(y - 1, 0)]
        links_y = maps.links_y[y]
        for x in range(width):
            links_y[x] = fading(here[x] - above[x], numbers.even_link)

    padded = width + 2 * pad_x
    row_size = padded * v.LANES
    slabs = layer_count // v.LANES
    windows = (len(samplings.owner) + 3) // 4  # carried by `standardise`
    ring_size = (last - first + 1) * row_size
    places = np.empty((len(layers.direct), 2), np.int64)
    for slab in range(slabs):
        lane0 = slab * v.LANES
        for row in range(first, last, GROUP):
            for k in range(len(layers.direct)):
                if not layers.direct[k]:
                    for j in range(GROUP):
                        transpose_rows(
                            scratch.value, samplings, layers, k, lane0, row + j - first_sample, pad_x, padded,
                            scratch.lanes, (k * GROUP + j) * row_size,
                        )  # fmt: skip
            for p in range(pair_count):
                k, m = layers.pairs[p]
                at = p * ring_size + (row - first + 1) * row_size
                carried = (windows + slab * pair_count + p) * row_size
                if row == first and not begin:
                    copy(scratch.carry, carried, scratch.ring, at - row_size, row_size)
                sample_row = (row - first_sample) * samplings.row_length
                at_k = sample_row + layers.start[k] + lane0 - layers.step[k] * pad_x
                at_m = sample_row + layers.start[m] + lane0 - layers.step[m] * pad_x
                step_k, step_m = layers.step[k], layers.step[m]
                down_k, down_m = samplings.row_length, samplings.row_length
                from_k = scratch.value if layers.direct[k] else scratch.lanes
                from_m = scratch.value if layers.direct[m] else scratch.lanes
                if not layers.direct[k]:
                    at_k, step_k, down_k = k * GROUP * row_size, v.LANES, row_size
                if not layers.direct[m]:
                    at_m, step_m, down_m = m * GROUP * row_size, v.LANES, row_size
                window_rows(
                    from_k, at_k, step_k, down_k, from_m, at_m, step_m, down_m,
                    scratch.ring, at, padded, numbers.decay, begin and row == first,
                )  # fmt: skip
        for p in range(pair_count):
            at = p * ring_size + row_size
            carried = (windows + slab * pair_count + p) * row_size
            below = at + (bottom - first) * row_size
            copy(scratch.ring, below - row_size, scratch.carry, carried, row_size)
            window_end(scratch.ring, at, last - first, padded, numbers.decay, scratch.state, p * row_size)
            for row in range(last - 2, bottom - 1, -1):
                window_up(
                    scratch.ring, at + (row - first) * row_size, padded, numbers.decay, scratch.state, p * row_size
                )
        for row in range(bottom - 1, top - 1, -1):
            locate_row(samplings, layers, lane0, row, first_sample, pad_x, padded, scratch, places)
            at = (row - first + 1) * row_size
            at_volume, stride = (row * slabs + slab) * BLOCK * v.LANES, height * slabs * BLOCK * v.LANES
            if pair_count == 1:
                score_two(
                    pictures, layers, numbers, row, lane0, pad_x, padded, at, places, scratch, maps,
                    volume, at_volume, stride,
                )  # fmt: skip
            else:
                score_three(
                    pictures, layers, numbers, row, lane0, pad_x, padded, at, ring_size, places, scratch, maps,
                    volume, at_volume, stride,
                )  # fmt: skip
            if not numbers.plain:
                _filter_back(scratch.scores, maps.links[row], width, numbers.even_link, volume, at_volume, stride)
    v.fence()


@inner
def _weigh_row(mask, min_weight, views, weights):
    """Finish the weights of a row: geometric mean of the views' signal fractions, the least weight where unusable."""
    if views == 2:
        for x in range(len(weights)):
            weights[x] = max(np.sqrt(weights[x]) * mask[x], min_weight)
    else:
        for x in range(len(weights)):
            weights[x] = max(weights[x] ** np.float32(1 / 3) * mask[x], min_weight)


@inner
def fading(difference, even_link):
    """Return even_link exp(-|difference|): a power series of a 64th, squared six times, which vectorises."""
    y = abs(difference) * np.float32(1 / 64)
    series = ONE + y * (ONE + y * (np.float32(1 / 2) + y * (np.float32(1 / 6) + y * np.float32(1 / 24))))
    series *= series
    series *= series
    series *= series
    series *= series
    series *= series
    series *= series
    return even_link / series


@inner
def _links_along_x(guide, even_link, links):
    """Link weight of each pixel of a row to its left neighbour; 0 at both ends."""
    width = len(guide)
    here, before, out = guide[1:], guide[: width - 1], links[1:]
    for x in range(width - 1):
        out[x] = fading(here[x] - before[x], even_link)
    links[0] = links[width] = ZERO


@inner
def _filter_weights(weights, even_link, links, other, out):
    """Both recursions along a row of weights, without their gain: a sample at an end counts 1 / gain.

    They run side by side, because each depends on its own last result; ``other`` holds the leftwards one.
    """
    end = len(weights) - 1
    right, left = weights[0] / (ONE - even_link), weights[end] / (ONE - even_link)
    v.put(out, 0, right)
    v.put(other, end, left)
    for i in range(1, end + 1):
        right = v.get(weights, i) + v.get(links, i) * right
        left = v.get(weights, end - i) + v.get(links, end - i + 1) * left
        v.put(out, i, right)
        v.put(other, end - i, left)
    for x in range(end + 1):
        out[x] += other[x]


@inner
def _filter_back(scores, links, width, even_link, volume, at, stride):
    """Add the leftwards recursion to the rightwards one of a row and store the sum."""
    end = width - 1
    border_gain, gain = v.broadcast(ONE / (ONE - even_link)), v.broadcast(ONE - even_link)
    here = v.load(scores, end * v.LANES)
    if end == 0:  # a picture one px wide: both recursions start and end here
        v.store_kept(volume, at, v.add(here, here))
        return
    # The weighted score is what the forward result has more than its link to the one before.
    before = v.load(scores, (end - 1) * v.LANES)
    state = v.mul(border_gain, v.fnma(v.broadcast_at(links, end), before, here))
    place = at + (end // BLOCK) * stride + (end % BLOCK) * v.LANES
    v.store_kept(volume, place, v.add(here, state))
    for x in range(end - 1, 0, -1):
        here, before = before, v.load(scores, (x - 1) * v.LANES)
        weighted = v.fnma(v.broadcast_at(links, x), before, here)
        state = v.fma(v.broadcast_at(links, x + 1), state, weighted)
        place = at + (x // BLOCK) * stride + (x % BLOCK) * v.LANES
        v.store_kept(volume, place, v.add(here, state))
    state = v.fma(v.broadcast_at(links, 1), state, v.mul(gain, before))
    v.store_kept(volume, at, v.add(before, state))
