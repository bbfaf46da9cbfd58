"""The frame of `chromaperture evaluate`, the prior methods on worlds that are known, and the parallel sweep."""

from __future__ import annotations

import csv
import json
import os
import signal
import threading
import time
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
import scipy.fft
import scipy.ndimage
from typer.testing import CliRunner

from chromaperture.cli.main import app
from chromaperture.evaluation.figures import new_figure
from chromaperture.optics.aperture import DESIGNS, centroids, film_unmixing
from chromaperture.optics.psf import geometric_otf
from chromaperture.system.errors import InputError
from chromaperture_paper import figures, methods, prior_methods, registry, run, sweep, world
from chromaperture_paper.context import Context
from chromaperture_paper.registry import Chart, Comparison, Content, CsvTable, Exhibit
from chromaperture_paper.run import page_html
from worlds import moved, small_trials, stored, texture

LAYERS = np.arange(-4, 4.01, 0.25)
INNER = np.s_[24:-24, 24:-24]


def exhibit(made=None, *, name="figure-x", files=(), calls=None):
    def make(context):
        if calls is not None:
            calls.append(name)
        if isinstance(made, Exception):
            raise made
        return made

    return Exhibit(name, f"Title of {name}", make, files)


def small_made():
    figure = new_figure(2, 1)
    figure.subplots().plot([0, 1])
    compared = [Comparison("light <&>", "55 %", "54 %", "A sentence.")]
    tables = [CsvTable("figures", "caption", ("a", "b"), [("1", "two, and three")])]
    return Content("Made up.", [Chart("picture", figure, "Look.")], tables, compared, ["Last line."])


# The frame


def test_pictures_tables_and_the_papers_numbers_are_written_and_shown(tmp_path):
    one = exhibit(small_made())
    outcomes = run.evaluate([one], Context(tmp_path))
    folder = tmp_path / "figure-x"
    assert (folder / "picture.png").read_bytes().startswith(b"\x89PNG")
    lines = (folder / "figures.csv").read_text(encoding="utf-8").splitlines()
    assert list(csv.reader(lines)) == [["a", "b"], ["1", "two, and three"]]
    page = page_html(tmp_path, outcomes, quick=True)
    for shown in ("Title of figure-x", "55 %", "54 %", "A sentence.", "Last line.", "light &lt;&amp;&gt;"):
        assert shown in page
    assert page.count("data:image/png;base64,") == 1
    assert 'src="http' not in page  # self-contained


def test_what_is_finished_is_kept_and_what_is_not_is_made(tmp_path):
    calls: list[str] = []
    first = exhibit(small_made(), name="first", calls=calls)
    second = exhibit(small_made(), name="second", calls=calls)
    run.evaluate([first], Context(tmp_path))
    outcomes = run.evaluate([first, second], Context(tmp_path))
    assert calls == ["first", "second"]
    assert [outcome.kept for outcome in outcomes] == [True, False]
    (tmp_path / "first" / "picture.png").unlink()  # half a result is none
    run.evaluate([first], Context(tmp_path))
    run.evaluate([first], Context(tmp_path, quick=True))  # of another size
    run.evaluate([first], Context(tmp_path, quick=True), again=True)
    assert calls == ["first", "second", "first", "first", "first"]


def test_one_that_fails_stops_no_other(tmp_path):
    outcomes = run.evaluate([exhibit(InputError("too dark"), name="bad"), exhibit(small_made())], Context(tmp_path))
    assert [outcome.problem for outcome in outcomes] == ["too dark", ""]
    assert "Not made: too dark" in page_html(tmp_path, outcomes, quick=False)
    assert not (tmp_path / "bad").exists()


def test_missing_data_names_the_files_and_changed_data_is_read_again(tmp_path):
    data = tmp_path / "data"
    (data / "white").mkdir(parents=True)
    calls: list[str] = []
    one = exhibit(small_made(), files=("white/open.png", "white/cy.png"), calls=calls)
    (data / "white" / "open.png").write_bytes(b"x")
    (outcome,) = run.evaluate([one], Context(tmp_path / "out", data=data))
    assert "white/cy.png" in outcome.problem
    assert "white/open.png" not in outcome.problem
    assert calls == []
    (data / "white" / "cy.png").write_bytes(b"x")
    for content in (b"x", b"x", b"longer"):
        (data / "white" / "cy.png").write_bytes(content)
        os.utime(data / "white" / "cy.png", (1, 1))
        run.evaluate([one], Context(tmp_path / "out", data=data))
    assert len(calls) == 2


