"""Blur that was measured: point-spread functions of every channel, on a grid over the frame, at one distance.

A measured kernel is a picture of the pupil. A ray through the pupil point xi (in stop radii) that met the sensor D_m xi
beside the chief ray, D_m being the displacement of the pupil's edge at the distance z_m of the measurement, meets it
D(z) xi beside it at the distance z::

    D(z) = D_m (1/f - 1/z) / (1/f - 1/z_m),   px

f is the distance in focus; the derivation is in ``docs/equations.md``, *Measured kernels*. So the kernel of z is the
measured one, D(z) / D_m times as large, and turned by half a turn on the other side of the focus. Aberrations, and what
a pixel itself blurs, are taken to grow and shrink with it, and the focus surface to be flat. All else that shapes a
kernel is held: films, rims, and how the halves of a dual pixel see the pupil, which in a telephone turns over the frame
(`dual_pixel_rays.py` has ramps of one direction).

References
----------
S. Xin, N. Wadhwa, T. Xue et al.: Defocus map estimation and deblurring from a single dual-pixel image. ICCV 2021, for
kernels that scale with defocus.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy.ndimage

from chromaperture.optics.lens_blur import BlurModel, LensBlur, PupilSamples
from chromaperture.system.errors import InputError

_FAINTEST = 1e-3  # of the brightest sample anywhere: fainter ones are noise of the measurement; chosen by hand
_NO_RIM = 1e6  # pupil radii: kernels hold the rims


@dataclass(frozen=True)
class KernelBlur(LensBlur):
    """Blur of one camera by measured kernels; `blur_from_kernels` makes it."""

    # (rows, columns, 3, N) float64: of the pupil's points, in the middles of equal cells of the frame.
    light: np.ndarray
    edge_px: float  # float, px: D_m: displacement of the pupil's edge where the kernels were measured

    def light_at(self, position: np.ndarray) -> np.ndarray:
        """Interpolate the light of the pupil's points bilinearly, at a frame position in half widths; (3, N)."""
        half = self.width_px / 2
        x_px, y_px = position * half + [self.width_px / 2, self.height_px / 2]  # from the frame's left and top sides
        rows, columns = self.light.shape[:2]
        (above, below), down = _between(y_px / self.height_px, rows)
        (left, right), across = _between(x_px / self.width_px, columns)
        upper, lower = (
            (1 - across) * self.light[row, left] + across * self.light[row, right] for row in (above, below)
        )
        return np.asarray((1 - down) * upper + down * lower)


def _between(share: float, count: int) -> tuple[tuple[int, int], float]:
    """Return the cells around a place, a share of the frame's side, and the place between their middles."""
    place = float(np.clip(share * count - 0.5, 0, count - 1))
    first = min(int(place), max(count - 2, 0))
    return (first, min(first + 1, count - 1)), place - first


def blur_from_kernels(
    kernels: np.ndarray, *, width_px: int, height_px: int, focus_mm: float, measured_mm: float, spacing_px: float = 1.0
) -> KernelBlur:
    """Make the blur of a camera from measured kernels.

    Parameters
    ----------
    kernels : (rows, columns, 3, K, K) float
        Of red, green and blue in the middles of rows x columns equal cells of the frame, from the top left: pictures
        of a point, from the top left. Their common centroid is moved to the middle, negative samples count as 0.
    width_px, height_px : int
        Of the photographs.
    focus_mm, measured_mm : float, mm
        Distances in focus and of the measurement from the entrance pupil; one of them may be infinite. Where they are
        not known, any two on the right sides do, such as 1 and 1.5 for kernels from beyond the focus: blur and
        half disparity are right, distances mean nothing.
    spacing_px : float
        Distance of two samples of a kernel, in px of the photographs.

    Raises
    ------
    InputError
        Kernels of another shape, without light, or not finite; distances that are equal or not positive.
    """
    kernels = np.asarray(kernels, float)
    if kernels.ndim != 5 or kernels.shape[2] != 3 or kernels.shape[3] != kernels.shape[4] or 0 in kernels.shape:
        raise InputError(f"kernels must have the shape (rows, columns, 3, K, K), not {kernels.shape}")
    if not np.isfinite(kernels).all():
        raise InputError("kernels must be finite")
    kernels = np.maximum(kernels, 0)
    if (kernels.sum(axis=(3, 4)) <= 0).any():
        raise InputError("every channel's kernel must hold light everywhere in the frame")
    apart = _inverse(focus_mm) - _inverse(measured_mm)
    if apart == 0 or min(width_px, height_px) < 1 or not (0 < spacing_px < math.inf):
        raise InputError("focus_mm and measured_mm must differ, sizes and spacing_px must be positive")
    kernels = np.array([[_centered(place) for place in row] for row in kernels])
    brightest = kernels.max(axis=(0, 1, 2))
    lit = brightest > _FAINTEST * brightest.max()
    axis = (np.arange(kernels.shape[-1]) - (kernels.shape[-1] - 1) / 2) * spacing_px
    places = np.stack(np.meshgrid(axis, axis), axis=-1)[lit]
    light = kernels[..., lit]
    light /= light.sum(axis=-1, keepdims=True)
    whole = light.mean(axis=(0, 1, 2))
    # A disc's root mean square radius is its edge's over the root of 2.
    edge_px = math.copysign(math.sqrt(2 * float(whole @ (places**2).sum(axis=1))), apart)
    scale = edge_px / apart
    model = BlurModel(
        infinity_px=scale * _inverse(focus_mm), scale_px_mm=scale, front_rim_radius=_NO_RIM, rear_rim_radius=_NO_RIM
    )
    return KernelBlur(
        model, PupilSamples(places / edge_px, light.mean(axis=(0, 1))), width_px, height_px, light, edge_px
    )


def _inverse(distance_mm: float) -> float:
    if not distance_mm > 0:
        raise InputError("focus_mm and measured_mm must be positive")
    return 1 / distance_mm


def _centered(kernels: np.ndarray) -> np.ndarray:
    """Move the centroid of all channels together to the middle; (3, K, K)."""
    axis = np.arange(kernels.shape[-1]) - (kernels.shape[-1] - 1) / 2
    whole = (kernels / kernels.sum(axis=(1, 2), keepdims=True)).mean(axis=0)
    off = (whole.sum(axis=1) @ axis, whole.sum(axis=0) @ axis)
    return np.stack([scipy.ndimage.shift(kernel, (-off[0], -off[1]), order=1) for kernel in kernels])
