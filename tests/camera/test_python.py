"""The package as Python users meet it: names, frames, and every snippet of docs/python.md."""

from __future__ import annotations

import ast
import base64
import gc
import importlib.util
import json
import pickle
import re
import shutil
import sys
import types
import warnings
import weakref
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import cv2
import matplotlib as mpl
import numpy as np
import pytest
import tifffile

import chromaperture as cap
from chromaperture import tasks
from chromaperture.calibration.calibrate_session import CalibrationResult
from chromaperture.color.color_maps import UNKNOWN
from chromaperture.frame import frame_files
from chromaperture.frame.frame_files import OUTPUTS
from chromaperture.frame.preview import ColorScale, color_pictures, write_preview
from chromaperture.products import archive
from worlds import content, painted_kernels

mpl.use("Agg")
ROOT = Path(__file__).parents[2]
SAMPLE = "still_life_cy_halves"


@pytest.fixture(scope="module")
def camera():
    return cap.open_sample(SAMPLE, quality="real-time")[0]


@pytest.fixture(scope="module")
def frame(camera):
    return camera.measure(cap.read_image(cap.sample_image(SAMPLE), black_level=16, white_level=1016))


def bare(frame):
    """The maps alone, as benchmarks put them together."""
    return cap.DepthFrame(
        frame.depth_mm, frame.sigma_mm, frame.disparity_px, frame.disparity_sigma_px, frame.confidence, frame.color
    )


def names_for_type_checkers() -> dict[str, str]:
    tree = ast.parse(Path(cap.__file__).read_text(encoding="utf-8"))
    block = next(n for n in tree.body if isinstance(n, ast.If) and ast.unparse(n.test) == "TYPE_CHECKING")
    return {alias.name: node.module for node in block.body for alias in node.names}


def test_completion_lists_the_product_and_not_its_modules():
    assert set(dir(cap)) == {*cap.__all__, "__version__"}
    assert [name for name in cap.__all__ if isinstance(getattr(cap, name), types.ModuleType)] == []
    wanted = {"load_camera", "read_image", "measure_file", "calibrate", "refocus", "all_in_focus", "open_source"}
    assert wanted | {"write_ply", "write_depth_png", "samples", "open_sample"} <= set(dir(cap))
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = cap.no_such_name


def test_type_checkers_see_the_names_that_exist():
    seen = names_for_type_checkers()
    assert set(seen) == set(cap.__all__)
    for name, module in seen.items():
        assert getattr(import_module(module), name) is getattr(cap, name), name


def test_a_path_is_measured_with_the_cameras_levels(camera, frame):
    again = camera.measure(cap.sample_image(SAMPLE))
    np.testing.assert_array_equal(again.depth_mm, frame.depth_mm)
    np.testing.assert_array_equal(camera.measure(str(cap.sample_image(SAMPLE))).color, frame.color)
    with pytest.raises(cap.InputError, match="missing"):
        camera.measure("missing.png")


def test_samples_open():
    for name in cap.samples():
        camera, image = cap.open_sample(name)
        assert image.shape == (camera.calibration.sensor.height_px, camera.calibration.sensor.width_px, 3)
        assert 0.02 < image.mean() < 0.9  # levels were applied: 16-bit counts up to 1016 would be 0.01
    with pytest.raises(cap.InputError, match="still_life_cy_open"):
        cap.open_sample("nothing")


def test_points_project_to_their_pixels(frame):
    cloud = frame.points(max_relative_sigma=0.05)
    kept = frame.sigma_mm <= 0.05 * frame.depth_mm
    lens = frame.calibration.lens
    pixels, _ = cv2.projectPoints(
        cloud.points_mm.astype(float), np.zeros(3), np.zeros(3), lens.camera_matrix, lens.distortion
    )
    v, u = np.nonzero(kept)
    np.testing.assert_allclose(pixels[:, 0], np.stack([u, v], 1), atol=2e-3)  # float32 at 5 m, fx of 1000 px
    delta = frame.calibration.on_axis("real-time").sensor_to_pupil_mm
    np.testing.assert_allclose(cloud.points_mm[:, 2], frame.depth_mm[kept] - delta, rtol=1e-6)
    assert len(frame.points(max_relative_sigma=np.inf).points_mm) > len(frame.points().points_mm) > len(v)


