"""The polynomial by which compiled kernels and shaders take logarithms: both must round alike."""

from __future__ import annotations

import numpy as np

# Chebyshev interpolation of ln(1.5 + t), |t| <= 1/2, highest power first; good to 4e-8.
LOGARITHM: tuple[float, ...] = tuple(
    np.polynomial.chebyshev.Chebyshev.interpolate(lambda t: np.log(1.5 + t), 8, domain=[-0.5, 0.5])
    .convert(kind=np.polynomial.Polynomial)
    .coef[::-1]
    .tolist()
)
