"""Gels before cameras: integrals by hand, what gels are named for, information from the whole likelihood."""

import numpy as np
import pytest

from chromaperture.optics.aperture import DESIGNS, FILMS, made_of
from chromaperture.optics.gel_spectra import (
    WAVELENGTHS_NM,
    crosstalk,
    light_named,
    own_spectrum,
    published,
    read_spectra,
    seen_by,
    strongest_line,
)
from chromaperture.optics.gels import (
    LIGHTS,
    all_information,
    best_pairs,
    cameras,
    gel_named,
    gels,
    information,
    pair_of,
    seen,
)
from chromaperture.system.errors import InputError

SOLD = {"red": "780", "green": "124", "blue": "715", "cyan": "118", "magenta": "002", "yellow": "101"}


def boxes() -> np.ndarray:
    """A camera that sees 600 to 700 as red, 500 to 590 as green, 400 to 490 as blue."""
    return np.array([[(first <= WAVELENGTHS_NM) & (last >= WAVELENGTHS_NM) for first, last in
                      ((600, 700), (500, 590), (400, 490))]], float)  # fmt: skip


def test_a_box_before_boxes_passes_its_share():
    film = (WAVELENGTHS_NM >= 550).astype(float)  # all of red, 550 to 590 of green: five samples of ten
    white, passed = crosstalk(film[None], boxes(), np.full(31, 7.0))
    np.testing.assert_allclose(passed[0, 0], [1, 0.5, 0], atol=1e-12)
    np.testing.assert_allclose(white[0], [1, 10 / 11, 10 / 11])
    # A light that rises with the wavelength: 500 + 510 ... by hand.
    _, passed = crosstalk(film[None], boxes(), WAVELENGTHS_NM)
    assert passed[0, 0, 1] == pytest.approx((550 + 560 + 570 + 580 + 590) / (5 * (500 + 590)))


SPECTRA = pytest.mark.extra("films", "lighting_filters")


# Luminous transmittance, %, of Lee's data sheets; of tungsten at 3200 K, as their chromaticities show.
@SPECTRA
@pytest.mark.parametrize(
    ("number", "percent"),
    [("002", 34.2), ("101", 80.7), ("118", 19.2), ("141", 14.0), ("768", 63.2), ("106", 12.8), ("139", 10.1)],
)
def test_gels_pass_the_light_that_their_maker_states(number, percent):
    def lobe(peak: float, low: float, high: float) -> np.ndarray:
        return np.exp(-0.5 * ((WAVELENGTHS_NM - peak) / np.where(peak > WAVELENGTHS_NM, low, high)) ** 2)

    # The eye's response as two lobes (Wyman, Sloan, Shirley 2013), good to about 1 %.
    eye = 0.821 * lobe(568.8, 46.9, 40.5) + 0.286 * lobe(530.9, 16.3, 31.1)
    lamp = eye * WAVELENGTHS_NM**-5.0 / np.expm1(1.4388e7 / (WAVELENGTHS_NM * 3200))
    assert 100 * (published()[number] @ lamp) / lamp.sum() == pytest.approx(percent, abs=0.8)


@pytest.mark.parametrize("light", LIGHTS)
def test_neutral_gels_pass_the_density_that_they_are_named_for(light):
    for number, density in (("298", 0.15), ("209", 0.3), ("210", 0.6), ("211", 0.9)):
        # To 0.06 of density: by their maker's luminous figures they are off by 0.03, and they are not quite grey.
        assert -np.log10(seen(light).passed[gels()[number]]) == pytest.approx(density, abs=0.06)


