"""Streams for robots, received and decoded without our code: MCAP by mcap's readers, WebSocket by its protocol."""

from __future__ import annotations

import base64
import json
import runpy
import shutil
import struct
import sys
import threading
import time
from pathlib import Path
from types import ModuleType, SimpleNamespace

import cv2
import numpy as np
import pytest

from apps import free_port
from chromaperture.products.foxglove_stream import FoxgloveStream, address
from chromaperture.products.mcap import write_mcap
from chromaperture.products.rectified import View, encoded_depth, stamp_ns
from chromaperture.products.samples import sample_camera, sample_image
from chromaperture.system.errors import InputError

MATRIX = np.array([[500.0, 0, 4], [0, 501, 3], [0, 0, 1]])
TOPICS = {"/camera/camera_info": "CameraCalibration", "/camera/depth/points": "PointCloud", "/tf": "FrameTransform"}
TOPICS |= {f"/camera/{part}/image_rect": "RawImage" for part in ("color", "depth", "sigma", "confidence")}
ROS_TOPICS = {topic for topic in TOPICS if topic.endswith("image_rect")}
ROS_TOPICS |= {f"/camera/{part}/camera_info" for part in ("color", "depth")}
SAMPLE = "still_life_cy_halves"
EXAMPLES = Path(__file__).parents[2] / "examples"


def view(time_s=1.75e9 + 0.125):
    z = np.full((6, 8), 1234.4, np.float32)
    z[0, :2] = np.nan, 70_000
    sigma = 0.01 * z
    sigma[0, 3] = 0.11 * z[0, 3]  # more than the tenth that is sent
    color = np.random.default_rng(0).integers(0, 256, (6, 8, 3)).astype(np.uint8)
    confidence = np.linspace(0, 1, z.size, dtype=np.float32).reshape(z.shape)
    return View(color, z, sigma, time_s, 0, confidence)


def pose():
    made = np.eye(4)
    made[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]  # a quarter of a turn about z
    made[:3, 3] = 100, -200, 300
    return made


def check_messages(found, expected, encoding="16UC1"):
    """Decoded messages by their topics against the view that was sent."""
    pixels = {part: found[f"/camera/{part}/image_rect"] for part in ("color", "depth", "sigma", "confidence")}
    assert [pixels[p].encoding for p in pixels] == ["rgb8", encoding, "32FC1", "32FC1"]
    np.testing.assert_array_equal(np.frombuffer(pixels["color"].data, np.uint8).reshape(6, 8, 3), expected.color)
    depth = np.frombuffer(pixels["depth"].data, {"16UC1": "<u2", "32FC1": "<f4"}[encoding]).reshape(6, 8)
    unknown = [depth[0, 0], depth[0, 3]]
    if encoding == "16UC1":
        assert (unknown, depth[0, 1], depth[3, 3]) == ([0, 0], 0, 1234)  # mm; beyond 65 m is unknown
    else:
        assert np.isnan(unknown).all()
        assert depth[3, 3] == np.float32(1.2344)  # m
    np.testing.assert_array_equal(np.frombuffer(pixels["sigma"].data, "<f4").reshape(6, 8), expected.sigma_mm / 1000)
    assert (pixels["depth"].step, pixels["color"].step) == (depth.itemsize * 8, 24)
    stamp = pixels["depth"].timestamp
    assert (stamp.seconds, stamp.nanos) == (1_750_000_000, 125_000_000)
    info = found["/camera/camera_info"]
    np.testing.assert_array_equal(np.reshape(info.K, (3, 3)), MATRIX)
    np.testing.assert_array_equal(np.reshape(info.P, (3, 4))[:, :3], MATRIX)
    cloud = found["/camera/depth/points"]
    layout = {"names": [f.name for f in cloud.fields], "offsets": [f.offset for f in cloud.fields]}
    layout |= {"formats": [{1: "u1", 7: "<f4"}[f.type] for f in cloud.fields], "itemsize": cloud.point_stride}
    points = np.frombuffer(cloud.data, np.dtype(layout))
    assert len(points) == 48 - 2  # without the unknown and the uncertain one
    at = points[-1]  # row 5, column 7
    assert at["z"] == np.float32(1.2344)
    np.testing.assert_allclose([at["x"], at["y"]], [3 / 500 * 1.2344, 2 / 501 * 1.2344], rtol=1e-6)
    assert [at["red"], at["green"], at["blue"], at["alpha"]] == [*expected.color[5, 7], 255]
    transform = found["/tf"]
    assert (transform.parent_frame_id, transform.child_frame_id) == ("world", pixels["depth"].frame_id)
    assert (transform.translation.x, transform.translation.y, transform.translation.z) == (0.1, -0.2, 0.3)
    assert (transform.rotation.z, transform.rotation.w) == (pytest.approx(0.5**0.5), pytest.approx(0.5**0.5))


