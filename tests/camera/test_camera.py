"""The camera as a whole, on a simulated plane seen through leaking film."""

from dataclasses import replace

import numpy as np
import pytest

from chromaperture.camera.alignment import channel_shifts
from chromaperture.camera.camera import CodedApertureCamera, load_camera
from chromaperture.camera.method import default_config
from chromaperture.capture.checks import check_capture
from chromaperture.depth.conversion import DepthModel
from chromaperture.depth.field import DepthField
from chromaperture.model.camera_file import Calibration
from chromaperture.model.camera_parts import Film
from chromaperture.products.measure_file import measure_file
from chromaperture.products.samples import SAMPLES, sample_camera, sample_image
from chromaperture.system.errors import CaptureWarning, InputError
from worlds import capture, texture

CYAN, YELLOW = np.array([0.10, 0.63, 0.65]), np.array([0.92, 0.85, 0.10])


def leaking_camera(height, width):
    camera = Calibration.uncalibrated("cy_halves", width_px=width, height_px=height)
    film = Film({"cyan": CYAN, "yellow": YELLOW}, np.ones(3), (CYAN + YELLOW) / 2)
    return replace(camera, film=film)


@pytest.mark.parametrize("quality", ["paper", "real-time", "accurate"])
def test_colours_come_together_at_every_quality(rng, quality):
    picture = texture(rng, 120, 160)
    image = capture(picture, "cy_halves", 2.6, {"cyan": CYAN, "yellow": YELLOW})
    calibration = leaking_camera(*picture.shape)
    camera = CodedApertureCamera(calibration, default_config(calibration, quality))
    frame = camera.measure(image)
    inner = (slice(20, -20), slice(20, -20))
    red, blue = frame.color[inner][..., 0], frame.color[inner][..., 2]
    before = np.corrcoef(image[inner][..., 0].ravel(), image[inner][..., 2].ravel())[0, 1]
    after = np.corrcoef(red.ravel(), blue.ravel())[0, 1]
    assert before < 0.5  # 5.2 px apart, of a texture of 1.5 px; the leaks have it in common
    # What leaks through the other half, a tenth of the light, is not moved; the rest must coincide.
    assert after > 0.93
    assert red.mean() == pytest.approx(blue.mean(), rel=0.01)  # a grey plane is grey
    assert not frame.valid.any()  # no calibration, no millimetres
    assert np.isfinite(frame.disparity_px[inner]).mean() > 0.99


def test_channels_brought_closer_by_leaks_are_moved_by_their_own_curve():
    camera = leaking_camera(48, 64)
    np.testing.assert_allclose(channel_shifts(camera, "paper")[[0, 2], 0], [1, -1], atol=1e-3)  # uncalibrated
    curves = {q: DepthField.constant(DepthModel(4.0, b, 50.0)) for q, b in (("real-time", 7300.0), ("paper", 8700.0))}
    known = replace(camera, depth=curves)
    np.testing.assert_allclose(channel_shifts(known, "real-time")[[0, 2], 0], [1, -1], atol=1e-3)  # rounding
    # At the same depth the unmixed views are 8700 / 7300 times as far apart as the channels.
    np.testing.assert_allclose(channel_shifts(known, "paper")[[0, 2], 0], [73 / 87, -73 / 87], atol=1e-3)


def test_captures_that_cannot_be_measured_say_why():
    image = np.full((48, 64, 3), (0.3, 0.25, 0.2), np.float32)
    for broken, word in (
        (image[:, :40], "40x48"),
        (image[..., 0], "RGB"),
        (np.ma.masked_array(image, mask=image > 0.5), "masked"),
        ((image * 255).astype(np.uint8), "read_image"),
        (image * 0, "black"),
        (image * 0 + 1, "saturated"),
        (image * np.nan, "finite"),
    ):
        with pytest.raises(InputError, match=word):
            check_capture(broken, 64, 48)
    partly = image.copy()
    partly[:8] = 1.0
    with pytest.warns(CaptureWarning, match="17%"):
        check_capture(partly, 64, 48)


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (None, "read files with read_image"),
        (np.zeros((0, 0, 3), np.float32), "with pixels"),
        ([[0.5, 0.5, 0.5]], "RGB image"),
        (5, "RGB image"),
    ],
)
def test_what_is_no_picture_is_refused(image, message):
    camera = CodedApertureCamera(leaking_camera(48, 64))
    with pytest.raises(InputError, match=message):
        camera.measure(image)


def test_a_grey_picture_is_refused(rng):
    """Its channels agree everywhere, as if all of the scene were in focus, with short error bars."""
    camera = CodedApertureCamera(leaking_camera(48, 64))
    with pytest.raises(InputError, match="grey"):
        camera.measure(np.repeat(texture(rng, 48, 64)[..., None], 3, axis=2))


@pytest.mark.parametrize("damage", [1e30, 2.5, -0.5, np.inf])
def test_values_that_are_no_light_are_unknown(rng, damage):
    camera = CodedApertureCamera(leaking_camera(96, 128))
    image = capture(texture(rng, 96, 128), "cy_halves", 2.6, {"cyan": CYAN, "yellow": YELLOW})
    image[30:50, 20:40] = np.nan
    expected = camera.measure(image)
    image[30:50, 20:40] = damage
    found = camera.measure(image)
    np.testing.assert_array_equal(found.disparity_px, expected.disparity_px)
    np.testing.assert_array_equal(found.disparity_sigma_px, expected.disparity_sigma_px)


def test_results_of_an_earlier_measurement_beside_new_ones_are_warned_of(tmp_path):
    camera = load_camera(sample_camera(SAMPLES[0]), quality="paper", device="cpu")
    photo = sample_image(SAMPLES[0])
    measure_file(photo, camera, out=tmp_path, write=["depth", "sigma"])
    before = (tmp_path / f"{photo.stem}.sigma.tiff").read_bytes()
    with pytest.warns(CaptureWarning, match="sigma.tiff beside the new files"):
        measure_file(photo, camera, out=tmp_path, write="depth")
    assert (tmp_path / f"{photo.stem}.sigma.tiff").read_bytes() == before
    measure_file(photo, camera, out=tmp_path, write=["depth", "sigma"])  # all that lies there: no warning