@pytest.mark.parametrize(
    ("number", "mired"), [("204", 159), ("205", 109), ("206", 64), ("201", -137), ("202", -78), ("203", -35)]
)
def test_correction_gels_move_the_colour_of_the_light_as_they_are_named(number, mired):
    """Daylight is 6504 K, tungsten 2856 K; log(red / blue) is nearly linear in 1e6 / K between them."""
    day, lamp = seen("daylight"), seen("tungsten")
    start, end = (day, lamp) if mired > 0 else (lamp, day)
    passed = start.passed[gels()[number]]
    moved, whole = (np.log(w[:, 0] / w[:, 2]) - np.log(start.white[:, 0] / start.white[:, 2])
                    for w in (start.white * passed, end.white))  # fmt: skip
    # 0.15 of the way from one lamp to the other: the eye, for which they are made, is no camera.
    assert moved / whole == pytest.approx(abs(mired) / (1e6 / 2856 - 1e6 / 6504), abs=0.15)


def whole_likelihood(first: np.ndarray, second: np.ndarray, white: np.ndarray) -> float:
    """Fisher information about the disparity with every sample of the texture unknown, by finite differences."""
    rng = np.random.default_rng(3)
    samples, frequency = 64, np.fft.fftfreq(64)
    texture = 1e-3 * rng.standard_normal(samples)
    texture -= texture.mean()

    def photograph(half_disparity: float, light: np.ndarray) -> np.ndarray:
        def moved(by: float) -> np.ndarray:
            return np.fft.ifft(np.fft.fft(light) * np.exp(2j * np.pi * frequency * by)).real

        halves = moved(half_disparity), moved(-half_disparity)
        return np.concatenate([w * (a * halves[0] + b * halves[1]) / 2 for w, a, b in
                               zip(white, first, second, strict=True)])  # fmt: skip

    step = 1e-4
    columns = [(photograph(step, 1 + texture) - photograph(-step, 1 + texture)) / (2 * step)]
    columns += [photograph(0, 1 + texture + sample) - photograph(0, 1 + texture) for sample in np.eye(samples)]
    jacobian = np.stack(columns, axis=1)
    fisher = jacobian.T @ (jacobian / photograph(0, 1 + texture)[:, None])  # photon noise
    return fisher[0, 0] - fisher[0, 1:] @ np.linalg.solve(fisher[1:, 1:], fisher[1:, 0])


def test_information_is_that_of_the_whole_likelihood():
    white = np.array([0.6, 1.0, 0.7])
    pairs = [
        ((0.09, 0.36, 0.64), (0.73, 0.34, 0.05)),
        ((0.15, 0.53, 0.63), (0.81, 0.60, 0.16)),
        ((0.9, 0.1, 0.5), (0.2, 0.8, 0.3)),
    ]
    pairs = [tuple(map(np.array, pair)) for pair in pairs]
    exact = np.array([whole_likelihood(*pair, white) for pair in pairs])
    found = np.array([float(information(*pair, white)[0]) for pair in pairs])
    # One unit for all: the energy of the texture's slope. The texture is faint, 0.1 %.
    np.testing.assert_allclose(found / found[0], exact / exact[0], rtol=2e-3)


def test_alike_films_tell_nothing_and_darker_ones_less():
    a, b, white = np.array([0.1, 0.4, 0.7]), np.array([0.8, 0.6, 0.2]), np.ones(3)
    assert information(a, a, white)[0] == pytest.approx(0, abs=1e-15)
    assert information(a, 0.5 * a, white)[0] == pytest.approx(0, abs=1e-15)  # a displacement of all channels alike
    assert information(a, b, white)[0] == pytest.approx(information(b, a, white)[0])
    # Half of the light, half of the information; exposed to the same level they tell the same.
    told, brightest = information(a / 2, b / 2, white)
    assert told == pytest.approx(information(a, b, white)[0] / 2)
    assert told / brightest == pytest.approx(np.divide(*information(a, b, white)))


