"""A chessboard is its own negative one square on: that shows the tone curve that a camera laid over its light."""

import re
import shutil
import warnings

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from chromaperture.calibration import fit_response as fit
from chromaperture.calibration.chessboard import board_color, color_notes, find_corners
from chromaperture.calibration.fit_response import fit_response, fold_board, with_response
from chromaperture.calibration.session import read_session
from chromaperture.camera.camera import load_camera
from chromaperture.capture.files import read_light
from chromaperture.color.encoding import KNOTS, Encoding, ResponseCurve, develop_counts
from chromaperture.color.srgb import linear_to_srgb, srgb_to_linear
from chromaperture.model.camera_file import Calibration
from chromaperture.optics.pinhole import PupilCamera
from chromaperture.system.errors import CaptureWarning
from worlds import render_boards

CORNERS = (9, 6)
SQUARE_PX, LEFT_TOP_PX = 21.3, (62.4, 51.7)
exponents = st.lists(st.floats(0.2, 5), min_size=2, max_size=12).map(tuple)


def s_curve(light):
    """A camera's picture style: sRGB with more contrast in the middle, less at both ends."""
    code = linear_to_srgb(light).astype(float)
    return code - 0.06 * np.sin(2 * np.pi * code)


CURVES = {
    "linear": lambda light: light,
    "sRGB": lambda light: linear_to_srgb(light).astype(float),
    "gamma 1.8": lambda light: light ** (1 / 1.8),
    "BT.709": lambda light: np.where(light < 0.018, 4.5 * light, 1.099 * light**0.45 - 0.099),
    "S-curve": s_curve,
}


def board(radius_px, *, mottle=0.0, seed=1, tint=(0.6, 0.8, 0.5), shift_px=3.0):
    """Light of a chessboard behind three half discs of blur, displaced by channel, and its corners.

    Drawn five times finer and averaged; ``mottle`` is the standard deviation of the paper's own texture.
    """
    fine, (height, width) = 5, (230, 340)
    y, x = ((np.arange(n * fine) + 0.5) / fine - 0.5 for n in (height, width))
    column, row = (x - LEFT_TOP_PX[0]) / SQUARE_PX, (y - LEFT_TOP_PX[1]) / SQUARE_PX
    black = (np.floor(column)[None] + np.floor(row)[:, None]) % 2 == 0
    inside = ((column >= -1) & (column < CORNERS[0]))[None] & ((row >= -1) & (row < CORNERS[1]))[:, None]
    paper = np.where(inside & black, 0.04, 0.92)
    rng = np.random.default_rng(seed)
    paper = paper * (1 + mottle * cv2.GaussianBlur(rng.standard_normal(paper.shape), (0, 0), 2.0 * fine) * 2 * fine)
    radius = radius_px * fine
    v, u = np.mgrid[-radius : radius + 1, -radius : radius + 1]
    disc = (u**2 + v**2 <= radius**2).astype(float)
    parts = (disc * (u < 0), disc, disc * (u >= 0))
    channels = []
    for kernel, color in zip(parts, tint, strict=True):
        blurred = cv2.filter2D(paper, -1, kernel / kernel.sum(), borderType=cv2.BORDER_REPLICATE)
        channels.append(color * blurred.reshape(height, fine, width, fine).mean(axis=(1, 3)))
    corners = np.stack(
        np.meshgrid(*(np.arange(n) * SQUARE_PX + o for n, o in zip(CORNERS, LEFT_TOP_PX, strict=True))), -1
    )
    return np.stack(channels, -1), corners.reshape(-1, 2).astype(np.float32)


@pytest.fixture(scope="module")
def blurred_boards():
    return [board(radius, seed=radius) for radius in (1, 2, 4, 6, 8)]


def decoded(light, name):
    """What is read of a file of 8 bits with a curve, which is taken for sRGB, with a little noise."""
    noise = np.random.default_rng(5).normal(0, 0.003, light.shape)
    code = CURVES[name](np.clip(light + noise * np.sqrt(light), 0, 1))
    return srgb_to_linear(np.rint(255 * code) / 255)


@pytest.mark.parametrize("name", CURVES)
def test_the_curve_comes_back(name):
    """Light to .006 of white, but for a constant and a factor, which a chessboard does not tell; exponents to .1."""
    boards = [board(radius, seed=radius) for radius in (4, 6, 8)]
    folded = [fold_board(decoded(light, name), corners, CORNERS) for light, corners in boards]
    found = fit_response(folded)
    values = np.concatenate([part.ravel() for f in folded for part in (f.even, f.odd)])
    places = np.linspace(*np.percentile(values, (2, 98)), 60)
    light = np.linspace(1e-5, 1, 200_001)
    of_light = srgb_to_linear(CURVES[name](light)).astype(float)
    true, fitted = np.interp(places, of_light, light), found.curve.light(places).astype(float)
    scale, offset = np.polyfit(fitted, true, 1)
    assert np.sqrt(np.mean((scale * fitted + offset - true) ** 2)) < 0.006
    low, high = (np.interp(places * ratio, of_light, light) for ratio in (1 / 1.05, 1.05))
    exponent = np.log(high / low) / np.log(1.05**2)
    bright = places > np.percentile(values, 25)  # darker, the constant matters
    assert np.sqrt(np.mean((found.curve.exponent(places) - exponent)[bright] ** 2)) < 0.1
    assert (found.deviation < 0.02) == (name == "sRGB")  # the limit is .12
    assert found.misfit < 0.01