@pytest.mark.extra("stream", "foxglove")
@pytest.mark.extra("readers", "mcap_protobuf")
@pytest.mark.parametrize("encoding", ["16UC1", "32FC1"])
def test_a_recorded_stream_is_read_by_mcap(tmp_path, encoding):
    from mcap.reader import make_reader
    from mcap_protobuf.decoder import DecoderFactory

    path = tmp_path / "a.mcap"
    with FoxgloveStream(str(path), camera_matrix=MATRIX, depth_encoding=encoding) as stream:
        stream.send(view())
        stream.send_pose(pose(), view().time_s)
    found, times = {}, set()
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            found[channel.topic] = decoded
            times.add(message.log_time)
            assert schema.name == f"foxglove.{TOPICS[channel.topic]}"
    assert (set(found), times) == (set(TOPICS), {1_750_000_000_125_000_000})
    check_messages(found, view(), encoding)
    with pytest.raises(InputError, match="exists"):
        FoxgloveStream(str(path), camera_matrix=MATRIX)
    with FoxgloveStream(str(tmp_path / "none.mcap"), camera_matrix=MATRIX):
        pass
    assert [p.name for p in tmp_path.iterdir()] == ["a.mcap"]


def receive(url, wanted, seconds=30.0):
    """Messages of a server by the Foxglove WebSocket protocol (foxglove.sdk.v1); decoded with what it advertises."""
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
    from websockets.sync.client import connect

    found, channels = {}, {}
    with connect(url, subprotocols=["foxglove.sdk.v1"], max_size=None, open_timeout=seconds) as socket_:
        end = time.monotonic() + seconds
        while set(wanted) - set(found) and time.monotonic() < end:
            message = socket_.recv(timeout=max(0.1, end - time.monotonic()))
            if isinstance(message, str):
                tree = json.loads(message)
                if tree["op"] == "serverInfo":
                    assert tree["name"] == "chromaperture"
                if tree["op"] == "advertise":
                    channels |= {c["id"]: c for c in tree["channels"]}
                    wishes = [{"id": c["id"], "channelId": c["id"]} for c in tree["channels"]]
                    socket_.send(json.dumps({"op": "subscribe", "subscriptions": wishes}))
            elif message[0] == 1:  # data of a subscription: its number, time in ns, payload
                number, _ = struct.unpack("<IQ", message[1:13])
                channel = channels[number]
                assert (channel["encoding"], channel["schemaEncoding"]) == ("protobuf", "protobuf")
                files = descriptor_pb2.FileDescriptorSet.FromString(base64.b64decode(channel["schema"]))
                pool = descriptor_pool.DescriptorPool()
                for file in files.file:
                    pool.Add(file)
                kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(channel["schemaName"]))
                found[channel["topic"]] = kind.FromString(message[13:])
    return found


@pytest.mark.extra("stream", "foxglove")
@pytest.mark.extra("readers", "websockets")
@pytest.mark.extra("readers", "google.protobuf")
def test_a_client_of_the_protocol_receives_what_was_sent():
    with FoxgloveStream("127.0.0.1:0", camera_matrix=MATRIX) as stream:
        over = threading.Event()

        def send():
            while not over.wait(0.1):
                stream.send(view())
                stream.send_pose(pose(), view().time_s)

        sender = threading.Thread(target=send)
        sender.start()
        try:
            found = receive(stream.url, TOPICS)
        finally:
            over.set()
            sender.join()
        port = int(stream.url.rsplit(":", 1)[1])
        second = FoxgloveStream(f"127.0.0.1:{port}", camera_matrix=MATRIX)
        with pytest.raises(InputError, match="cannot stream"), second:
            pass
    assert set(found) == set(TOPICS)
    check_messages(found, view())


