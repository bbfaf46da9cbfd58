"""The error bar of quality "accurate" by what its errors were like on captures of known depth.

The posterior of a pixel does not know that a whole plane is wrong, or that the surface before the planes said something
else. Such signs are numbers that a photograph tells without its truth; here they are logarithms, and the logarithm of
the error bar is a weighted sum of them. ``benchmarks/error_bar_training.py`` makes scenes, finds the weights and writes
``learned_error_bar.json``. Everything counts in steps between labels: 0.15 px of blur, whatever the design.

References
----------
R. Koenker, G. Bassett: Regression quantiles. Econometrica 46, 1978. doi:10.2307/1913643
"""

from __future__ import annotations

import json
from functools import cache, partial
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from chromaperture.disparity.error_bar import pooled_sigma
from chromaperture.disparity.evidence_signs import signs_of_evidence
from chromaperture.disparity.plane_fit import Planes, Volume
from chromaperture.disparity.winner import Surface
from chromaperture.threads import each_band, parallel_map

POOLED_PX = 8.0  # sigma of the windows in which signs are averaged; else they follow paths and blocks
WIDE_PX = 24.0  # the same, wider; chosen by hand
REACHES_PX = (8, 32)  # of the range of the surface about a pixel
SMOOTHED_PX = 3.0  # of the bar's logarithm: ranges within squares have corners; chosen by hand
APART = 1.0  # steps: a surface that lies farther from a plane contradicts it; chosen by hand
MOST_APART = 6.0  # steps: beyond, the surface was another one, whose distance says nothing; chosen by hand
_FILE = Path(__file__).parent / "learned_error_bar.json"


class Weights(NamedTuple):
    """A weighted sum of signs.

    Attributes
    ----------
    names : tuple of str
        Of the signs, see `signs`.
    weights : (N,) float
    constant : float
    least, most : (N,) float
        Signs beyond are taken as these: what was never seen is not guessed at.
    """

    names: tuple[str, ...]
    weights: np.ndarray
    constant: float
    least: np.ndarray
    most: np.ndarray


def learned_sigma(surface: Surface, step_px: float, *, first_px: np.ndarray, explained_by: Planes | None) -> np.ndarray:
    """Return the standard deviation of a surface by the signs of its errors; (H, W) float32, px.

    Parameters
    ----------
    surface : Surface
        Without NaN; labels, and the error bar of its posterior.
    step_px : float
        Between two labels.
    first_px : (H, W) float, px
        The surface before planes explained it.
    explained_by : Planes or None
        With the evidence of blocks.

    Raises
    ------
    ValueError
        The planes come without the evidence of blocks.
    """
    model = weights()["planes" if explained_by is not None else "surface"]
    found = signs(surface, step_px, first_px=first_px, explained_by=explained_by)
    logarithm = np.full(first_px.shape, model.constant, np.float32)

    def add(rows: slice) -> None:
        for name, weight, least, most in zip(model.names, model.weights, model.least, model.most, strict=True):
            logarithm[rows] += np.float32(weight) * np.clip(found[name][rows], np.float32(least), np.float32(most))

    each_band(add, len(logarithm))
    return np.asarray(step_px * np.exp(pooled(logarithm, SMOOTHED_PX)), np.float32)


