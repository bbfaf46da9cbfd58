"""Where a near surface ends: the likelihood of an edge's place, for a near texture in front of a far one.

Along a line across the edge channel k of the photograph is::

    y_k(x) = A_k(x - t) n_k(x) + (1 - A_k(x - t)) f_k(x) + noise

n and f are the near and the far texture as the lens blurs them at their depths, A_k is the blurred half plane that ends
at t. For Gaussian textures of one power spectrum S the lines are Gaussian, and a place t has the log-likelihood::

    L(t) = -1/2 [ log det K(t) + y^T K(t)^-1 y ]
    K_jk(x, x') = A_j A_k' N_jk(x - x') + (1 - A_j)(1 - A_k') F_jk(x - x') + noise
    N_jk = C_jk F^-1[ S H_j H_k* ]  at the near depth, F_jk alike at the far one

with the colours' covariance C. It holds everything that tells of an edge: the near outline's blur and its displacement
in every channel, and which side's detail agrees between channels. That the blur of a product is the product of the
blurs is the one approximation. As alpha mixing, but with unknown textures integrated out, compare:

P. Favaro, S. Soatto: Seeing beyond occlusions (and other marvels of a finite lens aperture). CVPR 2003.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cache, cached_property
from typing import NamedTuple

import cv2
import numpy as np
import scipy.fft

from chromaperture.disparity.execution import Execution
from chromaperture.disparity.labels import LabelMap
from chromaperture.disparity.result import NoiseModel
from chromaperture.optics.lens_blur import LensBlur
from chromaperture.threads import parallel_map

GRID_PX = 2  # distance of a line's samples, and of two places of an edge
HALF = 9  # samples on either side of a border; with 8 and 11 as many edges are found (docs/measurements.md)
SHIFTS = 7  # places to either side
OUTER = 5  # samples at either end, whose power tells how strong the texture there is; with 7 as good
LOW_PASS_PX = 1.0  # sigma of the Gaussian before sampling
# Finer steps gain nothing: with half of the layer, 7 x 5 nodes and steps of 2 octaves lines find as many edges within
# 4 px, and steps of 4 octaves lose .0005 of the pixels within 5 % (docs/measurements.md).
LAYER_PX = 0.5
NODES = 3  # along either side of the frame
AMPLITUDE_OCTAVES = 3.0  # steps of the power of textures
SLOPE = 1.3  # of the power spectrum f^(-2 slope) of textures; 1 and 1.6 do as well
SOFTEST = 0.01  # cycles a px, at which the spectrum levels off
OWN_COLOUR = 0.03  # share of a channel's texture that no other channel has; 0.01 does as well
# Sigmas of the Gaussians whose difference tells the covariance of colours: wider than most blur. Chosen by hand.
SHADES_PX = (6.0, 20.0)
SHADES_EVERY = 4  # pixels along either axis: less than the finer one's sigma
LEAST_TEXTURE = 0.05  # of the noise, where an end of a line holds only noise
UNKNOWN_LEVEL = 0.3  # standard deviation of a surface's mean light, over the mean light of its line; chosen by hand


class Lines(NamedTuple):
    """Lines across borders, on a grid of `GRID_PX`; P of one direction.

    Attributes
    ----------
    along_rows : bool
        Else along columns.
    y, x : (P,) int
        Last grid point before the border.
    near_px, far_px : (P,) float, px
        Labels of both sides.
    near_first : (P,) bool
        Whether the near side is at the lower coordinates.
    """

    along_rows: bool
    y: np.ndarray
    x: np.ndarray
    near_px: np.ndarray
    far_px: np.ndarray
    near_first: np.ndarray


class Texture(NamedTuple):
    """A texture of unit power at one depth, along rows or columns.

    Attributes
    ----------
    covariance : (3, 3, 2 HALF, 2 HALF) float64
        Of channels and samples; it depends on the distance of two samples alone.
    before : (2 SHIFTS + 1, 3, 2 HALF) float64
        Share of a half plane's light in every sample, for every place of its end, of one at the lower coordinates.
    energy : (3,) float64
        Sum of the variances about their mean of the `OUTER` samples at an end.
    size : int
        Pixels of the transforms.
    """

    covariance: np.ndarray
    before: np.ndarray
    energy: np.ndarray
    size: int


TextureKey = tuple[int, int, bool]  # node of the blur, layer, whether along rows


class Groups(NamedTuple):
    """Lines that share their covariances, G groups.

    Attributes
    ----------
    of_line : (P,) int
    near, far : list of TextureKey
    near_first : (G,) bool
    near_power, far_power : (G,) float
        Of the textures.
    level : (G,) float
        Variance of a surface's mean light.
    noise : (G, 3) float
    """

    of_line: np.ndarray
    near: list[TextureKey]
    far: list[TextureKey]
    near_first: np.ndarray
    near_power: np.ndarray
    far_power: np.ndarray
    level: np.ndarray
    noise: np.ndarray


class Photograph:
    """What lines in both directions need of a photograph, computed when it is asked for.

    The photograph is linear RGB, the variance that of its noise; (H, W, 3) float each.
    """

    def __init__(self, image: np.ndarray, noise_variance: np.ndarray) -> None:
        self._image, self._variance = image, noise_variance

    def samples(self, lines: Lines) -> np.ndarray:
        """Sample lines; (P, 3, 2 HALF) float64."""
        along = np.arange(-HALF + 1, HALF + 1)
        if lines.along_rows:
            found = self.smooth[lines.y[:, None], lines.x[:, None] + along]
        else:
            found = self.smooth[lines.y[:, None] + along, lines.x[:, None]]
        return found.transpose(0, 2, 1).astype(float)

    def noise_at(self, lines: Lines) -> np.ndarray:
        """Return the variance of noise at lines; (P, 3)."""
        return self.noise_variance[lines.y, lines.x]

    @cached_property
    def colours(self) -> np.ndarray:
        """Covariance of the channels' texture, of unit mean variance; (3, 3)."""
        return covariance_of_colours(products_of_shades(self._known))

    @cached_property
    def _known(self) -> np.ndarray:
        return np.where(np.isfinite(self._image), self._image, np.float32(0)).astype(np.float32)

    @cached_property
    def smooth(self) -> np.ndarray:
        """Light at the grid points, of which lines are samples; (h, w, 3) float32."""
        return cv2.GaussianBlur(self._known, (0, 0), LOW_PASS_PX)[::GRID_PX, ::GRID_PX]

    @cached_property
    def noise_variance(self) -> np.ndarray:
        """Variance of noise at the grid points; (h, w, 3) float32."""
        variance = np.nan_to_num(np.asarray(self._variance, np.float32), posinf=0, neginf=0)
        return cv2.GaussianBlur(variance, (0, 0), SHADES_PX[0])[::GRID_PX, ::GRID_PX]


