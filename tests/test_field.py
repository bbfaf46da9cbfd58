"""Fields of the depth curve over the frame: evaluated, fitted, robust."""

import numpy as np
import pytest

from chromaperture.depth.conversion import DepthModel
from chromaperture.depth.field import DepthField, degree_of, fit_depth_field, polynomials
from chromaperture.errors import InputError

WIDTH, HEIGHT = 61, 41
DELTA = 50.0


def curved_lens(x, y):
    """A and B as a lens gives them: bent in the square of the radius, with a tilt and a little of fourth order."""
    u, v = (x - 30) / 30, (y - 20) / 20
    r2 = u**2 + v**2
    return 4.4 - 0.3 * r2 + 0.05 * u + 0.02 * u**2 * v**2, 8600.0 - 900 * r2 + 100 * v


def measured_boards(rng, noise_px):
    y, x = (axis.ravel().astype(float) for axis in np.mgrid[0:HEIGHT:2, 0:WIDTH:2])
    infinity, scale = curved_lens(x, y)
    inverse = 1 / (np.arange(1000, 4001, 500) - DELTA)
    disparity = infinity - inverse[:, None] * scale + rng.normal(0, noise_px, (len(inverse), x.size))
    grid = [np.broadcast_to(a, disparity.shape).ravel() for a in (x, y, inverse[:, None])]
    return *grid, disparity.ravel()


def fit(x, y, inverse, disparity, degree=4):
    return fit_depth_field(
        x, y, inverse, disparity, np.ones_like(disparity),
        size_px=(WIDTH, HEIGHT), degree=degree, sensor_to_pupil_mm=DELTA, covariance=np.eye(3),
    )  # fmt: skip


def test_fields_of_fourth_order_come_back_exactly(rng):
    field, residual = fit(*measured_boards(rng, 0.0))
    model = field.model(WIDTH, HEIGHT)
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    infinity, scale = curved_lens(x, y)
    np.testing.assert_allclose(model.infinity_disparity_px, infinity, rtol=1e-9)
    np.testing.assert_allclose(model.scale_px_mm, scale, rtol=1e-9)
    assert np.abs(residual).max() < 1e-9
    on_axis = field.on_axis(WIDTH, HEIGHT)
    assert on_axis.infinity_disparity_px == pytest.approx(infinity[20, 30], rel=1e-9)
    assert on_axis.scale_px_mm == pytest.approx(scale[20, 30], rel=1e-9)


def test_noise_missing_pixels_and_wrong_layers_are_survived(rng):
    x, y, inverse, disparity = measured_boards(rng, 0.05)
    wrong = rng.random(disparity.size)
    disparity = np.where(wrong < 0.1, rng.uniform(-6, 4, disparity.size), disparity)
    disparity[wrong > 0.8] = np.nan
    field, residual = fit(x, y, inverse, disparity)
    rows, columns = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    infinity, scale = curved_lens(columns, rows)
    model = field.model(WIDTH, HEIGHT)
    predicted = model.infinity_disparity_px - model.scale_px_mm / 1950
    # 30 numbers from 3000 samples of 0.05 px: 0.005 px in the middle, a few times that in the corners
    assert np.abs(predicted - (infinity - scale / 1950)).max() < 0.03
    assert (np.isnan(residual) == np.isnan(disparity)).all()


def test_a_constant_field_is_its_model():
    model = DepthModel(4.5, 8700.0, 49.5, np.diag([1.0, 2.0, 3.0]))
    field = DepthField.constant(model)
    back = field.model(WIDTH, HEIGHT)
    assert (back.infinity_disparity_px, back.scale_px_mm, back.sensor_to_pupil_mm) == (4.5, 8700.0, 49.5)
    np.testing.assert_array_equal(back.covariance, model.covariance)


def test_polynomials_are_products_of_cosines():
    # Chebyshev's own definition, T_n(cos t) = cos(n t), is the oracle.
    x = np.linspace(0, WIDTH - 1, 7)
    y = np.linspace(0, HEIGHT - 1, 7)
    t, s = np.arccos(np.linspace(-1, 1, 7)), np.arccos(np.linspace(-1, 1, 7))
    expected = [np.cos(i * t) * np.cos(j * s) for i in range(4) for j in range(4 - i)]
    np.testing.assert_allclose(polynomials(x, y, WIDTH, HEIGHT, 3), np.stack(expected, -1), atol=1e-12)


def test_counts_that_are_no_degree_are_refused():
    assert [degree_of(n) for n in (1, 3, 6, 10, 15)] == [0, 1, 2, 3, 4]
    for count in (0, 2, 4, 14):
        with pytest.raises(InputError, match="coefficients"):
            degree_of(count)


def test_too_little_to_fit_says_so(rng):
    x, y, inverse, disparity = measured_boards(rng, 0.0)
    with pytest.raises(InputError, match="more boards"):
        fit(x[:50], y[:50], inverse[:50], disparity[:50])
    one = inverse == inverse[0]
    with pytest.raises(InputError, match="more boards"):
        fit(x[one], y[one], inverse[one], disparity[one], degree=1)
