"""``chromaperture films``, and gels in place of a film's name."""

import json
import sys

import pytest

from chromaperture.optics.gel_spectra import seen_by
from chromaperture.system.errors import MissingDependencyError

SPECTRA = pytest.mark.extra("films", "lighting_filters")


def table_of(path, head, rows):
    path.write_text("\n".join([head, *(",".join(map(str, row)) for row in rows)]), encoding="utf-8")
    return path


def camera(folder):
    """Channels of 100 nm each, that overlap."""
    rows = [(nm, *(max(0, 1 - abs(nm - at) / 100) for at in (600, 540, 450))) for nm in range(400, 701, 10)]
    return table_of(folder / "camera.csv", "nm,r,g,b", rows)


def test_best_pairs_and_a_pair_under_three_lights(run):
    rows = json.loads(run("films", "--json", "--camera-model", "canon eos r5").stdout)
    assert {"141 Bright Blue", "768 Egg Yolk Yellow"} < {row[which] for row in rows for which in ("first", "second")}
    assert min(row["relative_error"] for row in rows) == min(row["relative_error_exposed_longer"] for row in rows) == 1
    rows = json.loads(run("films", "115", "101", "--json").stdout)
    assert [row["list"] for row in rows] == ["chosen, daylight", "chosen, led", "chosen, tungsten"]
    assert all(row["relative_error"] > 1.1 for row in rows)
    text = run("films", "115", "101", "--light", "led").stdout
    assert "115 Peacock Blue" in text
    assert "photograph white sheets" in " ".join(text.split())
    assert run("films", "115", "101", "-q").stdout == ""


def test_gels_are_listed(run):
    assert "768 Egg Yolk Yellow" in run("films", "--list").stdout
    listed = json.loads(run("films", "--list", "--json", "--light", "tungsten").stdout)
    assert len(listed) > 200
    assert all(0 <= share <= 1 for row in listed for share in row["rgb"])


def test_the_figure_is_drawn(run, tmp_path):
    assert run("films", "141", "768", "--figure", tmp_path / "a.svg").returncode == 0
    assert "141 Bright Blue" in (tmp_path / "a.svg").read_text(encoding="utf-8")


@SPECTRA
def test_a_lamp_with_lines_is_warned_of(run, tmp_path):
    lamp = table_of(tmp_path / "lamp.csv", "nm,power", [(nm + by, p) for nm in (450, 530, 620) for by, p in
                                                        ((-3, 0), (0, 1), (3, 0))])  # fmt: skip
    said = run("films", "118", "101", "--sensitivities", camera(tmp_path), "--light", lamp)
    assert said.returncode == 0
    assert "lamp.csv has a line at" in said.stderr


@SPECTRA
def test_a_film_and_a_camera_of_ones_own(run, tmp_path):
    grey = table_of(tmp_path / "grey.csv", "nm,passes", [(nm, 0.25) for nm in (400, 500, 700)])
    own = ("--sensitivities", camera(tmp_path), "--json")
    (row,) = json.loads(run("films", grey, "768", *own, "--light", "led").stdout)
    assert (row["camera"], row["first"], row["first_rgb"]) == ("camera.csv", "grey", [0.25, 0.25, 0.25])
    listed = {row["gel"]: row["rgb"] for row in json.loads(run("films", "--list", *own, "--light", "led").stdout)}
    assert listed["768 Egg Yolk Yellow"] == row["second_rgb"]


def test_apertures_are_of_gels(run):
    found = {row["name"]: row for row in json.loads(run("apertures", "--film", "118,101", "--json").stdout)}
    assert set(found) == {"cy_halves", "cy_open", "cy_open_disc"}  # designs of two films
    assert run("apertures", "cy_halves", "--film", "Bright Blue,Egg Yolk Yellow", "-q").returncode == 0
    (two,) = json.loads(run("films", "118", "101", "--json", "--light", "daylight").stdout)
    halves = [(a + b) / 2 for a, b in zip(two["first_rgb"], two["second_rgb"], strict=True)]
    assert found["cy_halves"]["transmission_rgb"] == pytest.approx(halves, abs=2e-3)  # half the pupil each


WRONG = {
    "one gel": (["films", "118"], "give two gels"),
    "unknown gel": (["films", "118", "999"], "nearest: 799"),
    "unknown film": (["apertures", "--film", "118,999"], "nearest: 799"),
    "simulated": (["simulate", "FOLDER/new", "--film", "118"], "takes 2 gels"),
    "camera": (["films", "--camera-model", "Canon 60D"], "did you mean 'Canon EOS 600D'"),
    "both": (["films", "--camera-model", "Nikon D850", "--sensitivities", "x.csv"], "not both"),
    "no file": (["films", "--sensitivities", "FOLDER/none.csv"], "cannot read"),
    "light": (["films", "--light", "moon"], "unknown light moon: give daylight, led, tungsten"),
    "figure": (["films", "--figure", "FOLDER/a.jpg"], ".png or .svg"),
    "alike": (["films", "118", "118"], "move all channels alike"),
    "own light": (["films", "--light", "FOLDER/sodium.csv"], "needs --sensitivities"),
    "own gel": (["films", "118", "FOLDER/sodium.csv"], "with --sensitivities of the camera"),
    "own film": (["apertures", "--film", "118,FOLDER/sodium.csv"], "[filters.NAME] of an aperture file"),
}


@pytest.mark.parametrize(("command", "says"), WRONG.values(), ids=WRONG)
def test_bad_input_is_one_line(run, tmp_path, command, says):
    (tmp_path / "sodium.csv").write_text("388,0\n389,1\n390,0", encoding="utf-8")
    result = run(*(word.replace("FOLDER", str(tmp_path)) for word in command))
    assert (result.returncode, len(result.stderr.splitlines())) == (2, 1), result.stderr
    assert says in result.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["sodium.csv"]


@SPECTRA
def test_a_light_that_a_channel_does_not_see_is_one_line(run, tmp_path):
    sodium = table_of(tmp_path / "sodium.csv", "nm,power", [(388, 0), (389, 1), (390, 0)])
    said = run("films", "--light", sodium, "--sensitivities", camera(tmp_path))
    assert (said.returncode, len(said.stderr.splitlines())) == (2, 1)
    assert "hardly sees this light" in said.stderr


def test_without_the_extra_one_line_says_what_to_install(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "lighting_filters", None)
    with pytest.raises(MissingDependencyError, match=r"pip install 'chromaperture\[films\]'"):
        seen_by(camera(tmp_path), "daylight")
