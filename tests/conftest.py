from __future__ import annotations

import numpy as np
import pytest


@pytest.fixture
def rng() -> np.random.Generator:
    """The same random numbers in every run of a test, whatever ran before it.

    NumPy's floating-point warnings are errors here already, because pytest turns every warning into one.
    """
    return np.random.default_rng(20160626)
