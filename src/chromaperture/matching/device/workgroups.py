"""How many workgroups a dispatch needs."""

from __future__ import annotations

import math
from collections.abc import Sequence

from chromaperture.system.errors import InputError

GROUP = 64  # invocations of a workgroup of the stages that have one for every pixel
MOST_GROUPS = 65_535  # workgroups along an axis of a dispatch: WebGPU's default limit
MOST_BINDINGS = 8  # arrays of a stage: WebGPU's default limit


def groups_for(invocations: int, size: int = GROUP) -> tuple[int, int]:
    """Return workgroups along x and y for so many invocations, as ``indexing.wgsl`` numbers those of 64."""
    groups = max(1, -(-invocations // size))
    across = min(groups, MOST_GROUPS)
    return across, -(-groups // across)


def dispatch_size(stage: str, array_count: int, groups: Sequence[float]) -> tuple[int, int, int]:
    """Return workgroups along x, y, z, rounded up; raises InputError where WebGPU's limits do not allow a stage."""
    x, y, z = (max(1, math.ceil(g)) for g in (*groups, 1, 1)[:3])
    if max(x, y, z) > MOST_GROUPS or array_count > MOST_BINDINGS:
        raise InputError(f"stage {stage}: {(x, y, z)} workgroups, {array_count} arrays; the picture is too large")
    return x, y, z
