"""Hot and dead pixels are found among detail and noise; what a lens can image stays."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from chromaperture.camera.method import noise_model, noise_of_photographs, repaired
from chromaperture.color.image import without_defects
from chromaperture.color.noise import photon_noise_variance
from chromaperture.products.samples import open_sample

FULL_WELL, READ = 5000.0, 4.0


def noise_of(image):
    return photon_noise_variance(image, full_well_electrons=FULL_WELL, read_noise_electrons=READ)


@pytest.fixture
def photograph(rng):
    """Texture of another kind in every channel, behind a blur of 1.2 px (sigma), and its noise."""
    light = cv2.GaussianBlur(rng.uniform(0, 1, (240, 320, 3)), (0, 0), 1.2)
    light = np.clip(0.3 + 1.0 * (light - 0.5) * np.linspace(0, 2, 320)[None, :, None], 0.02, 0.9)
    return (light + rng.normal(size=light.shape) * np.sqrt(noise_of(light))).astype(np.float32)


def test_what_has_no_defect_is_returned_as_it_is(photograph):
    found = without_defects(photograph, noise_of)
    assert found is photograph


@pytest.mark.parametrize("level", [0.0, 0.7, 1.0])
def test_defects_come_back_as_their_neighbourhood(photograph, rng, level):
    """Where texture is strong some drown in it: .70, .79 and .98 of dead, bright and full pixels are found."""
    places = tuple(rng.integers(0, n, 200) for n in photograph.shape)
    spoiled = photograph.copy()
    spoiled[places] = level
    found = without_defects(spoiled, noise_of)
    touched = np.zeros(photograph.shape, bool)
    touched[places] = True
    np.testing.assert_array_equal(found[~touched], photograph[~touched])
    strong = np.abs(spoiled - photograph)[places] > 0.25
    repaired = (found != spoiled)[places]
    assert repaired[strong].mean() > 0.65
    # The median of a neighbourhood is as far off as the texture's own detail.
    detail = np.abs(photograph - cv2.blur(photograph, (3, 3))).mean()
    assert np.abs(found - photograph)[places][repaired].mean() < 2 * detail


@given(st.integers(1, 8), st.integers(1, 8), st.floats(0.3, 1))
def test_a_point_that_all_channels_show_stays(row, column, level):
    image = np.full((10, 10, 3), 0.1, np.float32)
    image[row, column] = level * np.array([1.0, 0.8, 0.9])
    assert without_defects(image, noise_of) is image


def test_unknown_pixels_stay_unknown(photograph):
    photograph[10:20, 10:20] = np.nan
    found = without_defects(photograph, noise_of)
    np.testing.assert_array_equal(np.isnan(found), np.isnan(photograph))


@pytest.mark.parametrize("times", [1.0, 9.0])
def test_the_noise_of_a_camera_decides_first_and_that_of_the_photograph_last(rng, times):
    """A photograph at another ISO: what stands out of the camera's noise may be the photograph's own."""
    camera, image = open_sample("still_life_cy_halves", quality="real-time", device="cpu")
    calibration = camera.calibration
    spread = np.sqrt((times - 1) * noise_model(calibration).variance(image))
    image = (image + rng.normal(size=image.shape) * spread).astype(np.float32)
    places = tuple(rng.integers(0, n, 300) for n in image.shape)
    image[places] = np.clip(image[places] + rng.uniform(0, 0.5, 300), 0, 0.95)
    expected = without_defects(image, noise_of_photographs(calibration).variance)
    assert (expected != image).any()
    np.testing.assert_array_equal(repaired(image, calibration), expected)
