"""The calibration report of a made-up camera whose every error is known."""

from __future__ import annotations

import base64
import re
from dataclasses import replace
from html.parser import HTMLParser

import cv2
import numpy as np
import pytest

from chromaperture.calibration.calibrate_blur import LayerEvidence
from chromaperture.calibration.calibrate_session import CalibrationResult
from chromaperture.calibration.chessboard import Intrinsics
from chromaperture.calibration.curves import Evidence
from chromaperture.calibration.fit_fields import DepthFit
from chromaperture.calibration.place_boards import BoardDistances
from chromaperture.calibration.read_boards import BoardMeasurement
from chromaperture.calibration.session import Session
from chromaperture.color.unmixing import view_reach
from chromaperture.depth.conversion import DepthModel, depth_to_disparity, disparity_to_depth
from chromaperture.depth.field import DepthField
from chromaperture.depth.nonlinearity import Nonlinearity
from chromaperture.evaluation import figures
from chromaperture.evaluation.figures import layer_errors, plane_residual
from chromaperture.evaluation.report import accuracy_table, report_html
from chromaperture.evaluation.verdict import (
    board_depth,
    board_errors,
    contradictions,
    depth_accuracy,
    intervals,
    sentences,
    unusable,
    weaknesses,
)
from chromaperture.model.camera_parts import Film
from chromaperture.optics.lens_blur import BlurModel
from worlds import halves_camera

WIDTH, HEIGHT = 96, 72
A, B, DELTA = 4.3, 8200.0, 52.0
BULGE = 0.2  # of A, from the middle of the frame to its edge
RULERS = np.array([1000.0, 1500.0, 2000.0, 2500.0, 3500.0])
NOISE_PX = 0.02


def infinity_at(x):
    """A over the frame: A (1 + BULGE x^2), x from -1 to 1."""
    return A * (1 + BULGE * (2 * x / (WIDTH - 1) - 1) ** 2)


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    rng = np.random.default_rng(8)
    folder = tmp_path_factory.mktemp("session")
    (folder / "board").mkdir()
    (folder / "white").mkdir()
    paths = {}
    for ruler in RULERS:
        picture = rng.integers(2000, 60000, (HEIGHT, WIDTH, 3)).astype(np.uint16)
        paths[folder / "board" / f"{ruler:.0f}.png"] = float(ruler)
        cv2.imwrite(str(folder / "board" / f"{ruler:.0f}.png"), picture)
    for name in ("open", "cy_halves"):
        sheet = np.full((HEIGHT, WIDTH, 3), (30000, 40000, 35000), np.uint16)
        cv2.imwrite(str(folder / "white" / f"{name}.png"), sheet)
    x, y = np.arange(3.0, WIDTH, 6), np.arange(3.0, HEIGHT, 6)
    boards, residuals = [], []
    for ruler in RULERS:
        noise = rng.normal(0, NOISE_PX, (len(y), len(x)))
        noise[0, 0] = np.nan  # one place without texture
        measured = (infinity_at(x)[None] - B / (ruler - DELTA) + noise).astype(np.float32)
        both = {"paper": measured, "real-time": measured}
        middle = {q: A - B / (ruler - DELTA) for q in both}
        boards.append(
            BoardMeasurement(f"{ruler:.0f}.png", ruler, middle, dict.fromkeys(both, 0.01), both, None, ruler + 1.0)
        )
        residuals.append(noise.astype(np.float32))
    # x^2 = (T0 + T2) / 2: coefficients of 1, y, y2, x, xy, x2
    infinity = A * np.array([1 + BULGE / 2, 0, 0, 0, 0, BULGE / 2])
    covariance = np.diag([1e-4, 100.0, 4.0])
    field = DepthField(infinity, np.array([B, 0, 0, 0, 0, 0.0]), DELTA, covariance)
    colors = {"cyan": np.array([0.05, 0.6, 0.7]), "yellow": np.array([0.9, 0.8, 0.05])}
    calibration = halves_camera(
        field, WIDTH, HEIGHT, focal_px=160.0, pixel_pitch_mm=0.3, far_mm=4550.0,
        film=Film(colors, np.ones(3), np.array([0.5, 0.7, 0.4])),
        provenance={"command": "chromaperture calibrate <made up>", "date": "2026-01-01"},
    )  # fmt: skip
    residual_px = np.stack(residuals)
    fit = DepthFit(DepthModel(A, B, DELTA, covariance), np.zeros(5), np.zeros(5), 0.0)
    lens = calibration.lens
    f_number = view_reach(calibration.aperture) * lens.focal_length_mm / calibration.baseline_mm
    session = Session(
        folder, "cy_halves", calibration.sensor, lens.focal_length_mm, f_number, 2000.0, (9, 6), 30.0, 3.0, paths, ()
    )  # fmt: skip
    both = ("paper", "real-time")
    ruler = BoardDistances(RULERS - DELTA, DELTA, 1.0, 1.0, np.eye(6), np.full(5, -1.0), np.full(5, 2.0))
    evidence = Evidence(calibration.sensor, boards, ruler, 3.0, np.ones(5, bool))
    return CalibrationResult(
        calibration=calibration, fits=dict.fromkeys(both, fit), notes=["a <note> & more"],
        session=session, residual_px=dict.fromkeys(both, residual_px),
        pixel_sigma_px=dict.fromkeys(both, np.full(5, NOISE_PX)),
        intrinsics=Intrinsics(calibration.lens.camera_matrix, np.zeros(5), 0.1), tilts={}, evidence=evidence,
    )  # fmt: skip