def test_a_frame_of_bare_maps_says_what_it_lacks(frame):
    for call in (lambda f: f.points(), cap.all_in_focus, lambda f: cap.refocus(f, 1500)):
        with pytest.raises(cap.InputError, match="camera"):
            call(bare(frame))


def test_representations_are_short(camera, frame):
    disparity = cap.Disparity(frame.disparity_px, frame.disparity_sigma_px, frame.confidence)
    things = (frame, bare(frame), camera, camera.calibration, camera.depth_model, disparity, frame.points())
    for thing in things:
        assert len(repr(thing)) < 140
        assert "array" not in repr(thing)
    unknown = np.full((4, 5), np.nan, np.float32)
    assert repr(cap.DepthFrame(*[unknown] * 5, np.zeros((4, 5, 3)))) == "DepthFrame(5x4 px, 0.0% filled)"
    numbers = re.fullmatch(r"DepthFrame\(720x480 px, ([\d.]+)% filled, median depth (\d+) mm, .*\)", repr(frame))
    assert float(numbers[1]) == pytest.approx(100 * np.isfinite(frame.depth_mm).mean(), abs=0.06)  # one decimal
    assert float(numbers[2]) == pytest.approx(np.nanmedian(frame.depth_mm), abs=0.51)  # whole mm


def test_a_notebook_shows_colour_and_depth(frame):
    for one in (frame, bare(frame)):
        html = one._repr_html_()
        picture = cv2.imdecode(np.frombuffer(base64.b64decode(re.search('base64,([^"]+)', html)[1]), np.uint8), 1)
        assert picture.shape[1] == 2 * round(picture.shape[0] * 720 / 480)
        assert len(html) < 400_000  # a notebook of many frames stays a small file
        assert "median depth" in html


def test_show_draws_three_maps_in_pixels_of_the_photograph(frame):
    figure = frame.show()
    photograph, depth, sigma, *bars = figure.axes
    assert [len(axes.images) for axes in (photograph, depth, sigma)] == [1, 1, 1]
    assert photograph.images[0].get_extent() == [-0.5, 719.5, 479.5, -0.5]
    assert [bar.get_ylabel() for bar in bars] == ["mm", "mm"]
    known = frame.depth_mm[np.isfinite(frame.depth_mm)]
    low, high = depth.images[0].get_clim()
    assert known.min() <= low < np.median(known) < high <= known.max()
    mpl.pyplot.close(figure)


def test_save_writes_the_files_of_the_command_line(frame, run, tmp_path):
    (tmp_path / "a").mkdir()
    image = shutil.copy(cap.sample_image(SAMPLE), tmp_path / "a" / "photo.png")
    result = run("depth", image, "--camera", cap.sample_camera(SAMPLE), "--quality=real-time", "-q")  # beside the image
    assert (result.returncode, result.stdout) == (0, ""), result.stderr
    image.unlink()
    saved = frame.save(tmp_path / "b" / "photo")
    assert sorted(p.name for p in saved) == sorted(p.name for p in (tmp_path / "a").iterdir())
    assert sorted(p.name for p in saved) == sorted(f"photo{o.suffix}" for o in OUTPUTS.values() if o.by_default)
    for path in saved:
        if path.suffix != ".json" and "preview" not in path.name:  # seconds; the name of the file
            assert content(path) == content(tmp_path / "a" / path.name), path.name
    assert [p.name for p in frame.save(tmp_path, write="sigma")] == ["frame.sigma.tiff"]


def test_only_what_is_named_is_written_and_its_libraries_loaded(frame, run, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "chromaperture.frame.preview", None)  # an import of it fails
    image = cap.sample_image(SAMPLE)
    options = ("--camera", cap.sample_camera(SAMPLE), "--quality=real-time", "--out", tmp_path / "a", "-q")
    assert run("depth", image, *options, "--write", "json, depth").returncode == 0
    assert {p.name for p in (tmp_path / "a").iterdir()} == {f"{SAMPLE}.depth.tiff", f"{SAMPLE}.json"}
    with pytest.raises(ImportError):
        frame.save(tmp_path / "x", write=["preview"])
    assert [p.name for p in tmp_path.iterdir()] == ["a"]


