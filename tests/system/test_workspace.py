"""Memory of volumes that is used again."""

from __future__ import annotations

import gc
from importlib import import_module

import numpy as np

from chromaperture.matching.compiled.upsample import upsample
from chromaperture.matching.compiled.workspace import _MOST_KEPT, _volumes, volume
from chromaperture.matching.readable.upsample import Coarse

SHAPE = (7, 11, 13)


def test_memory_is_lent_again_when_no_array_uses_it() -> None:
    first = volume(SHAPE)
    assert first.shape == SHAPE
    assert first.dtype == np.float32
    assert first.flags.c_contiguous
    first[:] = 3
    address, part = first.ctypes.data, first[2:, ::2]
    del first
    gc.collect()
    second = volume(SHAPE)
    second[:] = 5  # part is of the first one's memory
    assert (part == 3).all()
    del part
    gc.collect()
    third = volume((6, 11, 13))  # smaller, but not by half
    assert third.ctypes.data == address
    assert not np.shares_memory(second, third)


def test_a_large_volume_is_given_back() -> None:
    large = volume((_MOST_KEPT // 4 + 1, 1, 1))  # its pages are never touched
    size = large.size
    del large
    gc.collect()
    assert all(len(raw) < size for raw in _volumes)


def test_maps_of_a_large_photograph_take_the_memory_of_volumes(monkeypatch) -> None:
    monkeypatch.setattr(import_module("chromaperture.matching.compiled.upsample"), "_LARGE_BYTES", 100)
    used = volume(SHAPE)
    del used
    gc.collect()
    assert _volumes
    few = np.zeros((2, 2), np.float32)
    upsample(Coarse(few, few, few, few > 0, few), np.zeros((4, 4, 3), np.float32), np.ones(3))
    assert not _volumes