def with_evidence(result, **changes):
    return replace(result, evidence=replace(result.evidence, **changes))


def with_distances(result, **changes):
    return with_evidence(result, distances=replace(result.evidence.distances, **changes))


@pytest.fixture(scope="module")
def page(result):
    """The report, whose eleven pictures take seconds."""
    return report_html(result, title="a < b")


@pytest.fixture
def printed(run, monkeypatch):
    """A function that runs `calibrate` with a result that is there: its exit code, and what it printed in one line."""

    def printed(result, *options, report=False):
        monkeypatch.setattr("chromaperture.calibration.calibrate_session.calibrate_session", lambda *a, **k: result)
        monkeypatch.setattr("chromaperture.calibration.session.read_session", lambda folder: result.session)
        code, said, _ = run("calibrate", "session", *options, *(() if report else ("--no-report",)))
        return code, " ".join(said.split())

    return printed


def test_the_field_makes_a_flat_board_flat_again(result):
    index, before, after = figures.flat_board(result)
    assert RULERS[index] == 2500
    step = (RULERS[index] - DELTA) ** 2 / B  # mm a px
    assert after == pytest.approx(NOISE_PX * step, rel=0.15)  # 191 samples of noise: their rms is known to 5 %
    assert before > 5 * after  # the bulge has 0.26 px rms, the noise 0.02 px
    # The bulge itself: x^2 less its mean has an rms of sqrt(4 / 45) over [-1, 1]; depth is not quite linear in it.
    assert before == pytest.approx(A * BULGE * np.sqrt(4 / 45) * step, rel=0.4)
    depth = board_depth(result, index)
    assert np.isnan(depth[0, 0])
    # Four standard deviations of a mean.
    assert np.nanmedian(depth) == pytest.approx(RULERS[index], abs=4 * NOISE_PX * step / np.sqrt(depth.size))


def test_a_plane_is_taken_off(rng):
    y, x = np.indices((20, 30))
    depth = 1000 + 3.0 * x - 2.0 * y + rng.normal(0, 1.5, x.shape)
    depth[3, 4] += 500  # one wrong pixel is not the plane's
    residual, rms = plane_residual(depth)
    assert rms == pytest.approx(1.5, rel=0.1)  # 600 samples: known to 3 %
    assert residual[3, 4] == pytest.approx(500, abs=10)  # six standard deviations of its noise


def test_errors_of_boards_come_back(result):
    moved = [replace(board, ruler_mm=board.ruler_mm) for board in result.boards]
    offset = np.array(result.residual_px["real-time"], copy=True)
    offset[3] += 0.1  # px
    errors = board_errors(replace(with_evidence(result, boards=moved), residual_px={"real-time": offset}))
    z = RULERS[3] - DELTA
    assert errors[3] == pytest.approx(1 / (1 / z - 0.1 / B) - z, rel=0.05)  # noise of the median: 0.002 px of 0.1
    assert np.abs(errors[[0, 1, 2]]).max() < 3  # mm; 0.002 px are 1 mm at 2 m


