"""What is matched: smoothed zero-mean views, a guide, a mask, the noise; the same for every execution."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Literal

import cv2
import numpy as np

from chromaperture.color.image import SATURATION
from chromaperture.color.unmixing import (
    mixes_three_views,
    own_film_unmixing,
    pure_channels,
    view_directions,
    view_reach,
)
from chromaperture.matching.integer_light import (
    PixelMaps,
    even_mean,
    halved_whole,
    in_whole_units,
    light_unit,
    pixel_maps,
    plane_variance,
    smooth_whole,
)
from chromaperture.optics.aperture import Aperture, centroids, channel_transmission
from chromaperture.settings.stages import ViewsConfig
from chromaperture.system.errors import InputError
from chromaperture.system.threads import parallel_map

_LEAST_PRESMOOTH_PX = 0.3  # below, the pixel's own area smooths the noise


@dataclass(frozen=True)
class ViewNoise:
    """Noise of the smoothed views."""

    variance: np.ndarray  # (H, W, K) float32: of the views. Even noise is a broadcast array
    covariance: np.ndarray  # (H, W, P) float32: of the P pairs of views (0,1), (0,2), (1,2), before any shift
    presmooth_sigma_px: float  # of the Gaussian that correlates the noise of neighbours

    def sampled(self, variance_px2: float) -> ViewNoise:
        """Return the noise of views that are read by a kernel of this variance, px^2."""
        before = max(self.presmooth_sigma_px, _LEAST_PRESMOOTH_PX) ** 2
        left = np.float32(before / (before + variance_px2))  # as in `noise_of_views`: by the width's square
        sigma_px = math.sqrt(self.presmooth_sigma_px**2 + variance_px2)
        return ViewNoise(_scaled(self.variance, left), _scaled(self.covariance, left), sigma_px)

    def overlap(self, layers_px: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Return the fraction of the covariance that is left when layers have moved the views apart; (D, P) float32.

        White noise behind a Gaussian of sigma p has the autocorrelation exp(-r^2 / 4 p^2).
        """
        p = max(self.presmooth_sigma_px, _LEAST_PRESMOOTH_PX)
        apart = np.array([np.linalg.norm(directions[k] - directions[m]) for k, m in view_pairs(len(directions))])
        return np.exp(-((np.abs(layers_px)[:, None] * apart) ** 2) / (4 * p**2)).astype(np.float32)


def view_pairs(view_count: int) -> list[tuple[int, int]]:
    """Return the pairs of views in the order of ``ViewNoise.covariance``."""
    return list(combinations(range(view_count), 2))


def noise_of_views(noise_variance: np.ndarray, rows: np.ndarray, *, presmooth_sigma_px: float) -> ViewNoise:
    """Return the noise of mixed and smoothed views.

    ``noise_variance`` (H, W, 3) float32: of the sensor's channels; ``rows`` (K, 3) float: weights of R, G, B in the
    views; ``presmooth_sigma_px``: of the Gaussian before matching.
    """
    rows = np.asarray(rows)
    products = np.stack([rows[k] * rows[m] for k, m in view_pairs(len(rows))])
    p = max(presmooth_sigma_px, _LEAST_PRESMOOTH_PX)
    left = np.float32(min(1.0, 1 / (4 * math.pi * p**2)))  # of the variance of white noise behind the Gaussian
    variance, covariance = (_scaled(_mixed_noise(noise_variance, w), left) for w in (rows**2, products))
    return ViewNoise(variance, covariance, presmooth_sigma_px)


def is_even(maps: np.ndarray) -> bool:
    """Return whether maps (H, W, N) hold one value a channel, by construction (`numpy.broadcast_to`)."""
    return maps.strides[0] == 0 and maps.strides[1] == 0


