"""Read the layers of a flat board, in cells over the frame, by the evidence that quality "accurate" uses.

A cell is read where the log-likelihood of all its pixels together is largest. The surface that `accurate` makes of the
evidence would be wrong here: it explains a flat board by one plane, which hides how its reading changes over the frame.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import cast

import numpy as np

from chromaperture.matching.evidence.blur import SPACING_PX, BlurEvidence
from chromaperture.matching.execution import ExecutionName, execution_named
from chromaperture.matching.labels import IDENTITY
from chromaperture.matching.result import ESTIMATED_NOISE, NoiseModel
from chromaperture.matching.views import clipped_filled, mixed, view_spaces
from chromaperture.optics.aperture import Aperture
from chromaperture.optics.lens_blur import LensBlur
from chromaperture.settings.methods import AccurateConfig
from chromaperture.settings.stages import CrossFilterConfig

# Chosen by hand, not tuned.
_SEARCHED = (6, 15)  # layers searched to either side of the expected one; the second where cells remained unknown
_KNOWN_CELLS = 0.9  # fraction of cells that ends the search
_LEAST_USABLE = 0.5  # fraction of a cell's pixels that are not clipped


def measured_layers(
    image: np.ndarray,
    inverse_mm: float,
    blur: LensBlur,
    *,
    aperture: Aperture,
    cell_px: int,
    unmixing: np.ndarray | None = None,
    noise_variance: np.ndarray | None = None,
    full_well_electrons: float | None = None,
    execution: ExecutionName = "numba",
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Measure the disparity of a flat board, in cells over the frame.

    Pairs of channels alone: the boards' speckle has no power law, which would mislead the likelihood of all channels.

    Parameters
    ----------
    image : (H, W, 3) float32
    inverse_mm : float, 1/mm
        1 / z of the board, around which disparities are searched.
    blur : LensBlur
    aperture : Aperture
    cell_px : int
        Side of a cell.
    unmixing : (K, 3) float, optional
        Rows of M^-1.
    noise_variance : (H, W, 3) float, optional
        Of the image, (white level)^2.
    full_well_electrons : float, optional
        Of the camera's sensor: its settings depend on it.
    execution : {"numba", "numpy"}

    Returns
    -------
    x_px, y_px : (N,) float
        Centres of the cells.
    layer_px : (N,) float64
        NaN where half of a cell is clipped, or what it shows does not tell its layer to within one.
    """
    height, width = image.shape[:2]
    config = AccurateConfig.for_blur(blur.reach, full_well_electrons=full_well_electrons)
    usable = mixed(image, view_spaces(aperture, unmixing, "unmixed")[0])[2]
    image, usable = clipped_filled(image, usable.astype(np.float32))
    noise = ESTIMATED_NOISE if noise_variance is None else NoiseModel(lambda _: noise_variance, is_known=True)
    cross_filter = cast(CrossFilterConfig, config.evidence)  # a camera whose blur is known has no other
    evidence = BlurEvidence(cross_filter, blur, IDENTITY, noise, execution_named(execution))
    at_infinity, scale = blur.reference
    expected, step = at_infinity - scale * inverse_mm, config.layers.step_px
    windows = SPACING_PX**2 / (4 * math.pi * cross_filter.window_sigma_px**2)  # that a sample of the evidence counts
    rows, columns = (np.linspace(0, n, max(1, n // cell_px) + 1).astype(int) for n in (height, width))
    y, x = np.meshgrid((rows[:-1] + rows[1:] - 1) / 2, (columns[:-1] + columns[1:] - 1) / 2, indexing="ij")
    cells = [
        np.s_[-(-y0 // SPACING_PX) : -(-y1 // SPACING_PX), -(-x0 // SPACING_PX) : -(-x1 // SPACING_PX)]
        for y0, y1 in pairwise(rows)
        for x0, x1 in pairwise(columns)
    ]
    usable = usable[::SPACING_PX, ::SPACING_PX]
    for searched in _SEARCHED:
        layers_px = expected + step * np.arange(-searched, searched + 1)
        likelihood = evidence.likelihood(image, layers_px) * usable[..., None]
        found = np.array([
            _most_likely(windows * likelihood[cell].sum(axis=(0, 1)), layers_px)
            if usable[cell].mean() >= _LEAST_USABLE else math.nan
            for cell in cells
        ])  # fmt: skip
        if np.isfinite(found).mean() >= _KNOWN_CELLS:
            break
    return x.ravel(), y.ravel(), found


def _most_likely(log_likelihood: np.ndarray, layers_px: np.ndarray) -> float:
    """Return the vertex of the parabola through the best layer and its neighbours; NaN where that is unknown."""
    best, step = int(log_likelihood.argmax()), float(layers_px[1] - layers_px[0])
    if best in (0, len(layers_px) - 1):
        return math.nan
    before, here, after = log_likelihood[best - 1 : best + 2].astype(float)
    bend = 2 * here - before - after  # 1 / variance, in layers
    return float(layers_px[best] + step * (after - before) / (2 * bend)) if bend >= 1 else math.nan
