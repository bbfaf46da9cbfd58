"""Neighbouring planes that one plane explains as well are joined on a device: the stages of `plane_merging.py`.

A part is a plane's core blocks, or those of several planes that were joined. All pairs of neighbours are tried side by
side at first. A round joins the best pair, and tries the pairs that this makes side by side. How many joins follow is
known only when they are made: there are so many rounds, and those behind the last join do nothing.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from chromaperture.disparity.gpu.device import Array, Chain
from chromaperture.disparity.gpu.plane_stages import BlockChoice
from chromaperture.disparity.gpu.workgroups import groups_for
from chromaperture.disparity.plane_fit import NEWTON_STEPS
from chromaperture.disparity.plane_merging import FAR_APART_LAYERS, LEAST_CORE, PAIR_STEPS
from chromaperture.disparity.stages.plane_refining import CONDITION, GAINED, LEAST_BEND, MOST_POINTS, REACH
from chromaperture.planes_config import PlanesConfig


class _Side(NamedTuple):
    """How many work side by side: invocations of a fit, pairs behind a choice of blocks, pairs behind a join."""

    lanes: int
    pairs: int
    neighbours: int


_SIDE = _Side(128, 256, 32)  # a fit has 8 of the 16 KB that a workgroup shares; of `still_life` some hundred pairs meet
# In software workgroups that have nothing to do take time, too. But llvmpipe leaves a shader's loops after 65535 rounds
# of all of them together: of large pictures, whose parts have more blocks, fewer fall on an invocation.
_SIDE_IN_SOFTWARE, _MOST_BLOCKS = _Side(16, 128, 8), 30_000
_LARGE_IN_SOFTWARE = _Side(64, 256, 32)
_PART, _JOIN = 12, 12  # numbers of a `Part` and a `Join` in the shaders


def add_joining(chain: Chain, chooser: BlockChoice, unfinished: Array, *, rounds: int, config: PlanesConfig) -> Array:
    """Append `plane_merging.merged_planes`: the planes that blocks choose from, and their number, become those left.

    Parameters
    ----------
    chain : Chain
        With a choice of ``chooser``.
    chooser : BlockChoice
    unfinished : Array
        One number, which grows where there were fewer rounds than joins.
    rounds : int
    config : PlanesConfig

    Returns
    -------
    Array
        (capacity, 4) uint32; of each plane before, where blocks chose it, last the plane that took it.
    """
    (height, width), most = chooser.shape, chooser.capacity
    blocks, groups, uses = height * width, groups_for(height * width), ("indexing",)

    def room(name: str, size: int, dtype: type = np.float32) -> Array:
        return chain.arrays.get(name) or chain.array(name, size, dtype)  # that of an earlier round

    of_blocks: dict[str, Any] = dict(height=height, width=width)
    cores, points = (room(name, blocks, np.uint32) for name in ("part_cores", "part_points"))
    counts, segments = (room(f"part_{n}", k * most, np.uint32) for n, k in (("counts", 2), ("segments", 4)))
    parts = room("parts", _PART * most)
    meeting = room("parts_meeting", most * most, np.uint32)
    # Pairs that meet at first, half of all that there are, and those that joined parts have: as many at most.
    joins = room("part_joins", _JOIN * (1 + most * most))
    chain.add(
        "joining_start", [chooser.count, counts, joins, meeting], groups=groups_for(max(2 * most, most * most)),
        uses=uses, capacity=most,
    )  # fmt: skip
    side = _SIDE
    if chain.device.info.is_software:
        side = _SIDE_IN_SOFTWARE if blocks <= _MOST_BLOCKS else _LARGE_IN_SOFTWARE
    border = -(-config.border_px // config.block_px)
    chain.add("part_counts", [chooser.choice, cores, counts], groups=groups, uses=uses, **of_blocks, border=border)
    chain.add("part_starts", [counts, chooser.count, segments], groups=(1,), capacity=most, least_core=LEAST_CORE)
    chain.add("part_points", [chooser.choice, cores, counts, segments, points], groups=(most,), **of_blocks)
    fit: dict[str, Any] = dict(
        width=width, count=len(chooser.labels_px), reach=REACH, newton_steps=NEWTON_STEPS, condition=CONDITION,
        least_bend=LEAST_BEND, gained=GAINED, most_points=MOST_POINTS, slope_penalty=float(chooser.costs.slope),
        outside=float(chooser.costs.outside), slope_tolerance=float(config.slope_tolerance),
        lanes=side.lanes,
    )  # fmt: skip
    of_pairs: dict[str, Any] = dict(
        pair_steps=PAIR_STEPS, far_apart=float(FAR_APART_LAYERS), plane_penalty=float(config.plane_penalty),
        plane_tolerance=float(config.plane_tolerance),
    )  # fmt: skip
    kept, fits = ("joining_parts",), ("plane_newton", "joining_parts", "part_of_points")
    chain.add(
        "part_planes", [chooser.blocks, points, segments, chooser.planes, parts], groups=(most,), uses=fits, **fit
    )
    chain.add("planes_meeting", [chooser.choice, chooser.count, meeting], groups=groups, uses=uses, **of_blocks)
    chain.add("pairs_listed", [meeting, chooser.count, joins], groups=groups_for(most * most), uses=uses)

    def try_pairs(side_by_side: int) -> None:
        chain.add(
            "pair_joins", [chooser.blocks, points, segments, parts, joins], groups=(side_by_side,),
            uses=(*fits, "pair_fit"), **fit, **of_pairs, side_by_side=side_by_side,
        )  # fmt: skip

    try_pairs(side.pairs)
    for _ in range(min(rounds, most - 1)):
        chain.add(
            "best_join", [chooser.count, segments, parts, meeting, joins], groups=(1,), uses=(*kept, "open_joins")
        )
        try_pairs(side.neighbours)
    chain.add(
        "planes_left", [segments, parts, joins, chooser.planes, chooser.count, unfinished], groups=(1,),
        uses=(*kept, "open_joins"), slope_penalty=float(chooser.costs.slope),
    )  # fmt: skip
    return segments
