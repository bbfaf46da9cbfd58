"""What people hand to `refocus` and `transparency`, through the command line: one clear line, or a graceful result."""

import json

import cv2
import numpy as np
import pytest
from PIL import Image

from chromaperture.capture.files import read_image
from worlds import capture, texture

QUICK = ("--design", "cy_halves", "--quality", "real-time", "--sharpness", "fast", "--strength", "1.5")
LEVELS = ("--black-level", 16, "--white-level", 1016)
SHARE = np.array([0.5, 0.75, 0.375])


def write(path, image):
    cv2.imwrite(str(path), np.rint(np.clip(image, 0, 1)[..., ::-1] * 65535).astype(np.uint16))
    return path


def refused(result, message, folder, kept):
    """One line that says what is wrong, exit code 2, nothing written; a warning may come before."""
    assert result.returncode == 2, result.stderr
    assert message in result.stderr
    assert [line.split(":")[0] for line in result.stderr.strip().splitlines()].count("error") == 1
    assert "Traceback" not in result.stderr
    assert sorted(p.name for p in folder.iterdir()) == sorted(kept)


@pytest.fixture
def photograph(rng):
    return capture(texture(rng, height=96, width=128), "cy_halves", 2.0)


def test_a_photograph_with_a_blank_wall_is_refocused_over_the_holes_of_its_depth(run, tmp_path, photograph):
    photograph[20:60, 30:90] = photograph.mean(axis=(0, 1))  # nothing to match: the depth has a hole there
    photo = write(tmp_path / "photo.png", photograph)
    result = run("refocus", photo, *QUICK, "--out", tmp_path / "out.png", "--json")
    assert result.returncode == 0, result.stderr
    assert np.isfinite(json.loads(result.stdout)["radius_range_px"]).all()
    picture = read_image(tmp_path / "out.png")
    # The wall stays as plain as it was: nothing is invented in it.
    assert picture[30:50, 45:75].std(axis=(0, 1)).max() < 0.05


def test_clipped_highlights_stay_bright_and_colourless(run, tmp_path, photograph):
    photograph[40:46, 60:66] = 1.0
    result = run("refocus", write(tmp_path / "photo.png", photograph), *QUICK[:-1], "0", "--out", tmp_path / "o.png")
    assert result.returncode == 0, result.stderr
    light = read_image(tmp_path / "o.png")[41:45, 61:65].mean(axis=(0, 1))
    assert light.min() > 0.5  # 0.88 is found; it was clipped at 1


@pytest.fixture
def sheets(tmp_path):
    """White paper without and with the aperture, and a way to spoil one of them; 10-bit counts."""
    rng = np.random.default_rng(4)
    y, x = np.mgrid[-1:1:120j, -1:1:160j]
    paper = (0.85 * (1 - 0.2 * (x**2 + y**2)))[..., None]

    def made(name, light, spoil=lambda p: p):
        light = spoil(np.broadcast_to(light * paper, (120, 160, 3)).copy())
        counts = rng.poisson(light * 20000) / 20000 * 1000 + 16
        path = tmp_path / f"{name}.png"
        cv2.imwrite(str(path), np.rint(np.clip(counts, 0, 1023)[..., ::-1]).astype(np.uint16))
        return path

    return made


def dusty(sheet):
    sheet[30:38, 50:60] *= 0.3
    return sheet


def lit_from_the_side(sheet):
    return sheet * np.linspace(0.6, 1, 160)[None, :, None]


def test_dust_and_a_gradient_of_light_do_not_matter(run, sheets, tmp_path):
    bare = sheets("bare", 1.0, lit_from_the_side)
    coded = sheets("coded", SHARE, lambda p: dusty(lit_from_the_side(p)))
    command = ("transparency", coded, "--bare", bare, *LEVELS)
    result = run(*command, "--json", "--figure", tmp_path / "figure.png")
    assert result.returncode == 0, result.stderr
    (row,) = json.loads(result.stdout)
    # The speck is 80 of 19 200 px, and left out but for its rim.
    assert row["efficiency"] == pytest.approx(SHARE.mean(), abs=5e-3)
    assert row["minimum_rgb"] == pytest.approx(SHARE, abs=0.03)
    loss = np.mean(-10 * np.log10(SHARE))  # photon noise
    assert row["snr_loss_central_db"] == pytest.approx(loss, abs=0.25)
    assert row["exposure_shot_noise"] == pytest.approx(row["exposure_amplitude"] ** 2)
    with Image.open(tmp_path / "figure.png") as figure:
        assert min(figure.size) > 300
    assert "Transparency" in run(*command).stdout
    assert run(*command, "-q").stdout == ""
    for wrong in (("--exposure", 0), ("--figure", "f.gif")):
        assert run(*command, *wrong).returncode == 2


def test_light_on_one_sheet_only_is_told_from_the_aperture_s_own(run, sheets, tmp_path):
    bare, coded = sheets("bare", 0.5), sheets("coded", 1.0 * np.array([0.9, 0.95, 0.85]))
    refused(run("transparency", coded, "--bare", bare, *LEVELS, "--figure", tmp_path / "f.png"), "exposure", tmp_path,
            ["bare.png", "coded.png"])  # fmt: skip
    result = run("transparency", coded, "--bare", bare, *LEVELS, "--exposure", 2.0, "--json")
    (row,) = json.loads(result.stdout)
    assert row["efficiency"] == pytest.approx(0.9, abs=5e-3)  # means over 19 200 px of 1 % noise


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda p: np.full_like(p, 1.02), "bare white sheet is saturated"),
        (lambda p: 0.001 * p, "dark"),
        (lambda p: p[:100], "size"),
    ],
)
def test_sheets_that_cannot_be_compared_are_refused(run, sheets, tmp_path, spoil, message):
    bare, coded = sheets("bare", 1.0, spoil), sheets("coded", SHARE)
    result = run("transparency", coded, "--bare", bare, *LEVELS, "--figure", tmp_path / "f.png")
    refused(result, message, tmp_path, ["bare.png", "coded.png"])