def signs(
    surface: Surface, step_px: float, *, first_px: np.ndarray, explained_by: Planes | None
) -> dict[str, np.ndarray]:
    """Return the signs of an error, as `learned_sigma`; (H, W) float32 each, logarithms and shares.

    ``posterior``: error bar of the posterior. ``range_N``: range of the surface within N px. With planes besides, of a
    pixel's plane ``scatter``: root mean square difference of the surface before it, ``rejected``: the share of it that
    the surface contradicts; ``apart`` and ``apart_wide``: share of the pixels around where it does; and those of
    `signs_of_evidence`, ``spread_of_frame`` the mean of one: photographs differ in what their evidence is worth.
    """
    label = np.asarray(surface.disparity_px, np.float32) / np.float32(step_px)

    def of_posterior() -> dict[str, np.ndarray]:
        posterior = pooled_sigma(surface.sigma_px, POOLED_PX) / np.float32(step_px)
        return {"posterior": np.log(posterior + np.float32(0.02))}  # steps: below, nothing is told apart

    def of_ranges() -> dict[str, np.ndarray]:
        return {f"range_{reach}": np.log(part + np.float32(0.1)) for reach, part in ranges(label).items()}

    each = [of_ranges, of_posterior]
    if explained_by is not None:
        if explained_by.blocks is None:
            raise ValueError("the signs of the evidence need the blocks that chose the planes")
        first = np.asarray(first_px, np.float32) / np.float32(step_px)
        each += [
            partial(of_blocks, surface, explained_by.blocks, explained_by.choice),
            partial(of_planes, first, explained_by, step_px),
        ]
    return {name: sign for part in parallel_map(lambda work: work(), each) for name, sign in part.items()}


def of_blocks(surface: Surface, blocks: Volume, choice: np.ndarray) -> dict[str, np.ndarray]:
    """Return the signs that the evidence gives, see `signs`."""
    label = (np.asarray(surface.disparity_px, np.float32) - np.float32(blocks.labels_px[0])) / np.float32(
        blocks.step_px
    )
    found = signs_of_evidence(blocks, label, choice)
    return {**found, "spread_of_frame": np.full(label.shape, found["spread"].mean(), np.float32)}


def of_planes(first: np.ndarray, planes: Planes, step_px: float) -> dict[str, np.ndarray]:
    """Return the signs that planes give, see `signs`; ``first`` is the surface before them, steps."""
    there = planes.label_px / np.float32(step_px)
    apart = (np.abs(first - there) > APART).astype(np.float32)
    away = np.clip(first - there, -MOST_APART, MOST_APART)
    choice = planes.choice.ravel()
    area = np.maximum(np.bincount(choice), 1)
    scatter, rejected = (np.bincount(choice, values.ravel()) / area for values in (away * away, apart))
    of_plane: dict[str, np.ndarray] = {"scatter": np.log(np.sqrt(scatter) + 0.05), "rejected": rejected}
    return {
        "apart": pooled(apart),
        "apart_wide": pooled(apart, WIDE_PX),
        **{name: values.astype(np.float32)[planes.choice] for name, values in of_plane.items()},
    }


def pooled(values: np.ndarray, reach_px: float = POOLED_PX) -> np.ndarray:
    """Return the mean in a Gaussian window; (H, W) float32."""
    values = np.ascontiguousarray(values, np.float32)
    return np.asarray(cv2.GaussianBlur(values, (0, 0), reach_px, borderType=cv2.BORDER_REFLECT_101))


def ranges(label: np.ndarray) -> dict[int, np.ndarray]:
    """Return the range of a map within each of `REACHES_PX`; (H, W) float32 each. A square of squares is a square."""
    low: np.ndarray = np.ascontiguousarray(label, np.float32)
    high = low
    found: dict[int, np.ndarray] = {}
    before = 0
    for reach in REACHES_PX:
        square = np.ones((2 * (reach - before) + 1,) * 2, np.uint8)
        low, high, before = cv2.erode(low, square), cv2.dilate(high, square), reach
        found[reach] = np.subtract(high, low)
    return found


@cache
def weights() -> dict[str, Weights]:
    """Read the weights: "planes" where planes explain the surface, "surface" where none do."""
    stored = json.loads(_FILE.read_text(encoding="utf-8"))
    return {name: _weights_of(stored[name]) for name in ("planes", "surface")}


def _weights_of(part: dict) -> Weights:
    names = tuple(part["signs"])
    columns = np.array([part["signs"][name] for name in names], float).T
    return Weights(names, columns[0], float(part["constant"]), columns[1], columns[2])
