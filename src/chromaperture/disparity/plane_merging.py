"""Join planes that one plane explains as well: minimum description length on a map of planes.

A plane of one label is one number, a sloped one three. Joining may lose as much as the numbers that it saves are worth:
two walls of one label each are not one sloped plane, which would take more.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np

from chromaperture.disparity.plane_fit import Volume, log_likelihood, refined
from chromaperture.stage_config import PlanesConfig
from chromaperture.threads import parallel_map

LEAST_CORE = 0.25  # share of a plane's pixels away from its border below which all of them count; chosen by hand
FAR_APART_LAYERS = 12  # at the smaller plane's middle: such planes are never one; chosen by hand
_STEPS = 3  # of Newton's method for every pair
_NUMBERS_OF_PLANE = 3  # slope along x and y, and the label


Pixels = tuple[np.ndarray, np.ndarray]  # y and x


@dataclass(frozen=True, eq=False)  # a key of dictionaries: equal only to itself
class Part:
    """Pixels of one plane: all of them, and those that its fit counts."""

    every: Pixels
    core: Pixels
    plane: np.ndarray
    value: float  # log-likelihood of the core, nats

    @property
    def middle(self) -> np.ndarray:
        """(x, y, 1) of the middle of the core."""
        return np.array([self.core[1].mean(), self.core[0].mean(), 1.0])


def merged_planes(
    choice: np.ndarray, planes: np.ndarray, volume: Volume, *, config: PlanesConfig, border: int
) -> tuple[np.ndarray, np.ndarray]:
    """Join neighbours, the pair that loses least first, while the loss stays below what a plane costs.

    Parameters
    ----------
    choice : (H, W) int
        Plane of every entry of the volume.
    planes : (K, 3) float
    volume : Volume
    config : PlanesConfig
    border : int
        Entries of the volume next to another plane that fits leave out.

    Returns
    -------
    planes : (M, 3) float64
    choice : (H, W) int
    """
    parts = dict(enumerate(_parts(choice, planes, volume, border)))
    simplest: dict[Part, np.ndarray] = {}

    def simplest_of(part: Part) -> np.ndarray:
        if part not in simplest:
            simplest[part] = _simplest(part, volume, config.slope_tolerance)
        return simplest[part]

    def numbers_of(part: Part) -> int:
        return _NUMBERS_OF_PLANE if simplest_of(part)[:2].any() else 1

    renumbered = np.searchsorted(np.unique(choice), choice)
    pairs = neighbouring_pairs(renumbered)
    queue: list[tuple[float, int, int, Part]] = []

    def tried(pair: tuple[int, int]) -> tuple[float, int, int, Part] | None:
        one, other = (parts[k] for k in pair)
        smaller = min(one, other, key=lambda part: len(part.core[0]))
        if abs((one.plane - other.plane) @ smaller.middle) > FAR_APART_LAYERS * volume.step_px:
            return None
        joined = _joined(one, other, volume)
        loss = one.value + other.value - joined.value
        allowed = config.plane_penalty + config.plane_tolerance * min(one.value, other.value)
        if loss >= allowed:
            return None
        saved = numbers_of(one) + numbers_of(other) - numbers_of(joined)
        allowed *= min(max(saved / _NUMBERS_OF_PLANE, 0.0), 1.0)
        return (loss - allowed, *pair, joined) if loss < allowed else None

    def consider(some: Iterable[tuple[int, int]]) -> None:
        for entry in parallel_map(tried, sorted(some)):
            if entry is not None:
                heapq.heappush(queue, entry)

    consider(pairs)
    following = len(parts)
    while queue:
        _, i, j, joined = heapq.heappop(queue)
        if i not in parts or j not in parts:
            continue
        del parts[i], parts[j]
        parts[following] = joined
        touching = {a if b in (i, j) else b for a, b in pairs if (a in (i, j)) != (b in (i, j))} & parts.keys()
        pairs = {pair for pair in pairs if i not in pair and j not in pair} | {(n, following) for n in touching}
        consider((n, following) for n in touching)
        following += 1
    out = np.empty_like(choice)
    for k, part in enumerate(parts.values()):
        out[part.every] = k
    return np.array(parallel_map(simplest_of, parts.values())), out


def _parts(choice: np.ndarray, planes: np.ndarray, volume: Volume, border: int) -> list[Part]:
    square = np.ones((2 * border + 1, 2 * border + 1), np.uint8)
    numbers = choice.astype(np.float32)
    core = cv2.dilate(numbers, square) == cv2.erode(numbers, square)

    def of_plane(k: int) -> Part:
        every, inner = _places(choice == k), _places((choice == k) & core)
        if len(inner[0]) < LEAST_CORE * len(every[0]):
            inner = every
        plane = refined(planes[k], inner[1], inner[0], volume)
        return Part(every, inner, plane, log_likelihood(plane, inner[1], inner[0], volume))

    return parallel_map(of_plane, np.unique(choice).tolist())


def _simplest(part: Part, volume: Volume, tolerance: float) -> np.ndarray:
    """Return the plane of one label if it is nearly as likely: the blur that was calibrated tilts planes by itself."""
    y, x = part.core
    even = refined(np.array([0, 0, part.plane @ part.middle]), x, y, volume, even=True)
    loss = part.value - log_likelihood(even, x, y, volume)
    return even if loss <= tolerance * part.value else part.plane


def _joined(one: Part, other: Part, volume: Volume) -> Part:
    """Return both parts under the better of the planes that either's plane leads to."""
    every, core = _both(one.every, other.every), _both(one.core, other.core)
    fits = (refined(part.plane, core[1], core[0], volume, steps=_STEPS) for part in (one, other))
    value, plane = max(((log_likelihood(fit, core[1], core[0], volume), fit) for fit in fits), key=lambda pair: pair[0])
    return Part(every, core, plane, value)


def _places(where: np.ndarray) -> Pixels:
    y, x = np.nonzero(where)
    return y, x


def _both(one: Pixels, other: Pixels) -> Pixels:
    return np.concatenate([one[0], other[0]]), np.concatenate([one[1], other[1]])


def neighbouring_pairs(choice: np.ndarray) -> set[tuple[int, int]]:
    """Return the pairs of numbers that meet at a side of an entry, the lower first."""
    pairs = set()
    for a, b in ((choice[:, 1:], choice[:, :-1]), (choice[1:], choice[:-1])):
        apart = a != b
        pairs |= set(map(tuple, np.sort(np.stack([a[apart], b[apart]], axis=1), axis=1).tolist()))
    return pairs
