"""Join planes that one plane explains as well: minimum description length on a map of planes.

A plane of one label is one number, a sloped one three. Joining may lose as much as the numbers that it saves are worth:
two walls of one label each are not one sloped plane, which would take more.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from chromaperture.disparity.plane_fit import Pixels, Volume, best_planes
from chromaperture.planes_config import PlanesConfig
from chromaperture.threads import parallel_map

LEAST_CORE = 0.25  # share of a plane's pixels away from its border below which all of them count; chosen by hand
FAR_APART_LAYERS = 12  # at the smaller plane's middle: such planes are never one; chosen by hand
PAIR_STEPS = 3  # of Newton's method for every pair
_NUMBERS_OF_PLANE = 3  # slope along x and y, and the label


@dataclass(frozen=True, eq=False)  # a key of dictionaries: equal only to itself
class Part:
    """Pixels of one plane: all of them, and those that its fit counts."""

    every: Pixels
    core: Pixels
    plane: np.ndarray
    value: float  # log-likelihood of the core, nats

    @cached_property
    def middle(self) -> np.ndarray:
        """(x, y, 1) of the middle of the core."""
        return np.array([self.core[1].mean(), self.core[0].mean(), 1.0])


def merged_planes(
    choice: np.ndarray, planes: np.ndarray, volume: Volume, *, config: PlanesConfig, border: int, of_missed: float = 0.0
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
    of_missed : float
        Share of what the level plane misses that a slope has to gain, besides ``config.slope_tolerance``.

    Returns
    -------
    planes : (M, 3) float64
    choice : (H, W) int
    """
    parts = dict(enumerate(_parts(choice, planes, volume, border)))
    simplest = _Simplest(volume, config.slope_tolerance, of_missed)
    renumbered = np.searchsorted(np.unique(choice), choice)
    pairs = neighbouring_pairs(renumbered)
    queue: list[tuple[float, int, int, Part]] = []

    def consider(some: Iterable[tuple[int, int]]) -> None:
        near = [(i, j) for i, j in sorted(some) if not _far_apart(parts[i], parts[j], volume)]
        likely = []
        for pair, joined in zip(near, _joined([(parts[i], parts[j]) for i, j in near], volume), strict=True):
            one, other = (parts[k].value for k in pair)
            loss = one + other - joined.value
            allowed = config.plane_penalty + config.plane_tolerance * min(one, other)
            if loss < allowed:
                likely.append((loss, allowed, pair, joined))
        simplest.find(part for *_, (i, j), joined in likely for part in (parts[i], parts[j], joined))
        for loss, allowed, (i, j), joined in likely:
            saved = simplest.numbers_of(parts[i]) + simplest.numbers_of(parts[j]) - simplest.numbers_of(joined)
            allowed *= min(max(saved / _NUMBERS_OF_PLANE, 0.0), 1.0)
            if loss < allowed:
                heapq.heappush(queue, (loss - allowed, i, j, joined))

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
    simplest.find(parts.values())
    return np.array([simplest.planes[part] for part in parts.values()]), out


def _parts(choice: np.ndarray, planes: np.ndarray, volume: Volume, border: int) -> list[Part]:
    core, used = away_from_borders(choice, border), np.unique(choice)

    def pixels(k: int) -> tuple[Pixels, Pixels]:
        every = choice == k
        return _places(every), _places(counted(every, core))

    both = parallel_map(pixels, used.tolist())
    found, values = best_planes(planes[used][:, None], [inner for _, inner in both], volume)
    return [Part(*pair, plane, float(value)) for pair, plane, value in zip(both, found, values, strict=True)]


def away_from_borders(choice: np.ndarray, border: int) -> np.ndarray:
    """Find the entries with no other plane within so many rows and columns; (H, W) bool."""
    square = np.ones((2 * border + 1, 2 * border + 1), np.uint8)
    numbers = choice.astype(np.float32)
    return np.asarray(cv2.dilate(numbers, square) == cv2.erode(numbers, square))


def counted(every: np.ndarray, core: np.ndarray) -> np.ndarray:
    """Return the entries of a plane that its fit counts: those in the core, or all if few are; (H, W) bool each."""
    inner = every & core
    return inner if np.count_nonzero(inner) >= LEAST_CORE * np.count_nonzero(every) else every


class _Simplest:
    """Planes of one label where a slope gains little: the blur that was calibrated tilts planes by itself.

    A slope has to gain a share of all evidence of its plane. Where the level plane misses much of the best that blocks
    offer, slopes gain more by chance: then they have to gain a share of that, as in an F-test.
    """

    def __init__(self, volume: Volume, tolerance: float, of_missed: float) -> None:
        self.planes: dict[Part, np.ndarray] = {}
        self._volume, self._tolerance, self._of_missed = volume, tolerance, of_missed
        self._most = volume.likelihood.max(axis=2) if of_missed else None

    def find(self, parts: Iterable[Part]) -> None:
        """Find the planes of parts that are not known yet."""
        new = [part for part in dict.fromkeys(parts) if part not in self.planes]
        level = np.array([[[0, 0, part.plane @ part.middle]] for part in new])
        even, values = best_planes(level, [part.core for part in new], self._volume, even=True)
        for part, plane, value in zip(new, even, values, strict=True):
            self.planes[part] = plane if part.value - value <= self._least_gain(part, value) else part.plane

    def _least_gain(self, part: Part, of_level: float) -> float:
        """Nats that a part's slope has to gain over its level plane, which has ``of_level``."""
        of_all = self._tolerance * part.value
        if self._most is None:
            return of_all
        return max(of_all, self._of_missed * (float(self._most[part.core].sum(dtype=float)) - of_level))

    def numbers_of(self, part: Part) -> int:
        """How many numbers a part's plane takes."""
        return _NUMBERS_OF_PLANE if self.planes[part][:2].any() else 1


def _far_apart(one: Part, other: Part, volume: Volume) -> bool:
    smaller = min(one, other, key=lambda part: len(part.core[0]))
    return bool(abs((one.plane - other.plane) @ smaller.middle) > FAR_APART_LAYERS * volume.step_px)


def _joined(pairs: list[tuple[Part, Part]], volume: Volume) -> list[Part]:
    """Return both parts of every pair under the better of the planes that either's plane leads to."""
    cores = [_both(one.core, other.core) for one, other in pairs]
    starts = np.array([[one.plane, other.plane] for one, other in pairs])
    planes, values = best_planes(starts, cores, volume, steps=PAIR_STEPS)
    return [
        Part(_both(one.every, other.every), core, plane, float(value))
        for (one, other), core, plane, value in zip(pairs, cores, planes, values, strict=True)
    ]


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
