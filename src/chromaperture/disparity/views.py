"""What the matcher sees: smoothed zero-mean views, a guide, noise maps; the same for every implementation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import cv2
import numpy as np

from chromaperture.color.image import SATURATION
from chromaperture.config import MatcherConfig
from chromaperture.errors import InputError
from chromaperture.optics.aperture import Aperture, channel_transmission

_FILL_SIGMA_PX = 6.0  # of the mean that stands for unusable pixels, px of the halved picture


@dataclass(frozen=True)
class MatchInputs:
    """Arrays of one capture, ready to be matched.

    Attributes
    ----------
    views : (H, W, K) float32
        Views through the K filters, zero mean, pre-smoothed; in memory one plane after the other.
    directions : (K, 2) float64
        Displacement (x, y) of each view per px of disparity.
    layers_px : (D,) float64, px
        Disparities that are tried, equally spaced.
    guide : (H, W) float32
        Centre-view picture for the bilateral filter, in units of ``bilateral_range``.
    mask : (H, W) float32
        1 where the capture is usable, 0 where it is saturated or not finite.
    noise_variance : (H, W, K) float32
        Noise variance of the smoothed views; all zero when unknown. Even noise is a broadcast array.
    noise_covariance : (H, W, P) float32
        Noise covariance of the P pairs of views (0,1), (0,2), (1,2), before any shift.
    noise_overlap : (D, P) float32
        Share of that covariance left when a layer's shift has moved the two views apart.
    fine_guide : (H', W') float32 or None
        The guide before everything else was halved (``config.coarse``): H = ceil(H' / 2), W alike, and all lengths
        count px of the halved picture.
    """

    views: np.ndarray
    directions: np.ndarray
    layers_px: np.ndarray
    guide: np.ndarray
    mask: np.ndarray
    noise_variance: np.ndarray
    noise_covariance: np.ndarray
    noise_overlap: np.ndarray
    fine_guide: np.ndarray | None = None


def view_pairs(view_count: int) -> list[tuple[int, int]]:
    """Give the pairs of views in the order of ``noise_covariance``."""
    return list(combinations(range(view_count), 2))


def guide_weights(aperture: Aperture) -> np.ndarray:
    """Weights of R, G, B whose sum is seen through a pupil centred on the axis; (3,) float64.

    The green of complementary halves sees the whole pupil; designs without such a channel take the mean.
    """
    full = channel_transmission(aperture) > 0.95
    return full / full.sum() if full.any() else np.full(3, 1 / 3)


def smooth(image: np.ndarray, sigma_px: float, *, out: np.ndarray | None = None) -> np.ndarray:
    """Gaussian with replicated borders, of one plane (H, W) float32; sigma 0 copies the plane."""
    if out is None:
        out = np.empty_like(image)
    if sigma_px == 0:
        out[:] = image
    else:
        size = 2 * math.ceil(4 * sigma_px) + 1
        cv2.GaussianBlur(image, (size, size), sigma_px, dst=out, borderType=cv2.BORDER_REPLICATE)
    return out


def prepare(
    image: np.ndarray,
    *,
    directions: np.ndarray,
    unmixing: np.ndarray,
    guide_rgb: np.ndarray,
    noise_variance: np.ndarray,
    config: MatcherConfig,
) -> MatchInputs:
    """Change the colour space, smooth, and collect what the matcher needs.

    Parameters
    ----------
    image : (H, W, 3) float32, linear RGB, 1.0 = white level
    directions : (K, 2) float
    unmixing : (K, 3) float
    guide_rgb : (3,) float
    noise_variance : (H, W, 3) float32
        Noise variance of the sensor channels.
    config : MatcherConfig

    Returns
    -------
    MatchInputs

    Raises
    ------
    InputError
        A view is constant, so there is nothing to match.
    """
    image = np.ascontiguousarray(image, np.float32)
    brightest = cv2.max(cv2.max(image[..., 0], image[..., 1]), image[..., 2])
    finite = np.isfinite(_mix(image, np.ones(3)))  # a sum with a NaN or an infinity in it is not finite
    mask = finite & (brightest < SATURATION)
    if not mask.any():
        raise InputError(
            "no usable pixel: the whole image is saturated or not finite; lower the exposure, or check "
            "--black-level and --white-level"
        )
    if not finite.all():
        image = np.where(finite[..., None], image, np.float32(np.mean(image[mask])))
    return prepare_views(
        [_mix(image, row) for row in unmixing],
        _mix(image, guide_rgb),
        mask,
        directions=directions,
        noise_variance=_mix_noise(noise_variance, np.asarray(unmixing) ** 2),
        noise_covariance=_mix_noise(
            noise_variance, np.stack([unmixing[k] * unmixing[m] for k, m in view_pairs(len(unmixing))])
        ),
        config=config,
    )


def prepare_views(
    views: Sequence[np.ndarray],
    guide: np.ndarray,
    mask: np.ndarray,
    *,
    directions: np.ndarray,
    noise_variance: np.ndarray,
    noise_covariance: np.ndarray,
    config: MatcherConfig,
) -> MatchInputs:
    """Smooth the views and the guide and collect what the matcher needs.

    Parameters
    ----------
    views : K arrays (H, W) float32, finite
    guide : (H, W) float32, finite
    mask : (H, W) bool
    directions : (K, 2) float
    noise_variance : (H, W, K) float32
        Of the views, before smoothing.
    noise_covariance : (H, W, P) float32
        Of the pairs of views, before smoothing.
    config : MatcherConfig

    Returns
    -------
    MatchInputs

    Raises
    ------
    InputError
        A view is constant, so there is nothing to match.
    """
    if config.coarse is not None:
        return _halved(views, guide, mask, directions=directions, config=config)
    planes = np.empty((len(views), *mask.shape), np.float32)  # one plane a view: fast to smooth and to match
    for plane, view in zip(planes, views, strict=True):
        smooth(view - np.float32(cv2.mean(view)[0]), config.presmooth_sigma_px, out=plane)
    if min(cv2.norm(plane) for plane in planes) < 1e-6 * math.sqrt(mask.size):  # they have no mean
        raise InputError(
            "the image is constant in at least one view of the aperture: nothing to match. A lens cap, an even "
            "wall, a grey-scale file and a wrong aperture design look like this"
        )
    white_noise_left, overlap = _noise_autocorrelation(config, directions, view_pairs(len(views)))
    guide = smooth(guide, 1.0)
    guide *= _guide_scale(guide, config)
    return MatchInputs(
        views=np.moveaxis(planes, 0, -1),
        directions=np.asarray(directions, float),
        layers_px=config.layers_px,
        guide=guide,
        mask=mask.astype(np.float32),
        noise_variance=_scaled(noise_variance, white_noise_left),
        noise_covariance=_scaled(noise_covariance, white_noise_left),
        noise_overlap=overlap.astype(np.float32),
    )


def _halved(
    views: Sequence[np.ndarray], guide: np.ndarray, mask: np.ndarray, *, directions: np.ndarray, config: MatcherConfig
) -> MatchInputs:
    """Do as `prepare_views` with everything at half the resolution; pixel (x, y) there is (2 x, 2 y) here.

    Scores are not debiased and not weighted then: the noise is left out.
    """
    if mask.all():
        small, usable = [cv2.pyrDown(view) for view in views], mask[::2, ::2]
    else:
        small, usable = _halved_around(views, mask.astype(np.float32))
    even = np.zeros((1, 1, len(views) + len(view_pairs(len(views)))), np.float32)
    even = np.broadcast_to(even, (*usable.shape, even.shape[2]))
    coarse = replace(
        config,
        coarse=None,
        min_disparity_px=config.min_disparity_px / 2,
        max_disparity_px=config.max_disparity_px / 2,
        step_px=config.step_px / 2,
    )
    inputs = prepare_views(
        small,
        cv2.pyrDown(guide),
        usable,
        directions=directions,
        noise_variance=even[..., : len(views)],
        noise_covariance=even[..., len(views) :],
        config=coarse,
    )
    return replace(inputs, layers_px=config.layers_px / 2, fine_guide=guide * _guide_scale(guide, config))


def _halved_around(views: Sequence[np.ndarray], mask: np.ndarray) -> tuple[list[np.ndarray], np.ndarray]:
    """Halve views, unusable pixels replaced by the mean around them: their bright edges would outvote all texture."""
    share = cv2.pyrDown(mask)
    usable = share > 0.99
    around = cv2.GaussianBlur(share, (0, 0), _FILL_SIGMA_PX)
    small = []
    for view in views:
        mean = cv2.mean(view, (mask > 0).astype(np.uint8))[0]
        part = cv2.pyrDown((view - np.float32(mean)) * mask)
        fill = cv2.GaussianBlur(part, (0, 0), _FILL_SIGMA_PX) / (around + np.float32(1e-3))
        small.append(np.where(usable, part, fill) + np.float32(mean))
    return small, usable


def _guide_scale(guide: np.ndarray, config: MatcherConfig) -> np.float32:
    """Bring a guide to units of the bilateral range."""
    sparse = max(1, round(math.sqrt(guide.size / 20_000)))  # the percentiles of a subset are as good
    low, high = np.percentile(guide[::sparse, ::sparse], (1, 99))
    return np.float32(1 / (max(float(high - low), 1e-6) * config.bilateral_range))


def _mix(image: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Weighted sum of the channels; (H, W) float32."""
    return cv2.transform(image, np.asarray(weights, np.float32)[None, :])


def is_even(maps: np.ndarray) -> bool:
    """Tell whether maps (H, W, N) hold one value a channel, by construction (`numpy.broadcast_to`)."""
    return maps.strides[0] == 0 and maps.strides[1] == 0


def _mix_noise(variance: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Noise of weighted sums of the channels, (H, W, N) float32; even noise stays even."""
    weights = np.asarray(weights, np.float32)
    if is_even(variance):
        return np.broadcast_to((weights @ variance[0, 0]).astype(np.float32), (*variance.shape[:2], len(weights)))
    return cv2.transform(np.ascontiguousarray(variance, np.float32), weights).reshape(*variance.shape[:2], -1)


def _scaled(maps: np.ndarray, factor: np.float32) -> np.ndarray:
    if is_even(maps):
        return np.broadcast_to(maps[0, 0] * factor, maps.shape)
    return maps * factor


def _noise_autocorrelation(
    config: MatcherConfig, directions: np.ndarray, pairs: list[tuple[int, int]]
) -> tuple[np.float32, np.ndarray]:
    """Give the variance white noise keeps after the pre-smoothing, and its decay with the views' separation.

    White noise behind a Gaussian of sigma p has the autocorrelation exp(-r^2 / 4 p^2) and the variance 1 / (4 pi p^2).
    """
    p = max(config.presmooth_sigma_px, 0.3)  # below, the pixel itself is the smoother
    left = min(1.0, 1 / (4 * math.pi * p**2))
    apart = np.array([np.linalg.norm(directions[k] - directions[m]) for k, m in pairs])
    return np.float32(left), np.exp(-((np.abs(config.layers_px)[:, None] * apart) ** 2) / (4 * p**2))
