"""Dual-pixel photographs: noise that both halves share, a session through a prescription, a focus that is set anew."""

import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from chromaperture.camera.method import default_config, noise_of_photographs, sensor_noise
from chromaperture.color.shared_noise import shared_noise_ratio
from chromaperture.depth.field import DepthField
from chromaperture.model.camera_file import Calibration
from chromaperture.optics.dual_pixel_rays import HalfPixels
from chromaperture.optics.lens_blur import BlurModel
from chromaperture.optics.prescription import load_lens
from chromaperture.settings.methods import ALLOWED_GROWTH, AccurateConfig
from chromaperture.system.errors import InputError
from chromaperture_paper.dual_pixel import FOCUS_ERROR_PER_M

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))
import dual_pixel_session

SHAPE = (256, 384)


def photograph(rng, camera, *, times, shared):
    """Even steps of light, one of them printed; noise of ``times`` the camera's variance, partly of both halves."""
    light = np.repeat(np.linspace(0.05, 0.8, 8), SHAPE[1] // 8)[None].repeat(SHAPE[0], axis=0)
    light[:, : SHAPE[1] // 8] *= 1 + 0.3 * rng.standard_normal((SHAPE[0], SHAPE[1] // 8))
    sigma = np.sqrt(times * sensor_noise(np.dstack([light] * 3).astype(np.float32), camera)[..., 0])
    common, left, right = rng.standard_normal((3, *SHAPE))
    halves = [light + sigma * (np.sqrt(shared) * common + np.sqrt(1 - shared) * own) for own in (left, right)]
    return np.dstack([halves[0], sum(halves) / 2, halves[1]]).astype(np.float32)


def sensor_of_halves() -> Calibration:
    """A camera of which only the sensor is known, with a noise that is less than that of its photographs."""
    camera = Calibration.uncalibrated("cy_halves", width_px=SHAPE[1], height_px=SHAPE[0])
    sensor = replace(camera.sensor, full_well_electrons=160_000.0, read_noise_electrons=14.0, dual_pixel="left-right")
    return replace(camera, sensor=sensor)


@pytest.mark.parametrize(("times", "shared"), [(2.0, 0.5), (6.0, 0.5), (2.0, 0.0)])
def test_noise_is_measured_where_there_is_no_detail(rng, times, shared):
    camera = sensor_of_halves()
    image = photograph(rng, camera, times=times, shared=shared)
    variance = sensor_noise(image, camera)
    found = shared_noise_ratio(image, variance)
    # Green's share of the variance, threefold; the flattest tenth of squares of 256 px is a tenth below the mean.
    expected = 3 * times * (1 + shared) / 2
    assert found == pytest.approx(expected, rel=0.2)
    # In place of the camera's noise, where the likelihood is that of half pixels; nothing clearer is left to find.
    np.testing.assert_allclose(noise_of_photographs(camera, halves=True).variance(image), found * variance, rtol=1e-5)


def test_a_photograph_without_noise_is_taken_for_one_of_the_cameras():
    image = np.full((*SHAPE, 3), 0.4, np.float32)
    assert shared_noise_ratio(image, sensor_noise(image, sensor_of_halves())) == 1.0


def test_a_dual_pixel_camera_matches_with_the_settings_of_half_pixels_where_its_blur_is_known():
    camera = sensor_of_halves()
    plain = default_config(camera, "accurate").matcher
    assert isinstance(plain, AccurateConfig)
    assert not plain.uses_blur
    blurred = replace(camera, blur=BlurModel(5.0, 5000.0))
    matcher = default_config(blurred, "accurate").matcher
    assert matcher == matcher.with_half_pixels()
    film = replace(blurred, sensor=replace(camera.sensor, dual_pixel=None))
    assert not default_config(film, "accurate").matcher.spectral.dual_pixel


def test_settings_of_half_pixels_are_those_of_the_blur_but_for_what_halves_share():
    film = AccurateConfig.for_blur(0.2, one_pair=True).with_range(-1.0, 2.0)
    halves = film.with_half_pixels()
    assert halves.evidence.own_detail
    assert halves.evidence.allowed_growth == ALLOWED_GROWTH
    assert halves.spectral.dual_pixel
    assert halves.surface.learned_error_bar == "none"
    assert (halves.planes, halves.plate) == (film.planes, film.plate)
    assert halves.layers == film.layers
    assert halves.with_half_pixels() == halves
    with pytest.raises(InputError, match="for_blur"):
        AccurateConfig().with_half_pixels()


def test_a_focus_that_is_set_anew_widens_the_error_bar_by_as_much():
    field = DepthField(np.array([0.7, 0.01, 0.0]), np.array([700.0, 1.0, 2.0]), 0.0, np.zeros((3, 3)))
    wider = dual_pixel_session._with_focus_error(field)
    # A moves by B times the change of the inverse distance.
    assert np.sqrt(wider.covariance[0, 0]) == pytest.approx(700.0 * FOCUS_ERROR_PER_M / 1000)
    assert not field.covariance.any()


def test_the_session_of_a_prescription_shows_its_halves(tmp_path, monkeypatch):
    monkeypatch.setattr(dual_pixel_session, "BOARDS_MM", (2000.0,))
    monkeypatch.setattr(dual_pixel_session, "TILTS", 0)
    halves = HalfPixels(slope=0.4, half_slope_px=60.0)
    size = {"width_px": 96, "height_px": 64, "pixel_pitch_mm": 0.23}
    dual_pixel_session.write_lens_session(tmp_path, load_lens("double_gauss_50"), halves, focus_mm=2000.0, size=size)
    assert (tmp_path / "distances.csv").read_text().splitlines()[1].endswith(",2000")
    sheets = {
        name: cv2.imread(str(tmp_path / "white" / f"{name}.png"), cv2.IMREAD_UNCHANGED)[28:36, 44:52, ::-1].astype(
            float
        )
        for name in ("open", "sheet_c", "sheet_y", "cy_halves")
    }
    light = {name: (sheet - 256).mean(axis=(0, 1)) for name, sheet in sheets.items()}
    for name, filter_name in (("sheet_c", "cyan"), ("sheet_y", "yellow")):
        np.testing.assert_allclose(light[name] / light["open"], halves.film()[filter_name], rtol=5e-3)  # photons
    np.testing.assert_allclose(light["cy_halves"] / light["open"], 0.5, rtol=5e-3)
