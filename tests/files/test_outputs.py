"""Files appear whole or not at all, in the encodings other programs expect."""

import errno
import json
import os

import cv2
import numpy as np
import pytest
import tifffile

from chromaperture.color.srgb import linear_to_srgb
from chromaperture.depth.error_limit import within_error
from chromaperture.depth.pointcloud import depth_to_points, write_depth_ply, write_ply
from chromaperture.files.pictures import write_color_png, write_depth_png, write_float_tiff
from chromaperture.system.errors import InputError
from chromaperture.system.storage import staged, to_json


def test_depth_encodings(tmp_path):
    depth = np.array([[1000.4, np.nan, 65535.4], [70000.0, 0.2, 1234.6]], np.float32)
    write_float_tiff(tmp_path / "d.tiff", depth)
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "d.tiff"), depth)
    write_depth_png(tmp_path / "d.png", depth)
    stored = cv2.imread(str(tmp_path / "d.png"), cv2.IMREAD_UNCHANGED)
    assert stored.dtype == np.uint16
    np.testing.assert_array_equal(stored, [[1000, 0, 65535], [0, 0, 1235]])


def test_color_png_is_srgb(tmp_path):
    color = np.zeros((2, 2, 3), np.float32)
    color[0, 0] = (1.0, 0.2158605, np.nan)
    write_color_png(tmp_path / "c.png", color)
    np.testing.assert_array_equal(cv2.imread(str(tmp_path / "c.png"))[0, 0, ::-1], [255, 128, 0])


def test_files_appear_together(tmp_path):
    with staged(tmp_path / "new" / "folder") as stage:
        stage.path("a.txt").write_text("a")
        stage.path("b.txt").write_text("b")
        assert not (tmp_path / "new" / "folder" / "a.txt").exists()
    assert sorted(p.name for p in (tmp_path / "new" / "folder").iterdir()) == ["a.txt", "b.txt"]


@pytest.mark.parametrize("error", [RuntimeError("x"), KeyboardInterrupt(), OSError(errno.ENOSPC, "No space left")])
def test_an_error_leaves_the_old_files(tmp_path, error):
    (tmp_path / "a.txt").write_text("old")

    def write_and_fail():
        with staged(tmp_path) as stage:
            stage.path("a.txt").write_text("half of the n")
            raise error

    expected = InputError if isinstance(error, OSError) else type(error)
    with pytest.raises(expected):
        write_and_fail()
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]
    assert (tmp_path / "a.txt").read_text() == "old"


def test_full_disk_is_one_clear_line(tmp_path):
    # A file-size limit would kill the process; a full device raises the same error number in the same place.
    with pytest.raises(InputError, match="disk is full"), staged(tmp_path) as stage:
        target = stage.path("a.tiff")
        with open("/dev/full", "wb") as full:
            full.write(b"x" * 10_000_000)
        target.touch()
    assert list(tmp_path.iterdir()) == []


def test_a_device_is_not_replaced_by_a_file(tmp_path):
    os.mkfifo(tmp_path / "full")  # as /dev/full, which only root can make
    with pytest.raises(InputError, match="device"), staged(tmp_path) as stage:
        stage.path("full").write_text("x")
    assert [(p.name, p.is_fifo()) for p in tmp_path.iterdir()] == [("full", True)]


@pytest.mark.parametrize("limit", [0.05, 0.1, np.inf])
def test_depth_without_an_error_bar_is_limited_by_it(limit):
    depth = np.array([[1000, 1000, 2000, np.nan, 1000]], np.float32)
    sigma = np.array([[50, 100, 100, np.nan, np.nan]], np.float32)
    kept = np.isfinite(within_error(depth, sigma, limit))
    np.testing.assert_array_equal(kept, [[True, limit >= 0.1, True, False, False]])
    for nonsense in (0, -1, np.nan):
        with pytest.raises(InputError, match="positive"):
            within_error(depth, sigma, nonsense)


def test_json_has_no_nan():
    text = to_json({"a": np.float32(1.5), "b": [np.nan, np.inf], "c": np.arange(2), "d": (True, None)})
    assert json.loads(text) == {"a": 1.5, "b": [None, None], "c": [0, 1], "d": [True, None]}


