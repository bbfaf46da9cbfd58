"""Comparison of depth maps and of cameras: shares, error bars and pages are what a reader would compute by hand."""

from __future__ import annotations

import base64
import json
import re
import zlib
from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.stats import norm

from chromaperture.depth.conversion import DepthModel
from chromaperture.depth.pointcloud import PointCloud, write_ply
from chromaperture.evaluation.compare import camera_page, compare_cameras, compare_depth, depth_page
from chromaperture.files.map_page import Page, Panel, every, render
from chromaperture.files.pictures import write_color_png, write_depth_png, write_float_tiff
from chromaperture.products.result_files import StoredDepth, read_depth, read_ply, read_result
from chromaperture.products.samples import sample_camera
from chromaperture.system.errors import InputError
from worlds import halves_camera


def unpacked(text, dtype, shape):
    """The array of a page, decoded by other means than the page's: planes of bytes in a zlib stream."""
    planes = np.frombuffer(zlib.decompress(base64.b64decode(text)), np.uint8)
    item = np.dtype(dtype).itemsize
    return planes.reshape(item, -1).T.copy().view(dtype).reshape(shape)


def data_of(html):
    return json.loads(re.search(r'<script type="application/json" id="data">(.*?)</script>', html, re.S)[1])


def maps(rng, sigma_percent=1.0, claimed=1.0, shape=(200, 300)):
    """A slanted wall, and it with errors of ``sigma_percent`` and an error bar of ``claimed`` times that."""
    truth = np.linspace(1000, 3000, shape[1], dtype=np.float32) * np.ones((shape[0], 1), np.float32)
    sigma = (truth * sigma_percent / 100).astype(np.float32)
    noisy = (truth + sigma * rng.standard_normal(shape)).astype(np.float32)
    return StoredDepth("truth", truth), StoredDepth("measured", noisy, claimed * sigma)


def test_shares_are_those_of_the_noise(rng):
    figures = compare_depth(*maps(rng)).figures
    for percent in (1, 2, 5):
        expected = norm.cdf(percent) - norm.cdf(-percent)
        share = figures["within"][f"{percent}_percent"]
        assert share["of_known_in_a"] == share["of_known_in_both"] == pytest.approx(expected, abs=0.01)  # 60 000 pixels
    assert figures["difference_percent"]["median"] == pytest.approx(0, abs=0.02)


@pytest.mark.parametrize("claimed", [0.5, 1.0, 2.0])
def test_error_bars_are_judged_by_their_width(rng, claimed):
    found = compare_depth(*maps(rng, claimed=claimed))
    bars = found.figures["error_bars"]
    assert bars["of"] == "b"
    assert bars["spread_in_sigmas"] == pytest.approx(1 / claimed, rel=0.02)
    assert bars["within_1_sigma"]["share"] == pytest.approx(norm.cdf(claimed) - norm.cdf(-claimed), abs=0.01)
    said = " ".join(depth_page(found).sentences)
    assert {0.5: "too narrow", 1.0: "about as wide", 2.0: "wider than"}[claimed] in said


def test_error_bars_of_both_add_as_squares(rng):
    truth, b = maps(rng)
    other = maps(rng)[1]
    bars = compare_depth(other, b).figures["error_bars"]
    assert (bars["of"], bars["spread_in_sigmas"]) == ("both", pytest.approx(1, rel=0.02))
    assert compare_depth(truth, StoredDepth("b", b.depth_mm)).figures["error_bars"] is None


@pytest.mark.parametrize(("name", "counts_a_mm"), [("a.depth_0.1mm.png", 10), ("a_depth_mm.png", 1), ("a.png", 1)])
def test_the_unit_that_a_file_name_states_is_that_of_its_counts(tmp_path, name, counts_a_mm):
    truth = np.full((4, 5), 1234.0)
    truth[0, 0] = 0
    assert cv2.imwrite(str(tmp_path / name), (truth * counts_a_mm).astype(np.uint16))
    found = read_depth(tmp_path / name).depth_mm
    assert np.isnan(found[0, 0])
    np.testing.assert_allclose(found[1:], truth[1:], rtol=1e-6)  # float32