def test_the_best_pairs_are_the_best_and_each_gel_comes_once():
    what = seen("daylight", "Canon EOS R5")
    told = all_information(what)
    numbers = list(gels())
    rng = np.random.default_rng(1)
    for which in (0, 1):
        pairs = best_pairs(what, told[which], 5)
        named = [gel.number for pair in pairs for gel in pair]
        assert len(set(named)) == 10
        tells = [pair_of(*pair, what).information[which] for pair in pairs]
        assert tells == sorted(tells, reverse=True)
        for first, second in rng.choice(numbers, (40, 2)):  # by the other way, one pair at a time
            assert pair_of(gels()[first], gels()[second], what).information[which] <= tells[0] * (1 + 1e-12)
        for first, second in pairs:  # the bluer one stands first, as cyan does
            assert np.subtract(*(what.passed[gel][0, 2] - what.passed[gel][0, 0] for gel in (first, second))) > 0


def test_egg_yolk_with_bright_blue_tells_a_third_more_than_the_pair_named_cyan_and_yellow():
    what = seen("daylight")
    best, common = (pair_of(gels()[a], gels()[b], what) for a, b in (("141", "768"), ("115", "101")))
    assert best.information[0] / common.information[0] > 4 / 3
    assert best.exposure > common.exposure  # and costs light


def test_the_model_of_sold_film_is_what_the_table_says():
    what = seen("daylight")
    assert what.white.shape == (len(cameras()), 3)
    for name, number in SOLD.items():
        passed = what.passed[gel_named(number)].mean(axis=0)
        np.testing.assert_allclose(FILMS["lee"][name].transmission, passed, atol=0.0051)  # two digits are written


def test_the_table_is_of_cameras_and_lights_by_name():
    for light in LIGHTS:
        every = seen(light)
        assert every.white.max(axis=1) == pytest.approx(1)
        for i in (0, 20, 51):
            one = seen(light, cameras()[i])
            np.testing.assert_array_equal(one.white[0], every.white[i])
            np.testing.assert_array_equal(one.passed[gels()["118"]][0], every.passed[gels()["118"]][i])
    red_over_blue = [np.divide(*seen(light).white[:, [0, 2]].T) for light in ("tungsten", "daylight")]
    assert (red_over_blue[0] > 2 * red_over_blue[1]).all()


@SPECTRA
@pytest.mark.parametrize("light", LIGHTS)
def test_no_channel_sees_more_or_less_of_a_gel_than_it_passes_somewhere(light):
    spectra = published()
    for gel, passed in seen(light).passed.items():
        spectrum = spectra[gel.number]
        assert spectrum.min() - 0.0006 <= passed.min()  # thousandths are written
        assert passed.max() <= spectrum.max() + 0.0006


def test_gels_go_by_number_and_name():
    for text in ("2", "002", "L002", "Lee 2", "rose pink"):
        assert gel_named(text).title == "002 Rose Pink"
    for text, near in (("999", "799 Special KH Lavender"), ("brigt blue", "141 Bright Blue"), ("116 ", None)):
        if near is None:
            assert gel_named(text).number == "116"
        else:
            with pytest.raises(InputError, match=near):
                gel_named(text)


def test_an_aperture_is_made_of_gels_in_the_order_of_its_pieces():
    by_number, by_model = (made_of(DESIGNS["cmy_squares"], film) for film in ("118, 002,101", "lee"))
    for part, other in zip(by_number.parts, by_model.parts, strict=True):
        np.testing.assert_allclose(part.filter.transmission, other.filter.transmission, atol=0.0051)
    with pytest.raises(InputError, match=r"takes 3 gels \(cyan, magenta, yellow\); film '118,101' is 2"):
        made_of(DESIGNS["cmy_squares"], "118,101")


def write(path, rows, head="wavelength_nm,value") -> str:
    path.write_text("\n".join([head, *(",".join(f"{float(v):g}" for v in row) for row in rows)]), encoding="utf-8")
    return str(path)


def narrow(tmp_path, *centres_nm) -> str:
    """A camera whose channels see 10 nm each."""
    fine = np.arange(400, 701)
    return write(tmp_path / "camera.csv", zip(fine, *(abs(fine - at) <= 5 for at in centres_nm), strict=True),
                 "# mine\nnm;r;g;b")  # fmt: skip


