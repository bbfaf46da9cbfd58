"""The command line as the contract fixes it: files, figures, exit codes, one clear line for bad input."""

import json
import os
import re
import subprocess
import sys
from dataclasses import replace

import cv2
import numpy as np
import pytest
import tifffile
import typer
from PIL import Image

from chromaperture.cli import console
from chromaperture.cli.depth import cameras
from chromaperture.cli.main import app
from chromaperture.frame.frame_files import OUTPUTS
from chromaperture.model.camera_file import Calibration
from chromaperture.products.samples import SAMPLES, sample_camera, sample_image
from chromaperture_paper.registry import EXHIBITS
from worlds import capture, texture

SUFFIXES = (
    "depth.tiff", "sigma.tiff", "disparity.tiff", "depth.png", "color.png", "ply", "preview.png", "json",
)  # fmt: skip


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    folder = tmp_path_factory.mktemp("demo")
    command = [sys.executable, "-m", "chromaperture", "demo"]
    result = subprocess.run(command, capture_output=True, text=True, cwd=folder, timeout=300, check=False)
    assert result.returncode == 0, result.stderr
    return folder / "chromaperture-demo", result.stdout


@pytest.mark.slow
def test_demo_writes_every_file_and_a_table(demo):
    folder, printed = demo
    assert "the far wall at the top right" in printed
    assert sorted(p.name for p in folder.iterdir()) == sorted(f"{s}.{x}" for s in SAMPLES for x in SUFFIXES)
    for word in ("quality accurate", "how sure", "mm", "preview.png"):
        assert word in printed


@pytest.mark.slow
@pytest.mark.parametrize("sample", SAMPLES)
def test_the_maps_of_the_demo_hang_together(demo, sample):
    folder, _ = demo
    depth, sigma, disparity = (tifffile.imread(folder / f"{sample}.{n}.tiff") for n in ("depth", "sigma", "disparity"))
    assert depth.dtype == sigma.dtype == disparity.dtype == np.float32
    assert depth.shape == (480, 720)
    known = np.isfinite(depth)
    assert (np.isfinite(sigma) == known).all()
    assert (sigma[known] > 0).all()
    assert (np.isfinite(disparity) >= known).all()
    in_mm = cv2.imread(str(folder / f"{sample}.depth.png"), cv2.IMREAD_UNCHANGED)
    certain = known & (sigma <= 0.1 * depth)
    assert 0.3 * known.sum() < certain.sum() < known.sum()  # neither nothing nor all is left of the samples
    np.testing.assert_array_equal(in_mm, np.where(certain, np.rint(np.nan_to_num(depth)), 0))
    # Light of a point at that depth arrives with that disparity: d = A - B / (depth - delta), forwards.
    model = Calibration.load(sample_camera(sample)).depth_model("accurate")
    expected = model.infinity_disparity_px - model.scale_px_mm / (depth - model.sensor_to_pupil_mm)
    exact = 2e-5  # float32 of 5 px
    if model.nonlinearity is not None:
        expected = model.nonlinearity.measured(expected)
        exact = 2e-4  # the table that inverts it
    np.testing.assert_allclose(disparity[known], expected[known], atol=exact)
    summary = json.loads((folder / f"{sample}.json").read_text())
    assert summary["fill_rate"] == pytest.approx(known.mean(), abs=1e-6)  # rounded in the file
    # Float32 against float64.
    assert summary["depth_percentiles_mm"]["50"] == pytest.approx(np.median(depth[known]), rel=1e-5)
    assert summary["config"]["matcher"]["layers"]["step_px"] > 0
    assert summary["camera"]["design"] in sample
    header = (folder / f"{sample}.ply").read_bytes()[:400].decode("ascii", "replace")
    assert f"element vertex {certain.sum()}\n" in header
    with Image.open(folder / f"{sample}.preview.png") as preview:
        assert min(preview.size) > 500
        shades = np.unique(np.asarray(preview.convert("RGB").resize((64, 48))).reshape(-1, 3), axis=0)
        assert len(shades) > 200  # a picture, not a blank sheet


