"""Two prints, neutral and coloured, tell where the chroma of files lies; planes are sampled where the truth says."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from chromaperture.capture.native_planes import Planes, rgb_of_planes
from chromaperture.capture.picture_format import FORM, PictureFormat
from chromaperture.color.encoding import SITINGS
from chromaperture.evaluation.chroma_siting import check_siting, find_chroma_error, siting_without_error
from chromaperture.model.camera_file import Calibration
from chromaperture.products.samples import sample_camera
from chromaperture.system.errors import InputError
from test_native_planes import GREY, HEIGHT, ORANGE, WIDTH, clip, grid, planes_of, scene, sites

LEAF, BLUE, BEIGE = (0.2, 0.5, 0.3), (0.4, 0.6, 0.9), (0.75, 0.7, 0.6)
JPEG = {"jpg": {"quality": 95, "subsampling": 2}, "webp": {"quality": 95}}


def form_of(factors, siting):
    return PictureFormat("", (WIDTH, HEIGHT), 8, factors, siting, luma_weights=(0.299, 0.114))


def noisy(planes, rng, counts=3.0):
    parts = (planes.luma, counts), (planes.blue, 0.7 * counts), (planes.red, 0.7 * counts)
    return Planes(*((p + rng.normal(0, s, p.shape)).round().clip(0, 255).astype(np.uint8) for p, s in parts))


def found_in(neutral, coloured, factors, stated):
    form = form_of(factors, stated)
    found = find_chroma_error(*(rgb_of_planes(planes, form) for planes in (neutral, coloured)), form)
    return found, siting_without_error(found, form)


# ---- planes


@pytest.mark.parametrize("apart", [0.0, 3.0])
@pytest.mark.parametrize("true", SITINGS)
@pytest.mark.parametrize("stated", SITINGS)
def test_all_pairs_of_true_and_stated_siting_are_told_apart(true, stated, apart, rng):
    neutral, coloured = (noisy(planes_of(c, (2, 2), true, apart_px=apart), rng) for c in (GREY, ORANGE))
    found, siting = found_in(neutral, coloured, (2, 2), stated)
    expected = np.subtract(sites((2, 2), stated), sites((2, 2), true))
    # Beyond the first order of the formula .02 px, of parallax .06; noise leaves .015.
    np.testing.assert_allclose(found.error_px, expected, atol=0.1)
    assert siting == true


@pytest.mark.parametrize("factors", [(2, 1), (4, 1), (1, 2)])
@pytest.mark.parametrize("true", SITINGS)
@pytest.mark.parametrize("stated", SITINGS)
def test_other_subsamplings(factors, true, stated):
    neutral, coloured = (planes_of(c, factors, true) for c in (GREY, ORANGE))
    _, siting = found_in(neutral, coloured, factors, stated)
    assert sites(factors, siting) == sites(factors, true)  # of 4:2:2 left and top-left are the same
    assert siting == stated or sites(factors, stated) != sites(factors, true)


@pytest.mark.parametrize("colour", [ORANGE, LEAF, BLUE])
def test_the_error_bar_is_that_of_the_noise(colour, rng):
    errors, sigmas = [], []
    for _ in range(8):
        neutral, coloured = (noisy(planes_of(c, (2, 2), "left", apart_px=1.0), rng) for c in (GREY, colour))
        found, siting = found_in(neutral, coloured, (2, 2), "centre")
        errors.append(found.error_px)
        sigmas.append(found.sigma_px)
        assert siting == "left"
    # Standard deviations of eight are known to a quarter; two axes of them.
    assert 0.5 < np.std(errors, axis=0, ddof=1).mean() / np.mean(sigmas) < 1.6


def test_what_is_not_in_the_prints_does_not_count(rng):
    """A print in the middle third of the frame, in front of other things: grey, blank, noisy."""
    prints = []
    for colour in (GREY, ORANGE):
        planes, around = planes_of(colour, (2, 2), "left"), planes_of((0.5, 0.52, 0.5), (2, 2), "left", apart_px=5.0)
        parts = []
        for inner, outer, n in zip(vars(planes).values(), vars(around).values(), (1, 2, 2), strict=True):
            part = outer.copy()
            part[:, WIDTH * 3 // 4 // n :] = 100
            inside = np.s_[60 // n : 320 // n, 80 // n : 350 // n]
            part[inside] = inner[inside]
            parts.append(part)
        prints.append(noisy(Planes(*parts), rng))
    found, siting = found_in(*prints, (2, 2), "centre")
    assert siting == "left"
    assert 4 <= found.windows < 30  # of 35


def test_the_colour_of_the_texture_counts_not_that_of_the_print():
    """Orange ink on white paper: of dark texture on orange the mean may be the same, blue against luma is not."""
    planes = planes_of(tuple(1 - c for c in ORANGE), (2, 2), "left")
    ink = Planes(255 - planes.luma, *((256 - p.astype(int)).clip(0, 255) for p in (planes.blue, planes.red)))
    found, siting = found_in(planes_of(GREY, (2, 2), "left"), ink, (2, 2), "centre")
    np.testing.assert_allclose(found.error_px, [0.5, 0], atol=0.05)
    assert siting == "left"


@pytest.mark.parametrize(
    ("planes", "contrast"),
    [
        (lambda rng: planes_of(BEIGE, (2, 2), "left"), 0.25),
        (lambda rng: planes_of(GREY, (2, 2), "left"), 0.0),
        (lambda rng: noisy(Planes(*(np.full(s, 128, np.uint8) for s in ((384, 512), (192, 256), (192, 256)))), rng),
         np.nan),
        (lambda rng: Planes(*(np.full(s, 128, np.uint8) for s in ((384, 512), (192, 256), (192, 256)))), np.nan),
        (lambda rng: stripes(), np.nan),
    ],
)  # fmt: skip
def test_a_weak_colour_no_texture_or_stripes_tell_nothing(planes, contrast, rng):
    found, siting = found_in(planes_of(GREY, (2, 2), "left"), planes(rng), (2, 2), "centre")
    assert siting is None
    np.testing.assert_allclose(found.contrast, contrast, atol=0.02)


def stripes():
    luma = np.tile(128 + 60 * np.sin(np.arange(512) / 7), (384, 1))
    return Planes(*(p.astype(np.uint8) for p in (luma, 256 - luma[::2, ::2] / 2, luma[::2, ::2] / 2 + 64)))


def test_much_noise_or_a_place_that_is_no_siting_tell_nothing(rng):
    neutral, leaf, orange = (planes_of(c, (2, 2), "left") for c in (GREY, LEAF, ORANGE))
    found, siting = found_in(neutral, noisy(leaf, rng, 12.0), (2, 2), "left")
    assert siting is None
    assert not (found.sigma_px < 0.05).all()
    elsewhere = planes_of(ORANGE, (2, 2), "left", apart_px=0.5)  # at another distance than the neutral print
    found, siting = found_in(neutral, elsewhere, (2, 2), "left")
    assert found.error_px[0] == pytest.approx(0.5 / found.contrast, abs=0.03)
    assert siting is None
    assert found_in(neutral, orange, (2, 2), "left")[1] == "left"


# ---- files


@pytest.fixture(scope="module")
def camera():
    return Calibration.load(sample_camera("still_life_cy_halves"))


def stating(camera, siting):
    return replace(camera, sensor=replace(camera.sensor, siting=siting))


@pytest.mark.parametrize("suffix", JPEG)
def test_photographs(tmp_path, camera, rng, suffix):
    paths = [tmp_path / f"{name}.{suffix}" for name in ("neutral", "orange")]
    for path, colour in zip(paths, (GREY, ORANGE), strict=True):
        counts = 255 * scene(grid(), colour, 3.0) + rng.normal(0, 4, (HEIGHT, WIDTH, 3))
        Image.fromarray(counts.round().clip(0, 255).astype(np.uint8)).save(path, **JPEG[suffix])
    fine, wrong = check_siting(*paths, camera), check_siting(*paths, stating(camera, "left"))
    assert (fine.verdict, fine.finding) == ("ok", "chroma lies where it is taken for (siting centre)")
    assert wrong.verdict == "warn"
    assert "chroma lies in the middle, not at the left" in wrong.finding
    assert 'siting = "centre"' in wrong.advice


@pytest.fixture
def left_sited(tmp_path):
    """A clip of each print whose chroma lies at the left, without loss, and as PNG."""
    for name, colour in (("neutral", GREY), ("orange", ORANGE), ("beige", BEIGE)):
        planes = planes_of(colour, (2, 2), "left", full=False)
        clip(tmp_path / f"{name}.mkv", "ffv1", "yuv420p", planes, code=5, times=(0,))
        Image.fromarray(np.rint(255 * scene(grid(), colour)).astype(np.uint8)).save(tmp_path / f"{name}.png")
    return tmp_path


def test_the_error_in_mm_is_that_of_the_depth_curve(left_sited, camera):
    paths = left_sited / "neutral.mkv", left_sited / "orange.mkv"
    found = check_siting(*paths, stating(camera, "centre"))
    model = camera.on_axis("real-time")
    # .93 px of R against B by the formula; the camera has 720 px for the clip's 512, disparity is half of it.
    expected_mm = 0.93 / 2 * 720 / 512 * (1000 - model.sensor_to_pupil_mm) ** 2 / model.scale_px_mm
    told_px, told_mm = (float(found.finding.split(unit)[0].split()[-1]) for unit in (" px", " mm"))
    assert told_px == pytest.approx(0.93, abs=0.06)
    assert told_mm == pytest.approx(expected_mm, rel=0.12)  # near objects read 7 % off the plain curve
    assert found.finding.endswith("mm at 1 m")


def test_a_camera_file_that_was_made_by_another_siting_is_named(left_sited, camera):
    paths = left_sited / "neutral.mkv", left_sited / "orange.mkv"
    assert check_siting(*paths, camera).advice == ""
    other = replace(camera, provenance={**camera.provenance, FORM: {"siting": "centre"}})
    assert check_siting(*paths, other).advice.endswith("made with siting centre: calibrate again with left")


def test_files_of_two_formats_are_refused(left_sited, camera):
    with pytest.raises(InputError, match=r"neutral\.mkv is ffv1.*orange\.png is PNG.*one format"):
        check_siting(left_sited / "neutral.mkv", left_sited / "orange.png", camera)


def test_the_command_and_its_exit_codes(left_sited, run):
    def checked(neutral, coloured, *options):
        camera = ("--camera", sample_camera("still_life_cy_halves"))
        result = run("check", left_sited / neutral, "--coloured", left_sited / coloured, *camera, *options, "--json")
        assert result.stderr == ""
        told = json.loads(result.stdout)
        assert told["exit_code"] == result.returncode
        (test,) = told["checks"]
        return result.returncode, told["ok"], test["verdict"], test["finding"] + "; " + test["advice"]

    assert checked("neutral.mkv", "orange.mkv")[:3] == (0, True, "ok")
    *told, text = checked("neutral.mkv", "orange.mkv", "--siting", "centre")
    assert told == [1, False, "warn"]
    assert "say --siting left" in text
    *told, text = checked("neutral.mkv", "beige.mkv")
    assert told == [2, True, "cannot tell"]
    assert "differ too little in colour" in text
    *told, text = checked("neutral.png", "orange.png")
    assert told == [0, True, "ok"]
    assert "stores every colour in every pixel: there is nothing to check" in text
    result = run("check", left_sited / "neutral.mkv", "--coloured", left_sited / "none.mkv", "--camera",
                 sample_camera("still_life_cy_halves"))  # fmt: skip
    assert (result.returncode, result.stderr.count("\n")) == (2, 1)
    result = run("check", left_sited / "neutral.mkv", "--coloured", left_sited / "orange.mkv", "--camera",
                 sample_camera("still_life_cy_halves"))  # fmt: skip
    assert "Chroma is read right." in result.stdout
