"""The matcher's public function: it checks, prepares, picks an implementation and adds the error bar."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from chromaperture.color.image import checked_image
from chromaperture.color.noise import estimate_noise_variance
from chromaperture.color.unmixing import ideal_unmixing, pure_channels, view_directions
from chromaperture.config import MatcherConfig
from chromaperture.disparity import optimise, phase, reference
from chromaperture.disparity.error_bar import confidence, disparity_sigma
from chromaperture.disparity.semiglobal import LayerField
from chromaperture.disparity.views import guide_weights, prepare
from chromaperture.errors import InputError
from chromaperture.optics.aperture import Aperture, design_named
from chromaperture.optics.lens_blur import LensBlur

Backend = Literal["numba", "reference"]


@dataclass(frozen=True)
class Disparity:
    """Disparity of every pixel, anchored in the view of the pupil's centre.

    Attributes
    ----------
    value_px : (H, W) float32
        Half disparity, px; 0 in focus, + beyond the focus surface, NaN unknown.
    sigma_px : (H, W) float32
        One standard deviation, px; NaN unknown.
    confidence : (H, W) float32
        In [0, 1]; 0 where unknown.
    """

    value_px: np.ndarray
    sigma_px: np.ndarray
    confidence: np.ndarray

    def full_disparity_px(self) -> np.ndarray:
        """Displacement between two opposed sub-apertures, 2 d: what a stereo pair would call disparity; (H, W)."""
        return 2 * self.value_px


def estimate_disparity(
    image: np.ndarray,
    *,
    aperture: Aperture | str,
    unmixing: np.ndarray | None = None,
    config: MatcherConfig | None = None,
    noise_variance: np.ndarray | None = None,
    fields: Sequence[LayerField] | None = None,
    blur: LensBlur | None = None,
    backend: Backend = "numba",
) -> Disparity:
    """Estimate the disparity of every pixel of one photograph.

    Parameters
    ----------
    image : (H, W, 3) array, linear RGB, 1.0 = white level
    aperture : Aperture or str
        The aperture in the pupil, or the name of a design such as ``"cy_halves"``.
    unmixing : (K, 3) float, optional
        Rows of M^-1, Eq. (1). Ideal film when absent.
    config : MatcherConfig, optional
    noise_variance : (H, W, 3) float, optional
        Noise variance of the image. Estimated from the image when absent, and then not subtracted from the scores.
    fields : sequence of LayerField, optional
        For an optimiser: what equal depth means at every pixel, for each of `colour_spaces`. Without them it looks
        for surfaces of even disparity, in the first colour space only.
    blur : LensBlur, optional
        For ``config.phase``: the camera's blur.
    backend : {"numba", "reference"}

    Returns
    -------
    Disparity

    Raises
    ------
    InputError
        Wrong shape, nothing to match, or an aperture without parallax.
    """
    config = config or MatcherConfig.preset("real-time")
    aperture = design_named(aperture) if isinstance(aperture, str) else aperture
    image = checked_image(image)
    known_noise = noise_variance
    if noise_variance is None:
        # A blind estimate takes fine texture for noise: good enough for weights, but subtracted from the scores it
        # would dig the very hole at disparity 0 that it should fill.
        config = replace(config, noise_debiasing=False)
        unused = np.broadcast_to(np.float32(0), image.shape)  # by the halved picture's matcher
        noise_variance = unused if config.coarse is not None else estimate_noise_variance(image)
    spaces = colour_spaces(aperture, unmixing, config)
    if config.phase is not None or (config.optimiser is not None and fields is None):
        spaces = spaces[:1]
    inputs = [
        prepare(
            image,
            directions=view_directions(aperture),
            unmixing=rows,
            guide_rgb=guide_weights(aperture),
            noise_variance=noise_variance,
            config=config,
        )
        for rows in spaces
    ]
    matcher: Any = reference
    if backend != "reference":
        from chromaperture.disparity import kernels  # compiling starts here, not at import

        matcher = kernels
    share = None
    if config.phase is not None:
        if blur is None or fields is None:
            raise InputError("PSF-aware matching needs the blur of a calibrated camera")
        winner = phase.match(image, inputs[0], blur, fields[0], config, noise_variance=known_noise, backend=backend)
    elif config.coarse is not None:
        winner = _coarse(backend).match(inputs[0], config, field=None if fields is None else fields[0])
    elif config.optimiser is not None:
        winner = optimise.match(
            inputs, config, config.optimiser, score_volume=matcher.score_volume, fields=fields, backend=backend
        )
    else:
        winner = matcher.match(inputs[0], config)
        if config.noise_debiasing:  # such a score tells nothing of the noise; a biased one has it in its peak already
            share = matcher.texture_weights(inputs[0], replace(config, texture_weighting=True))
    sigma = disparity_sigma(winner, config, len(spaces[0]), share)
    return Disparity(winner.disparity_px, sigma, confidence(sigma, winner.peak))


def _coarse(backend: Backend) -> Any:
    if backend == "reference":
        from chromaperture.disparity import coarse

        return coarse
    from chromaperture.disparity import coarse_kernels

    return coarse_kernels


def colour_spaces(aperture: Aperture, unmixing: np.ndarray | None, config: MatcherConfig) -> list[np.ndarray]:
    """Give the rows that make the matched views, one (K, 3) array a colour space, as ``config.views`` asks."""
    rows = ideal_unmixing(aperture) if unmixing is None else np.asarray(unmixing, float)
    if rows.shape != (len(aperture.views), 3):
        raise InputError(f"unmixing must have shape ({len(aperture.views)}, 3) for {aperture.name}, got {rows.shape}")
    pure = None if config.views == "unmixed" else pure_channels(aperture)
    if pure is None:
        return [rows]
    # Three pure channels are the unmixed views but for the leaks: one of the two says it all.
    return [rows, pure] if config.views == "both" and len(rows) == 2 else [pure]
