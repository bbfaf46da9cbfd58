"""The camera as one linear map from the sharp picture to the capture, and its adjoint.

    y_k = sum_l (m_l x_k) * h_kl / sum_l m_l * h_kl

m_l are the layers' shares of the pixels. The denominator is 1 within a surface; at depth edges, where light is added
or hidden that the picture does not hold, it keeps the energy and tells how far the model can be trusted.
"""

from __future__ import annotations

import numpy as np
import scipy.fft

from chromaperture.effects.blur_layers import layer_radii, shares
from chromaperture.effects.transfer_functions import Blur

_SHARP_PX = 0.25
_TRUST = 0.12  # departure from full coverage at which the model's word counts 1/e


class LayeredModel:
    """Blur by depth, all over one picture.

    Parameters
    ----------
    radius_px : (H, W) float32
        Signed blur radius of every pixel; no NaN.
    blur : Blur
    center : (x, y), optional
        Of the picture in the frame.
    """

    def __init__(self, radius_px: np.ndarray, blur: Blur, *, center: tuple[float, float] | None = None) -> None:
        self.shape = (int(radius_px.shape[0]), int(radius_px.shape[1]))
        self._layers: list[tuple[tuple[slice, slice], np.ndarray, np.ndarray]] = []
        radii = layer_radii(radius_px)
        for radius, share in zip(radii, shares(radius_px, radii), strict=True):
            if not share.any():
                continue
            rows, columns = np.flatnonzero(share.any(axis=1)), np.flatnonzero(share.any(axis=0))
            box = (slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1))
            otf = blur(float(radius) if abs(radius) > _SHARP_PX else 0.0, self.shape, center=center)
            self._layers.append((box, np.ascontiguousarray(share[box]), otf))
        self.cover = np.ones((3, *self.shape), np.float32)
        # Light of a coloured half passes where the other does not: coverage differs from channel to channel.
        self.cover = np.maximum(self._blurred(np.ones((3, *self.shape), np.float32)), np.float32(0.05))

    @property
    def trust(self) -> np.ndarray:
        """(3, H, W) float32 in [0, 1]: low at depth edges, where the model lacks what is hidden."""
        return np.exp(-(((self.cover - 1) / np.float32(_TRUST)) ** 2))

    def forward(self, sharp: np.ndarray) -> np.ndarray:
        """Blur a sharp picture; (3, H, W) float32."""
        return self._blurred(sharp) / self.cover

    def adjoint(self, capture: np.ndarray) -> np.ndarray:
        """Transpose of `forward`; (3, H, W) float32."""
        out = np.zeros((3, *self.shape), np.float32)
        with scipy.fft.set_workers(-1):
            spectra = scipy.fft.rfft2(capture / self.cover)
            for box, share, otf in self._layers:
                back = scipy.fft.irfft2(np.conj(otf) * spectra, s=self.shape)
                out[:, *box] += share * back[:, *box]
        return out

    def _blurred(self, sharp: np.ndarray) -> np.ndarray:
        total = np.zeros((3, self.shape[0], self.shape[1] // 2 + 1), np.complex64)
        held = np.zeros((3, *self.shape), np.float32)
        with scipy.fft.set_workers(-1):
            for box, share, otf in self._layers:
                held[:] = 0
                held[:, *box] = share * sharp[:, *box]
                total += otf * scipy.fft.rfft2(held)
            return np.asarray(scipy.fft.irfft2(total, s=self.shape))