def test_unknown_outputs_are_one_line_before_the_work(run, tmp_path):
    image = cap.sample_image(SAMPLE)
    for wrong in ("depth,colour", ""):
        options = ("--camera", cap.sample_camera(SAMPLE), "--out", tmp_path / "a", "--write", wrong)
        done = run("depth", image, *options)
        assert done.returncode == 2
        assert len(done.stderr.strip().splitlines()) == 1
        for name in OUTPUTS:
            assert name in done.stderr
    assert not (tmp_path / "a").exists()


def photographs(folder, count=3):
    image = cv2.imread(str(cap.sample_image(SAMPLE)), cv2.IMREAD_UNCHANGED)
    folder.mkdir()
    for i in range(count):  # unlike pictures of one size
        cv2.imwrite(str(folder / f"p{i}.png"), np.roll(image, 40 * i, axis=0))
    return [folder / f"p{i}.png" for i in range(count)]


def test_files_written_beside_the_next_measurement_are_the_same(run, camera, tmp_path):
    images = photographs(tmp_path / "in")
    options = ("--camera", cap.sample_camera(SAMPLE), "--quality=real-time", "-q")
    assert run("depth", *images, *options, "--out", tmp_path / "many").returncode == 0
    for image in images:
        cap.measure_file(image, camera, out=tmp_path / "one")
    names = sorted(p.name for p in (tmp_path / "one").iterdir())
    assert names == sorted(p.name for p in (tmp_path / "many").iterdir())
    for name in names:
        one, many = (content(tmp_path / folder / name) for folder in ("one", "many"))
        if name.endswith(".json"):
            one, many = ({**json.loads(text), "seconds": 0, "made_from": 0} for text in (one, many))
        assert one == many, name


@pytest.mark.slow
def test_no_more_than_two_measurements_are_in_memory(run, tmp_path, monkeypatch):
    frames, alive, measure = [], [], archive.measure_only

    def counted(*args, **options):
        gc.collect()
        alive.append(sum(frame() is not None for frame in frames))
        made = measure(*args, **options)
        frames.append(weakref.ref(made.frame))
        return made

    monkeypatch.setattr(archive, "measure_only", counted)
    options = ("--camera", cap.sample_camera(SAMPLE), "--out", tmp_path / "out", "--write", "depth", "-q")
    options += ("--quality=real-time",)
    assert run("depth", *photographs(tmp_path / "in", 4), *options).returncode == 0
    assert len(alive) == 4
    assert max(alive) <= 1  # when a measurement begins, only the one before is there, being written


def test_a_disk_that_fills_up_beside_a_measurement_is_one_line(run, tmp_path, monkeypatch):
    images, write = photographs(tmp_path / "in"), frame_files.write_depth_ply

    def full(path, *maps, **rays):
        if path.name == "p1.ply":
            raise OSError(28, "No space left on device")
        write(path, *maps, **rays)

    monkeypatch.setattr(frame_files, "write_depth_ply", full)
    options = ("--camera", cap.sample_camera(SAMPLE), "--quality=real-time", "--out", tmp_path / "out")
    options += ("--write", "depth,ply,json")
    done = run("depth", *images, *options, "-q")
    assert done.returncode == 1
    full, summary = done.stderr.splitlines()
    assert "disk is full" in full
    assert "1 of 3 photographs could not be measured: p1.png" in summary
    written = {f"p{i}{OUTPUTS[name].suffix}" for i in (0, 2) for name in ("depth", "ply", "json")}
    assert {p.name for p in (tmp_path / "out").iterdir()} == written  # nothing of p1, and no private folder


def test_measure_takes_another_quality_and_keeps_its_camera(camera, frame):
    image = camera.read(cap.sample_image(SAMPLE))
    other = camera.measure(image, quality="paper")
    assert (frame.config.quality, other.config.quality) == ("real-time", "paper")
    expected = cap.load_camera(cap.sample_camera(SAMPLE), quality="paper", device=camera.device).measure(image)
    np.testing.assert_array_equal(other.depth_mm, expected.depth_mm)
    np.testing.assert_array_equal(camera.measure(image, quality="real-time").depth_mm, frame.depth_mm)
    assert cap.load_camera(cap.sample_camera(SAMPLE)).config.quality == "accurate"  # of photographs