@pytest.mark.slow
def test_the_demo_scene_lies_where_it_stands(demo):
    """Depths the scene was traced with; one curve for the whole frame knows no field curvature, so 8 %."""
    folder, _ = demo
    depth = tifffile.imread(folder / "still_life_cy_halves.depth.tiff")
    assert np.nanmedian(depth[320:400, 340:440]) == pytest.approx(1850, rel=0.08)  # DEPTH
    assert np.nanmedian(depth[300:420, 100:220]) == pytest.approx(1476, rel=0.08)  # OPTICS
    assert np.nanmedian(depth[420:470, 480:580]) == pytest.approx(1299, rel=0.08)  # PUPIL


def test_info_prints_json_with_units_in_the_names(run):
    result = run("info", sample_camera(SAMPLES[0]), "--json")
    assert result.returncode == 0, result.stderr
    info = json.loads(result.stdout)
    for name in ("focal_length_mm", "sensor_to_pupil_mm", "in_focus_mm", "baseline_mm"):
        assert info[name] > 0
    assert info["design"] == "cy_halves"
    assert (info["width_px"], info["height_px"]) == (720, 480)


def test_without_calibration_there_is_disparity_and_it_says_so(run, tmp_path, rng):
    picture = capture(texture(rng, 120, 160), "rgb_squares", 2.4)
    Image.fromarray(np.uint8(255 * picture ** (1 / 2.2))).save(tmp_path / "photo.png")
    result = run("depth", tmp_path / "photo.png", "--design", "rgb_squares", "--out", tmp_path / "out")
    assert result.returncode == 0, result.stderr
    assert "No calibration" in result.stdout
    names = sorted(p.name for p in (tmp_path / "out").iterdir())
    assert names == ["photo.color.png", "photo.disparity.tiff", "photo.json", "photo.preview.png"]
    disparity = tifffile.imread(tmp_path / "out" / "photo.disparity.tiff")
    assert np.nanmedian(disparity) == pytest.approx(2.4, abs=0.03)  # 8 bits and another gamma than sRGB