def test_the_accuracy_agrees_with_drawn_cameras(result):
    """Spread of the depth over cameras drawn from the covariance and pixels drawn from the noise."""
    rng = np.random.default_rng(4)
    seen = depth_accuracy(result)
    a, b, delta = rng.multivariate_normal([A, B, DELTA], np.diag([1e-4, 100.0, 4.0]), 20000).T
    for true in (1200.0, 2400.0):
        d = A - B / (true - DELTA) + rng.normal(0, NOISE_PX, a.size)
        scatter = np.std(b / (a - d) + delta)
        # 20000 draws, and linear propagation of errors
        assert np.interp(true, seen.depth_mm, seen.pixel_sigma_mm) == pytest.approx(scatter, rel=0.05)
    step = np.interp(2400.0, seen.depth_mm, seen.step_mm)
    near, far = (B / (A - d) + DELTA for d in A - B / (2400.0 - DELTA) + np.array([-0.005, 0.005]))
    assert step == pytest.approx((far - near) / 0.01, rel=1e-3)  # interpolated between depths


@pytest.mark.parametrize("vignetted", [True, False])
def test_the_bar_is_that_of_the_whole_frame_and_has_no_jump_at_the_last_board(result, vignetted):
    """Depths of pixels drawn over the frame, at and about the last board, where the nonlinearity ends.

    With A and B the same all over the frame, all of its pixels reach the end at the last board.
    """
    rng = np.random.default_rng(5)
    fall = -0.3 * B if vignetted else 0.0  # of B from the middle to the sides, as a double Gauss has it
    scale = np.array([B + fall / 2, 0, 0, 0, 0, fall / 2])
    infinity = scale * A / B
    curve = Nonlinearity(A - B / (RULERS[0] - DELTA), A - B / (RULERS[-1] - DELTA), np.array([-0.016, 0.05, 0.04]))
    field = DepthField(infinity, scale, DELTA, np.zeros((3, 3)), curve)
    noise_px = 0.06
    known = replace(
        result,
        calibration=replace(result.calibration, depth={"real-time": field, "paper": field, "accurate": field}),
        pixel_sigma_px={"real-time": np.full(5, noise_px)},
    )
    assert float(curve.slope(curve.high_px - 1e-6)) > 1.3  # so much steeper than beyond, where it is 1
    seen = depth_accuracy(known)
    for true in (1400.0, 2500.0, 3350.0, 3500.0, 3650.0):
        x, y = rng.uniform(-0.5, WIDTH - 0.5, 20000), rng.uniform(-0.5, HEIGHT - 0.5, 20000)
        model = field.at(x, y, WIDTH, HEIGHT)
        reading = depth_to_disparity(true, model) + rng.normal(0, noise_px, x.size)
        drawn = disparity_to_depth(reading, model)[0].astype(float)
        # 20000 draws know it to 0.5 %; noise of 4 % of the distance is not small enough for a first order.
        assert np.interp(true, seen.depth_mm, seen.pixel_sigma_mm) == pytest.approx(np.std(drawn), rel=0.06), true
    before, after = (np.interp(mm, seen.depth_mm, seen.pixel_sigma_mm) for mm in (3480.0, 3520.0))
    assert after / before < 1.1  # was 1.35, the ratio of the slopes; 1.02 is due to the distance


def with_layers(result):
    """Return the result with quality accurate measured: cells that read every board 0.5 % too far, little noise."""
    camera = replace(result.calibration, blur=BlurModel(A / 0.4, B / 0.4))
    at_infinity, scale = camera.field_blur().reference
    model = DepthModel(at_infinity, scale, DELTA, np.diag([1e-6, 1.0, 1.0]))
    camera = replace(camera, depth={**camera.depth, "accurate": DepthField.constant(model)})
    read_mm = 1.005 * RULERS
    layer = np.repeat(depth_to_disparity(read_mm, model)[:, None], 7, axis=1)
    layers = LayerEvidence((WIDTH, HEIGHT), np.linspace(10, 86, 7), np.full(7, 30.0), layer, 0.05, 0.2)
    evidence = replace(result.evidence, distances=replace(result.evidence.distances, from_pupil_mm=RULERS - DELTA))
    noise = {**result.pixel_sigma_px, "accurate": np.array([0.005, np.nan, 0.005, np.nan, 0.005])}
    return replace(result, calibration=camera, layers=layers, evidence=evidence, pixel_sigma_px=noise)