@pytest.mark.extra("stream", "foxglove")
@pytest.mark.extra("readers", "websockets")
@pytest.mark.extra("readers", "google.protobuf")
@pytest.mark.slow
def test_the_live_command_streams_what_it_measures(run, tmp_path):
    image, camera = sample_image(SAMPLE), sample_camera(SAMPLE)
    assert run("record", image, "--out", tmp_path / "walk", "-q").returncode == 0
    port = free_port()
    found = {}

    def client():
        end = time.monotonic() + 60
        while time.monotonic() < end and not found:
            try:
                found.update(receive(f"ws://127.0.0.1:{port}", set(TOPICS) - {"/tf"}, 60))
            except OSError:
                time.sleep(0.2)  # not started yet

    listener = threading.Thread(target=client)
    listener.start()
    result = run("live", f"replay:{tmp_path / 'walk'}?loop=1&speed=5", "--camera", camera, "--no-page", "--no-model",
                 "--stream", f"127.0.0.1:{port}", "--seconds", 8, "--out", tmp_path / "out")  # fmt: skip
    listener.join()
    assert result.returncode == 0, result.stderr
    assert f"ws://127.0.0.1:{port}" in result.stdout
    depth = found["/camera/depth/image_rect"]
    assert (depth.width, depth.height, depth.encoding) == (720, 480, "16UC1")
    mm = np.frombuffer(depth.data, "<u2")
    assert 1000 < np.median(mm[mm > 0]) < 3000


def test_depth_is_encoded_as_rep_118_says():
    z = np.array([[np.nan, -1, 0, 0.6, 1234.5001, 65534.4, 65536, np.inf]], np.float32)
    np.testing.assert_array_equal(encoded_depth(z, "16UC1"), [[0, 0, 0, 1, 1235, 65534, 0, 0]])
    metres = encoded_depth(z, "32FC1")
    assert metres.dtype == np.dtype("<f4")
    np.testing.assert_array_equal(metres, z / 1000)


@pytest.mark.parametrize(
    ("text", "found"),
    [("127.0.0.1:9000", ("127.0.0.1", 9000)), ("0.0.0.0", ("0.0.0.0", 8765)), ("[::1]:70", ("::1", 70)),
     ("robot.local", ("robot.local", 8765))],
)  # fmt: skip
def test_addresses(text, found):
    assert address(text) == found


@pytest.mark.parametrize("text", ["", "a:b", "127.0.0.1:99999", "::1:80", "http://a:80", "a b"])
def test_wrong_addresses_are_refused(text):
    with pytest.raises(InputError, match="--stream"):
        address(text)


def by_the_files_definitions(path):
    """Topics and messages, decoded with the schemas in the file."""
    from mcap_ros2.reader import read_ros2_messages

    return [(message.channel.topic, message.ros_msg) for message in read_ros2_messages(str(path))]


def by_ros_own_definitions(path):
    from mcap.reader import make_reader
    from rosbags.typesys import Stores, get_typestore

    store, found = get_typestore(Stores.ROS2_HUMBLE), []
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            assert channel.message_encoding == "cdr"
            found.append((channel.topic, store.deserialize_cdr(message.data, schema.name)))
    return found


@pytest.mark.parametrize(
    "read",
    [
        pytest.param(by_the_files_definitions, marks=pytest.mark.extra("ros", "mcap_ros2")),
        pytest.param(by_ros_own_definitions, marks=pytest.mark.extra("readers", "rosbags")),
    ],
)
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_exported_messages_are_read_by_other_libraries(tmp_path, read):
    path, sent = tmp_path / "a.mcap", [view(), view(1.75e9 + 0.25)]
    assert write_mcap(path, sent, camera_matrix=MATRIX) == 2
    parts, found = ("color", "depth", "sigma", "confidence"), {}
    for topic, message in read(path):
        found.setdefault(topic, []).append(message)
    assert set(found) == ROS_TOPICS
    for i, expected in enumerate(sent):
        color, depth, sigma, confidence = (found[f"/camera/{part}/image_rect"][i] for part in parts)
        assert (color.encoding, depth.encoding, sigma.encoding, confidence.encoding) == (
            "rgb8", "16UC1", "32FC1", "32FC1")  # fmt: skip
        assert (depth.height, depth.width, depth.step, depth.is_bigendian, sigma.step) == (6, 8, 16, 0, 32)
        frames = [m.header.frame_id for m in (color, depth, sigma, confidence)]
        assert frames == ["camera_optical_frame"] * 2 + [""] * 2  # rerun projects what has one
        mm, bars, shares = (
            np.frombuffer(bytes(part.data), kind).reshape(6, 8)
            for part, kind in ((depth, "<u2"), (sigma, "<f4"), (confidence, "<f4"))
        )
        assert mm[0].tolist() == [0, 0, 1234, 0, *[1234] * 4]  # unknown, too far, and too uncertain
        assert (mm[1:] == 1234).all()
        np.testing.assert_array_equal(bars, expected.sigma_mm / 1000)
        np.testing.assert_array_equal(shares, expected.confidence)
        np.testing.assert_array_equal(np.frombuffer(bytes(color.data), np.uint8).reshape(6, 8, 3), expected.color)
        info = found["/camera/depth/camera_info"][i]
        np.testing.assert_array_equal(np.reshape(info.k, (3, 3)), MATRIX)
        assert info.distortion_model == "plumb_bob"
        for stamp in (depth.header.stamp, info.header.stamp):
            assert (stamp.sec, stamp.nanosec) == (1_750_000_000, 125_000_000 * (i + 1))
    with pytest.raises(InputError, match="no frame"):
        write_mcap(tmp_path / "none.mcap", [], camera_matrix=MATRIX)
    assert [p.name for p in tmp_path.iterdir()] == ["a.mcap"]