def _mixed_noise(variance: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Noise of weighted sums of the channels, (H, W, N) float32; even noise stays even."""
    weights = np.asarray(weights, np.float32)
    if is_even(variance):
        return np.broadcast_to((weights @ variance[0, 0]).astype(np.float32), (*variance.shape[:2], len(weights)))
    return cv2.transform(np.ascontiguousarray(variance, np.float32), weights).reshape(*variance.shape[:2], -1)


def _scaled(maps: np.ndarray, factor: np.float32) -> np.ndarray:
    if is_even(maps):
        return np.broadcast_to(maps[0, 0] * factor, maps.shape)
    return maps * factor


def no_usable_pixel() -> InputError:
    """Return the error of a picture without usable pixels."""
    return InputError(
        "no usable pixel: the whole image is saturated or not finite; lower the exposure, or check "
        "--black-level and --white-level"
    )


def constant_view() -> InputError:
    """Return the error of a picture without texture."""
    return InputError(
        "the image is constant in at least one view of the aperture: nothing to match. A lens cap, an even "
        "wall, a grey-scale file and a wrong aperture design look like this"
    )


FILL_SIGMA_PX = 6.0  # of the mean that replaces unusable pixels, px of the halved picture; chosen by hand
FILL_UNITS = 16.0  # to which that mean is rounded, so that executions seldom round it apart; below a picture's noise
USABLE = 0.99  # fraction of a halved pixel that must be usable: below, a saturated neighbour's edge is in it
GUIDE_SIGMA_PX = 1.0  # noise of the guide would break the links between pixels; chosen by hand
_PERCENTILE_SAMPLES = 20_000  # of the guide, from which its percentiles are taken; chosen by hand
CONSTANT = 1e-6  # RMS of a view, of full scale, below which it has no texture: a thousandth of a 10-bit step


@dataclass(frozen=True)
class ViewSpace:
    """How views are made of the sensor's channels, and how a layer displaces them."""

    directions: np.ndarray  # (K, 2) float64: displacement (x, y) of each view per px of disparity
    rows: np.ndarray  # (K, 3) float64: weights of R, G, B in each view
    guide_rgb: np.ndarray  # (3,) float64: weights of R, G, B in the guide
    # (rows, columns, K, 2) float64, px, or None: displacement of each view by the lens, whatever the disparity, which
    # `halved_views` takes off; see `integer_light.halved_moves`.
    moves_px: np.ndarray | None = None


def moved_px(directions: np.ndarray) -> float:
    """Return by how many px a px of disparity displaces the views, in the mean."""
    return float(np.linalg.norm(directions, axis=1).mean())


@dataclass(frozen=True)
class Views:
    """The pictures of one capture, ready to be matched."""

    # (H, W, K) float32: views through the K filters, zero mean, pre-smoothed; in memory one plane after the other.
    pictures: np.ndarray
    directions: np.ndarray  # (K, 2) float64: displacement (x, y) of each view per px of disparity
    # (H, W) float32: centre-view picture that steers filters and penalties, in units of ``guide_range``.
    guide: np.ndarray
    mask: np.ndarray  # (H, W) float32: 1 where the capture is usable, 0 where it is saturated or not finite
    noise: ViewNoise | None = None  # None where no use is made of it
    unit: float = 0.0  # the pictures are multiples of it (`integer_light.light_unit`); 0 where they are any numbers


def view_spaces(
    aperture: Aperture, unmixing: np.ndarray | None, space: Literal["unmixed", "pure", "channels", "both"]
) -> list[ViewSpace]:
    """Return the views that a method matches: one space, or for ``both`` two where they differ.

    ``unmixing`` (K, 3) float or None: rows of M^-1, Eq. (1). That of the aperture's own film when absent; ``space``
    {"unmixed", "pure", "channels", "both"}: for ``pure`` and ``both``, a design without pure channels has its unmixed
    views only, but for ``both`` and three views its channels: through CMY circles and squares twice as much is found by
    them (docs/decisions.md, *Hues in unmixed views*). ``channels``: see `channel_space`. Raises InputError:
    ``unmixing`` does not fit the aperture, or the aperture has no parallax.
    """
    rows = own_film_unmixing(aperture) if unmixing is None else np.asarray(unmixing, float)
    if rows.shape != (len(aperture.views), 3):
        raise InputError(f"unmixing must have shape ({len(aperture.views)}, 3) for {aperture.name}, got {rows.shape}")
    if space == "channels" or (space == "both" and mixes_three_views(aperture)):
        return [channel_space(aperture, rows)]
    pure = None if space == "unmixed" else pure_channels(aperture)
    # Three pure channels are the unmixed views but for the leaks: one of the two is enough.
    if pure is None or (space == "both" and len(rows) == 3):
        matched = [rows]
    else:
        matched = [pure] if space == "pure" else [rows, pure]
    return [ViewSpace(view_directions(aperture), each, guide_weights(aperture)) for each in matched]


def channel_space(aperture: Aperture, unmixing: np.ndarray) -> ViewSpace:
    """Return the views that hold for surfaces of any colour: sensor channels, not what unmixing makes of them.

    Unmixing, Eq. (1), takes all views to show a surface equally bright. On a red wall it leaves the red channel in all
    views, undisplaced, and the wall looks as if in focus. A channel only needs texture of its own. Displacements are
    those of the channels' centroids in the pupil, which lie closer together where a channel sees several filters.

    - Two filters: the two channels farthest apart; half their distance is the unit of disparity.
    - Three filters: all channels, each with the centroid that the film's colours give it, leaks included.
    """
    if len(unmixing) == 2:
        centres = centroids(aperture)
        a, b = max(combinations(range(3), 2), key=lambda pair: np.linalg.norm(centres[pair[0]] - centres[pair[1]]))
        directions = centres[[a, b]] / np.linalg.norm(centres[[a, b]], axis=1).mean()
        return ViewSpace(_rounded(directions), np.eye(3)[[a, b]], guide_weights(aperture))
    colors = np.linalg.inv(unmixing).T  # of the filters: a channel's unit cancels in its centroid
    filmed = aperture.with_film(dict(zip(aperture.views, colors, strict=True)))
    return ViewSpace(_rounded(centroids(filmed) / view_reach(aperture)), np.eye(3), guide_weights(aperture))


def _rounded(directions: np.ndarray) -> np.ndarray:
    """Round directions to 1e-3, as `view_directions` does: axis-aligned shifts stay on the axis."""
    return np.round(directions, 3) + 0.0


def guide_weights(aperture: Aperture) -> np.ndarray:
    """Return weights of R, G, B whose sum is seen through a pupil centred on the axis; (3,) float64.

    The green of complementary halves sees the whole pupil; designs without such a channel take the mean.
    """
    full = channel_transmission(aperture) > 0.95  # halves' green passes all of the pupil but for rounding
    return full / full.sum() if full.any() else np.full(3, 1 / 3)


def filtered_views(
    image: np.ndarray, space: ViewSpace, *, config: ViewsConfig, noise_variance: np.ndarray | None = None
) -> Views:
    """Mix the sensor's channels into views, Eq. (1), and smooth them.

    ``image`` (H, W, 3) float32, linear RGB, 1.0 = white level; ``noise_variance`` (H, W, 3) float32: of the sensor's
    channels. Raises InputError: no pixel is usable, or a view is constant, so there is nothing to match.
    """
    views, guide, mask = mixed(image, space)
    noise = None
    if noise_variance is not None:
        noise = noise_of_views(noise_variance, space.rows, presmooth_sigma_px=config.presmooth_sigma_px)
    return smoothed_views(views, guide, mask, directions=space.directions, config=config, noise=noise)


def halved_views(image: np.ndarray, space: ViewSpace, *, config: ViewsConfig) -> tuple[Views, np.ndarray]:
    """Mix the sensor's channels into views at half the resolution; the guide at full resolution beside them.

    ``image`` (H, W, 3) float32, linear RGB, 1.0 = white level; ``config``: ``presmooth_sigma_px`` counts px of the
    halved picture. Returns ``views`` (h, w) with h = ceil(H / 2), w alike; pixel (x, y) is (2 x, 2 y) of the image;
    ``guide`` (H, W) float32: in units of ``guide_range``, not smoothed. Raises InputError: as `filtered_views`.
    """
    views, guide, mask = mixed(image, space)
    maps = None if space.moves_px is None else pixel_maps(space.moves_px, mask.shape)
    return halved(views, guide, mask, directions=space.directions, config=config, maps=maps)


def mixed(image: np.ndarray, space: ViewSpace) -> tuple[list[np.ndarray], np.ndarray, np.ndarray]:
    """Return views and guide as they are, without unknown pixels, and where they are usable; raises InputError.

    Returns ``views`` K arrays (H, W) float32, finite; ``guide`` (H, W) float32, finite; ``mask`` (H, W) bool: neither
    saturated nor without a finite value.
    """
    image = np.ascontiguousarray(image, np.float32)
    brightest = cv2.max(cv2.max(image[..., 0], image[..., 1]), image[..., 2])
    finite = np.isfinite(_mix(image, np.ones(3)))  # a sum with a NaN or an infinity in it is not finite
    mask = finite & (brightest < SATURATION)
    if not mask.any():
        raise no_usable_pixel()
    if not finite.all():
        image = np.where(finite[..., None], image, np.float32(np.mean(image[mask])))
    return [_mix(image, row) for row in space.rows], _mix(image, space.guide_rgb), mask


def smoothed_views(
    views: Sequence[np.ndarray],
    guide: np.ndarray,
    mask: np.ndarray,
    *,
    directions: np.ndarray,
    config: ViewsConfig,
    noise: ViewNoise | None = None,
) -> Views:
    """Take the mean off the views, smooth them and the guide; see `mixed` for shapes. Raises InputError."""
    planes = np.empty((len(views), *mask.shape), np.float32)  # one plane a view: fast to smooth and to match
    for plane, view in zip(planes, views, strict=True):
        smooth(view - np.float32(cv2.mean(view)[0]), config.presmooth_sigma_px, out=plane)
    if min(plane_variance(plane) for plane in planes) <= constant_variance(0):
        raise constant_view()
    guide = smooth(guide, GUIDE_SIGMA_PX)
    guide *= _guide_scale(guide, config)
    return Views(np.moveaxis(planes, 0, -1), np.asarray(directions, float), guide, mask.astype(np.float32), noise)


def halved(
    views: Sequence[np.ndarray],
    guide: np.ndarray,
    mask: np.ndarray,
    *,
    directions: np.ndarray,
    config: ViewsConfig,
    maps: Sequence[PixelMaps] | None = None,
) -> tuple[Views, np.ndarray]:
    """Halve and smooth the views, sampled at ``maps``; see `halved_views`, and `mixed` for the shapes."""
    is_whole = bool(mask.all())
    unit = light_unit(cv2.mean(guide, None if is_whole else mask.view(np.uint8))[0])
    usable = mask[::2, ::2]
    if not is_whole:
        views, usable = _halved_around(views, mask.astype(np.float32), unit)
    planes = np.empty((len(views), *usable.shape), np.float32)
    variances = [0.0] * len(planes)
    guides: list[np.ndarray] = [guide, guide]

    def prepare(i: int) -> None:
        """Smooth a view, or bring the halved or the whole guide to its units."""
        if i < len(planes):
            small = halved_whole(views[i], unit) if is_whole else views[i]
            smooth_whole(small, config.presmooth_sigma_px, unit, out=planes[i], maps=maps[i] if maps else None)
            variances[i] = plane_variance(planes[i])
        else:
            part = smooth(cv2.pyrDown(guide), GUIDE_SIGMA_PX) if i == len(planes) else guide
            guides[i - len(planes)] = part * _guide_scale(part, config)

    parallel_map(prepare, range(len(planes) + 2))
    if min(variances) <= constant_variance(unit):
        raise constant_view()
    pictures, axes = np.moveaxis(planes, 0, -1), np.asarray(directions, float)
    return Views(pictures, axes, guides[0], usable.astype(np.float32), None, unit), guides[1]


def _halved_around(views: Sequence[np.ndarray], mask: np.ndarray, unit: float) -> tuple[list[np.ndarray], np.ndarray]:
    """Halve views, unusable pixels replaced by the mean around them: their bright edges would outweigh all texture."""
    fraction = cv2.pyrDown(mask)
    usable = fraction > USABLE
    around = cv2.GaussianBlur(fraction, (0, 0), FILL_SIGMA_PX)
    small = []
    for view in views:
        less = even_mean(view, unit, (mask > 0).astype(np.uint8))
        part = in_whole_units(cv2.pyrDown(in_whole_units(view, unit, less=less) * mask), unit)
        fill = cv2.GaussianBlur(part, (0, 0), FILL_SIGMA_PX) / (around + np.float32(1e-3))  # 1e-3: no division by 0
        small.append(np.where(usable, part, in_whole_units(fill, FILL_UNITS * unit)))
    return small, usable


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


def _guide_scale(guide: np.ndarray, config: ViewsConfig) -> np.float32:
    """Return the factor that brings a guide to units of ``guide_range``."""
    sparse = percentile_spacing(guide.size)
    return np.float32(guide_unit(guide[::sparse, ::sparse], config))


def guide_unit(guide: np.ndarray, config: ViewsConfig) -> float:
    """Return the factor that brings a guide to units of ``guide_range``, by all its pixels."""
    low, high = np.percentile(guide, (1, 99))
    return 1 / (max(float(high - low), 1e-6) * config.guide_range)  # 1e-6: an even guide


def percentile_spacing(pixels: int) -> int:
    """Return the px between the samples of a guide from which its percentiles are taken."""
    return max(1, round(math.sqrt(pixels / _PERCENTILE_SAMPLES)))


def constant_variance(unit: float) -> float:
    """Return the variance of a view at which it is constant but for rounding to whole units."""
    return max(CONSTANT, unit / 2) ** 2


def _mix(image: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Weighted sum of the channels; (H, W) float32."""
    return cv2.transform(image, np.asarray(weights, np.float32)[None, :])


_CLIPPED_REACH_PX = 3  # about clipped pixels: demosaicing and the sensor spread their light; chosen by hand


def clipped_filled(image: np.ndarray, usable: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Replace clipped areas, what is next to them, and non-finite pixels by the mean of the usable ones around.

    A clipped disc has its edge at the same place in channels whose light is displaced, and outweighs all texture.
    Single clipped pixels, as noise makes them in bright paper, miss little of their light and are left as they are.

    ``image`` (H, W, 3) float32, linear RGB; ``usable`` (H, W) float32: 1 or 0: `Views.mask`. Returns ``image`` (H, W,
    3) float32; ``usable`` (H, W) float32: 0 in the grown areas, too.
    """
    if usable.all():
        return image, usable
    areas = cv2.morphologyEx((usable == 0).astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    grown = cv2.dilate(areas, np.ones((2 * _CLIPPED_REACH_PX + 1,) * 2, np.uint8)) > 0
    replaced = grown | ~np.isfinite(image).all(axis=2)
    usable = np.where(replaced, np.float32(0), usable)
    kept = usable > 0
    if not (replaced.any() and kept.any()):
        return image, usable
    mean = image[kept].mean(axis=0)
    rest = np.where(kept[..., None], image - mean, np.float32(0))
    sigma = 2 * FILL_SIGMA_PX  # that is px of the halved picture
    around = cv2.GaussianBlur(usable, (0, 0), sigma)[..., None] + np.float32(1e-3)  # 1e-3: no division by 0
    fill = cv2.GaussianBlur(rest, (0, 0), sigma) / around
    return np.where(replaced[..., None], mean + fill, image).astype(np.float32), usable
