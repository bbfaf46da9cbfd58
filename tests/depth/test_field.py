"""Fields of the depth curve over the frame: evaluated, fitted, robust."""

import numpy as np
import pytest
from numpy.polynomial import chebyshev

from chromaperture.calibration import fit_fields
from chromaperture.calibration.fit_fields import fit_depth_field, ranked_curves, with_local
from chromaperture.calibration.place_boards import BoardDistances
from chromaperture.depth.conversion import DepthModel, disparity_to_depth
from chromaperture.depth.field import DepthField, degree_of, polynomials
from chromaperture.depth.nonlinearity import Nonlinearity
from chromaperture.system.errors import InputError

WIDTH, HEIGHT = 61, 41
DELTA = 50.0


def curved_lens(x, y):
    """A and B as a lens gives them: bent in the square of the radius, with a tilt and a little of fourth order."""
    u, v = (x - 30) / 30, (y - 20) / 20
    r2 = u**2 + v**2
    return 4.4 - 0.3 * r2 + 0.05 * u + 0.02 * u**2 * v**2, 8600.0 - 900 * r2 + 100 * v


RULERS = np.arange(1000.0, 4001, 500)


def exact_distances(z=RULERS - DELTA):
    count = len(z)
    return BoardDistances(z, DELTA, 0.0, 1.0, np.zeros((count + 1, count + 1)), *np.full((2, count), np.nan))


def erring_distances(rng, z, covariance):
    """Distances of boards at z with errors drawn from the covariance of all of them and of delta."""
    error = np.linalg.cholesky(covariance) @ rng.normal(size=len(z) + 1)
    return BoardDistances(z + error[:-1], DELTA + error[-1], 2.0, 1.0, covariance, *np.full((2, len(z)), np.nan))


def measured_boards(rng, noise_px, z=RULERS - DELTA, step=2):
    y, x = (axis.ravel().astype(float) for axis in np.mgrid[0:HEIGHT:step, 0:WIDTH:step])
    infinity, scale = curved_lens(x, y)
    return x, y, infinity - scale / z[:, None] + rng.normal(0, noise_px, (len(z), x.size))


def fit(x, y, disparity, distances=None, degree=4, **more):
    distances = distances or exact_distances()
    return fit_depth_field(x, y, disparity, distances, size_px=(WIDTH, HEIGHT), degree=degree, **more)


def test_fields_of_fourth_order_come_back_exactly(rng):
    field, residual = fit(*measured_boards(rng, 0.0))
    model = field.model(WIDTH, HEIGHT)
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    infinity, scale = curved_lens(x, y)
    np.testing.assert_allclose(model.infinity_disparity_px, infinity, rtol=1e-9)  # float64; 2e-14 is found
    np.testing.assert_allclose(model.scale_px_mm, scale, rtol=1e-9)  # as above
    assert np.abs(residual).max() < 1e-9  # as above
    for on_axis in (field.on_axis(WIDTH, HEIGHT), field.at(np.array(30.0), np.array(20.0), WIDTH, HEIGHT)):
        assert on_axis.infinity_disparity_px == pytest.approx(infinity[20, 30], rel=1e-9)  # as above
        assert on_axis.scale_px_mm == pytest.approx(scale[20, 30], rel=1e-9)  # as above


def test_noise_missing_pixels_and_wrong_layers_are_survived(rng):
    x, y, disparity = measured_boards(rng, 0.05)
    wrong = rng.random(disparity.shape)
    disparity = np.where(wrong < 0.1, rng.uniform(-6, 4, disparity.shape), disparity)
    disparity[wrong > 0.8] = np.nan
    field, residual = fit(x, y, disparity)
    rows, columns = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    infinity, scale = curved_lens(columns, rows)
    model = field.model(WIDTH, HEIGHT)
    predicted = model.infinity_disparity_px - model.scale_px_mm / 1950
    # 30 numbers from 3000 samples of 0.05 px: 0.005 px in the middle, a few times that in the corners
    assert np.abs(predicted - (infinity - scale / 1950)).max() < 0.03
    assert (np.isnan(residual) == np.isnan(disparity)).all()


def bent(linear_px):
    """A matcher's bias: too little near focus, too much far from it."""
    return linear_px + 0.15 * np.sin(1.1 * linear_px) - 0.1


def test_the_nonlinearity_is_separated_from_the_lens(rng):
    z = np.linspace(1000, 4000, 16) - DELTA
    x, y, linear = measured_boards(rng, 0.0, z)
    disparity = bent(linear) + rng.normal(0, 0.01, linear.shape)
    distances = exact_distances(z)
    straight, _ = fit(x, y, disparity, distances)
    curved, _ = fit(x, y, disparity, distances, nonlinearity=5)
    between = 2 * z[:-1] * z[1:] / (z[:-1] + z[1:])  # distances at which no board stood
    infinity, scale = curved_lens(30.0, 20.0)
    errors = []
    for field in (straight, curved):
        depth, _ = disparity_to_depth(bent(infinity - scale / between), field.on_axis(WIDTH, HEIGHT))
        errors.append(np.abs(depth - between - DELTA).max() / between.max())
    # 0.01 px is a thousandth of the depth at 4 m before averaging
    assert errors[1] < 0.002
    assert errors[0] > 5 * errors[1]