def test_every_exhibit_has_its_function():
    for exhibit in registry.EXHIBITS.values():
        module, function = exhibit.make.args
        assert callable(getattr(import_module(f"chromaperture_paper.{module}"), function))


def test_an_unknown_figure_is_answered_with_the_nearest_name(tmp_path):
    with pytest.raises(InputError, match=r"figure-13.*did you mean 'figure-1"):
        registry.chosen(["figure-13"])
    assert [e.name for e in registry.chosen(["table-2", "figure-9"])] == ["figure-9", "table-2"]  # the paper's order
    assert len(registry.chosen(["all"])) == len(registry.EXHIBITS)


@pytest.mark.slow
def test_the_command_makes_a_report_and_goes_on_where_it_stopped(tmp_path):
    arguments = ["evaluate", "figure-4a", "figure-12", "--quick", "--out", str(tmp_path)]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    assert "2 made" in result.output
    assert (tmp_path / "report.html").is_file()
    again = CliRunner().invoke(app, arguments)
    assert "2 kept" in again.output
    entries = json.loads(CliRunner().invoke(app, [*arguments, "--json"]).output)
    assert [entry["name"] for entry in entries] == ["figure-4a", "figure-12"]
    assert all(entry["compared"] for entry in entries)


def test_the_command_skips_what_the_data_lack_and_says_so_by_its_exit_code(tmp_path):
    (tmp_path / "data").mkdir()
    arguments = ["evaluate", "table-1", "figure-4a", "-q", "--quick", "--out", str(tmp_path / "out")]
    result = CliRunner().invoke(app, [*arguments, "--data", str(tmp_path / "data")])
    assert result.exit_code == 1
    assert (tmp_path / "out" / "figure-4a" / "cyx.png").is_file()
    assert "white/cy_halves.png" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("arguments", [["--data", "nowhere"], ["--workers", "-1"], ["bench"], ["figure-99"]])
def test_bad_arguments_are_told(tmp_path, arguments):
    result = CliRunner().invoke(app, ["evaluate", *arguments, "--out", str(tmp_path / "out")])
    assert isinstance(result.exception, InputError)
    assert not (tmp_path / "out").exists()


# Prior art: a perfect world, spoiled by noise, and asked for back


def moved_views(rng, directions, disparity, noise=0.004):
    picture = texture(rng, height=112, width=128)
    views = [moved(picture, disparity * u, disparity * v) for u, v in directions]
    return np.stack(views, axis=-1) + rng.normal(0, noise, (112, 128, len(directions)))


THREE = np.array([(1.0, 0.0), (0.0, 0.0), (-1.0, 0.0)])
TRIANGLE = np.array([(0.0, -1.0), (-0.866, 0.5), (0.866, 0.5)])


@pytest.mark.parametrize("directions", [THREE, TRIANGLE], ids=["line", "triangle"])
@pytest.mark.parametrize("disparity", [-2.6, 1.35])
@pytest.mark.parametrize(
    "method",
    [
        prior_methods.cross_correlation,
        prior_methods.phase_correlation,
        lambda *a: prior_methods.colour_lines(*a, optimised=False),
        prior_methods.colour_lines,
    ],
    ids=["ncc", "phase", "lines", "lines-optimised"],
)
def test_prior_methods_find_a_shift_and_its_sign(rng, method, directions, disparity):
    found = method(moved_views(rng, directions, disparity), directions, LAYERS)[INNER]
    assert np.isfinite(found).mean() > 0.98  # noise sends single pixels to an end of the range
    # A tenth of a px: layers of a quarter px, a parabola between them, noise of a twentieth of the texture. Blocks cut
    # at one position overlap less the more the picture moved, which biases the phase towards 0: 6 % of 2.6 px.
    most = 0.16 if method is prior_methods.phase_correlation else 0.1
    assert abs(np.nanmedian(found) - disparity) < most
    assert np.nanmedian(np.abs(found - disparity)) < most + 0.05