def bad_inputs(folder):
    """Name, command, and a word of the line that must come; built once, each is one user's mistake."""
    camera, image = sample_camera(SAMPLES[0]), sample_image(SAMPLES[0])
    data = image.read_bytes()
    counts = cv2.imread(str(image), cv2.IMREAD_UNCHANGED)
    made = {
        "truncated.png": data[: len(data) // 2],
        "text.png": b"hello, I am not a picture",
        "empty.png": b"",
        "corrupt.asdf": camera.read_bytes()[:700],
        "newer.asdf": re.sub(rb"format_version: \d+", b"format_version: 7", camera.read_bytes()),
        "config.toml": b"[matcher]\nstep = 0.5\n",
    }
    (folder / "session").mkdir()
    made["session/session.toml"] = b""
    for name, content in made.items():
        (folder / name).write_bytes(content)
    cv2.imwrite(str(folder / "black.png"), np.full_like(counts, 16))
    cv2.imwrite(str(folder / "white.png"), np.full_like(counts, 1023))
    cv2.imwrite(str(folder / "grey.png"), counts[..., 1])
    cv2.imwrite(str(folder / "small.png"), counts[:360, :360])
    cv2.imwrite(str(folder / "portrait.png"), counts.transpose(1, 0, 2))
    nan = (counts[..., ::-1].astype(np.float32) - 16) / 1000
    nan[:] = np.nan
    tifffile.imwrite(folder / "nan.tif", nan, photometric="rgb")
    (folder / "file").write_text("in the way")
    here = folder.joinpath
    camera_alone = ("--camera", camera)
    with_camera = (*camera_alone, "--out", here("out"))
    return {
        "truncated image": (["depth", here("truncated.png"), *with_camera], "damaged"),
        "not an image": (["depth", here("text.png"), *with_camera], "not an image"),
        "empty file": (["depth", here("empty.png"), *with_camera], "empty"),
        "missing file": (["depth", here("none.png"), *with_camera], "cannot read"),
        "grey image": (["depth", here("grey.png"), *with_camera], "grey"),
        "all black": (["depth", here("black.png"), *with_camera], "black"),
        "saturated": (["depth", here("white.png"), *with_camera], "is saturated"),
        "not a number": (["depth", here("nan.tif"), *with_camera], "finite"),
        "unknown design": (["depth", image, "--design", "cy_thirds", "--out", here("out")], "cy_halves"),
        "design without parallax": (["depth", image, "--design", "open", "--out", here("out")], "shifts no channel"),
        "neither camera nor design": (["depth", image, "--out", here("out")], "--camera"),
        "corrupt camera": (["depth", image, "--camera", here("corrupt.asdf"), "--out", here("out")], "damaged"),
        "newer camera": (["depth", image, "--camera", here("newer.asdf"), "--out", here("out")], "upgrade"),
        "image as camera": (["depth", image, "--camera", image, "--out", here("out")], "is no camera file; give"),
        "missing camera": (["info", here("none.asdf")], "no camera file"),
        "folder as camera": (["depth", image, "--camera", folder, "--out", here("out")], folder.name),
        "folder as lens": (["apertures", "--lens", folder], folder.name),
        # A second line would be how long the measurement takes.
        "focus outside": (["refocus", image, *camera_alone, "--point", "720,0"], "720x480"),
        "focus inside the lens": (["refocus", image, *camera_alone, "--focus-mm", "3"], "inside the lens"),
        "unknown quality": (["depth", image, *with_camera, "--quality", "best"], "real-time"),
        "levels": (["depth", image, *with_camera, "--black-level", "9000"], "black level"),
        "unknown setting": (["depth", image, *with_camera, "--config", here("config.toml")], "'step'"),
        "folder is a file": (["depth", image, "--camera", camera, "--out", here("file")], "cannot write"),
        "no error bar": (["depth", image, *with_camera, "--max-relative-sigma", "0"], "positive"),
        "same names": (["depth", image, image, *with_camera], "same files"),
        "a result over a photograph": (
            ["depth", here("portrait.png"), here("portrait.color.png"), *camera_alone],
            "would replace the photograph",
        ),
        "picture over the photograph": (
            ["refocus", here("small.png"), *camera_alone, "--focus-mm", "1500", "--out", here("small.png")],
            "replace an input",
        ),
        "page over a camera": (["view", image, "--out", here("corrupt.asdf")], "must end in .html"),
        "page over a map": (["compare", image, image, "--out", here("nan.tif")], "must end in .html"),
        "camera over a session": (["calibrate", folder, "--out", here("session.toml")], "must end in .asdf"),
        "capture over its depth": (
            ["simulate-rgbd", here("small.png"), here("grey.png"), here("grey.png"), "--focal-px", "600"],
            "replace an input",
        ),
        "session into another": (["simulate", here("session")], "holds a session"),
        "error bars compared": (["compare", here("a.sigma.tiff"), here("nan.tif"), "--json"], "no depth map"),
        "no session": (["calibrate", folder, "--out", here("c.asdf")], "session"),
    }


@pytest.mark.slow
def test_bad_input_is_one_clear_line_exit_code_2_and_nothing_written(run, tmp_path):
    cases = bad_inputs(tmp_path)
    before = sorted(p.name for p in tmp_path.iterdir())
    wrong = {}
    for name, (command, word) in cases.items():
        result = run(*command)
        lines = messages(result.stderr)
        good = result.returncode == 2 and len(lines) == 1 and re.search(word, lines[0]) and "Traceback" not in lines[0]
        if not good:
            wrong[name] = (result.returncode, result.stderr[-400:])
    assert not wrong, "\n".join(f"{name}: {got}" for name, got in wrong.items())
    assert sorted(p.name for p in tmp_path.iterdir() if p.name != "out") == before
    assert not (tmp_path / "out").exists() or list((tmp_path / "out").iterdir()) == []


def messages(stderr: str) -> list[str]:
    """Lines on standard error that are neither warnings nor progress, such as ``[0:02] chessboards, 4 of 5``."""
    return [line for line in stderr.splitlines() if not re.match(r"warning:|\[\d+:\d\d\]", line)]


# A command of each that writes; OUT is what cannot be written. `demo` writes as `depth` does.
WRITERS = {
    "depth": "depth PHOTO --camera CAMERA --quality paper --out OUT",
    "calibrate": "calibrate SESSION --no-blur --out OUT.asdf",
    "its report": "calibrate SESSION --no-blur --out c.asdf --report OUT.html",
    "board": "board --out OUT.pdf",
    "figure": "apertures cy_halves --at-mm 2000 --figure OUT.png",
    "template": "apertures cy_halves --at-mm 2000 --template OUT.svg",
    "refocus": "refocus SMALL --design cy_halves --quality paper --sharpness aligned --out OUT.png",
    "sweep": "refocus SMALL --design cy_halves --quality paper --sharpness aligned --sweep --out OUT.gif",
    "transparency": "transparency SMALL --bare SMALL --figure OUT.png",
    "simulate": "simulate OUT --width 60 --height 40 --cells 4 --step-mm 3000 --tilts 0 -q",
    "simulate-rgbd": "simulate-rgbd COLOR DEPTH OUT.png --focal-px 60",
    "session": "session new OUT",
    "record": "record SMALL --out OUT",
    "view": "view CAMERA --out OUT.html",
    "compare": "compare CAMERA CAMERA --out OUT.html",
    "TUM folder": "export PHOTO OUT --camera CAMERA --quality paper",
    "evaluate": "evaluate figure-4a --quick --out OUT",
}


@pytest.mark.slow
@pytest.mark.parametrize("command", WRITERS.values(), ids=WRITERS)
@pytest.mark.parametrize("out", ["/proc/foo", "/dev/full"])
def test_an_output_that_cannot_be_written_is_one_line(run, tmp_path, monkeypatch, session, small_camera, command, out):
    cv2.imwrite(str(tmp_path / "depth.png"), np.full((108, 144), 1500, np.uint16))
    monkeypatch.chdir(tmp_path)
    names = {"PHOTO": sample_image(SAMPLES[0]), "CAMERA": sample_camera(SAMPLES[0]), "SESSION": session,
             "SMALL": small_camera / "photo.png", "COLOR": session / "board" / "1150.png",
             "DEPTH": tmp_path / "depth.png"}  # fmt: skip
    suffix = re.search(r"OUT(\.\w+)?", command)[1]
    if out == "/dev/full" and suffix:
        out, command = f"{tmp_path}/device{suffix}", command.replace(f"OUT{suffix}", "OUT")
        os.symlink("/dev/full", out)  # a device with a name that the command takes
    words = [str(names.get(word, word)).replace("OUT", out) for word in command.split()]
    before = sorted(os.listdir("/dev")), sorted(os.listdir(tmp_path))
    result = run(*words)
    lines = messages(result.stderr)
    assert (result.returncode, len(lines)) == (2, 1), result.stderr
    assert lines[0].startswith("error: ")
    assert re.search("/proc|/dev/full|device", lines[0])
    # What a repetition begins with, and the report, which is written before the camera file.
    left = [n for n in sorted(os.listdir(tmp_path)) if not n.endswith((".calibrating", ".report.html"))]
    assert (sorted(os.listdir("/dev")), left) == before


@pytest.mark.slow
def test_a_full_device_as_output_is_one_clear_line():
    command = [sys.executable, "-m", "chromaperture", "info", str(sample_camera(SAMPLES[0])), "--json"]
    with open("/dev/full", "wb") as full:
        result = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, timeout=60, check=False)
    assert result.returncode == 2
    assert result.stderr.count("\n") == 1
    assert "disk is full" in result.stderr