def ranked(x, y, disparity, z, *, degree=4, **more):
    more = {"boards": np.ones(len(z), bool)} | more
    return ranked_curves(x, y, disparity, exact_distances(z), size_px=(WIDTH, HEIGHT), degree=degree, **more)


@pytest.mark.slow
@pytest.mark.parametrize(("true_terms", "boards"), [(0, 12), (3, 15), (6, 24)])
def test_as_many_terms_as_the_matcher_needs(rng, true_terms, boards):
    """At the most a third as many terms as boards are tried."""
    z = np.linspace(1000, 4000, boards) - DELTA
    x, y, linear = measured_boards(rng, 0.0, z, step=4)
    series = np.zeros(true_terms + 2)
    series[-1:] = 0.03 * bool(true_terms)  # T_(K+1) alone: fewer terms see nothing of it
    low, high = linear.min(), linear.max()
    read = linear + chebyshev.chebval((2 * linear - low - high) / (high - low), series)
    read += rng.normal(0, 0.002, (len(z), 1)) + rng.normal(0, 0.01, linear.shape)  # of boards, and of pixels
    found = ranked(x, y, read, z)
    assert found[0] == max(true_terms, 2)  # two are always allowed for
    assert found[-1] == 0


@pytest.mark.slow
def test_a_curve_known_beforehand_is_taken_where_it_is_right(rng):
    """Eight boards carry two terms; the matcher's curve has ten times the bend of what they may follow."""
    z = np.linspace(1000, 4000, 8) - DELTA
    x, y, linear = measured_boards(rng, 0.0, z)
    low, high = float(linear.min()), float(linear.max())
    right = Nonlinearity(low, high, np.array([0.02, -0.05, 0.04, 0.03, -0.02]))
    wrong = Nonlinearity(low, high, -right.coefficients)
    read = right.measured(linear) + rng.normal(0, 0.01, linear.shape)
    assert ranked(x, y, read, z, known=right)[0] is right
    assert ranked(x, y, read, z, known=wrong)[0] is not wrong
    fitted, residual = fit(x, y, read, exact_distances(z), nonlinearity=right)
    assert fitted.nonlinearity is right
    assert np.abs(np.median(residual, axis=1)).max() < 0.002  # 0.01 px, averaged over the frame


@pytest.mark.slow
def test_many_boards_need_no_rendered_curve(rng, monkeypatch):
    """A nearly right rendered curve would predict as well as a fitted one; with 31 boards it is not tried."""
    monkeypatch.setattr(fit_fields, "_TRIALS", (2, 3))
    z = np.linspace(1000, 4000, 31) - DELTA
    x, y, linear = measured_boards(rng, 0.0, z, step=4)
    known = Nonlinearity(float(linear.min()), float(linear.max()), np.array([0.02, -0.05]))
    read = known.measured(linear) + rng.normal(0, 0.01, linear.shape)
    found = ranked(x, y, read, z, known=known)
    assert found[0] == 2
    assert known not in found


def test_few_boards_carry_no_terms(rng):
    x, y, linear = measured_boards(rng, 0.01)
    z = RULERS - DELTA
    assert max(ranked(x, y, bent(linear), z, degree=2)) <= len(RULERS) // 3
    assert ranked(x, y, linear, z, degree=2, boards=RULERS < 2000) == [0]
    with pytest.raises(InputError):
        fit(x, y, linear, boards=RULERS == 1000.0)


