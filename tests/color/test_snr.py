"""Noise and exposure of white sheets."""

import numpy as np
import pytest

from chromaperture.color.noise import exposure_to_restore, snr_db
from chromaperture.system.errors import InputError

FULL_WELL = 20000.0


def sheet(rng, light, read=0.0):
    electrons = rng.poisson(FULL_WELL * light, (240, 360, 3)) + read * rng.normal(size=(240, 360, 3))
    return (electrons / FULL_WELL).astype(np.float32)


@pytest.mark.parametrize("frames", [1, 2])
def test_photon_noise_gives_the_root_of_the_electrons(rng, frames):
    light = 0.6
    pictures = [sheet(rng, light) for _ in range(frames)]
    # SNR of N electrons is sqrt(N); 1 % of sigma from 30 000 px is 0.1 dB
    for found in snr_db(*pictures):
        np.testing.assert_allclose(found, 10 * np.log10(FULL_WELL * light), atol=0.15)


def test_border_and_middle_are_told_apart(rng):
    light = np.full((240, 360, 1), 0.2)
    light[40:200, 60:300] = 0.8
    central, border = snr_db(sheet(rng, light), sheet(rng, light))
    # The standard error of sigma over 40 000 px is 0.4 %, 0.03 dB.
    np.testing.assert_allclose(central, 10 * np.log10(FULL_WELL * 0.8), atol=0.15)
    np.testing.assert_allclose(border, 10 * np.log10(FULL_WELL * 0.2), atol=0.15)  # as above


def test_a_textured_sheet_spoils_one_frame_not_two(rng):
    paper = 0.6 * (1 + 0.02 * rng.normal(size=(240, 360, 1)))
    pair = sheet(rng, paper), sheet(rng, paper)
    two, _ = snr_db(*pair)
    one, _ = snr_db(pair[0])
    np.testing.assert_allclose(two, 10 * np.log10(FULL_WELL * 0.6), atol=0.15)  # as above
    assert np.all(one < two - 5)


@pytest.mark.parametrize(
    ("transmission", "read"), [(0.86, 0.0), (0.55, 0.0), (0.055, 0.0), (0.055, 30.0), (0.55, 60.0)]
)
def test_the_expected_loss_is_the_measured_one(rng, transmission, read):
    bare, coded = (snr_db(sheet(rng, light, read), sheet(rng, light, read))[0] for light in (0.8, 0.8 * transmission))
    ratio = read**2 / (0.8 * FULL_WELL)  # variance of the read noise over that of the shot noise at full light
    expected = 20 * np.log10(np.sqrt((transmission + ratio) / (1 + ratio)) / transmission)
    np.testing.assert_allclose(bare - coded, expected, atol=0.2)  # two such figures


def test_a_longer_exposure_restores_the_ratio(rng):
    bare = snr_db(sheet(rng, 0.4), sheet(rng, 0.4))[0].mean()
    coded = snr_db(sheet(rng, 0.22), sheet(rng, 0.22))[0].mean()
    longer = 0.22 * exposure_to_restore(float(bare - coded)).shot
    again = snr_db(sheet(rng, longer), sheet(rng, longer))[0].mean()
    assert again == pytest.approx(bare, abs=0.15)  # dB, of such figures as above; 0.02 is found
    # The paper's 2.3 dB: both readings
    both = exposure_to_restore(2.3)
    assert both.shot == pytest.approx(both.amplitude**2)  # rounding
    assert both.amplitude == pytest.approx(1.30, abs=0.005)  # 10^(2.3 / 20) = 1.303; the paper has three digits


def test_what_cannot_be_compared_says_so(rng):
    with pytest.raises(InputError, match="size"):
        snr_db(sheet(rng, 0.5), sheet(rng, 0.5)[1:])
    with pytest.raises(InputError, match="brightness"):
        snr_db(sheet(rng, 0.5), sheet(rng, 0.6))