def test_a_warning_of_every_image_is_printed_once_a_run(run, tmp_path, rng):
    for name in ("a.jpg", "b.jpg"):
        picture = Image.fromarray(rng.integers(0, 255, (40, 56, 3)).astype(np.uint8))
        exif = picture.getexif()
        exif[0x0112] = 6
        picture.save(tmp_path / name, subsampling=0, exif=exif)
    for _ in range(2):
        images = (tmp_path / "a.jpg", tmp_path / "b.jpg")
        result = run("depth", *images, "--design", "cy_halves", "--out", tmp_path / "out", "-q")
        assert result.returncode == 0, result.stderr
        assert result.stderr.count("portrait orientation") == 1
    result = run("record", tmp_path / "*.jpg", "--out", tmp_path / "walk", "-q")
    assert (result.returncode, result.stderr) == (0, "")


def test_a_camera_file_is_read_once_and_images_of_one_size_have_one_camera_of_a_design(tmp_path):
    sizes = {"a": (20, 30), "b": (20, 30), "c": (30, 20)}
    for name, size in sizes.items():
        Image.new("RGB", size).save(tmp_path / f"{name}.png")
    camera_of = cameras(tmp_path / "a.png", None, "cy_halves", quality="real-time", config=None)
    a, b, c = (camera_of(tmp_path / f"{name}.png") for name in sizes)
    assert a is b
    assert (c.calibration.sensor.width_px, c.calibration.sensor.height_px) == sizes["c"]
    camera_of = cameras(tmp_path / "a.png", sample_camera(SAMPLES[0]), None, quality="real-time", config=None)
    assert camera_of(tmp_path / "a.png") is camera_of(tmp_path / "c.png")