@given(
    gain=st.floats(0.5, 2),
    exposures=st.lists(st.floats(0.2, 1), min_size=5, max_size=5),
    channel=st.sampled_from([0, 1, 2]),
    which=st.integers(0, 4),
)
def test_a_white_balance_that_changes_is_named(blurred_boards, gain, exposures, channel, which):
    """Boards of any blur and exposure have one colour; one whose channel has another gain is named, and by how much."""
    colors = {}
    for i, ((light, corners), exposure) in enumerate(zip(blurred_boards, exposures, strict=True)):
        gains = np.full(3, exposure)
        gains[channel] *= gain if i == which else 1
        colors[f"{i}.png"] = board_color(light * gains, corners)
    notes = color_notes(colors)
    if abs(np.log(gain)) < 0.06:
        assert notes == ()
    elif abs(np.log(gain)) > 0.1:
        percent = int(re.search(r"up to (\d+)% \((\d)\.png\)", *notes)[1])
        # What blur brings from around the board moves colours by .015.
        assert percent == pytest.approx(100 * np.expm1(abs(np.log(gain))), rel=0.02, abs=4)
        assert f"({which}.png)" in notes[0]


def test_boards_of_unknown_colour_are_left_out():
    white = np.ones(3)
    assert color_notes({}) == () == color_notes({"dark": np.zeros(3), "saturated": np.full(3, np.nan)})
    assert color_notes({"a": white, "b": white, "dark": np.zeros(3)}) == ()


def test_mottled_paper_and_uneven_light_bend_no_curve():
    boards = []
    for radius in (4, 6, 8):
        light, corners = board(radius, mottle=0.05, seed=radius)
        ramp = np.linspace(1, 0.8, light.shape[1])[None, :, None]
        boards.append(fold_board((light * ramp).astype(np.float32), corners, CORNERS))
    assert fit_response(boards).deviation < 0.03


@given(exponents)
def test_light_rises_with_the_values_and_keeps_its_ends(powers):
    curve = ResponseCurve(powers)
    light = curve.light(np.concatenate([[-0.01, 0], np.linspace(0.001, 1, 500), [1.2, np.nan]]))
    assert (np.diff(light[:-1]) >= 0).all()
    assert np.isnan(light[-1])
    np.testing.assert_allclose(light[[1, -3, -2]], [0, 1, 1.2], atol=1e-6)


@given(st.floats(0.3, 3))
def test_one_exponent_is_a_power(power):
    values = np.linspace(0.001, 1, 300)
    light = ResponseCurve((power,) * KNOTS).light(values)
    # Between the places of the table the power is taken as straight: at .01 they are 5 % apart, (.05 q)^2 / 8 at most.
    np.testing.assert_allclose(light[values > 0.01], values[values > 0.01] ** power, rtol=3e-3)
    np.testing.assert_allclose(ResponseCurve((power,) * KNOTS).exponent(values), power)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_all_kinds_of_counts_become_the_same_light(rng, dtype):
    """By table or one by one; levels first, then the curve, then the response."""
    curve = ResponseCurve((0.6, 0.8, 1.5))
    counts = rng.integers(0, 256, (30, 40, 3)).astype(dtype)
    encoding = Encoding(4.0, 250.0, "srgb", response=curve)
    expected = curve.light(srgb_to_linear((counts.astype(np.float32) - 4) / 246))
    np.testing.assert_allclose(develop_counts(counts, encoding), expected, rtol=1e-6)


SUFFIXES = {"sRGB": ".png", "S-curve": ".jpg", "8 bits": ".png"}


@pytest.fixture(scope="module")
def linear(tmp_path_factory):
    """A session of rendered boards in linear counts."""
    folder = tmp_path_factory.mktemp("tones") / "linear"
    camera = PupilCamera(360, 240, 800.0, 12.5, 1800.0, 50.0, 0.06)
    render_boards(folder, camera, (1000, 1250, 1500, 2200, 2800))
    return folder


