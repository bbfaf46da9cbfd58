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
from chromaperture.disparity.plane_fit import Planes, Volume, blocks_of_pixels
from chromaperture.disparity.winner import Surface
from chromaperture.threads import each_band, parallel_map

POOLED_PX = 8.0  # sigma of the window in which the posterior's variance is averaged; else it follows paths
REACHES_PX = (8, 32)  # of the range of the surface about a pixel
SMOOTHED_PX = 3.0  # of the bar's logarithm: planes, blocks and ranges within squares have corners; chosen by hand
APART = 1.0  # steps: a surface that lies farther from a plane contradicts it; chosen by hand
# Steps, added to the mean distance of fits: below, they agree. With .3 the loss is .004 more, with 2 .002 less.
LEAST_DISTANCE = 1.0
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

    ``posterior``: error bar of the posterior. Without planes also ``range_N``: range of the surface within N px. With
    planes also ``posterior_of_frame``: its mean, for photographs differ in what their evidence is worth; ``rejected``:
    the share of a pixel's plane that the surface before contradicts; ``fits``: the mean distance at which several fits
    of planes put the pixel; and those of `signs_of_evidence`.
    """
    label = np.asarray(surface.disparity_px, np.float32) / np.float32(step_px)
    posterior = pooled_sigma(surface.sigma_px, POOLED_PX) / np.float32(step_px)
    found = {"posterior": np.log(posterior + np.float32(0.02))}  # steps: below, nothing is told apart
    if explained_by is None:
        return {**found, **{f"range_{reach}": np.log(part + np.float32(0.1)) for reach, part in ranges(label).items()}}
    if explained_by.blocks is None:
        raise ValueError("the signs of the evidence need the blocks that chose the planes")
    height, width = explained_by.blocks.likelihood.shape[:2]
    size = label.shape[0] // height
    middles = np.s_[size // 2 : height * size : size, size // 2 : width * size : size]  # windows of 8 px need no more
    found["posterior_of_frame"] = np.full(label.shape, found["posterior"][middles].mean(), np.float32)
    fits = None if explained_by.fits_px is None else explained_by.fits_px / np.float32(step_px)
    each = (
        partial(of_blocks, label, explained_by.blocks, explained_by.choice),
        partial(of_planes, first_px, explained_by, step_px),
        partial(of_fits, label, fits),
    )
    return found | {name: sign for part in parallel_map(lambda work: work(), each) for name, sign in part.items()}


def of_blocks(label: np.ndarray, blocks: Volume, choice: np.ndarray) -> dict[str, np.ndarray]:
    """Return the signs that the evidence gives, see `signs`; ``label`` in steps."""
    above_first = label - np.float32(blocks.labels_px[0] / blocks.step_px)
    return signs_of_evidence(blocks, above_first, choice)


def of_planes(first_px: np.ndarray, planes: Planes, step_px: float) -> dict[str, np.ndarray]:
    """Return the sign that planes give, see `signs`."""
    apart = (np.abs(first_px - planes.label_px) > APART * step_px).astype(np.float32)
    choice = planes.choice.ravel()
    share = np.bincount(choice, apart.ravel()) / np.maximum(np.bincount(choice), 1)
    return {"rejected": share.astype(np.float32)[planes.choice]}


def of_fits(label: np.ndarray, fits: np.ndarray | None) -> dict[str, np.ndarray]:
    """Return how far fits (F, h, w) of blocks lie from an answer (H, W), see `signs`; steps. 0 without."""
    if fits is None:
        return {"fits": np.full(label.shape, np.log(LEAST_DISTANCE), np.float32)}
    size = label.shape[0] // fits.shape[1]
    rows, columns = blocks_of_pixels(label.shape, fits.shape[1:], size)
    away = np.zeros(label.shape, np.float32)

    def add(band: slice) -> None:
        for fit in fits:
            away[band] += np.abs(fit[rows[band]][:, columns] - label[band])

    each_band(add, len(label))
    return {"fits": np.log(away / np.float32(len(fits)) + np.float32(LEAST_DISTANCE))}


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