@pytest.mark.slow
def test_quality_accurate_is_beside_the_others(result):
    both = with_layers(result)
    np.testing.assert_allclose(board_errors(both, "accurate"), 0.005 * RULERS, rtol=1e-3)  # float32 depth
    found = depth_accuracy(both, "accurate")
    # Between boards, and at those whose noise was not measured; 0.5 % of bias and 0.005 px.
    step = (found.depth_mm - DELTA) ** 2 / float(both.calibration.on_axis("accurate").scale_px_mm)
    inside = (found.depth_mm >= RULERS[0]) & (found.depth_mm <= RULERS[-1])
    assert np.isfinite(found.total_mm[inside]).all()
    alone = np.sqrt(found.pixel_sigma_mm**2 - found.curve_sigma_mm**2)
    np.testing.assert_allclose(alone, 0.005 * step, rtol=1e-6)
    said = [s.text for s in sentences(both)]
    assert any(s.startswith("At quality accurate, one pixel of a textured board is good to 1%") for s in said)
    assert any(s.startswith("At quality real-time, one pixel of a textured board is good to") for s in said)
    panels = figures.draw_accuracy(both).axes
    assert [axes.get_title(loc="left") for axes in panels] == ["quality real-time", "quality accurate"]
    above = figures.draw_true_against_measured(both).axes[0]
    assert [text.get_text() for text in above.get_legend().get_texts()][1:] == ["real-time", "paper", "accurate"]
    head, rows = accuracy_table(both).head, accuracy_table(both).rows
    assert "one pixel, accurate ±, mm" in head
    assert {len(row) for row in rows} == {len(head)}
    page = report_html(both, title="both")
    assert "measured on 1000.png, 2000.png, 3500.png" in page
    # Its noise not measured: said, and no headline.
    large = replace(both, pixel_sigma_px=result.pixel_sigma_px)
    assert not any("quality accurate" in s.text for s in sentences(large))
    assert "was not measured: it takes" in report_html(large, title="large")


def test_the_box_says_that_its_figures_hold_for_texture(result, page, tmp_path, printed):
    box = page[page.index('class="verdict"') : page.index("</section>")]
    _, said = printed(result, "--out", tmp_path / "camera.asdf")
    for text in (box, said):
        assert "one pixel of a textured board is good to 2%" in text
        assert "On weak texture and beside edges of objects pixels are worse" in text


@pytest.mark.slow
def test_errors_of_the_layers_are_those_put_in(result):
    """Layers that read every board 1 % too far by the blur alone, and a curve that knows."""
    camera = replace(result.calibration, blur=BlurModel(A / 0.4, B / 0.4))
    at_infinity, scale = camera.field_blur().reference
    x = np.linspace(10, 86, 7)
    layer = np.repeat((at_infinity - scale / (1.01 * RULERS - DELTA))[:, None], 7, axis=1)
    layers = LayerEvidence((WIDTH, HEIGHT), x, np.full(7, 30.0), layer, 0.05, 0.2)
    # 1 / (1.01 (z + delta) - delta) is not linear in 1 / z: here the curve is right on the first board only.
    first = DepthModel(at_infinity, scale * (RULERS[0] - DELTA) / (1.01 * RULERS[0] - DELTA), DELTA)
    camera = replace(camera, depth={**camera.depth, "accurate": DepthField.constant(first)})
    exact = replace(result.evidence.distances, from_pupil_mm=RULERS - DELTA)
    known = replace(result, calibration=camera, layers=layers, evidence=replace(result.evidence, distances=exact))
    mm, by_blur, by_curve = figures.blur_layer_errors(known)
    np.testing.assert_allclose(mm, RULERS)
    np.testing.assert_allclose(by_blur, 1.0, atol=1e-4)  # float32 depth
    np.testing.assert_allclose(by_curve[0], 0.0, atol=1e-4)
    page = report_html(known, title="blur")
    assert "5.0 % of the power disagrees" in page
    assert "Depth by blur" in page


