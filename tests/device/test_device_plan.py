"""Plans by which a browser measures: the chain of the GPU written down, nothing added and nothing lost."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from chromaperture.app.device_plan import color_tables, light_of_counts, make_plan, make_points
from chromaperture.app.messages import pack_array
from chromaperture.app.state import AppState
from chromaperture.camera.camera import CodedApertureCamera
from chromaperture.camera.method import default_config
from chromaperture.capture.files import Decoded, linearise
from chromaperture.color.alignment import shift_back
from chromaperture.color.color_maps import DISTANCE, ERROR, draw_levels
from chromaperture.color.encoding import Encoding
from chromaperture.color.srgb import linear_to_srgb_bytes
from chromaperture.depth.pointcloud import depth_to_points
from chromaperture.matching.device.device import Chain, open_device
from chromaperture.matching.device.measured import add_conversion
from chromaperture.matching.device.picture_stages import (
    add_colored_maps,
    add_light_of_counts,
    add_sparse_maps,
    row_pitch,
)
from chromaperture.matching.device.real_time_chain import add_real_time
from chromaperture.matching.working_scale import reduced
from chromaperture.model.scale import resized
from chromaperture.products.samples import sample_camera
from chromaperture.system.errors import CaptureWarning, InputError
from devices import unpack_array, unpacked, with_device

NAME = "still_life_cy_halves"
SIZE_PX = (180, 120)


@pytest.fixture(scope="module")
def camera():
    """The sample's camera in fewer pixels."""
    from chromaperture.model.camera_file import Calibration

    calibration = resized(Calibration.load(sample_camera(NAME)), *SIZE_PX)
    return CodedApertureCamera(calibration, default_config(calibration, scale=1), execution="numpy")


# ---- without a device


@given(st.lists(st.integers(0, 2**32 - 1), min_size=1, max_size=50), st.sampled_from([np.float32, np.uint32]))
def test_arrays_come_back_bit_by_bit(bits, kind):
    values = np.array(bits, np.uint32)
    np.testing.assert_array_equal(unpack_array(pack_array(values.view(kind)), kind).view(np.uint32), values)


def test_smooth_maps_become_small():
    y, x = np.mgrid[:200, :300] / 300
    field = (3 + 0.2 * x - 0.1 * y + 0.3 * x * y).astype(np.float32)
    assert len(pack_array(field)) < 0.2 * field.nbytes


def test_counts_become_light_as_files_do(camera):
    light, notes = light_of_counts(camera.calibration)
    counts = np.random.default_rng(3).integers(0, 256, (9, 8, 3), np.uint8)
    with pytest.warns(CaptureWarning, match="encoded values"):
        expected = linearise(Decoded(counts), camera_encoding=Encoding(16, 1016))
    np.testing.assert_array_equal(light[counts], expected)
    assert "encoded values" in notes[0]


def test_a_plan_has_the_curves_of_the_camera(camera):
    text, array = unpacked(make_plan(camera, "quad", {"camera": "x"}))
    assert (text["width"], text["height"], text["camera"], text["unit"]) == (*SIZE_PX, "x", "mm")
    fields = array(text["arrays"]["fields"]["values"])
    expected = np.concatenate([np.ravel(part).astype(np.float32) for part in camera.conversion.fields])
    np.testing.assert_array_equal(fields, expected)
    assert {name for step in text["measure"] + text["draw"] for name in step["arrays"]} == set(text["arrays"])
    assert "depth_mm" in text["maps"]
    sentences = [check["says"] for check in text["checks"]]
    assert any("saturated" in sentence for sentence in sentences)
    assert any("lens cap" in sentence for sentence in sentences)