def test_help_tells_how(run, monkeypatch):
    monkeypatch.setenv("COLUMNS", "250")  # no line is broken
    said = run("depth", "--help").stdout
    for words in ("chromaperture depth photo.png --camera camera.asdf", "[matcher]", "[depth]", "docs/settings.md"):
        assert words in said
    for by_default in (True, False):
        assert ", ".join(name for name, output in OUTPUTS.items() if output.by_default == by_default) in said
    said = run("evaluate", "--help").stdout
    for name, exhibit in EXHIBITS.items():
        assert f"{name:<11}  {exhibit.title}" in said


@pytest.mark.parametrize("code", ["", ".cli.main as m; m.app(['depth', '--help'], standalone_mode=False)"])
def test_the_package_and_help_load_no_library_of_the_work(code):
    loaded = "sorted({'numpy', 'scipy', 'numba', 'cv2', 'asdf', 'matplotlib', 'PIL'} & set(sys.modules))"
    program = f"import sys, chromaperture{code}; print({loaded})"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


def every_option():
    """Names and help of the options of each command."""

    def below(command, name):
        for child_name, child in getattr(command, "commands", {}).items():
            yield from below(child, child_name)
        yield name, {option: p.help for p in command.params for option in p.opts if option.startswith("--")}

    return dict(below(typer.main.get_command(app), "chromaperture"))


def test_one_thing_has_one_name_in_every_command():
    options = every_option()
    assert len(options) > 15
    names = {option for command in options.values() for option in command}
    # The second of each pair means the same as the first.
    for one, another in (
        ("--design", "--aperture"), ("--focus-mm", "--focus"), ("--board", "--columns"), ("--square-mm", "--square"),
    ):  # fmt: skip
        assert one in names
        assert another not in names
    for option in ("--black-level", "--white-level", "--quality", "--quiet", "--json"):
        said = {command[option] for name, command in options.items() if option in command and name != "reconstruct"}
        assert len(said) == 1, option


def test_the_shell_completes_commands(run, monkeypatch):
    assert "--install-completion" in run("--help").stdout
    monkeypatch.setenv("_CHROMAPERTURE_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", "chromaperture ref")
    monkeypatch.setenv("COMP_CWORD", "1")
    assert run().stdout.split() == ["refocus"]