@dataclass(frozen=True)
class EdgeLikelihood:
    """Finds the likely places of edges in photographs of one camera.

    Attributes
    ----------
    blur : LensBlur
    label_map : LabelMap
    noise : NoiseModel
    run : Execution
    """

    blur: LensBlur
    label_map: LabelMap
    noise: NoiseModel
    run: Execution
    # Of a node, a layer and a direction, 30 kB each: kept for the next photograph.
    _textures: dict[TextureKey, Texture] = field(default_factory=dict, init=False, repr=False, compare=False)

    def photograph(self, image: np.ndarray, noise_variance: np.ndarray | None = None) -> Photograph:
        """Return an image (H, W, 3), linear RGB, as `costs` needs it; a variance that is not given is computed."""
        return Photograph(image, self.noise.given_or_computed(image, noise_variance))

    def costs(self, photograph: Photograph, lines: Lines) -> np.ndarray:
        """Compute the negative log-likelihood of the places of edges.

        Parameters
        ----------
        photograph : Photograph
        lines : Lines
            All of their `HALF` samples to either side lie within the image.

        Returns
        -------
        (P, 2 SHIFTS + 1) float64, nats, 0 for the best place of a line
            Of an edge that lies ``i - SHIFTS`` grid points beyond the border.
        """
        samples = photograph.samples(lines)
        groups = self.groups(photograph, lines, samples)
        out = np.empty((len(samples), 2 * SHIFTS + 1))
        order = np.argsort(groups.of_line, kind="stable")
        ends = np.cumsum(np.bincount(groups.of_line, minlength=len(groups.near)))

        def of_group(i: int) -> None:
            members = order[ends[i - 1] if i else 0 : ends[i]]
            near, far, share, noise = self.covariances(groups, i, photograph.colours)
            out[members] = self.run.edge_costs(samples[members].reshape(-1, 6 * HALF), near, far, share, noise)

        parallel_map(of_group, range(len(groups.near)))
        return out - out.min(axis=1, keepdims=True)

    def groups(self, photograph: Photograph, lines: Lines, samples: np.ndarray) -> Groups:
        """Find the lines that share their covariances.

        Parameters
        ----------
        photograph : Photograph
        lines : Lines
        samples : (P, 3, 2 HALF) float
            As `Photograph.samples`.
        """
        nodes, near, far = self._depths(lines)
        sides, member = _distinct(np.stack([nodes, near, far, lines.near_first], axis=1))
        count = np.bincount(member)
        mean_light = np.bincount(member, samples.mean(axis=(1, 2))) / count
        noise_at = photograph.noise_at(lines)
        noise = np.stack([np.bincount(member, noise_at[:, k]) / count for k in range(3)], axis=1)
        near_keys, far_keys = (
            [(node, layer, lines.along_rows) for node, layer in sides[:, [0, column]].tolist()] for column in (1, 2)
        )
        missing = sorted({*near_keys, *far_keys} - self._textures.keys())
        found = parallel_map(lambda key: self._texture(*key), missing)
        self._textures.update(zip(missing, found, strict=True))
        ends = np.stack([_energy(samples[..., :OUTER]), _energy(samples[..., -OUTER:])], axis=1)  # first and last
        of_noise = noise.sum(axis=1) * noise_of_end()
        octaves = []
        for keys, at_end in ((near_keys, ~lines.near_first), (far_keys, lines.near_first)):
            of_unit = np.array([np.diag(photograph.colours) @ self._textures[key].energy for key in keys])
            energy = np.take_along_axis(ends, at_end[:, None].astype(np.intp), axis=1)[:, 0]
            least = LEAST_TEXTURE * of_noise + np.finfo(np.float32).tiny
            power = np.maximum(energy - of_noise[member], least[member]) / of_unit[member]
            octaves.append(AMPLITUDE_OCTAVES * np.rint(np.log2(power) / AMPLITUDE_OCTAVES))
        kinds, of_line = _distinct(np.stack([member, *octaves], axis=1))
        side = kinds[:, 0].astype(np.intp)
        level = (UNKNOWN_LEVEL * mean_light) ** 2 / np.mean(np.diag(photograph.colours))
        return Groups(
            of_line, [near_keys[i] for i in side], [far_keys[i] for i in side], sides[side, 3].astype(bool),
            np.exp2(kinds[:, 1]), np.exp2(kinds[:, 2]), level[side], noise[side],
        )  # fmt: skip

    def covariances(
        self, groups: Groups, i: int, colours: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return what `stages.edge_costs` takes of a group besides its lines."""
        near, far = (
            (colours[:, :, None, None] * (power * self._textures[key].covariance + groups.level[i]))
            .transpose(0, 2, 1, 3)
            .reshape(6 * HALF, 6 * HALF)
            for power, key in ((groups.near_power[i], groups.near[i]), (groups.far_power[i], groups.far[i]))
        )
        before = self._textures[groups.near[i]].before.reshape(-1, 6 * HALF)
        share = before if not groups.near_first[i] else 1 - before
        return near, far, share, np.kron(np.diag(groups.noise[i]), noise_covariance())

    def _depths(self, lines: Lines) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the nearest node of the blur, and the nearest layers of both sides, of every line."""
        shape = self.blur.height_px, self.blur.width_px
        y, x = lines.y * GRID_PX, lines.x * GRID_PX
        offset, scale = (np.broadcast_to(part, shape)[y, x] for part in self.label_map)
        near, far = (np.rint((offset + scale * side) / LAYER_PX) for side in (lines.near_px, lines.far_px))
        return self.nodes(y, x), near.astype(int), far.astype(int)

    def nodes(self, y: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return the nearest nodes of the blur of pixels; int."""
        shape = self.blur.height_px, self.blur.width_px
        row, column = (np.rint(p / max(1, n - 1) * (NODES - 1)) for p, n in zip((y, x), shape, strict=True))
        return np.asarray(row * NODES + column).astype(int)

    def _texture(self, node: int, layer: int, along_rows: bool) -> Texture:
        """Blur the texture of unit power by the lens, as lines see it."""
        return _seen_by_lines(self._transfer(node, layer), along_rows)

    def textures_at(self, node: int, layer: int) -> tuple[Texture, Texture]:
        """Return the textures at a node of the blur and a layer, along rows and along columns."""
        transfer = self._transfer(node, layer)
        return _seen_by_lines(transfer, True), _seen_by_lines(transfer, False)

    def _transfer(self, node: int, layer: int) -> np.ndarray:
        """Return the transfer functions of the lens and of the filter before sampling; (3, S, S // 2 + 1)."""
        y, x = (part / (NODES - 1) for part in divmod(node, NODES))
        rays = self.blur.rays(x * (self.blur.width_px - 1), y * (self.blur.height_px - 1))
        at_infinity, scale = self.blur.reference
        diameter = 2 * abs(layer * LAYER_PX) / self.blur.reach
        size = int(scipy.fft.next_fast_len(math.ceil(diameter) + 4 * HALF * GRID_PX, real=True))
        size += size % 2
        transfer = self.blur.transfer_of(rays, (at_infinity - layer * LAYER_PX) / scale, size)
        return np.asarray(transfer * np.exp(-2 * np.pi**2 * LOW_PASS_PX**2 * _squared_frequencies(size)))


def _squared_frequencies(size: int) -> np.ndarray:
    fy, fx = scipy.fft.fftfreq(size)[:, None], scipy.fft.rfftfreq(size)[None]
    return np.asarray(fx**2 + fy**2)


def _seen_by_lines(transfer: np.ndarray, along_rows: bool) -> Texture:
    size = transfer.shape[1]
    power = (_squared_frequencies(size) + SOFTEST**2) ** -SLOPE
    lag = GRID_PX * (np.arange(2 * HALF)[:, None] - np.arange(2 * HALF))
    covariance = np.empty((3, 3, 2 * HALF, 2 * HALF))
    for j in range(3):
        for k in range(3):
            along = _line_of(power * transfer[j] * transfer[k].conj(), along_rows)
            covariance[j, k] = along[lag % size]
    spread = np.stack([_projection_of(part, along_rows) for part in transfer])
    sums = np.cumsum(np.roll(spread, size // 2, axis=1), axis=1)
    energy = np.array([np.trace(_centred() @ covariance[k, k, :OUTER, :OUTER] @ _centred()) for k in range(3)])
    return Texture(covariance, _before(sums), energy, size)


def _before(sums: np.ndarray) -> np.ndarray:
    """Read sums of a line spread (3, S) at every sample for every place of the edge; (2 SHIFTS + 1, 3, 2 HALF)."""
    size = sums.shape[1]
    place = GRID_PX * (np.arange(2 * HALF) - HALF + 0.5)
    edge = GRID_PX * np.arange(-SHIFTS, SHIFTS + 1)
    at = place - edge[:, None] + size / 2 - 0.5
    return np.stack([np.interp(at, np.arange(size), of_channel) for of_channel in sums], axis=1)


def _distinct(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the different rows, in order, and which of them each row is."""
    found, member = np.unique(rows, axis=0, return_inverse=True)
    return found, member.ravel()


def _energy(ends: np.ndarray) -> np.ndarray:
    """Sum of squares about the mean of every channel; (P,)."""
    return np.asarray(np.square(ends - ends.mean(axis=2, keepdims=True)).sum(axis=(1, 2)))


@cache
def _centred() -> np.ndarray:
    """Return the matrix that takes the mean of an end away; (OUTER, OUTER)."""
    return np.eye(OUTER) - 1 / OUTER


def noise_of_end() -> float:
    """Return the energy of an end of a line, of white noise of unit variance."""
    return float(np.trace(_centred() @ noise_covariance()[:OUTER, :OUTER] @ _centred()))


def products_of_shades(image: np.ndarray) -> np.ndarray:
    """Sum the products of the channels' shades, at every `SHADES_EVERY`-th pixel; (3, 3)."""
    fine, coarse = (cv2.GaussianBlur(image, (0, 0), sigma) for sigma in SHADES_PX)
    shades = (fine - coarse)[::SHADES_EVERY, ::SHADES_EVERY].reshape(-1, 3).astype(float)
    return np.asarray(shades.T @ shades)


def covariance_of_colours(covariance: np.ndarray) -> np.ndarray:
    """Return the covariance of the channels' texture, of unit mean variance, by the products of shades; (3, 3)."""
    covariance = covariance.copy()
    # 1e-3: an empty channel; tiny: an even picture.
    covariance += max(1e-3 * np.trace(covariance), np.finfo(np.float32).tiny) * np.eye(3)
    covariance /= np.trace(covariance) / 3
    own = np.diag(np.diag(covariance))
    return np.asarray((1 - OWN_COLOUR) * covariance + OWN_COLOUR * own)


@cache
def noise_covariance() -> np.ndarray:
    """Return the covariance of a line's samples of white noise of unit variance; (2 HALF, 2 HALF)."""
    lag2 = (GRID_PX * (np.arange(2 * HALF)[:, None] - np.arange(2 * HALF))) ** 2
    return np.asarray(np.exp(-lag2 / (4 * LOW_PASS_PX**2)) / (4 * np.pi * LOW_PASS_PX**2))


def _line_of(spectrum: np.ndarray, along_rows: bool) -> np.ndarray:
    """Transform a half plane of frequencies back, along the row or column through the middle; (S,)."""
    size = len(spectrum)
    if along_rows:
        return np.asarray(scipy.fft.irfft(spectrum.sum(axis=0), size) / size)
    mirrored = np.roll(spectrum[::-1], 1, axis=0)[:, 1 : size // 2].conj()
    return np.asarray(scipy.fft.ifft(spectrum.sum(axis=1) + mirrored.sum(axis=1)).real / size)


def _projection_of(transfer: np.ndarray, along_rows: bool) -> np.ndarray:
    """Return a point-spread function, summed across rows or columns; (S,)."""
    size = len(transfer)
    return np.asarray(scipy.fft.irfft(transfer[0], size) if along_rows else scipy.fft.ifft(transfer[:, 0]).real)