@pytest.mark.parametrize(("exchange", "has_quads"), [("quad", True), ("shared", False)])
def test_paths_are_those_that_the_device_can(camera, exchange, has_quads):
    text, _ = unpacked(make_plan(camera, exchange, {}))
    assert any("quadSwapX" in source for source in text["sources"]) == has_quads
    groups = {step["groups"][0] for step in text["measure"] if step["stage"] == "four_paths"}
    assert groups == {-(-lines // 16) for lines in (30, 45)}  # rows and columns of the cells


def test_points_are_those_of_the_command_line(camera):
    text, array = unpacked(make_points(camera.calibration, camera.config.quality))
    points = text["points"]
    rays = array(points["rays"]).reshape(points["rows"], points["columns"], 2)
    depth = np.full(SIZE_PX[::-1], 2000.0, np.float32)
    lens = camera.calibration.lens
    expected = depth_to_points(
        depth, np.zeros((*depth.shape, 3), np.float32), camera_matrix=lens.camera_matrix, distortion=lens.distortion,
        sensor_to_pupil_mm=points["sensor_to_pupil_mm"],
    ).points_mm.reshape(*depth.shape, 3)  # fmt: skip
    step = points["pitch_px"]
    z = 2000.0 - points["sensor_to_pupil_mm"]
    found = rays[: depth.shape[0] // step, : depth.shape[1] // step] * z
    np.testing.assert_allclose(found, expected[::step, ::step, :2], atol=2e-3)  # mm; 32 bits


@pytest.mark.parametrize(
    ("size", "exchange", "reason"),
    [
        ((720, 480), "wishes", "unknown exchange"),
        ((100, 100), "quad", "does not show the same frame"),
        ((0, 480), "quad", "4 megapixels"),
        ((7200, 4800), "quad", "4 megapixels"),
    ],
)
def test_plans_that_cannot_be_made_are_one_line(tmp_path, size, exchange, reason):
    app_state = AppState(tmp_path, sample_camera(NAME), reserve_bytes=0)
    with pytest.raises(InputError, match=reason):
        app_state.plan("cy_halves", size, exchange)


def test_a_plan_of_another_size_says_so(tmp_path):
    app_state = AppState(tmp_path, sample_camera(NAME), reserve_bytes=0)
    text, _ = unpacked(app_state.plan("cy_halves", (480, 320), "shared"))
    assert (text["width"], text["height"]) == (480, 320)
    assert any("480x320" in note for note in text["notes"])
    assert app_state.plan("cy_halves", (480, 320), "shared") is app_state.plan("cy_halves", (480, 320), "shared")
    half, _ = unpacked(app_state.plan("cy_halves", (360, 240), "shared"))  # squares of pixels: the whole frame for sure
    assert not any("360x240" in note for note in half["notes"])


# ---- on a device, against NumPy


@with_device
def test_a_plan_is_the_chain_that_python_runs(camera):
    exchange = "quad" if open_device("gpu").subgroups else "shared"
    text, array = unpacked(make_plan(camera, exchange, {}))
    chain, size = Chain(open_device("gpu")), SIZE_PX[::-1]
    image = chain.array("image", 3 * size[0] * size[1])
    add_real_time(chain, image, size, camera.method)
    add_conversion(chain, chain.arrays["disparity"], chain.arrays["sigma"], camera.conversion)
    planned = [
        (step["stage"], text["sources"][step["source"]], tuple(step["groups"]), tuple(step["arrays"]))
        for step in text["measure"]
    ]
    run = [(d.stage, d.source, d.groups, tuple(a.name for a in d.arrays)) for d in chain.dispatches]
    assert planned[1:-1] == run  # without light of counts and sparse maps
    constants = [a.name for a in chain.arrays.values() if a.is_constant]
    for name, values in chain.run({"image": np.full((*size, 3), 0.5, np.float32)}, constants).items():
        np.testing.assert_array_equal(array(text["arrays"][name]["values"]), values, err_msg=name)


@with_device
@pytest.mark.parametrize("side", [1, 2, 3])
def test_squares_of_counts_become_light(camera, side):
    height, width = 21, 30
    light, _ = light_of_counts(camera.calibration)
    counts = np.random.default_rng(4).integers(0, 254, (side * height, side * width, 3), np.uint8)
    counts[5, 7] = 255
    pitch = row_pitch(side * width)
    packed = np.zeros((side * height, pitch), np.uint32)
    packed[:, : side * width] = counts.astype(np.uint32) @ np.array([1, 1 << 8, 1 << 16], np.uint32)
    chain = Chain(open_device("gpu"))
    chain.array = lambda name, size, dtype=np.float32: Chain.array(  # as the page makes it: as large as the picture
        chain, name, packed.size if name == "counts" else size, dtype
    )
    add_light_of_counts(chain, (height, width), light)
    found = chain.run({"counts": packed.ravel(), "form": np.array([side, pitch, 0, 0], np.uint32)}, ["image"])
    found = found["image"].reshape(height, width, 3)
    expected = reduced(light[counts], (width, height))
    unknown = np.isnan(expected) if side > 1 else light[counts].max(axis=2, keepdims=True) >= 0.995
    assert (found[np.broadcast_to(unknown, found.shape)] == 1.0).all()
    assert unknown.any()
    np.testing.assert_allclose(found, np.where(unknown, 1.0, expected), atol=1e-6)


@with_device
def test_maps_become_pictures():
    height, width = 33, 50
    rng = np.random.default_rng(5)
    depth = rng.uniform(900, 4200, (height, width)).astype(np.float32)
    sigma = (depth * rng.uniform(0.01, 0.2, depth.shape)).astype(np.float32)
    disparity = np.full(depth.shape, 1.25, np.float32)
    depth[3, 4] = sigma[3, 4] = disparity[3, 4] = np.nan
    image = rng.uniform(0, 0.8, (height, width, 3)).astype(np.float32)
    shifts, balance = np.array([[-1.0, 0], [0, 0.5], [1, 0]]), np.array([1.0, 1.25, 1.5])
    chain = Chain(open_device("gpu"))
    arrays = {"image": image, "disparity": disparity, "depth_mm": depth, "sigma_mm": sigma}
    for name, values in arrays.items():
        chain.array(name, values.size)
    maps, size = ("depth_mm", "sigma_mm"), (height, width)
    down, across = add_sparse_maps(chain, size, maps, shifts=shifts, balance=balance)
    add_colored_maps(chain, size, maps, color_tables(), shifts=shifts, balance=balance, most_relative=0.1)

    def drawn(*look):
        inputs = {name: values.ravel() for name, values in arrays.items()} | {"look": np.array(look, np.float32)}
        picture = chain.run(inputs, ["picture"])["picture"].reshape(height, row_pitch(width))[:, :width]
        assert (picture >> 24 == 255).all()
        return np.stack([(picture >> bit) & 255 for bit in (0, 8, 16)], axis=-1)

    expected = draw_levels((depth - 1000) / 3000, DISTANCE).astype(int)
    uncertain = sigma > np.float32(0.1) * depth
    expected[uncertain] = (expected[uncertain] + 3 * draw_levels(np.array([[np.nan]]), DISTANCE)[0, 0]) >> 2
    # A level at the border of two colours may be drawn in the other.
    assert (np.abs(drawn(0, 1000, 4000, 1) - expected).max(axis=2) == 0).mean() > 0.995
    assert (np.abs(drawn(1, 0, 500, 1) - draw_levels(sigma / 500, ERROR)).max(axis=2) == 0).mean() > 0.995
    # Away from the border, whole and half px: bilinear samples of the channels where they were displaced to.
    moved = np.nan_to_num(disparity)[None, None] * shifts[:, :, None, None].astype(np.float32)
    aligned = shift_back(image, moved, interpolation=1) * balance.astype(np.float32)
    inner = (slice(4, -4), slice(4, -4))
    # OpenCV's bilinear weights are 32nds of a px, which is 0.8 % of the contrast.
    assert np.abs(drawn(2, 0, 1, 1.2)[inner] - linear_to_srgb_bytes(aligned / 1.2)[inner].astype(int)).max() <= 3
    sparse = chain.run({}, ["sparse"])["sparse"].view(np.float32).reshape(3, down, across)
    assert (down, across) == size  # so few pixels are all kept
    np.testing.assert_array_equal(sparse[0], depth)
    np.testing.assert_array_equal(sparse[1], sigma)
    np.testing.assert_allclose(sparse[2][inner], aligned.max(axis=2)[inner], atol=0.02)