@SPECTRA
@pytest.mark.parametrize("light", LIGHTS)
def test_a_camera_of_narrow_channels_sees_the_spectrum_itself(tmp_path, light):
    own = gel_named(write(tmp_path / "mine.csv", [(400, 0.2), (500, 0.4), (700, 0.8)]))
    what = seen_by(narrow(tmp_path, 600, 540, 450), light, [own])
    assert what.passed[own][0] == pytest.approx([0.6, 0.48, 0.3])
    for number in ("118", "768"):
        spectrum = published()[number]
        expected = [spectrum[nm == WAVELENGTHS_NM][0] for nm in (600, 540, 450)]
        assert what.passed[gels()[number]][0] == pytest.approx(expected)
    assert set(what.passed) == {own, *gels().values()}


def test_a_line_keeps_its_place(tmp_path):
    """A flat camera behind a line at 546.1 nm sees the film's transmission there."""
    light = light_named(write(tmp_path / "line.csv", [(545.5, 0), (546, 1), (546.5, 0)]))
    film = 0.5 + 0.4 * np.sin(WAVELENGTHS_NM / 30)
    _, passed = crosstalk(film[None], np.ones((1, 3, 31)), light)
    assert passed[0, 0, 0] == pytest.approx(np.interp(546, WAVELENGTHS_NM, film))


def test_the_strongest_line_is_found(tmp_path):
    flat = [(nm, 1) for nm in range(380, 781, 5)]
    line = [(nm, 101 if nm == 545 else 1) for nm in range(380, 781)]  # 100 of 501
    assert strongest_line(write(tmp_path / "flat.csv", flat))[1] == pytest.approx(11 / 401)
    at_nm, share = strongest_line(write(tmp_path / "line.csv", line))
    assert at_nm == pytest.approx(545)
    assert share == pytest.approx(111 / 501)


BAD = {
    "words": ("no numbers\nat all", "on three lines or more"),
    "late words": ("400,1\n500,1\nabc,1\n600,1", "line 3 holds no numbers"),
    "columns": ("400,1\n500,1,2\n600,1", "line 2 needs 2 numbers"),
    "decimal comma": ("400;0,5\n500;0,5\n600;0,5", "line 1 needs 2 numbers"),
    "negative": ("400,1\n500,-1\n700,1", "line 2 needs 2 numbers from 0 up"),
    "not finite": ("400,1\n500,nan\n700,1", "line 2"),
    "falling": ("700,1\n500,1\n400,1", "must rise"),
    "twice": ("400,1\n400,1\n700,1", "must rise"),
    "micrometres": ("0.4,1\n0.5,1\n0.7,1", "in nanometres"),
    "short": ("500,1\n550,1\n600,1", "cover at least 430 to 650 nm"),
    "black": ("400,0\n500,0\n700,0", "0 everywhere"),
    "percent": ("400,10\n500,50\n700,80", "shares from 0 to 1"),
    "empty": ("", "on three lines or more"),
}


@pytest.mark.parametrize(("text", "says"), BAD.values(), ids=BAD)
def test_a_bad_table_is_refused_with_its_line(tmp_path, text, says):
    path = tmp_path / "film.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=says):
        own_spectrum(str(path))


def test_light_is_dark_beyond_its_table_and_film_is_not(tmp_path):
    path = write(tmp_path / "t.csv", [(430, 1), (500, 1), (650, 1)])
    assert read_spectra(path, ["power"], whole=False)[0][[0, 49, 50, 270, 271]].tolist() == [0, 0, 1, 1, 0]
    assert read_spectra(path, ["transmission"]).min() == 1


def test_a_light_that_a_channel_does_not_see_is_refused(tmp_path):
    sodium = light_named(write(tmp_path / "sodium.csv", [(588, 0), (589, 1), (590, 0)]))
    with pytest.raises(InputError, match="hardly sees this light"):
        crosstalk(np.ones((1, 31)), boxes(), sodium)
