"""The matcher's door: it checks an image and composes the method that a configuration describes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from chromaperture.color.image import checked_image
from chromaperture.matching.accurate import AccurateMethod, Evidence
from chromaperture.matching.evidence.blur import BlurEvidence
from chromaperture.matching.evidence.correlation import CorrelationEvidence
from chromaperture.matching.evidence.spectral import SpectralEvidence
from chromaperture.matching.execution import execution_named
from chromaperture.matching.labels import IDENTITY, LabelMap
from chromaperture.matching.paper import PaperMethod
from chromaperture.matching.real_time import RealTimeMethod
from chromaperture.matching.result import ESTIMATED_NOISE, Disparity, Method, NoiseModel
from chromaperture.matching.views import view_spaces
from chromaperture.optics.aperture import Aperture, design_named
from chromaperture.optics.lens_blur import LensBlur
from chromaperture.settings.methods import AccurateConfig, ExecutionName, MatcherConfig, PaperConfig, RealTimeConfig
from chromaperture.settings.stages import CorrelationEvidenceConfig, CrossFilterConfig
from chromaperture.system.errors import InputError


def estimate_disparity(
    image: np.ndarray,
    *,
    aperture: Aperture | str,
    unmixing: np.ndarray | None = None,
    config: MatcherConfig | None = None,
    noise_variance: np.ndarray | None = None,
    label_maps: Sequence[LabelMap] = (),
    blur: LensBlur | None = None,
    channel_moves_px: np.ndarray | None = None,
    execution: ExecutionName = "numba",
) -> Disparity:
    """Estimate the disparity of every pixel of one photograph.

    Parameters
    ----------
    image : (H, W, 3) array, linear RGB, 1.0 = white level
    aperture, unmixing, config, label_maps, blur, channel_moves_px, execution
        As `method_for`.
    noise_variance : (H, W, 3) float, optional
        Noise variance of the image. Estimated from the image when absent, and then not subtracted from the scores.

    Returns
    -------
    Disparity

    Raises
    ------
    InputError
        Wrong shape, nothing to match, or an aperture without parallax.
    """
    image = checked_image(image)
    method = method_for(
        config or RealTimeConfig(),
        aperture=aperture,
        unmixing=unmixing,
        label_maps=label_maps,
        blur=blur,
        channel_moves_px=channel_moves_px,
        noise=ESTIMATED_NOISE if noise_variance is None else NoiseModel(lambda _: noise_variance, is_known=True),
        execution=execution,
    )
    return method.match(image)


def method_for(
    config: MatcherConfig,
    *,
    aperture: Aperture | str,
    unmixing: np.ndarray | None = None,
    label_maps: Sequence[LabelMap] = (),
    blur: LensBlur | None = None,
    channel_moves_px: np.ndarray | None = None,
    noise: NoiseModel = ESTIMATED_NOISE,
    execution: ExecutionName = "numba",
) -> Method:
    """Compose the method of a configuration for one camera.

    Parameters
    ----------
    config : MatcherConfig
    aperture : Aperture or str
        The aperture in the pupil, or the name of a design such as ``"cy_halves"``.
    unmixing : (K, 3) float, optional
        Rows of M^-1, Eq. (1). That of the aperture's own film when absent.
    label_maps : sequence of LabelMap
        What equal depth means at every pixel, one map for each view space that is matched. Without them a method looks
        for surfaces of even disparity, or of even distance if it knows the blur, and ``accurate`` matches its first
        view space only.
    blur : LensBlur, optional
        The camera's blur, which ``accurate`` with a `CrossFilterConfig` needs; `blur_from_kernels` makes one of
        measured point-spread functions.
    channel_moves_px : (rows, columns, 3, 2) float, optional
        Displacement of R, G, B by the lens, which ``real-time`` takes off where it matches all three; see
        `integer_light.halved_moves`.
    noise : NoiseModel
        Of the camera's images.
    execution : {"numba", "numpy"}

    Raises
    ------
    InputError
        An aperture without parallax, or a blur that is missing.
    """
    aperture = design_named(aperture) if isinstance(aperture, str) else aperture
    run = execution_named(execution)
    match config:
        case PaperConfig():
            return PaperMethod(config, view_spaces(aperture, unmixing, config.space)[0], noise, run)
        case RealTimeConfig():
            label_map = label_maps[0] if label_maps else IDENTITY
            space = view_spaces(aperture, unmixing, config.space)[0]
            if channel_moves_px is not None and np.array_equal(space.rows, np.eye(3)):
                space = replace(space, moves_px=np.asarray(channel_moves_px, float))
            return RealTimeMethod(config.for_views(space.directions), space, label_map, run)
        case AccurateConfig(evidence=CrossFilterConfig() as cross_filter):
            if blur is None:
                raise InputError("matching with the blur needs one: of a calibrated camera, or of measured kernels")
            label_map = label_maps[0] if label_maps else IDENTITY
            evidence: Evidence = SpectralEvidence(
                config.spectral, BlurEvidence(cross_filter, blur, label_map, noise, run)
            )
            space = view_spaces(aperture, unmixing, "unmixed")[0]
            return AccurateMethod(config, space, evidence, label_map, run)
        case AccurateConfig(evidence=CorrelationEvidenceConfig() as correlation):
            maps = tuple(label_maps) or (IDENTITY,)
            spaces = tuple(view_spaces(aperture, unmixing, correlation.space))[: len(maps)]
            evidence = CorrelationEvidence(correlation, config.views, spaces, maps[: len(spaces)], noise, run)
            return AccurateMethod(config, spaces[0], evidence, maps[0], run)
    raise InputError(f"unknown configuration {type(config).__name__}")