def test_tables_fit_80_columns(run, monkeypatch, small_camera):
    monkeypatch.setattr(console.out, "width", 80)
    sheet = small_camera / "photo.png"
    for name in ("magenta_annulus", "cy_open_disc"):
        (small_camera / f"{name}.png").write_bytes(sheet.read_bytes())
    for command, words in (
        (["apertures"], ("magenta_annulus", "cy_open_disc", "baseline, mm")),
        (["info", sample_camera(SAMPLES[0])], ("infinity_disparity_px", "rms_on_axis_mm")),
        (["transparency", *small_camera.glob("*_*.png"), "--bare", sheet], ("magenta_annulus", "cy_open_disc")),
    ):
        result = run(*command)
        assert result.returncode == 0, result.stderr
        for word in words:
            assert word in result.stdout
        assert max(map(len, result.stdout.splitlines())) <= 80


def test_info_prints_words_and_no_python(run, tmp_path):
    camera = Calibration.load(sample_camera(SAMPLES[0]))
    made = {"options": {"blur": True, "degrees": (4, 2)}, "notes": ["a note", "another"], "lens_from": None}
    replace(camera, provenance={**camera.provenance, **made}).save(tmp_path / "camera.asdf")
    text = run("info", tmp_path / "camera.asdf").stdout
    rms = camera.provenance["rms_on_axis_mm"]["real-time"]
    for word in ("blur: yes", "degrees: 4, 2", "a note ", "another ", f"real-time: {rms:.3g}"):
        assert word in text
    assert not re.search(r"[\[\]{}()']|None|True", text.split("title")[1])


def test_figures_that_nobody_measured_are_null(run, small_camera, tmp_path):
    common = ("--design", "cy_halves", "--quality", "paper", "--out", tmp_path, "--json")
    result = run("depth", small_camera / "photo.png", *common)
    assert result.returncode == 0, result.stderr
    camera = json.loads(result.stdout)[0]["camera"]
    known = {name for name, value in camera.items() if value is not None}
    assert known == {"design", "title", "width_px", "height_px", "provenance"}


@pytest.fixture(scope="module")
def small_camera(tmp_path_factory):
    """A photograph of a plane with its camera file, made for the sample lens."""
    folder = tmp_path_factory.mktemp("refocus")
    rng = np.random.default_rng(5)
    image = capture(texture(rng, height=96, width=128), "cy_halves", 2.0)
    cv2.imwrite(str(folder / "photo.png"), np.rint(image[..., ::-1] * 65535).astype(np.uint16))
    return folder


