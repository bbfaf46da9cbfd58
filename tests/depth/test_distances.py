"""Ruler and poses reconciled; wrong boards, swapped boards and wrong units are named."""

import numpy as np
import pytest

from chromaperture.calibration.place_boards import find_outliers, fit_distances
from chromaperture.calibration.session import check_units
from chromaperture.system.errors import InputError

DELTA = 48.0
Z = np.linspace(950, 3950, 25)


def reconcile(ruler, pose, **more):
    settings = {
        "ruler_sigma_mm": 1.7, "pose_sigma_mm": 2e-4 * Z[: len(ruler)], "sensor_to_pupil_mm": 52.0,
        "sensor_to_pupil_sigma_mm": 10.0,
    }  # fmt: skip
    return fit_distances(ruler, pose, **(settings | more))


def test_ruler_and_poses_give_pupil_scale_and_distances(rng):
    ruler = Z + DELTA + rng.uniform(-3, 3, 25)
    pose = Z / 0.99 * (1 + 2e-4 * rng.normal(size=25))
    ruler[7] += 60  # misread by six centimetres: the pose knows better
    found = reconcile(ruler, pose)
    assert found.scale == pytest.approx(0.99, abs=0.001)  # 6e-4 is found; poses of 2e-4, pulled by rulers of 3 mm
    assert abs(found.sensor_to_pupil_mm - DELTA) < 3 * found.sigma_mm < 6
    assert np.abs(found.from_pupil_mm - Z).max() < 5
    assert abs(found.residual_mm[7] - 60) < 5


@pytest.mark.parametrize("better", [0.5, 1.0, 3.0])
def test_the_stated_errors_are_those_of_many_sessions(better):
    """Also where the corners are better or worse than assumed."""
    rng = np.random.default_rng(5)
    found, stated = [], []
    for _ in range(60):
        pose = Z * (1 + better * 5e-4 * rng.normal(size=25))
        result = reconcile(Z + DELTA + rng.normal(0, 1.7, 25), pose, pose_sigma_mm=5e-4 * Z)
        found.append([*result.from_pupil_mm, result.sensor_to_pupil_mm])
        stated.append(np.sqrt(np.diag(result.covariance)))
    ratio = np.std(found, axis=0) / np.mean(stated, axis=0)
    # 60 sessions know one standard deviation to 9 %, the mean of 25 to far better
    assert 0.8 < ratio[:-1].mean() < 1.25
    assert 0.75 < ratio[-1] < 1.3


def test_without_poses_the_ruler_and_the_prior_remain():
    ruler = Z + DELTA
    found = reconcile(ruler, np.full(25, np.nan), pose_sigma_mm=np.full(25, np.inf))
    np.testing.assert_allclose(found.from_pupil_mm, ruler - 52.0, atol=1e-6)  # rounding; weights of poses are 0
    assert found.sigma_mm == pytest.approx(10.0, rel=1e-6)  # rounding
    assert np.isnan(found.residual_mm).all()


def test_half_of_the_poses_missing_costs_little(rng):
    pose = np.where(np.arange(25) % 2, Z, np.nan)
    found = reconcile(Z + DELTA + rng.uniform(-3, 3, 25), pose)
    assert abs(found.sensor_to_pupil_mm - DELTA) < 3 * found.sigma_mm < 8
    assert np.isfinite(found.from_pupil_mm).all()


def outliers(ruler, measured):
    names = [f"{r:.0f}.png" for r in (2000, 2100, 2200, 2300)]
    return find_outliers(names, np.array(ruler), np.array(measured), np.full(4, 1.5), ruler_error_mm=3.0)


def test_a_board_off_its_ruler_is_named_with_its_distance():
    found = outliers([2000, 2100, 2200, 2300.0], [2001, 2098, 2202, 2314.0])
    assert list(found) == ["2300.png"]
    assert "14 mm off its ruler" in found["2300.png"]


def test_two_swapped_boards_are_named_as_such():
    found = outliers([2000, 2300, 2200, 2100.0], [2001, 2098, 2202, 2301.0])
    assert set(found) == {"2100.png", "2300.png"}
    assert all("2100.png and 2300.png" in text or "2300.png and 2100.png" in text for text in found.values())
    assert all("swapped" in text for text in found.values())


def test_unknown_distances_are_no_outliers():
    assert outliers([2000, 2100, 2200, 2300.0], [np.nan] * 4) == {}


@pytest.mark.parametrize(("factor", "unit"), [(0.1, "cm"), (0.001, "m,"), (1 / 25.4, "inches")])
def test_other_units_are_named(factor, unit):
    with pytest.raises(InputError, match=f"look like {unit}"):
        check_units(Z * factor, Z + 30, where="distances.csv")
    check_units(Z, Z * 1.4, where="distances.csv")
    check_units(Z, np.full(25, np.nan), where="distances.csv")