def test_rays_between_the_grid_of_a_wide_lens():
    # 500 px of focal length, 0.6 of it to the corner: the rays of every pixel by OpenCV's own iteration.
    matrix, distortion = np.array([[500.0, 0, 240], [0, 500.0, 180], [0, 0, 1]]), np.array([-0.1, 0.02, 0.001, 0, 0])
    cloud = depth_to_points(
        np.full((361, 483), 1050.0), np.zeros((361, 483, 3)),
        camera_matrix=matrix, distortion=distortion, sensor_to_pupil_mm=50.0,
    )  # fmt: skip
    v, u = np.mgrid[:361, :483]
    exact = cv2.undistortPoints(np.stack([u.ravel(), v.ravel()], 1)[:, None].astype(float), matrix, distortion)[:, 0]
    off_px = 500 * np.abs(cloud.points_mm[:, :2] / 1000 - exact)
    assert off_px.max() < 2e-3  # h^2 / 8 of the second derivative, 6 k1 x / f = 7e-4 a px: 1.4e-3 px along one axis


def test_large_clouds_and_pictures_are_whole(tmp_path, rng):
    # Points are written, and pixels converted, in pieces of 65536: nothing is lost or repeated at their ends.
    depth = rng.uniform(900, 1100, (300, 400)).astype(np.float32)
    depth[rng.random(depth.shape) < 0.1] = np.nan
    color = rng.uniform(-0.1, 1.1, (300, 400, 3)).astype(np.float32)
    view = {"camera_matrix": np.diag([800.0, 800.0, 1.0]), "distortion": np.zeros(5), "sensor_to_pupil_mm": 50.0}
    cloud = depth_to_points(depth, color, **view)
    known = np.isfinite(depth)
    np.testing.assert_array_equal(cloud.points_mm[:, 2], depth[known] - np.float32(50))
    v, u = np.nonzero(known)
    pixels = 800 * cloud.points_mm[:, :2] / cloud.points_mm[:, 2:]
    np.testing.assert_allclose(pixels, np.stack([u, v], 1), atol=1e-3)  # float32
    write_ply(tmp_path / "c.ply", cloud)
    body = (tmp_path / "c.ply").read_bytes().partition(b"end_header\n")[2]
    stored = np.frombuffer(body, [("xyz", "<f4", 3), ("rgb", "u1", 3)])
    np.testing.assert_array_equal(stored["xyz"], cloud.points_mm)
    np.testing.assert_array_equal(stored["rgb"], cloud.colors)
    write_color_png(tmp_path / "c.png", color)
    picture = cv2.imread(str(tmp_path / "c.png"))[..., ::-1]
    np.testing.assert_array_equal(picture[known], cloud.colors)
    # Rounding, and a fiftieth of a grey level by the table.
    assert np.abs(picture - 255.0 * linear_to_srgb(color)).max() < 0.5 + 0.03


def test_points_written_in_bands_are_those_written_at_once(tmp_path, rng):
    depth = rng.uniform(900, 4000, (150, 700)).astype(np.float32)  # two bands
    depth[rng.random(depth.shape) < 0.3] = np.nan
    depth[40:110] = np.nan  # rows without points
    srgb = rng.integers(0, 256, (*depth.shape, 3)).astype(np.uint8)
    rays = dict(
        camera_matrix=np.array([[900.0, 0, 350], [0, 900, 75], [0, 0, 1]]),
        distortion=np.array([0.05, 0, 0, 0, 0]), sensor_to_pupil_mm=12.0,
    )  # fmt: skip
    write_ply(tmp_path / "a.ply", depth_to_points(depth, srgb, **rays))
    for values, name in ((depth, "b.ply"), (np.full_like(depth, np.nan), "none.ply")):
        write_depth_ply(tmp_path / name, values, srgb, **rays)
    assert (tmp_path / "b.ply").read_bytes() == (tmp_path / "a.ply").read_bytes()
    write_ply(tmp_path / "0.ply", depth_to_points(np.full_like(depth, np.nan), srgb, **rays))
    assert (tmp_path / "none.ply").read_bytes() == (tmp_path / "0.ply").read_bytes()
    assert b"element vertex 0\n" in (tmp_path / "0.ply").read_bytes()
