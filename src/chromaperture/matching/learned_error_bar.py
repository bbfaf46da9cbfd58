"""The error bar of quality "accurate" by what its errors were like on captures of known depth.

The posterior of a pixel does not know that a whole wall is wrong, or that planes and paths said something else. Such
signs are numbers that a photograph tells without its truth; here they are logarithms, and the logarithm of the error
bar is a weighted sum of them. ``benchmarks/error_bar_training.py`` finds the weights on the choosing part of
``benchmarks/world_scenes.py`` and writes ``learned_error_bar.json``. Everything counts in labels: 0.15 px of blur,
whatever the design.

References
----------
R. Koenker, G. Bassett: Regression quantiles. Econometrica 46, 1978. doi:10.2307/1913643
"""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Literal, NamedTuple

import cv2
import numpy as np

from chromaperture.matching.blocks import BLOCK_PX
from chromaperture.matching.planes.block_surface import BlockSurface, read_along

Source = Literal["blur", "views"]
POOLED_BLOCKS = 2.0  # sigma of the window in which signs are averaged
REACHES_BLOCKS = 2, 8  # of the range of the surface about a block
SMOOTHED_BLOCKS = 0.75  # sigma, of the bar's logarithm
LEAST_LABELS = 0.1  # every sign needs a finite logarithm
SHIFTS = np.array([-24, -16, -12, -8, -6, -4, -3, -2, -1, 0, 1, 2, 3, 4, 6, 8, 12, 16, 24], float)  # labels
SPREAD_BLOCKS = 3.0  # sigma of the window whose evidence is read along the surface
# Pixels of a window that say one thing: detail and windows of correlation are that wide. Chosen by hand: it only scales
# a sign, whose weight is learned.
PIXELS_ALIKE = 10.0
LEAST_EVIDENCE = 1e-3  # nats a pixel
_FILE = Path(__file__).parent / "learned_error_bar.json"


class Weights(NamedTuple):
    """A weighted sum of signs."""

    names: tuple[str, ...]  # of the signs, see `signs`
    weights: np.ndarray  # (N,) float
    constant: float
    # ``least``, ``most``: (N,) float: signs beyond are taken as these: what was never seen is not guessed at.
    least: np.ndarray
    most: np.ndarray


def learned_bar(found: dict[str, np.ndarray], source: Source) -> np.ndarray:
    """Return the standard deviation of a surface of blocks by the signs of its errors; (h, w) float32, labels."""
    model = weights()[source]
    logarithm = np.full(next(iter(found.values())).shape, model.constant, np.float32)
    for name, weight, least, most in zip(model.names, model.weights, model.least, model.most, strict=True):
        logarithm += np.float32(weight) * np.clip(found[name], np.float32(least), np.float32(most))
    return np.asarray(np.exp(pooled(logarithm, SMOOTHED_BLOCKS)), np.float32)


def signs(surface: BlockSurface, first: np.ndarray, sigma: np.ndarray) -> dict[str, np.ndarray]:
    """Return the signs of an error of every block; (h, w) float32 each, logarithms but for ``edges``.

    ``posterior``: error bar of the paths' posterior about the surface; ``frame``: its mean, for photographs differ in
    what their evidence is worth; ``spread``: standard deviation of a shift of the surface by the evidence of a window;
    ``evidence``: nats a pixel along the surface; ``paths`` and ``planes``: how far the paths' surface and the planes
    lie from it; ``edges``: how likely depth edges are nearby; ``range_N``: range of the surface within N blocks.

    ``first``, ``sigma`` (h, w) float, labels: the paths' surface, and the standard deviation of their posterior about
    the final one.
    """
    label = np.asarray(surface.label, np.float32)
    posterior = np.log(np.sqrt(pooled(np.square(sigma))) + np.float32(LEAST_LABELS))
    away = {"paths": first, "planes": surface.regions.label}
    found = {
        "posterior": posterior,
        "frame": np.full_like(posterior, posterior.mean()),
        **_signs_of_evidence(surface.nats, label),
        **{name: np.log(pooled(np.abs(part - label)) + np.float32(LEAST_LABELS)) for name, part in away.items()},
        "edges": pooled(1 / (1 + np.exp(-surface.log_odds.max(axis=0)))),
    }
    for reach in REACHES_BLOCKS:
        square = np.ones((2 * reach + 1,) * 2, np.uint8)
        extent = cv2.dilate(label, square) - cv2.erode(label, square)
        found[f"range_{reach}"] = np.log(extent + np.float32(LEAST_LABELS))
    return {name: np.asarray(part, np.float32) for name, part in found.items()}


def _signs_of_evidence(nats: np.ndarray, label: np.ndarray) -> dict[str, np.ndarray]:
    """Return what the evidence says of a surface by what it would say if the surface lay elsewhere."""
    profile = np.stack([read_along(nats, label + shift) for shift in SHIFTS], axis=2) / np.float32(BLOCK_PX**2)
    around = cv2.GaussianBlur(profile, (0, 0), SPREAD_BLOCKS, borderType=cv2.BORDER_REFLECT_101)
    pixels = 2 * np.pi * (SPREAD_BLOCKS * BLOCK_PX) ** 2 / PIXELS_ALIKE
    likely = np.exp((around - around.max(axis=2, keepdims=True)) * np.float32(pixels))
    likely *= np.gradient(SHIFTS).astype(np.float32)  # every shift stands for the shifts about it
    variance = likely @ np.square(SHIFTS).astype(np.float32) / likely.sum(axis=2)
    here = np.maximum(around[..., len(SHIFTS) // 2], 0)
    return {"spread": np.log(np.sqrt(variance) + LEAST_LABELS), "evidence": np.log(here + LEAST_EVIDENCE)}


def pooled(values: np.ndarray, sigma: float = POOLED_BLOCKS) -> np.ndarray:
    """Return the mean in a Gaussian window; (h, w) float32."""
    values = np.ascontiguousarray(values, np.float32)
    return np.asarray(cv2.GaussianBlur(values, (0, 0), sigma, borderType=cv2.BORDER_REFLECT_101))


@cache
def weights() -> dict[str, Weights]:
    """Return the stored weights, of cameras whose blur is known and of shifted views."""
    stored = json.loads(_FILE.read_text())
    return {
        kind: Weights(
            tuple(model["weights"]),
            np.array(list(model["weights"].values())),
            model["constant"],
            *(np.array([model[end][name] for name in model["weights"]]) for end in ("least", "most")),
        )
        for kind, model in stored.items()
    }