def test_maps_in_different_units_are_said_to_be(rng):
    truth, measured = maps(rng)
    in_metres = StoredDepth("metres", measured.depth_mm / 1000)
    said = depth_page(compare_depth(truth, in_metres)).sentences[0]
    assert "0.001 times those of A: one of them seems not to be in mm" in said
    assert "times those" not in " ".join(depth_page(compare_depth(truth, measured)).sentences)


def test_what_b_does_not_know_is_not_within_anything():
    a = np.array([[1000, 1000, 1000, 1000, np.nan]], np.float32)
    b = np.array([[1005, 1030, np.nan, np.nan, 1000]], np.float32)
    figures = compare_depth(StoredDepth("a", a), StoredDepth("b", b)).figures
    assert figures["known_share"] == {"a": 0.8, "b": 0.6, "both": 0.4}
    assert figures["within"]["1_percent"] == {"of_known_in_a": 0.25, "of_known_in_both": 0.5}
    assert figures["within"]["5_percent"] == {"of_known_in_a": 0.5, "of_known_in_both": 1.0}
    assert sum(row["pixels"] for row in figures["by_distance"]) in (0, 4)  # one distance has no quarters


def test_maps_that_cannot_be_compared_are_refused():
    a = StoredDepth("a", np.full((4, 5), 1000, np.float32))
    with pytest.raises(InputError, match="5x4 and 4x5"):
        compare_depth(a, StoredDepth("b", np.full((5, 4), 1000, np.float32)))
    with pytest.raises(InputError, match="same view"):
        compare_depth(a, StoredDepth("b", np.full((4, 5), np.nan, np.float32)))


def test_a_camera_with_another_scale_reads_other_distances():
    # d = A - B / (z - delta) read with 1.01 B gives z' - delta = 1.01 (z - delta).
    models = [DepthModel(4.0, scale, 50.0) for scale in (8000.0, 8080.0)]
    a, b = (halves_camera(model, 120, 80) for model in models)
    found = compare_cameras(a, b)
    z = found.distances_mm
    expected = 100 * ((1.01 * (z - 50) + 50) / z - 1)
    over_the_frame = np.broadcast_to(expected[:, None, None], (24, 33, 33))
    np.testing.assert_allclose(found.difference_percent, over_the_frame, atol=1e-4)  # depth is float32
    assert found.figures["within"]["1_percent"]["of_frame_and_distances"] == 1.0
    assert (z[0], z[-1]) == (pytest.approx(900), pytest.approx(4200))
    same = compare_cameras(a, a)
    assert np.abs(same.difference_percent).max() < 1e-4  # depth is float32
    for wrong in (replace(a, design="rgb_squares"), replace(a, depth={}), replace(a, near_mm=4200.0, far_mm=9000.0)):
        with pytest.raises(InputError):
            compare_cameras(a, wrong)
    assert data_of(render(camera_page(found)))["panels"][0]["title"] == "B − A at 900 mm"


def test_the_page_holds_every_value_and_loads_nothing(rng):
    values = rng.normal(size=(7, 11)).astype(np.float32)
    values[2, 3] = np.nan
    html = render(Page("a </script><b>", panels=[Panel("</script>", values, "mm", -1, 1, "turbo_r")]))
    panel = data_of(html)["panels"][0]
    np.testing.assert_array_equal(unpacked(panel["values"], "<f4", (7, 11)), values)
    assert (panel["width"], panel["height"], panel["step"], panel["title"]) == (11, 7, 1, "</script>")
    assert "<b>" not in html.split("<title>")[1].split("</title>")[0]
    assert not re.findall(r'(?:src|href)="(?!data:)|url\(|\bfetch\(|https?:|@import', html)


def test_large_maps_are_thinned_and_say_so():
    assert every((4000, 6000)) == 5  # 24 megapixels to 0.96
    large = np.zeros((1100, 1000), np.float32)
    html = render(Page("large", panels=[Panel("map", large, "mm", 0, 1, "viridis")]))
    panel = data_of(html)["panels"][0]
    assert (panel["step"], panel["columns"], panel["rows"]) == (2, 500, 550)
    assert "Of 2 columns and rows, one is shown" in html