def test_the_preview_is_bounded_and_unknown_is_grey(frame, tmp_path):
    large = [np.repeat(np.repeat(a, 4, axis=0), 4, axis=1) for a in (frame.depth_mm, frame.sigma_mm, frame.color)]
    large[0][:, :1440] = np.nan  # the left half
    made = cap.DepthFrame(large[0], large[1], large[0], large[1], large[1], large[2], large[2])
    write_preview(tmp_path / "p.png", made.image, made, title="title")
    picture = cv2.imread(str(tmp_path / "p.png"))[..., ::-1]
    assert picture.shape[1] == 1408
    assert picture.shape[0] < 1100
    grey = (np.array([int(UNKNOWN[i : i + 2], 16) for i in (1, 3, 5)]) == picture).all(axis=2)
    unknown = np.isnan(large[0]).mean() + np.isnan(large[1]).mean()
    assert unknown >= 0.5
    assert grey.sum() == pytest.approx(unknown * 627 * 418, rel=0.03)  # pixels of a panel; sampled by the nearest


def test_colours_are_made_when_they_are_asked_for(frame, tmp_path):
    """Files of a frame without colours are those of one with them, and do not keep them."""
    made: list[slice] = []

    def bands(take, *, multiple=1):
        for top in range(0, len(frame.color), 32 * multiple):
            made.append(slice(top, min(top + 32 * multiple, len(frame.color))))
            take(made[-1], frame.color[made[-1]])

    maps = (frame.depth_mm, frame.sigma_mm, frame.disparity_px, frame.disparity_sigma_px, frame.confidence)
    later = cap.DepthFrame.with_lazy_color(bands, maps, frame.image, (frame.calibration, frame.config))
    assert "color" not in vars(later)
    for one, other in zip(later.save(tmp_path / "a"), frame.save(tmp_path / "b"), strict=True):
        if one.suffix != ".json" and ".preview" not in one.name:  # its title is the file's name
            assert content(one) == content(other)
    assert made
    assert "color" not in vars(later)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(replace(later, calibration=None))).color, frame.color)
    np.testing.assert_array_equal(later.color, frame.color)
    count = len(made)
    assert later.color is later.color
    assert len(made) == count
    with pytest.raises(AttributeError, match="colour"):
        later.colour  # noqa: B018


def test_the_preview_of_reduced_colours_is_that_of_all(frame, tmp_path):
    maps = (frame.depth_mm, frame.sigma_mm, frame.disparity_px, frame.disparity_sigma_px, frame.confidence)
    rows = 21 * 66 + 1  # of bands of 66, which are multiples of the three rows of an average: the last has one row
    color = np.tile(frame.color, (3, 3, 1))[:rows]
    large = cap.DepthFrame(*[np.tile(values, (3, 3))[:rows] for values in maps], color)
    small = color_pictures(large).small
    assert small.shape[0] < len(color) / 2
    for name, given in (("a", None), ("b", small)):
        write_preview(tmp_path / name, None, large, title="title", color=given)
    assert content(tmp_path / "a") == content(tmp_path / "b")


@pytest.mark.parametrize(("low", "high"), [(1189.0, 3511.0), (0.0, 0.037), (-3.2, 1.9), (999.0, 1001.0)])
def test_ticks_are_round_and_inside(low, high):
    ticks = np.array(ColorScale(low, high, "magma", "mm").ticks())
    assert 3 <= len(ticks) <= 8
    assert low <= ticks[0] < ticks[-1] <= high
    step = ticks[1] - ticks[0]
    np.testing.assert_allclose(np.diff(ticks), step)
    assert round(step / 10 ** np.floor(np.log10(step) + 1e-9), 6) in (1, 2, 5)


def test_a_lens_without_size_is_refused(frame):
    with pytest.raises(cap.InputError, match="f_number"):
        cap.refocus(frame, f_number=0)


def test_a_calibration_that_cannot_be_used_is_warned_of(monkeypatch):
    made = types.SimpleNamespace(camera="the camera")
    monkeypatch.setattr(tasks, "read_session", lambda folder: types.SimpleNamespace(square_mm=30.0))
    monkeypatch.setattr(tasks, "calibrate_session", lambda *args, **options: made)
    monkeypatch.setattr(tasks, "unusable", lambda result: ["no board was read"])
    with pytest.warns(cap.CaptureWarning, match="no board was read"):
        assert cap.calibrate("folder") == "the camera"
    assert hasattr(CalibrationResult, "camera")  # what the stand-in has


