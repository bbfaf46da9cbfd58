"""Boards rendered with the blur of a lens determine the nonlinearity of shift matching."""

import numpy as np
import pytest
import scipy.fft

from chromaperture.calibration.read_boards import read_board
from chromaperture.calibration.rendered_boards import render_board, rendered_nonlinearity, surrogate
from chromaperture.depth.conversion import DepthModel
from chromaperture.optics.lens_blur import BlurModel
from worlds import Boards, blurred, board_evidence, halves_camera, lens_blur

W, H, DELTA = 192, 128, 50.0
LENS = BlurModel(6.0, 12000.0)  # a thin lens, in focus at 2 m
Z_MM = np.array([1000.0, 1400.0, 2000.0, 3000.0, 4000.0])


def blur(model=LENS, width=W, height=H):
    return lens_blur(model, width, height)


def photograph(inverse_mm, seed):
    """One convolution of a periodic pattern: another way than that of ``render_board``."""
    return blurred(np.random.default_rng(seed).normal(0.5, 0.15, (256, 256)), blur(), inverse_mm)


def session():
    return Boards({z: photograph(1 / z, i) for i, z in enumerate(Z_MM)})


def camera(model=LENS):
    reach = blur().reach
    return halves_camera(DepthModel(6.0 * reach, 12000.0 * reach, DELTA), W, H, blur=model)


def evidence():
    return board_evidence(camera().sensor, Z_MM, pupil_mm=DELTA, variance=0.0)


def test_a_surrogate_has_the_spectrum_and_is_another_pattern(rng):
    white = rng.normal(0.4, 0.1, (H, W))
    pattern = scipy.fft.irfft2(scipy.fft.rfft2(white) * np.exp(-np.arange(W // 2 + 1) / 20), s=(H, W))
    other = surrogate(pattern, rng)
    assert other.mean() == pytest.approx(pattern.mean(), abs=0.01)  # of a part: the mirrored whole has it exactly
    assert abs(np.corrcoef(pattern.ravel(), other.ravel())[0, 1]) < 0.1

    def power(picture):  # by octaves of horizontal frequency
        spectrum = np.abs(scipy.fft.rfft2(picture - picture.mean())) ** 2
        return np.array([spectrum[:, a : 2 * a].sum() for a in (2, 4, 8, 16, 32)])

    # Some 4 * 128 random numbers in the smallest octave: a tenth.
    np.testing.assert_allclose(power(other), power(pattern), rtol=0.25)


@pytest.mark.parametrize("inverse_mm", [1 / 900, 1 / 1900, 1 / 4000])
def test_a_rendered_board_is_the_convolution(rng, inverse_mm):
    pattern = rng.normal(0.5, 0.15, (H, W)).astype(np.float32)
    found = render_board(blur(), pattern, inverse_mm)
    room = 64
    size = 2 * 192
    padded = np.pad(pattern, ((room, size - H - room), (room, size - W - room)), mode="symmetric")
    transfer = blur().transfer((W - 1) / 2, (H - 1) / 2, inverse_mm, size)
    whole = scipy.fft.irfft2(scipy.fft.rfft2(padded) * transfer)[:, room : room + H, room : room + W]
    # Places are rounded to the grid's bilinear weights in single precision, and the tiles' margins cut off ringing.
    np.testing.assert_allclose(found, whole.transpose(1, 2, 0), atol=2e-4)


def test_blur_that_changes_over_the_frame_is_that_of_the_place():
    curved, width, height = blur(BlurModel(6.0, 12000.0, curvature_px=3.0), 480, 320), 480, 320
    pattern = np.zeros((height, width), np.float32)
    places = ((160, 240), (100, 130), (40, 50))
    for y, x in places:
        pattern[y, x] = 1.0
    found = render_board(curved, pattern, 1 / 3000)
    v, u = np.mgrid[-12:13, -12:13]
    for y, x in places:
        spot = found[y - 12 : y + 13, x - 12 : x + 13, 1]
        size2 = ((u**2 + v**2) * spot).sum() / spot.sum()
        f2 = ((x - (width - 1) / 2) ** 2 + (y - (height - 1) / 2) ** 2) / (width / 2) ** 2
        radius = 6.0 - 12000 / 3000 + 3.0 * f2
        # Half a disc's radius squared, and the raster's tent; between the middles of tiles blur is a mean.
        assert size2 == pytest.approx(radius**2 / 2 + 1 / 3, rel=0.1)


@pytest.mark.slow
def test_it_predicts_what_the_matcher_measures():
    """Photographs by another way of blurring, at distances of their own, read as straight lines of 1 / z."""
    curves = rendered_nonlinearity(camera(), session(), evidence())
    z = np.linspace(1000, 4000, 13)
    photographs = [[photograph(1 / at, 100 * k + i) for k in range(4)] for i, at in enumerate(z)]
    readings = [[read_board(image, camera()) for image in images] for images in photographs]
    rms = {}
    for quality in ("paper", "real-time"):
        read = np.array([np.mean([np.nanmedian(one[quality]) for one in four]) for four in readings])
        for name, line in (("read", read), ("straight", curves[quality].linear(read))):
            rms[quality, name] = np.std(line - np.polyval(np.polyfit(1 / z, line, 1), 1 / z))
    # Halves are mirrored, not shifted: 0.06 px. What is left is the texture's own, on a frame this small.
    assert rms["paper", "straight"] < 0.03
    assert rms["paper", "straight"] < rms["paper", "read"] / 2
    assert rms["real-time", "straight"] < 0.015  # it reads nearly straight as it is


def test_without_a_blur_nothing_is_known():
    assert rendered_nonlinearity(camera(None), session(), evidence()) == {}
