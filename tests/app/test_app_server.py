"""The app's server over real connections: what it answers, and what it refuses."""

from __future__ import annotations

import contextlib
import http.client
import io
import json
import socket
import ssl
import time
import warnings
import zipfile
import zlib
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from apps import TOKEN, call, served
from chromaperture.app import certificate as kept
from chromaperture.app.messages import MOST_COUNT, pack_frame, to_counts
from chromaperture.app.server import static_files
from chromaperture.capture.files import Decoded, linearise
from chromaperture.color.encoding import Encoding
from chromaperture.color.srgb import linear_to_srgb_bytes
from chromaperture.frame.frame_files import OUTPUTS, chosen_outputs
from chromaperture.products.samples import open_sample, sample_camera, sample_image
from chromaperture.system.errors import CaptureWarning
from icons import ICONS, STATIC, draw_icon

pytestmark = pytest.mark.extra("serve", "starlette")
NAME = "still_life_cy_halves"


@pytest.fixture(scope="module")
def app(tmp_path_factory):
    with served(tmp_path_factory.mktemp("app"), camera=sample_camera(NAME)) as running:
        yield running


@pytest.fixture(scope="module")
def photo():
    """The sample as a video frame: 8 bits, sRGB."""
    _, image = open_sample(NAME, quality="real-time")
    return linear_to_srgb_bytes(image)


def unpack(message):
    length = int.from_bytes(message[:4], "little")
    facts = json.loads(message[4 : 4 + length])
    count = facts["width"] * facts["height"]
    maps = np.frombuffer(message, "<u2", 2 * count, 4 + length).reshape(2, facts["height"], facts["width"])
    found = [
        np.where(counts > 0, facts[name]["first"] + counts * facts[name]["step"], np.nan)
        for name, counts in zip(("depth", "sigma"), maps, strict=True)
    ]
    return facts, *found, message[4 + length + 4 * count :]


@pytest.fixture(scope="module")
def halves():
    """The sample as the two halves of a dual-pixel sensor, of even light; PNG files by name."""
    _, image = open_sample(NAME)
    level = image / np.median(image, axis=(0, 1)) * 20_000
    counts = np.clip(level, 0, 65535).astype(np.uint16)
    sides = {"a_left.png": counts[..., 2], "a_right.png": counts[..., 0]}
    return {name: cv2.imencode(".png", half)[1].tobytes() for name, half in sides.items()}


@pytest.fixture(scope="module")
def pair_app(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pairs")
    known = open_sample(NAME)[0].calibration
    sensor = replace(known.sensor, dual_pixel="left-right", black_level=0.0, white_level=65535.0)
    replace(known, sensor=sensor).save(folder / "halves.asdf")
    with served(folder, camera=folder / "halves.asdf") as running:
        yield running


# ---- what it answers


@pytest.mark.parametrize("order", [("a_left.png", "a_right.png"), ("a_right.png", "a_left.png")])
def test_a_left_and_a_right_picture_are_measured_together(pair_app, halves, order):
    first, second = order
    where = f"/api/photos?camera=halves&name={first}&right={second}&left_bytes={len(halves[first])}"
    status, message, _ = call(pair_app, "POST", where, halves[first] + halves[second])
    assert status == 200, message
    facts = unpack(message)[0]
    assert facts["fill"] > 0.5
    _, packed, _ = call(pair_app, "GET", f"/api/photos/{facts['photo']}/files")
    archive = zipfile.ZipFile(io.BytesIO(packed))
    assert "a.depth.tiff" in archive.namelist()
    assert all(archive.read(name) == content for name, content in halves.items())


def test_what_is_no_pair_is_refused_by_the_app(pair_app, halves, photo):
    left = halves["a_left.png"]
    for where, body in (
        ("name=a_left.png", left),
        ("name=a_left.png&right=a_left.png&left_bytes=10", left),
        ("name=a_left.png&right=a_right.png&left_bytes=nan", left),
        (f"name=a_left.png&right=a_right.png&left_bytes={len(left)}", left),
    ):
        status, text, _ = call(pair_app, "POST", f"/api/photos?camera=halves&{where}", body)
        assert status == 400, text
    height, width = photo.shape[:2]
    where = f"/api/frames?camera=halves&width={width}&height={height}"
    status, text, _ = call(pair_app, "POST", where, photo.tobytes())
    assert (status, b"dual-pixel" in text) == (400, True)


def test_a_frame_is_measured_as_python_measures_it(app, photo):
    height, width = photo.shape[:2]
    where = f"/api/frames?camera=cy_halves&width={width}&height={height}"
    status, message, _ = call(app, "POST", where, photo.tobytes())
    assert status == 200
    facts, depth, sigma, jpeg = unpack(message)
    camera, _ = open_sample(NAME, quality="real-time")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", CaptureWarning)
        frame = camera.measure(linearise(Decoded(photo), camera_encoding=Encoding(16, 1016)))
    np.testing.assert_array_equal(np.isnan(depth), np.isnan(frame.depth_mm))
    np.testing.assert_allclose(depth, frame.depth_mm, atol=facts["depth"]["step"])  # half a count and its rounding
    known = np.isfinite(frame.sigma_mm)
    np.testing.assert_allclose(sigma[known], frame.sigma_mm[known], atol=facts["sigma"]["step"])
    assert facts["depth"]["step"] < 0.5  # mm
    assert cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR).shape == photo.shape
    assert "encoded values" in facts["notes"][0]