def through(linear, folder, name):
    """The same photographs as deep sRGB, as JPEG with a picture style, or as 8-bit files of linear counts."""
    plain, suffix = read_session(linear), SUFFIXES[name]
    shutil.copytree(linear, folder)
    for path in sorted(folder.rglob("*.png")):
        code = CURVES["linear" if name == "8 bits" else name](
            np.clip(plain.read(linear / path.relative_to(folder)), 0, 1)
        )
        path.unlink()
        if name == "sRGB":
            cv2.imwrite(str(path), np.rint(65535 * code).astype(np.uint16)[..., ::-1])
        else:
            written = np.rint(255 * code).astype(np.uint8)
            Image.fromarray(written).save(path.with_suffix(suffix), quality=97, subsampling=0)
    table = (folder / "distances.csv").read_text()
    (folder / "distances.csv").write_text(table.replace(".png", suffix))
    settings = (folder / "session.toml").read_text().splitlines()
    left_out = ("black_level", "white_level", "full_well", "read_noise")
    (folder / "session.toml").write_text("\n".join(line for line in settings if not line.startswith(left_out)))
    return folder


@pytest.mark.slow
@pytest.mark.parametrize(("name", "curve"), [("sRGB", "srgb"), ("S-curve", "srgb"), ("8 bits", "linear")])
def test_a_session_behind_a_curve_is_decoded_as_its_light(linear, tmp_path, name, curve):
    """Also the photographs that are measured later, without a word about 8 bits."""
    folder = through(linear, tmp_path / "bent", name)
    session = read_session(folder)
    corners = {path: find_corners(session.read(path)[..., 1], session.inner_corners) for path in session.boards}
    assert all(c is not None for c in corners.values())
    found, notes = with_response(session, corners)
    assert found.sensor.curve == curve
    assert len(notes) == (1 if name == "sRGB" else 2)  # the others have 8 bits
    assert (found.sensor.response is not None) == (name == "S-curve")
    plain = read_session(linear)
    for path, expected in zip(found.boards, plain.boards, strict=True):
        light = found.read(path)
        np.testing.assert_array_equal(session.decoded_as(found.sensor).read(path), light)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            np.testing.assert_array_equal(read_light(path, camera_encoding=found.sensor.encoding).image, light)
        ours, true = (cv2.blur(image, (5, 5)).ravel() for image in (light, plain.read(expected)))  # JPEG adds noise
        scale, offset = np.polyfit(ours, true, 1)
        assert np.abs(scale * ours + offset - true).mean() < 0.005
    assert with_response(plain, dict(zip(plain.boards, corners.values(), strict=True))) == (plain, ())


@pytest.mark.slow
def test_the_camera_file_keeps_the_response(linear, tmp_path, run):
    """Calibrated from a JPEG session, a camera measures its JPEG files as the linear camera does linear ones."""
    bent = through(linear, tmp_path / "bent", "S-curve")
    for folder in (linear, bent):
        assert run("calibrate", folder, "--no-blur", "--out", tmp_path / f"{folder.name}.asdf", "-q").returncode in (
            0,
            1,
        )
    ours, theirs = (Calibration.load(tmp_path / f"{name}.asdf") for name in ("bent", "linear"))
    assert any("tone curve" in note for note in ours.provenance["notes"])
    assert theirs.sensor.response is None
    assert theirs.summary()["curve"] == "linear"
    assert ours.sensor.response is not None
    assert ours.summary()["curve"] == "srgb, then a tone curve"
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        frame = load_camera(tmp_path / "bent.asdf").measure(bent / "board" / "1250.jpg")
    assert float(np.nanmedian(frame.depth_mm)) == pytest.approx(1250, rel=0.01)


def test_boards_that_only_one_decoding_saturates_are_no_error(linear, tmp_path, monkeypatch):
    """Of the other curve nothing is known then."""
    session = read_session(through(linear, tmp_path / "bent", "S-curve"))
    corners = {path: find_corners(session.read(path)[..., 1], session.inner_corners) for path in session.boards}
    folded = fit.folded_boards
    monkeypatch.setattr(
        fit, "folded_boards", lambda s, c: folded(s, c) if s.sensor.curve == session.sensor.curve else []
    )
    found, _ = with_response(session, corners)
    assert found.sensor.curve == "srgb"
    assert found.sensor.response is not None


def test_a_deep_file_tells_nothing_of_an_8_bit_camera(tmp_path):
    """The response belongs to the files that the camera was calibrated on."""
    counts = np.full((4, 5, 3), 30_000, np.uint16)
    cv2.imwrite(str(tmp_path / "deep.png"), counts)
    camera = Encoding(0.0, 255.0, "srgb", response=ResponseCurve((0.5, 1.5)))
    light = read_light(tmp_path / "deep.png", camera_encoding=camera).image
    np.testing.assert_allclose(light, 30_000 / 65535, rtol=1e-6)
    cv2.imwrite(str(tmp_path / "flat.png"), np.full((4, 5, 3), 100, np.uint8))
    with pytest.warns(CaptureWarning, match="encoded values"):
        read_light(tmp_path / "flat.png", camera_encoding=Encoding(16, 1016))