def results(folder, rng):
    truth, b = maps(rng, shape=(40, 60))
    write_float_tiff(folder / "p.depth.tiff", b.depth_mm)
    write_float_tiff(folder / "p.sigma.tiff", b.sigma_mm)
    write_depth_png(folder / "truth.png", truth.depth_mm)
    write_color_png(folder / "p.color.png", rng.uniform(0, 1, (40, 60, 3)).astype(np.float32))
    points = rng.normal(size=(50, 3)).astype(np.float32)
    cloud = PointCloud(points, rng.integers(0, 256, (50, 3)).astype(np.uint8))
    write_ply(folder / "p.ply", cloud)
    (folder / "p.json").write_text('{"fill_rate": 0.5, "camera": {"design": "<i>"}}')
    np.save(folder / "truth.npy", truth.depth_mm)
    return truth, b, cloud


def test_results_are_found_beside_each_other(tmp_path, rng):
    truth, b, cloud = results(tmp_path, rng)
    for name in ("p.depth.tiff", "p.ply", "p.json", "p.color.png"):
        found = read_result(tmp_path / name)
        assert (found.name, set(found.maps)) == ("p", {"depth", "sigma"})
        np.testing.assert_array_equal(found.cloud.points_mm, cloud.points_mm)
        np.testing.assert_array_equal(found.cloud.colors, cloud.colors)
        stored = read_depth(tmp_path / name)
        np.testing.assert_array_equal(stored.depth_mm, b.depth_mm)
        np.testing.assert_array_equal(stored.sigma_mm, b.sigma_mm)
    np.testing.assert_array_equal(read_depth(tmp_path / "truth.npy").depth_mm, truth.depth_mm)
    np.testing.assert_allclose(read_depth(tmp_path / "truth.png").depth_mm, truth.depth_mm, atol=0.5)  # whole mm


@pytest.mark.parametrize(
    "damage", [lambda d: d[:-1], lambda d: d.replace(b"vertex 50", b"vertex 5000000000"), lambda d: b"ply\n" + d[30:],
               lambda d: d.replace(b"binary_little_endian", b"ascii"), lambda d: d.replace(b"float y", b"float x")]
)  # fmt: skip
def test_damaged_points_are_refused(tmp_path, rng, damage):
    results(tmp_path, rng)
    (tmp_path / "bad.ply").write_bytes(damage((tmp_path / "p.ply").read_bytes()))
    with pytest.raises(InputError, match="damaged"):
        read_ply(tmp_path / "bad.ply")


def test_compare_on_the_command_line(run, tmp_path, rng, monkeypatch):
    results(tmp_path, rng)
    monkeypatch.chdir(tmp_path)
    code, said, complaint = run("compare", "truth.png", "p.depth.tiff", "--json")
    figures = json.loads(said)
    assert (code, complaint, figures["error_bars"]["of"]) == (0, "", "b")
    assert not (tmp_path / "comparison.html").exists()
    assert run("compare", "truth.npy", "p.depth.tiff")[0] == 0
    titles = [p["title"] for p in data_of((tmp_path / "comparison.html").read_text())["panels"]]
    assert titles == ["A: truth.npy", "B: p.depth.tiff", "B − A", "B − A in error bars", "error bar of B", "colour"]
    camera = sample_camera("still_life_cy_halves")
    same = json.loads(run("compare", camera, camera, "--json").stdout)
    assert same["within"]["1_percent"]["of_frame_and_distances"] == 1.0
    for a, b in (("truth.png", camera), ("truth.png", "missing.tiff"), ("p.color.png", "p.json"), ("p.json", "x.txt")):
        result = run("compare", a, b, "--out", "new.html")
        ok = (a, b) == ("p.color.png", "p.json")  # both stand for p.depth.tiff
        assert result.returncode == (0 if ok else 2)
        assert ok or len(result.stderr.strip().splitlines()) == 1, result.stderr
