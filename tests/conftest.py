from __future__ import annotations

import numpy as np
import pytest


@pytest.fixture
def rng() -> np.random.Generator:
    """The same random numbers in every run of a test, whatever ran before it."""
    return np.random.default_rng(20160626)


@pytest.fixture(autouse=True)
def _numpy_errors_raise():
    """A division by zero or an overflow nobody asked for is an error in the package's own arithmetic.

    Underflow to zero is harmless: it is what an exponential window does far from its centre.
    """
    with np.errstate(divide="raise", over="raise", invalid="raise"):
        yield