def test_a_photograph_is_measured_refocused_and_saved(app):
    where = f"/api/photos?camera=cy_halves&name={NAME}.png"
    status, message, _ = call(app, "POST", where, sample_image(NAME).read_bytes())
    assert status == 200
    facts = unpack(message)[0]
    assert facts["fill"] > 0.9
    where = f"/api/photos/{facts['photo']}"
    pictures = []
    for wish in ("f_number=2&x=0.3&y=0.6", "f_number=1&x=0.3&y=0.6", "f_number=2&x=0.3&y=0.6&background=desaturate"):
        status, png, headers = call(app, "GET", f"{where}/refocused?{wish}")
        assert (status, headers["content-type"]) == (200, "image/png")
        pictures.append(cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR).astype(float))
    # the wall is behind the book that was touched: softer with a larger pupil, grey in the third
    wall = (slice(30, 120), slice(200, 500))
    detail = [np.abs(np.diff(picture[wall].mean(axis=2), axis=1)).mean() for picture in pictures[:2]]
    assert detail[1] < 0.8 * detail[0]
    chroma = [np.ptp(picture[wall], axis=2).mean() for picture in (pictures[0], pictures[2])]
    assert chroma[1] < 0.2 * chroma[0]
    status, packed, _ = call(app, "GET", f"{where}/files")
    names = zipfile.ZipFile(io.BytesIO(packed)).namelist()
    outputs = (*chosen_outputs(None), "gdepth", "dynamic-depth")
    assert sorted(names) == sorted(NAME + end for end in (".png", *(OUTPUTS[name].suffix for name in outputs)))
    for name, form in (("", "gdepth"), ("?format=dynamic-depth", "dynamic-depth")):
        status, jpeg, headers = call(app, "GET", f"{where}/embedded{name}")
        assert (status, headers["content-type"]) == (200, "image/jpeg")
        assert jpeg == zipfile.ZipFile(io.BytesIO(packed)).read(NAME + OUTPUTS[form].suffix)
    status, text, _ = call(app, "GET", f"{where}/embedded?format=glb")
    assert (status, b"not 'glb'" in text) == (400, True)
    assert [p.name for p in app.folder.iterdir() if p.name.startswith((".", "tmp"))] == []  # nothing is left behind


def test_camera_files_come_and_go(app):
    data = sample_camera("still_life_cy_open").read_bytes()
    status, text, _ = call(app, "POST", "/api/cameras?name=../../My%20phone.asdf", data)
    assert (status, json.loads(text)["name"]) == (200, "My-phone")
    assert call(app, "POST", "/api/cameras?name=My%20phone.asdf", data)[1] == text  # the same again is the same
    assert call(app, "GET", "/api/cameras/My-phone")[1] == data
    assert (app.folder / "cameras" / "My-phone.asdf").is_file()
    status, text, _ = call(app, "POST", "/api/cameras?name=bad.asdf", b"not a camera")
    assert status == 400
    assert {c["name"] for c in json.loads(call(app, "GET", "/api/about")[1])["cameras"]} == {"cy_halves", "My-phone"}


