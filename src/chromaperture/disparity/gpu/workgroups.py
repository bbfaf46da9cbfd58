"""How many workgroups a dispatch needs."""

from __future__ import annotations

from chromaperture.disparity.gpu.device import MOST_GROUPS

GROUP = 64  # invocations of a workgroup of the stages that have one for every pixel


def groups_for(invocations: int, size: int = GROUP) -> tuple[int, int]:
    """Return workgroups along x and y for so many invocations, as ``indexing.wgsl`` numbers those of 64."""
    groups = max(1, -(-invocations // size))
    across = min(groups, MOST_GROUPS)
    return across, -(-groups // across)