@pytest.mark.parametrize(("module", "extra"), [("open3d", "reconstruct"), ("xarray", "xarray")])
def test_a_missing_library_is_named_with_its_extra(frame, monkeypatch, module, extra):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(cap.MissingDependencyError, match=rf"chromaperture\[{extra}\]"):
        getattr(frame, f"to_{module}")()


@pytest.mark.extra("xarray", "xarray")
def test_xarray_holds_every_map_with_its_unit(frame):
    data = frame.to_xarray()
    assert dict(data.sizes) == {"y": 480, "x": 720, "channel": 3}
    for name in ("depth_mm", "sigma_mm", "disparity_px", "confidence", "color"):
        np.testing.assert_array_equal(data[name].values, getattr(frame, name))
    assert {name: data[name].attrs["units"] for name in ("depth_mm", "disparity_px")} == {
        "depth_mm": "mm",
        "disparity_px": "px",
    }
    assert data.attrs == {"design": "cy_halves", "quality": "real-time"}


@pytest.mark.extra("reconstruct", "open3d")
def test_open3d_gets_metres(frame):
    cloud, points = frame.to_open3d(max_relative_sigma=0.05), frame.points(max_relative_sigma=0.05)
    np.testing.assert_allclose(np.asarray(cloud.points) * 1000, points.points_mm, rtol=1e-6)
    np.testing.assert_allclose(np.asarray(cloud.colors) * 255, points.colors, atol=1e-9)


def blur_alone(image, disparity_px, camera, **options):
    """Stand in for the restoration, which takes 20 s and has tests of its own: the picture as aligned, and its blur."""
    radius = camera.alignment.blur_radius_px(disparity_px)
    return cap.SharpPicture(camera.alignment.align(image, disparity_px), np.nan_to_num(radius))


@pytest.mark.slow
def test_every_snippet_of_the_page_runs(session, tmp_path, monkeypatch):
    text = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL)
    assert len(blocks) >= 9
    monkeypatch.chdir(tmp_path)
    (tmp_path / "photos").mkdir()
    for name in ("photo.png", "photos/0.png", "photos/1.png"):
        shutil.copy(cap.sample_image(SAMPLE), tmp_path / name)
    shutil.copy(cap.sample_camera(SAMPLE), tmp_path / "camera.asdf")
    shutil.copytree(session, tmp_path / "my_session")
    blur = cap.Calibration.load(tmp_path / "camera.asdf").field_blur()
    np.save(tmp_path / "kernels.npy", painted_kernels(blur, 1100.0, side=61))
    monkeypatch.setattr(tasks, "restore", blur_alone)
    space = {}
    needs = {"to_open3d": "open3d", "to_xarray": "xarray"}
    for block in blocks:
        for line_needs, module in needs.items():  # lines of an extra that is not installed are left out
            if importlib.util.find_spec(module) is None:
                block = "\n".join(line for line in block.splitlines() if line_needs not in line)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", cap.CaptureWarning)  # the session has neither tilts nor a noise model
            exec(compile(block, "docs/python.md", "exec"), space)
    book = (slice(260, 440), slice(60, 280))  # at 1.45 m, sharp in one picture and blurred in the other
    near, far = (np.abs(np.diff(space[name][book], axis=1)).mean() for name in ("near", "far"))
    camera, photograph = cap.open_sample(SAMPLE)
    pupil_mm = camera.measure(photograph).depth_mm - camera.calibration.depth["accurate"].sensor_to_pupil_mm
    # Kernels of one distance do not tell the focus surface's curve: half of the pixels are within 5 %.
    assert np.nanmedian(space["pupil_mm"] / pupil_mm) == pytest.approx(1, abs=0.03)
    assert near > 1.3 * far
    written = {p.name for p in (tmp_path / "results").iterdir()}
    assert {"photo.ply", "photo.preview.png", "few.sigma.tiff", "photo.json"} <= written
    assert len((tmp_path / "walk" / "associations.txt").read_text().splitlines()) == 2
    assert tifffile.imread(tmp_path / "results" / "few.depth.tiff").shape == (480, 720)
    assert cap.Calibration.load(tmp_path / "mine.asdf").is_calibrated