@pytest.mark.parametrize(
    ("path", "body", "sentence"),
    [
        ("/api/frames?camera=cy_halves&width=7&height=5", b"x" * 105, "7x5"),  # another aspect
        ("/api/frames?camera=cy_halves&width=480&height=720", bytes(480 * 720 * 3), "rotated"),
        ("/api/frames?camera=cy_halves&width=720&height=480", b"short", "reload the page"),
        ("/api/frames?camera=cy_halves&width=-1&height=5", b"", "whole number"),
        ("/api/frames?camera=nobody&width=1&height=1", b"abc", "no camera of that name"),
        ("/api/frames?camera=cy_halves&width=720&height=480", bytes(720 * 480 * 3), "lens cap"),
        ("/api/photos?camera=cy_halves&name=x.png", b"not a picture", "damaged"),
        ("/api/photos?camera=cy_halves&name=x.png", b"", "nothing was sent"),
        ("/api/photos?camera=cy_halves&name=x.png&quality=best", b"x", "quality"),
        ("/api/sessions", b"[", "not understood"),
        ("/api/sessions", b'{"name": "../up", "facts": {}}', "name"),
        ("/api/sessions", b'{"name": "x", "facts": null}', "session"),
        ("/api/sessions/none/shots?kind=board&ruler_mm=5&name=a.png", b"x", "no such session"),
        ("/api/sessions/none/shots?kind=cat", b"x", "board"),
        ("/api/sessions/none/calibration", b"", "no such session"),
    ],
)
def test_what_cannot_be_used_is_one_sentence(app, path, body, sentence):
    status, text, headers = call(app, "POST", path, body)
    assert status == 400
    line = json.loads(text)["error"]
    assert sentence in line
    assert "\n" not in line
    assert headers["content-security-policy"]
    assert [p.name for p in app.folder.iterdir() if p.name.startswith((".", "tmp"))] == []


def test_a_portrait_photograph_is_measured_as_the_sensor_saw_it(app, tmp_path, photo):
    from PIL import Image

    path = tmp_path / "portrait.jpg"
    exif = Image.Exif()
    exif[0x0112] = 6  # Orientation: turn by 90 degrees
    Image.fromarray(photo).save(path, quality=95, subsampling=0, exif=exif)
    status, message, _ = call(app, "POST", "/api/photos?camera=cy_halves&name=portrait.jpg", path.read_bytes())
    facts = unpack(message)[0]
    assert (status, facts["turn_degrees"], facts["width"]) == (200, 90, 720)
    assert any("portrait" in note for note in facts["notes"])


@pytest.mark.parametrize(
    ("path", "status", "reason"),
    [
        ("/api/cameras/cy_halves/plan?width=720&height=480&exchange=quad", 200, ""),
        ("/api/cameras/cy_halves/points?width=720&height=480", 200, ""),
        ("/api/cameras/other/plan?width=720&height=480&exchange=quad", 400, "no camera of that name"),
        ("/api/cameras/cy_halves/plan?width=-1&height=480&exchange=quad", 400, "whole number"),
        ("/api/cameras/cy_halves/points?width=720&height=480&quality=other", 400, "unknown quality"),
        ("/api/cameras/cy_halves/points?width=9999999&height=9999999", 400, "4 megapixels"),
    ],
)
def test_plans_and_what_makes_points(app, path, status, reason):
    found, body, _ = call(app, "GET", path)
    assert found == status
    if status == 200:
        length = int.from_bytes(body[:4], "little")
        assert json.loads(zlib.decompress(body[4 : 4 + length]))["points"]["sensor_to_pupil_mm"] > 0
    else:
        assert reason in json.loads(body)["error"]


# ---- what it refuses