@pytest.mark.parametrize(
    ("seed", "curve", "z", "with_pupil"),
    [(7, None, RULERS - DELTA, -1.0), (11, (0.06, -0.04), np.linspace(1000, 4000, 16) - DELTA, 0.0)],
    ids=["lens alone", "nonlinearity"],
)
def test_covariance_is_the_scatter_of_many_sessions(seed, curve, z, with_pupil):
    """Forty sessions: noise of every sample, and a ruler that errs by the same mm at all samples of a board.

    Terms of a nonlinearity are correlated with A and B: depth by the whole curve is known best.
    """
    rng = np.random.default_rng(seed)
    x, y, clean = measured_boards(rng, 0.0, z)
    if curve is not None:
        clean = Nonlinearity(float(clean.min()), float(clean.max()), np.array(curve)).measured(clean)
    covariance = np.diag([1.7**2] * len(z) + [2.0**2])
    covariance[-1, :-1] = covariance[:-1, -1] = with_pupil
    depths = 1 / np.array([1100.0, 1600, 2200, 3600])
    found, stated = [], []
    for _ in range(40):
        assumed = erring_distances(rng, z, covariance)
        read = clean + rng.normal(0, 0.05, clean.shape)
        field, _ = fit(x, y, read, assumed, degree=2, nonlinearity=len(curve or ()))
        numbers, errors = [], []
        for px, py in ((30, 20), (4, 4)):
            model = field.at(np.array(float(px)), np.array(float(py)), WIDTH, HEIGHT)
            readings = np.interp(depths, 1 / (z + DELTA)[::-1], clean[::-1, py // 2 * 31 + px // 2])
            depth, sigma = disparity_to_depth(readings, model, sigma_px=np.zeros(4))
            numbers += [model.infinity_disparity_px, model.scale_px_mm, model.sensor_to_pupil_mm, *depth]
            errors += [*np.sqrt(np.diag(model.covariance)), *sigma]
        found.append(numbers)
        stated.append(errors)
    ratio = np.std(found, axis=0) / np.sqrt(np.mean(np.square(stated), axis=0))
    assert np.all((ratio > 0.75) & (ratio < 1.3)), ratio  # 40 sessions know a standard deviation to 11 %; twice that


def test_error_bars_vary_over_the_frame_as_the_fields_covariance_says(rng):
    x, y, disparity = measured_boards(rng, 0.05)
    field, _ = fit(x, y, disparity, degree=2)
    model = field.model(WIDTH, HEIGHT)
    for px, py in ((30, 20), (0, 0), (60, 40), (11, 33)):
        exact = field.at(np.array(float(px)), np.array(float(py)), WIDTH, HEIGHT).covariance
        # bilinear between 33 nodes a side: the second difference of a quartic is a few per mille of its range
        np.testing.assert_allclose(model.covariance[py, px], exact, rtol=0.05)
    corner, middle = model.covariance[0, 0, 0, 0], model.covariance[20, 30, 0, 0]
    assert corner > 2 * middle  # a polynomial is loosest where it ends


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
    np.testing.assert_allclose(polynomials(x, y, WIDTH, HEIGHT, 3), np.stack(expected, -1), atol=1e-12)  # rounding


def test_counts_that_are_no_degree_are_refused():
    assert [degree_of(n) for n in (1, 3, 6, 10, 15)] == [0, 1, 2, 3, 4]
    for count in (0, 2, 4, 14):
        with pytest.raises(InputError, match="coefficients"):
            degree_of(count)


def test_rough_sums_differ_by_rounding_alone(rng):
    """Without the covariance sums are in another order; boards' weights and a nonlinearity are in all of them."""
    x, y, disparity = measured_boards(rng, 0.05)
    (exact, left), (rough, also_left) = (
        fit(x, y, bent(disparity), nonlinearity=3, covariance=precisely) for precisely in (True, False)
    )
    np.testing.assert_allclose(rough.scale_px_mm, exact.scale_px_mm, atol=1e-7 * exact.scale_px_mm[0])
    np.testing.assert_allclose(also_left, left, atol=1e-8)
    assert np.isnan(rough.covariance).all()


def test_too_little_to_fit_says_so(rng):
    x, y, disparity = measured_boards(rng, 0.0)
    with pytest.raises(InputError, match="more boards"):
        fit(x[:20], y[:20], disparity[:, :20])
    with pytest.raises(InputError, match="more boards"):
        fit(x, y, disparity, boards=np.arange(len(RULERS)) == 1, degree=1)


def test_what_no_polynomial_follows_comes_back_place_by_place(rng):
    """A decentred element's bump, far too narrow for degree 4, in fifty sessions' worth of boards."""
    z = np.linspace(1000, 4000, 60) - DELTA
    columns, rows = np.arange(1.0, WIDTH, 3), np.arange(1.0, HEIGHT, 3)
    x, y = np.meshgrid(columns, rows)
    bump = np.exp(-((x - 22) ** 2 + (y - 16) ** 2) / 30)
    infinity, scale = curved_lens(x, y)
    infinity, scale = infinity + 0.2 * bump, scale + 500 * bump
    read = infinity - scale / z[:, None, None] + rng.normal(0, 0.01, (60, *x.shape))
    read[rng.random(read.shape) < 0.05] += 3.0  # wrong layers
    flat = (x.ravel(), y.ravel(), read.reshape(60, -1))
    everything, distances = np.ones(60, bool), exact_distances(z)
    smooth, _ = fit(*flat, distances)
    free = with_local(smooth, columns, rows, read, distances, size_px=(WIDTH, HEIGHT), boards=everything)
    wrong = []
    for field in (smooth, free):
        model = field.at(x, y, WIDTH, HEIGHT)
        wrong.append(np.abs(model.infinity_disparity_px - model.scale_px_mm / 1500 - infinity + scale / 1500).max())
    # .01 px over 60 boards is .0013; the ridge keeps a sixteenth of the bump's .2 - 500 / 1500 px
    assert wrong[1] < 0.025
    assert wrong[0] > 3 * wrong[1]
    whole = free.model(WIDTH, HEIGHT)
    np.testing.assert_allclose(whole.scale_px_mm[1::3, 1::3], model.scale_px_mm, rtol=1e-6)  # rounding
    assert free.on_axis(WIDTH, HEIGHT).scale_px_mm == pytest.approx(whole.scale_px_mm[20, 30], rel=1e-6)  # rounding
    assert (whole.covariance[..., 0, 0] > smooth.model(WIDTH, HEIGHT).covariance[..., 0, 0]).all()