def test_refocus_writes_a_picture_and_a_film(run, small_camera, tmp_path):
    photo = small_camera / "photo.png"
    common = ("--design", "cy_halves", "--sharpness", "fast", "--quality", "real-time")
    result = run("refocus", photo, *common, "--strength", "1.5", "--out", tmp_path / "a.png", "--json")
    assert result.returncode == 0, result.stderr
    figures = json.loads(result.stdout)
    assert figures["strength"] == 1.5
    # A plane 2 px beyond focus; the rim of a half pupil moves 3 pi / 4 as far as its centroid, and so does
    # the error of the disparity, a layer of 0.5 px at worst.
    assert figures["radius_range_px"] == pytest.approx([2 * 0.75 * np.pi] * 2, abs=1.5)
    with Image.open(tmp_path / "a.png") as picture:
        assert picture.size == (128, 96)
    result = run("refocus", photo, *common, "--point", "64,48", "--background", "desaturate")
    assert result.returncode == 0, result.stderr
    assert (small_camera / "photo.refocus.png").is_file()
    result = run("refocus", photo, *common, "--sweep", "--out", tmp_path / "film.gif", "-q")
    assert (result.returncode, result.stdout) == (0, "")
    with Image.open(tmp_path / "film.gif") as film:
        assert film.n_frames > 2


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--focus-mm", "0"), "--focus-mm"),
        (("--focus-mm", "-3"), "--focus-mm"),
        (("--point", "5"), "X,Y"),
        (("--point", "9999,1"), "outside"),
        (("--focus-mm", "1000", "--sweep"), "one of --focus-mm"),
        (("--focus-mm", "1000"), "calibrat"),
        (("--f-number", "2"), "--strength"),
        (("--f-number", "2", "--strength", "1"), "one of"),
        (("--strength", "-1"), "--strength"),
        (("--bokeh", "star"), "unknown bokeh"),
        (("--background", "sepia"), "--background"),
        (("--sharpness", "very"), "--sharpness"),
        (("--out", "picture.jpg"), ".png"),
        (("--sweep", "--out", "film.avi"), ".gif or .mp4"),
    ],
)
def test_refocus_refuses_in_one_line(run, small_camera, tmp_path, monkeypatch, options, message):
    monkeypatch.chdir(tmp_path)
    quick = () if "--sharpness" in options else ("--sharpness", "aligned")
    result = run("refocus", small_camera / "photo.png", "--design", "cy_halves", *quick, *options)
    assert result.returncode == 2
    assert message in result.stderr
    assert len(result.stderr.strip().splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


def test_a_template_states_its_diameter_and_where_it_comes_from(run, tmp_path):
    common = ("apertures", "cy_halves", "--at-mm", "2000", "--template", tmp_path / "cut.svg")
    assert "iris of 17.1 mm\n" in run(*common, "--pupil-mm", "17.1").stdout
    assert "of the lens double_gauss_50; --pupil-mm is for yours" in run(*common).stdout


def test_light_is_rounded_once(run):
    command = ("apertures", "cy_open", "--at-mm", "2000", "--film", "real")
    light = json.loads(run(*command, "--json").stdout)[0]["efficiency_mean"]
    printed = run(*command).stdout
    assert f"{100 * light:.1f}" == "86.9"  # 86.947 %; rounded to 0.8695 before it would be 87.0
    assert " 86.9 " in printed


def test_transparency_prints_the_tables(run, tmp_path):
    rng = np.random.default_rng(8)
    full, share = 0.8, np.array([0.5, 0.75, 0.375])
    for name, light in (("bare", np.full(3, full)), ("coded", full * share)):
        counts = rng.poisson(light * 20000, (120, 160, 3)) / 20000 * 1000 + 16
        cv2.imwrite(str(tmp_path / f"{name}.png"), np.rint(counts[..., ::-1]).astype(np.uint16))
    levels = ("--black-level", 16, "--white-level", 1016)
    bare, coded = tmp_path / "bare.png", tmp_path / "coded.png"
    result = run("transparency", coded, "--bare", bare, *levels, "--json", "--figure", tmp_path / "figure.png")
    assert result.returncode == 0, result.stderr
    (row,) = json.loads(result.stdout)
    # Means over 19 200 px of 1 % noise
    assert row["efficiency"] == pytest.approx(share.mean(), abs=2e-3)
    loss = np.mean(-10 * np.log10(share))  # photon noise
    assert row["snr_loss_central_db"] == pytest.approx(loss, abs=0.25)
    assert row["exposure_shot_noise"] == pytest.approx(row["exposure_amplitude"] ** 2)
    with Image.open(tmp_path / "figure.png") as figure:
        assert min(figure.size) > 300
    assert "Transparency" in run("transparency", coded, "--bare", bare, *levels).stdout
    assert run("transparency", coded, "--bare", bare, *levels, "-q").stdout == ""
    swapped = run("transparency", bare, "--bare", coded, *levels)
    assert swapped.returncode == 2
    assert "exposure" in swapped.stderr
    assert run("transparency", coded, "--bare", bare, *levels, "--exposure", 0).returncode == 2
    assert run("transparency", coded, "--bare", bare, *levels, "--figure", "f.gif").returncode == 2