@pytest.mark.parametrize(
    "path",
    [
        "/../pyproject.toml", "/%2e%2e/%2e%2e/etc/passwd", "/..%2f..%2fetc%2fpasswd", "/server.py",
        "/static/index.html",
        "/index.html%00.png", "/api/cameras/..%2f..%2fetc%2fpasswd", "/api/cameras/%2e%2e",
        "/api/sessions/..%2f..", "/api/sessions/%2e%2e/report", "/api/photos/..%2f../files",
    ],
)  # fmt: skip
def test_no_path_leads_out(app, path):
    status, text, _ = call(app, "GET", path)
    assert status in (400, 404, 405)
    assert b"root:" not in text
    assert len(text) < 300


def test_wrong_tokens_hosts_and_origins_are_refused(app):
    assert call(app, "GET", "/", token="wrong")[0] == 403
    assert call(app, "GET", "/", headers={"Host": "evil.example"})[0] == 403
    assert call(app, "POST", "/api/frames", b"x", headers={"Origin": "https://evil.example"})[0] == 403
    assert call(app, "GET", "/", headers={"Origin": f"http://127.0.0.1:{app.port}"})[0] == 200
    upgrade = {"Connection": "Upgrade", "Upgrade": "websocket", "Sec-WebSocket-Version": "13"}
    assert call(app, "GET", "/api/frames", headers=upgrade | {"Origin": "https://evil.example"})[0] == 403
    assert call(app, "GET", "/api/frames", headers=upgrade)[0] == 405  # there is no WebSocket


def test_a_gigabyte_is_refused_before_it_is_sent(app):
    with socket.create_connection(("127.0.0.1", app.port), timeout=20) as client:
        head = f"POST /{TOKEN}/api/photos HTTP/1.1\r\nHost: 127.0.0.1:{app.port}\r\nContent-Length: {2**30}\r\n\r\n"
        client.sendall(head.encode())
        assert client.recv(200).startswith(b"HTTP/1.1 413")


def test_a_slow_client_does_not_hold_the_others_up(tmp_path):
    with served(tmp_path, camera=sample_camera(NAME), part_s=0.3) as app, contextlib.ExitStack() as opened:
        clients = [
            opened.enter_context(socket.create_connection(("127.0.0.1", app.port), timeout=20)) for _ in range(8)
        ]
        for client in clients[:4]:  # the body never comes
            head = f"POST /{TOKEN}/api/photos HTTP/1.1\r\nHost: 127.0.0.1:{app.port}\r\nContent-Length: 1000\r\n\r\nx"
            client.sendall(head.encode())
        for client in clients[4:]:  # nor the header
            client.sendall(b"GET / HTTP/1.1\r\nHo")
        assert call(app, "GET", "/api/about")[0] == 200
        for client in clients[:4]:
            assert client.recv(200).startswith(b"HTTP/1.1 408")
        time.sleep(0.2)
        assert [p.name for p in tmp_path.iterdir() if p.name.startswith(".")] == []  # no half of an upload


# ---- the page's files, address and certificate


def test_the_service_worker_keeps_every_file_of_the_page():
    worker = static_files()["sw.js"][0].decode()
    listed = worker.split("FILES = [")[1].split("]")[0].replace('"', "").replace("\n", "").split(",")
    names = {name.strip() for name in listed if name.strip()}
    assert names == ({*static_files()} - {"sw.js", "index.html"}) | {"./"}


def test_the_manifest_can_be_installed():
    manifest = json.loads(static_files()["manifest.webmanifest"][0])
    assert manifest["display"] == "standalone"
    for icon in manifest["icons"]:
        picture = cv2.imdecode(np.frombuffer(static_files()[icon["src"]][0], np.uint8), cv2.IMREAD_COLOR)
        assert f"{picture.shape[1]}x{picture.shape[0]}" == icon["sizes"]
    assert {"192x192", "512x512"} <= {icon["sizes"] for icon in manifest["icons"]}


@pytest.mark.parametrize("name", ICONS)
def test_the_icons_are_those_that_the_script_draws(name):
    stored = cv2.imread(str(STATIC / name), cv2.IMREAD_COLOR)[..., ::-1]
    np.testing.assert_allclose(draw_icon(*ICONS[name]), stored, atol=1)