def test_layers_are_coarser_than_their_parabola(result):
    whole, layers, fine = layer_errors(result)
    assert (whole + 1e-6 >= fine).all()
    assert np.median(layers / fine) > 2  # a layer of 0.5 px is off by 0.12 px on average, the noise is 0.02


def test_intervals_of_depth():
    depth = np.arange(6.0)
    assert intervals(depth, np.array([True, True, False, False, True, True])) == [(0, 1), (4, 5)]
    assert intervals(depth, np.zeros(6, bool)) == []


def test_the_verdict_changes_with_the_evidence(result):
    # From the first board on, not from the next of evenly spaced depths.
    assert any("good to 2% from 1000 to" in s.text and s.tone == "good" for s in sentences(result))
    noisy = replace(result, pixel_sigma_px={"real-time": np.full(5, 2.0)})
    assert any("nowhere good to 2%" in s.text and s.tone == "weak" for s in sentences(noisy))


def test_what_is_weak_is_named_with_what_to_do(result):
    near = with_evidence(result, boards=result.boards[:2], outliers={"1000.png": "board 1000 is 14 mm off its ruler."})
    text = " ".join(s.text for s in weaknesses(near))
    for word in ("No board stands farther", "photograph two or three", "was found in 2 of 2", "14 mm off"):
        assert word in text
    misread = with_distances(result, residual_mm=np.array([0, 0, 14.0, np.nan, 2]))
    said = [s.text for s in weaknesses(misread) if "disagree" in s.text]
    assert len(said) == 1
    assert "2000.png disagree by +14 mm" in said[0]
    lost = replace(result, intrinsics=None)
    assert any("add tilted boards" in s.text for s in weaknesses(lost))


def test_stated_facts_that_the_photographs_contradict_are_named(result):
    assert contradictions(result) == []
    session = result.session
    for wrong, word in (
        ({"nominal_focal_length_mm": 0.7 * session.nominal_focal_length_mm}, "check square_mm"),
        ({"nominal_f_number": 1.5 * session.nominal_f_number}, "1.50 times that of design cy_halves"),
    ):
        found = contradictions(replace(result, session=replace(session, **wrong)))
        assert len(found) == 1
        assert word in found[0]
    # A ruler that begins 90 mm before the sensor mark moves the pupil by as much.
    depth = {q: replace(f, sensor_to_pupil_mm=f.sensor_to_pupil_mm - 90) for q, f in result.calibration.depth.items()}
    found = contradictions(replace(result, calibration=replace(result.calibration, depth=depth)))
    assert len(found) == 1
    assert "behind the sensor" in found[0]


def test_far_boards_may_disagree_with_their_ruler_as_far_as_corners_err(result):
    off, sure = np.array([0, 0, 14.0, 0, 14.0]), np.array([2, 2, 2, 2, 6.0])
    far = with_distances(result, residual_mm=off, residual_sigma_mm=sure)
    said = [s.text for s in weaknesses(far) if "disagree" in s.text]
    assert len(said) == 1
    assert "2000.png" in said[0]


class _Page(HTMLParser):
    VOID = frozenset({"meta", "img", "br"})

    def __init__(self):
        super().__init__()
        self.open, self.images, self.links, self.headings = [], [], [], []

    def handle_starttag(self, tag, attrs):
        attributes = dict(attrs)
        if tag == "img":
            self.images.append(attributes["src"])
        self.links += [v for k, v in attrs if k in ("href", "src") and not v.startswith("data:")]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] == "h2":
            self.headings.append(data)


def test_the_page_is_whole_and_needs_nothing_else(page):
    parsed = _Page()
    parsed.feed(page)
    assert parsed.open == []
    assert parsed.links == []
    assert "http" not in re.sub(r'src="data:[^"]*"', "", page)
    assert "a &lt; b" in page
    assert "a &lt;note&gt; &amp; more" in page
    assert len(parsed.headings) == 15
    assert len(parsed.images) == 11
    for source in parsed.images:
        data = base64.b64decode(source.removeprefix("data:image/png;base64,"))
        picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
        assert picture.std() > 5  # something is drawn on it


