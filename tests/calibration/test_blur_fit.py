"""Boards blurred by a known lens give that lens back."""

from dataclasses import replace

import numpy as np
import pytest

from chromaperture.calibration.calibrate_blur import calibrate_blur, measured_layers
from chromaperture.calibration.fit_blur import fit_blur
from chromaperture.depth.conversion import DepthModel
from chromaperture.model.camera_file import Calibration
from chromaperture.optics.aperture import DESIGNS
from chromaperture.optics.lens_blur import BlurModel, LensBlur
from chromaperture.settings.methods import AccurateConfig
from chromaperture.system.errors import InputError
from worlds import Boards, blurred, board_evidence, halves_camera, lens_blur

W, H = 160, 120
TRUE = BlurModel(5.0, 8000.0, axial_red_px=-0.3, axial_blue_px=0.4, spherical_px=-1.0)
DISTANCES_MM = (900.0, 1200.0, 1700.0, 2400.0, 3500.0)


def boards(model=TRUE, noise=0.001):
    """The same blur in the whole frame, so that one convolution makes a board exactly."""
    rng = np.random.default_rng(8)
    for z in DISTANCES_MM:
        image = blurred(rng.normal(0.5, 0.15, (256, 256)), lens_blur(model, W, H), 1 / z)
        yield (image + rng.normal(0, noise, image.shape)).astype(np.float32), 1 / z


@pytest.fixture(scope="module")
def fitted():
    start = lens_blur(BlurModel(4.4, 7300.0, front_rim_radius=1.08, rear_rim_radius=1.08), W, H)
    return fit_blur(boards(), start, board_count=len(DISTANCES_MM), tile_count=15)


@pytest.mark.slow
def test_the_lens_comes_back(fitted):
    """Single numbers trade places (defocus with spherical aberration): what counts are the transfer functions."""
    true = lens_blur(TRUE, W, H)
    place = ((W - 1) / 2, (H - 1) / 2)
    for z in (1000.0, 2000.0, 3000.0):
        expected = true.transfer(*place, 1 / z, 64)
        found = fitted.blur.transfer(*place, 1 / z, 64)
        error = np.abs(found - expected).max()
        start = np.abs(lens_blur(BlurModel(4.4, 7300.0), W, H).transfer(*place, 1 / z, 64) - expected).max()
        assert error < 0.06, z  # of 1; 0.005 at most is found
        assert error < start / 3, z


@pytest.mark.slow
def test_layers_of_the_boards_are_their_distances(fitted):
    at_infinity, scale = fitted.blur.reference
    for image, inverse_mm in boards():
        *_, layer = measured_layers(image, inverse_mm, fitted.blur, aperture=DESIGNS["cy_halves"], cell_px=40)
        # Noise of 0.1 % and a fit to 15 tiles: 0.011 px at most.
        assert np.nanmedian(layer) == pytest.approx(at_infinity - scale * inverse_mm, abs=0.02)


@pytest.mark.slow
def test_a_board_far_from_where_it_is_expected_is_found(fitted):
    """Nine layers off: the first search, six to either side, leaves the board unknown."""
    image, inverse_mm = list(boards())[2]
    nine_layers = 9 * AccurateConfig.for_blur(fitted.blur.reach).layers.step_px / fitted.blur.reference[1]
    how = {"aperture": DESIGNS["cy_halves"], "cell_px": 40}
    *_, expected = measured_layers(image, inverse_mm, fitted.blur, **how)
    *_, found = measured_layers(image, inverse_mm + nine_layers, fitted.blur, **how)
    # The same layers of another range: labels lie elsewhere, by which surfaces may differ by a hundredth of a layer.
    np.testing.assert_allclose(found, expected, atol=3e-3)


def test_boards_without_texture_are_refused():
    flat = [(np.full((H, W, 3), 0.4, np.float32), 1e-3)] * 4
    with pytest.raises(InputError, match="texture"):
        fit_blur(flat, lens_blur(TRUE, W, H), board_count=4)


@pytest.mark.slow
def test_no_step_leaves_a_corner_without_light(monkeypatch):
    """Boards through an achromat drew the rims together until no ray was left at the corners."""
    start = lens_blur(BlurModel(4.4, 7300.0, front_rim_radius=1.08, rear_rim_radius=1.08), W, H)
    monkeypatch.setattr(LensBlur, "least_light", property(lambda blur: float(blur.model == start.model)))
    assert fit_blur(boards(), start, board_count=len(DISTANCES_MM), tile_count=15).blur.model == start.model


def session(count):
    return Boards({1 / inverse + 50.0: image for image, inverse in list(boards())[:count]})


def evidence(count):
    return board_evidence(draft().sensor, np.array(DISTANCES_MM[:count]))


def draft():
    beta = 4 / (3 * np.pi)
    return halves_camera(DepthModel(4.4 * beta, 7300.0 * beta, 50.0), W, H)


@pytest.fixture(scope="module")
def calibrated():
    return calibrate_blur(draft(), session(5), evidence(5))


@pytest.mark.slow
def test_a_camera_gets_its_blur_and_keeps_it_in_its_file(calibrated, tmp_path):
    camera, layers = calibrated.camera, calibrated.layers
    assert not calibrated.notes
    assert layers.disagreement < layers.start_disagreement / 4
    curve = camera.on_axis("accurate")
    at_infinity, scale = camera.field_blur().reference
    for z in DISTANCES_MM:
        layer = at_infinity - scale / z
        # 0.01 is found, as for the layers above.
        assert curve.infinity_disparity_px - curve.scale_px_mm / z == pytest.approx(layer, abs=0.03)
    camera.save(tmp_path / "camera.asdf")
    again = Calibration.load(tmp_path / "camera.asdf")
    assert again.blur == camera.blur
    assert replace(again, blur=None).field_blur() is None


@pytest.mark.slow
def test_a_lens_that_is_known_is_where_the_fit_starts(calibrated):
    unknown = calibrated.layers
    known = calibrate_blur(draft(), session(5), evidence(5), lens=TRUE).layers
    assert known.start_disagreement < 1.05 * known.disagreement  # what is left is noise
    assert unknown.start_disagreement > 3 * known.start_disagreement


def test_three_boards_are_too_few():
    blurred = calibrate_blur(draft(), session(3), evidence(3))
    assert blurred.layers is None
    assert blurred.camera.blur is None
    assert "3 boards" in blurred.notes[0]