@pytest.mark.parametrize("disparity", [-2.5, 1.5])
def test_stereo_matcher_finds_a_shift_and_its_sign(rng, disparity):
    ends = THREE[[0, 2]]
    found = prior_methods.stereo_sgbm(moved_views(rng, ends, disparity), ends, LAYERS)[INNER]
    assert np.nanmedian(np.abs(found - disparity)) < 0.15  # whole px of stereo disparity and OpenCV's own parabola


def test_the_colour_line_measure_is_the_product_of_eigenvalues(rng):
    image = rng.uniform(0, 1, (15, 15, 3))
    measure = prior_methods.colour_line_measure(image, np.zeros((3, 2)), np.array([0.0]))[0, 7, 7]
    covariance = np.cov(image.reshape(-1, 3).T, bias=True)
    expected = np.prod(np.linalg.eigvalsh(covariance)) / np.prod(np.diag(covariance))
    assert measure == pytest.approx(expected, rel=1e-5)  # views are resampled in float32


def test_the_annulus_knows_the_size_of_the_blur_but_not_its_side(rng):
    aperture, shape = DESIGNS["magenta_annulus"], (128, 144)
    radii = np.arange(0, 7.1, 0.5)
    transfer = [geometric_otf(aperture, float(r), shape) for r in radii]
    grey = scipy.fft.rfft2(texture(rng, height=128, width=144, blur_px=0.7))
    for true in (-4.0, 4.0):
        blurred = [scipy.fft.irfft2(grey * otf, s=shape) for otf in geometric_otf(aperture, true, shape)]
        image = np.stack(blurred, axis=-1) + rng.normal(0, 2e-4, (*shape, 3))
        found = prior_methods.annulus_radius(image, transfer, radii, shape)[INNER]
        assert np.median(found) == pytest.approx(4.0, abs=0.5)  # a step of the radii


def test_largest_eigenvalues_are_those_of_the_matrices(rng):
    matrices = rng.normal(size=(40, 3, 3))
    matrices = matrices @ matrices.transpose(0, 2, 1)
    matrices[0] = np.diag([2.0, 2.0, 2.0])  # all alike
    matrices[1] = np.outer([1.0, 2.0, 3.0], [1.0, 2.0, 3.0])  # colours on a line
    places = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
    found = prior_methods.largest_eigenvalue(*(matrices[:, a, b] for a, b in places))
    # The arc cosine costs half the digits where two eigenvalues meet.
    np.testing.assert_allclose(found, np.linalg.eigvalsh(matrices)[:, -1], rtol=1e-7)


def test_a_shift_is_that_of_the_spline(rng):
    view = rng.normal(size=(40, 50)).astype(np.float32)
    for dx, dy in ((0.3, -2.6), (-7.25, 0.0), (11.0, 3.5)):
        expected = scipy.ndimage.shift(view, (-dy, -dx), order=3, mode="mirror")
        np.testing.assert_allclose(
            prior_methods.sampled(prior_methods.spline(view), dx, dy), expected, atol=1e-5
        )  # float32


# Judging


def test_depth_and_blur_radius_invert_each_other():
    camera = world.camera_of(96, 64)
    depth = np.array([900.0, 2000.0, 5000.0])
    np.testing.assert_allclose(methods.depth_of(camera.blur_radius_px(depth), camera), depth, rtol=1e-9)  # float64


def test_a_calibrated_reading_gives_the_radius_back():
    radius = np.array([3.0, -2.0, 0.0, 1.5])

    def reading(r):
        return 0.4 * r + 0.02 * r * abs(r)

    curve = methods.increasing_curve(radius, reading(radius))
    np.testing.assert_allclose(curve.radius_of(reading(radius)), radius, atol=1e-12)  # float64
    beyond = curve.radius_of(np.array([np.nan, reading(3.0) + 0.01]))[1]
    np.testing.assert_allclose(beyond, 3 + 0.01 / 0.49, rtol=1e-9)  # float64
    assert len(methods.increasing_curve(radius, -radius).reading) == 1
    assert np.isnan(methods.increasing_curve(radius, -radius).radius_of(np.zeros((2, 2)))).all()


def test_scores_count_all_pixels_with_truth():
    truth = np.array([1000.0, 1000.0, 1000.0, 1000.0, np.nan])
    found = np.array([1010.0, 1040.0, np.nan, 2000.0, 1000.0])
    result = methods.scores(found, truth)
    assert (result["fill"], result["within_2"], result["within_5"], result["within_10"]) == (0.75, 0.25, 0.5, 0.5)
    assert result["median_error"] == pytest.approx(0.04)  # rounding