def test_a_tone_curve_has_a_section(result, page):
    sensor = replace(result.calibration.sensor, response=(0.8, 0.7, 1.5))
    bent = replace(result, calibration=replace(result.calibration, sensor=sensor))
    text = report_html(bent, title="tones")
    assert "Tone curve" in text
    assert "Tone curve" not in page
    assert text.count("data:image/png") == page.count("data:image/png") + 1


def test_what_is_missing_leaves_its_section_out_of_pictures(result, tmp_path):
    bare = replace(
        with_distances(result, residual_mm=np.full(5, np.nan)),
        intrinsics=None,
        session=replace(result.session, design="cy_open", folder=result.session.folder),
    )  # fmt: skip
    (tmp_path / "elsewhere").mkdir()
    text = report_html(bare, title="bare")
    assert "nothing to compare the ruler with" in text
    assert text.count("data:image/png") == 10


@pytest.mark.slow
def test_the_command_writes_the_report_beside_the_camera(result, tmp_path, printed):
    assert printed(result, "--out", tmp_path / "a" / "camera.asdf", report=True)[0] == 0
    assert {p.name for p in (tmp_path / "a").iterdir()} == {"camera.asdf", "camera.report.html"}
    assert printed(result, "--out", tmp_path / "b" / "camera.asdf")[0] == 0
    assert {p.name for p in (tmp_path / "b").iterdir()} == {"camera.asdf"}
    elsewhere = ("--report", tmp_path / "d" / "page.html")
    assert printed(result, "--out", tmp_path / "c" / "camera.asdf", *elsewhere, report=True)[0] == 0
    assert (tmp_path / "d" / "page.html").is_file()
    assert not (tmp_path / "c" / "camera.report.html").exists()


def test_the_command_prints_the_error_over_the_frame_and_the_verdict(result, tmp_path, printed):
    offset = np.array(result.residual_px["real-time"], copy=True)
    offset[3] += 0.1  # px over the frame, nothing in the middle
    shifted = replace(result, residual_px={"real-time": offset, "paper": offset})
    code, said = printed(shifted, "--out", tmp_path / "camera.asdf")
    assert code == 0
    assert f"{100 * board_errors(shifted)[3] / RULERS[3]:+.2f}" in said
    for sentence in sentences(shifted):
        assert sentence.text in said


def test_a_camera_that_cannot_be_used_ends_with_1(result, tmp_path, printed):
    nothing = np.full_like(result.residual_px["real-time"], np.nan)
    far_off = result.residual_px["real-time"] + np.float32(0.5)
    unread = replace(result.session, tilts=(tmp_path / "tilt.png",))
    # Halves that were called the open design have 2.5 times its baseline.
    other = replace(result.session, nominal_f_number=2.6 * result.session.nominal_f_number)
    for broken, words in (
        (replace(result, session=other), "correct design in session.toml"),
        (replace(result, residual_px={"real-time": nothing, "paper": nothing}), "unknown at every distance"),
        (replace(result, residual_px={"real-time": far_off, "paper": far_off}), "half of the boards are off"),
        (replace(result, session=unread, intrinsics=None), "in any of 1 tilted"),
    ):
        code, said = printed(broken, "--out", tmp_path / "camera.asdf")
        assert code == 1
        assert "cannot be used" in said
        assert words in said
        assert "nan" not in said
    assert unusable(result) == []


def test_a_camera_that_only_accurate_can_use_says_so(result):
    """As an open aperture: its views lie too close together for shifts, its blur tells."""
    far_off = result.residual_px["real-time"] + np.float32(0.5)
    both = replace(with_layers(result), residual_px={"real-time": far_off, "paper": far_off})
    assert unusable(both) == []
    said = " ".join(sentence.text for sentence in sentences(both))
    assert "Measure with quality accurate: at real-time half of the boards are off by" in said
    unmeasured = replace(both, pixel_sigma_px={name: both.pixel_sigma_px[name] for name in ("paper", "real-time")})
    assert unusable(unmeasured) == []  # as `calibrate` from Python, which does not measure the noise of accurate
    moved = replace(both, layers=replace(both.layers, layer_px=both.layers.layer_px + 0.5))
    assert "half of the boards" in unusable(moved)[0]