def test_the_page_loads_nothing_from_elsewhere():
    for name, (content, kind) in static_files().items():
        if not kind.startswith("image"):
            text = content.decode().replace("http://www.w3.org/2000/svg", "")  # a name, not an address
            assert "http:" not in text, name
            assert "https:" not in text, name
            assert "innerHTML" not in text, name  # texts of the server are never markup


def test_the_token_stays_until_it_is_drawn_anew(tmp_path):
    token = kept.kept_token(tmp_path)
    assert kept.kept_token(tmp_path) == token
    assert (tmp_path / "serve.token").stat().st_mode & 0o077 == 0  # nobody else reads it
    assert kept.kept_token(tmp_path, anew=True) != token
    (tmp_path / "serve.token").write_text("short")
    assert len(kept.kept_token(tmp_path)) >= 20


def test_the_certificate_is_made_once_and_anew_for_another_address(tmp_path):
    first = kept.kept_certificate(tmp_path, ["127.0.0.1", "bench.local"])
    assert kept.kept_certificate(tmp_path, ["bench.local"]).fingerprint == first.fingerprint
    assert kept.kept_certificate(tmp_path, ["192.0.2.7"]).fingerprint != first.fingerprint
    assert first.key.stat().st_mode & 0o077 == 0
    first.certificate.write_text("damaged")
    assert kept.kept_certificate(tmp_path, ["127.0.0.1"]).fingerprint


def test_a_browser_that_trusts_the_certificate_is_answered_by_https(tmp_path):
    made = kept.kept_certificate(tmp_path, ["127.0.0.1"])
    with served(tmp_path / "app", certificate=made) as app:
        trusting = ssl.create_default_context(cafile=str(made.certificate))
        connection = http.client.HTTPSConnection("127.0.0.1", app.port, context=trusting, timeout=20)
        connection.request("GET", f"/{TOKEN}/api/certificate")
        answer = connection.getresponse()
        assert (answer.status, answer.read()) == (200, made.certificate.read_bytes())
        connection.close()
        with pytest.raises(ssl.SSLCertVerificationError):
            http.client.HTTPSConnection("127.0.0.1", app.port, timeout=20).request("GET", "/")


def test_the_qr_code_holds_the_address():
    text = kept.qr_code("https://192.0.2.7:8733/token/")
    assert len(text.splitlines()) > 12
    assert kept.qr_code("https://192.0.2.8:8733/token/") != text


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ("--port TAKEN", "--port"),
        ("--camera missing.asdf", "missing.asdf"),
        ("--camera bad.asdf", "bad.asdf"),
        ("--source camera:0", "unknown kind"),
    ],
)
def test_serve_refuses_in_one_line(run, tmp_path, monkeypatch, options, said):
    monkeypatch.setenv("CHROMAPERTURE_STATE", str(tmp_path / "state"))
    monkeypatch.chdir(tmp_path)
    Path("bad.asdf").write_text("bad")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        words = options.replace("TAKEN", str(taken.getsockname()[1])).split()
        result = run("serve", "--out", "app", "--keep-free-gb", 0, "-q", *words)
    assert (result.returncode, len(result.stderr.splitlines())) == (2, 1)
    assert said in result.stderr


# ---- the message


@pytest.mark.parametrize("values", [[[1000.0, 5200.0, np.nan]], [[-2.5, 1.0, 3.0]], [[np.nan]], [[7.0]]])
def test_counts_give_the_values_back(values):
    values = np.array(values, np.float32)
    counts, first, step = to_counts(values)
    assert counts.max() <= MOST_COUNT
    np.testing.assert_array_equal(counts == 0, np.isnan(values))
    back = np.where(counts > 0, first + counts.astype(float) * step, np.nan)
    np.testing.assert_allclose(back, values, atol=step)


def test_a_message_of_an_uncalibrated_frame_has_disparity():
    camera, image = open_sample(NAME, quality="real-time")
    frame = camera.measure(image)
    from dataclasses import replace

    unknown = replace(frame, depth_mm=frame.depth_mm * np.nan, sigma_mm=frame.sigma_mm * np.nan)
    facts, disparity, *_ = unpack(pack_frame(unknown, {}))
    assert facts["depth"]["unit"] == "px"
    np.testing.assert_allclose(disparity, frame.disparity_px, atol=facts["depth"]["step"])