def test_designs_are_exposed_to_one_level():
    camera = world.camera_of(48, 32)
    for design in ("rgb_circles", "cy_halves"):
        table = world.pinhole_table(camera, design, 8)
        sheet = [world.plane(np.ones((2, 2, 3)), center_mm=(0, 0, 2000.0), width_mm=4000)]
        exposure = world.level_exposure(design)
        shot = world.photograph(table, sheet, camera, seed=0, exposure=exposure)
        # Few rays sample small discs coarsely: two per cent.
        assert np.median(shot.image, axis=(0, 1)).max() == pytest.approx(world.WHITE, rel=0.02)


def test_the_apertures_colour_space_separates_the_views_of_an_open_design_further():
    camera = world.camera_of(120, 96, pitch_mm=world.SENSOR_WIDTH_MM / 480)
    rulers = np.array([1200.0, 3200.0])
    ranges = []
    for letter, design, _, unmixing in figures.PANELS:
        if letter in "cd":
            disparity, _ = figures.read_boards(design, unmixing, camera, rulers, cells=10)
            ranges.append(abs(disparity[1] - disparity[0]))
    # The centroids say by how much: of the unmixed views, and of the sensor's blue and red.
    film = world.real_film("cy_open")
    unmixed, sensor = (np.ptp(centroids(film, rows)[:, 0]) for rows in (film_unmixing(film), np.eye(3)[[2, 0]]))
    # Blur of the open centre reduces both readings, not quite alike: within a quarter.
    assert ranges[0] / ranges[1] == pytest.approx(unmixed / sensor, rel=0.25)


def test_the_bend_of_a_floor_is_told_from_its_tilt_and_noise(rng):
    y, x = np.mgrid[-1:1:200j, -1:1:300j]
    truth = 2000 + 100 * y
    bowl = 0.05 * (x**2 - 1 / 3)
    tilted = truth * (1 + 0.1 * x + rng.normal(0, 0.03, x.shape))
    assert figures.bend(tilted, truth) < 0.002  # medians of 600 pixels each: 0.03 / sqrt(600) * 1.25
    # The rms of x^2 - 1/3 is sqrt(4 / 45); ten cells across average a little of it away.
    assert figures.bend(truth * (1 + bowl), truth) == pytest.approx(0.05 * np.sqrt(4 / 45), rel=0.03)


# The sweep


@pytest.mark.slow
def test_two_workers_one_killed_give_what_one_gives_byte_for_byte(tmp_path):
    alone = sweep.sweep(small_trials(), workers=1, keep_in=tmp_path / "one")

    def kill_one():
        while len(children()) < 2:
            time.sleep(0.05)
        os.kill(children()[0], signal.SIGKILL)

    def children():
        # multiprocessing's own list would join them; /proc is read instead.
        mine = Path(f"/proc/self/task/{os.getpid()}/children")
        found = mine.read_text().split() if mine.is_file() else []
        here = {
            int(pid) for task in Path("/proc/self/task").iterdir() for pid in (task / "children").read_text().split()
        }
        return [p for p in here | {int(f) for f in found} if b"spawn_main" in Path(f"/proc/{p}/cmdline").read_bytes()]

    if not Path("/proc/self/task").is_dir():
        pytest.skip("needs /proc to find a worker to kill")
    killer = threading.Thread(target=kill_one, daemon=True)
    killer.start()
    shared = sweep.sweep(small_trials(), workers=2, keep_in=tmp_path / "two")
    killer.join(timeout=10)
    assert not killer.is_alive()
    assert shared == alone
    assert stored(tmp_path / "one") == stored(tmp_path / "two")
    assert len(stored(tmp_path / "one")) == len(small_trials())


def test_a_sweep_goes_on_from_what_is_kept(tmp_path, monkeypatch):
    for one in small_trials():
        sweep.keep(tmp_path, one, {"fill": 0.5, "median_error": float("nan")})
    monkeypatch.setattr(sweep, "ProcessPoolExecutor", None)  # nothing is left to compute
    results = sweep.sweep(small_trials(), workers=2, keep_in=tmp_path)
    assert [r["fill"] for r in results] == [0.5] * len(small_trials())
    assert np.isnan(results[0]["median_error"])