def test_the_first_frame_of_a_file_has_a_time():
    # ROS has no other word than 0 for "no time"; 1 microsecond is what PCL keeps of it.
    stamps = [stamp_ns(time_s) for time_s in (0.0, 1 / 30, 12.25, 1.75e9 + 0.125)]
    assert stamps == [1000, 33_333_333, 12_250_000_000, 1_750_000_000_125_000_000]


def ros_message(store, kind, fields):
    """A message of ROS's own definition; a field that it does not have, or that is missing, is an error."""
    from rosbags.interfaces import Nodetype

    made = {}
    for name, (node, what) in store.fielddefs[kind][1]:
        value = fields.pop(name)
        if node == Nodetype.NAME:
            value = ros_message(store, what, dict(value))
        elif node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            numbers = {"uint8": np.uint8, "float64": np.float64}[what[0][1][0]]
            value = np.frombuffer(value, numbers) if isinstance(value, bytes) else np.array(value, numbers)
            assert len(value) == (what[1] or len(value))
        made[name] = value
    assert not fields, f"{kind} has no {list(fields)}"
    return store.types[kind](**made)


@pytest.fixture
def ros(monkeypatch):
    """A stand-in for rclpy and rosidl_runtime_py that keeps what is published, made of ROS's own definitions."""
    from rosbags.typesys import Stores, get_typestore

    store, sent, asked = get_typestore(Stores.ROS2_JAZZY), [], {}

    class Node:
        def __init__(self, name):
            assert name == "chromaperture"

        def declare_parameter(self, name, default):
            return SimpleNamespace(value=asked.get(name, default))

        def create_publisher(self, kind, topic, depth):
            return SimpleNamespace(publish=lambda message: sent.append((topic, message)))

        def get_logger(self):
            return SimpleNamespace(warning=lambda line: sent.append(("log", line)))

    def get_message(kind):
        return type(kind, (), {"kind": kind})

    def set_message_fields(message, fields):
        message.made = ros_message(store, message.kind, dict(fields))

    names = ("rclpy", "rclpy.node", "rosidl_runtime_py", "rosidl_runtime_py.utilities")
    made = {name: ModuleType(name) for name in names}
    made["rclpy"].ok = made["rclpy"].init = made["rclpy"].try_shutdown = lambda: True
    made["rclpy.node"].Node = Node
    made["rosidl_runtime_py"].set_message_fields = set_message_fields
    made["rosidl_runtime_py.utilities"].get_message = get_message
    for name, module in made.items():
        monkeypatch.setitem(sys.modules, name, module)
    return SimpleNamespace(store=store, sent=sent, asked=asked)


@pytest.mark.extra("ros", "mcap_ros2")
@pytest.mark.extra("readers", "rosbags")
def test_the_node_publishes_the_messages_of_an_exported_file(ros, tmp_path, run):
    from mcap.reader import make_reader

    photo, camera, path = shutil.copy(sample_image(SAMPLE), tmp_path / "0.png"), sample_camera(SAMPLE), tmp_path / "a"
    cv2.imwrite(str(tmp_path / "1.png"), np.zeros_like(cv2.imread(str(photo), -1)))
    ros.asked.update(camera=str(camera), source=str(tmp_path / "*.png"))
    runpy.run_path(str(EXAMPLES / "ros2_node.py"), run_name="__main__")
    assert ros.sent[-1][0] == "log"
    assert "frame 1 is left out: " in ros.sent.pop()[1]
    assert {topic for topic, _ in ros.sent} == ROS_TOPICS
    assert run("export", photo, path, "--camera", camera, "--format", "mcap", "-q").returncode == 0
    with path.open("rb") as file:
        stored = {c.topic: (schema.name, message) for schema, c, message in make_reader(file).iter_messages()}
    for topic, message in ros.sent:
        kind, written = stored[topic]
        assert kind == message.kind
        assert bytes(ros.store.serialize_cdr(message.made, kind)) == written.data
        assert (message.made.header.stamp.sec, message.made.header.stamp.nanosec, written.log_time) == (0, 1000, 1000)
