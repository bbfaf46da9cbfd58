"""Which layers an invocation takes together: four that follow each other, or four that are 1 px apart.

Where all layers of a phase (`correlation_stages.Chunk`) read the same samples 1 px further on, an invocation that walks
along this direction reads a sample once for all four of them. Rasterisers in software need that: what takes their
time are single reads.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

_SLIDES = {(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)}  # px along x and y from a layer to the next of its phase
_MOST_PHASES = 8  # 32 layers by four


class Fours(NamedTuple):
    """The layers of a chunk by four.

    Attributes
    ----------
    phases, per_phase : int
        ``layer_of`` in ``layers_by_four.wgsl``: every so many-th layer, and fours of these.
    places : (K, 4 Q, 4) int32
        As `correlation_stages.Chunk` has them, in the order of the fours.
    slides_x, slides_y : tuple of float
        What the layers of four are apart in each view, px; empty where that is not 1 px or nothing, in all fours.
    """

    phases: int
    per_phase: int
    places: np.ndarray
    slides_x: tuple[float, ...] = ()
    slides_y: tuple[float, ...] = ()

    @property
    def quads(self) -> int:
        """The number of fours."""
        return self.phases * self.per_phase

    @property
    def slide(self) -> bool:
        """Whether the layers of four are 1 px apart, in all views that move."""
        return bool(self.slides_x)


def consecutive(places: np.ndarray) -> Fours:
    """Take layers by four as they follow each other; the last four are filled with the last layer."""
    count = -(-places.shape[1] // 4)
    return Fours(1, count, np.pad(places, ((0, 0), (0, 4 * count - places.shape[1]), (0, 0)), mode="edge"))


def sliding(places: np.ndarray) -> Fours | None:
    """Take layers by four that are 1 px apart, or none where there are no such; the last four are continued."""
    layers = places.shape[1]
    for phases in range(1, min(_MOST_PHASES, layers - 1) + 1):
        apart = places[:, phases:] - places[:, :-phases]
        steps = apart[:, 0]
        if (
            np.any(apart != steps[:, None])
            or np.any(steps[:, 0])
            or not {(x, y) for _, x, y, _ in steps.tolist()} <= _SLIDES
        ):
            continue
        per_phase = -(-layers // (4 * phases))
        number = np.arange(4 * per_phase)[:, None]
        ordered = [places[:, phase, None] + steps[:, None] * number.T[..., None] for phase in range(phases)]
        x, y = (tuple(float(step) for step in steps[:, axis]) for axis in (1, 2))
        return Fours(phases, per_phase, np.concatenate(ordered, axis=1).astype(np.int32), x, y)
    return None
