"""Attempts to get in: each is refused with one line before the app sees it, or bounded in size and time."""

from __future__ import annotations

import asyncio
import time

import pytest

from chromaperture.app.gate import MOST_BODY_BYTES, MOST_UPLOADS, Access, Gate
from chromaperture.app.state import safe_name

TOKEN = "right-token-of-the-test"
HOST = b"127.0.0.1:8733"


async def _eat(scope, receive, send):
    """An application that reads the whole body and says how long it was."""
    length, more = 0, True
    while more:
        message = await receive()
        length, more = length + len(message.get("body", b"")), message.get("more_body", False)
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": f"{scope['path']} {length}".encode()})


def ask(gate, path=f"/{TOKEN}/api/about", *, method="GET", headers=(), body=(b"",), between_s=0.0, read_s=0.0):
    """One request; returns status, text and headers of the answer."""
    parts, answer = list(body), []
    base = [(b"host", HOST)] if not any(name == b"host" for name, _ in headers) else []

    async def receive():
        await asyncio.sleep(between_s)
        part = parts.pop(0)
        return {"type": "http.request", "body": part, "more_body": bool(parts)}

    async def send(message):
        await asyncio.sleep(read_s)
        answer.append(message)

    scope = {"type": "http", "method": method, "path": path, "headers": [*base, *headers]}
    asyncio.run(gate(scope, receive, send))
    if not answer:
        return None, "", {}
    return answer[0]["status"], b"".join(m.get("body", b"") for m in answer[1:]).decode(), dict(answer[0]["headers"])


@pytest.fixture
def gate():
    return Gate(_eat, Access("127.0.0.1", TOKEN, command="serve"), uploads=("/api/photos",))


def test_the_owner_gets_in_and_the_app_sees_no_token(gate):
    status, text, headers = ask(gate)
    assert (status, text) == (200, "/api/about 0")
    assert b"default-src 'none'" in headers[b"content-security-policy"]
    assert headers[b"cache-control"] == b"no-store"
    assert not any(name.startswith(b"access-control") for name in headers)  # no other origin may read an answer


@pytest.mark.parametrize(
    ("path", "headers", "reason"),
    [
        ("/wrong-token/api/about", (), "token"),
        # a foreign name that leads here (DNS rebinding); more in test_live_page.py
        (f"/{TOKEN}/", ((b"host", b"evil.example:8733"),), "name"),
        (f"/{TOKEN}/", ((b"host", HOST), (b"host", b"evil.example")), "name"),
        (f"/{TOKEN}/", ((b"origin", b"https://evil.example"),), "another web page"),
        (f"/{TOKEN}/", ((b"sec-fetch-site", b"cross-site"), (b"sec-fetch-mode", b"no-cors")), "another web page"),
    ],
)
def test_everyone_else_is_refused(gate, path, headers, reason):
    status, text, _ = ask(gate, path, headers=headers)
    assert status == 403
    assert reason in text


def test_a_websocket_is_refused(gate):
    sent = []

    async def send(message):
        sent.append(message)

    asyncio.run(gate({"type": "websocket", "path": f"/{TOKEN}/", "headers": [(b"host", HOST)]}, None, send))
    assert sent == [{"type": "websocket.close", "code": 1008}]


def test_an_upload_that_does_not_state_its_length_ends_at_the_limit(gate):
    gate.most_upload_bytes = 1000
    status, text, _ = ask(gate, f"/{TOKEN}/api/photos", method="POST", body=[b"x" * 600] * 1000)
    assert status == 413
    status, text, _ = ask(gate, f"/{TOKEN}/api/photos", method="POST", body=[b"x" * 400] * 2)
    assert (status, text) == (200, "/api/photos 800")


def test_only_photographs_may_be_large(gate):
    status, _, _ = ask(gate, method="POST", body=[b"x" * MOST_BODY_BYTES, b"x"])
    assert status == 413


def test_a_sender_of_one_byte_at_a_time_is_cut_off(gate):
    gate.body_s = 0.2
    status, _, _ = ask(gate, f"/{TOKEN}/api/photos", method="POST", body=[b"x"] * 1000, between_s=0.02)
    assert status == 408


def test_a_reader_who_stops_reading_is_let_go(gate):
    gate.part_s = 0.05
    began = time.monotonic()
    assert ask(gate, read_s=5.0) == (None, "", {})
    assert time.monotonic() - began < 2


def test_a_long_answer_is_sent_in_parts_that_wait_for_the_reader(gate):
    async def long(scope, receive, send):
        await send({"type": "http.response.start", "status": 200, "headers": []})
        await send({"type": "http.response.body", "body": bytes(range(256)) * 4096})

    sent = []

    async def send(message):
        sent.append(message)

    gate.inner = long
    scope = {"type": "http", "method": "GET", "path": f"/{TOKEN}/", "headers": [(b"host", HOST)]}
    asyncio.run(gate(scope, None, send))
    parts = sent[1:]
    assert b"".join(part["body"] for part in parts) == bytes(range(256)) * 4096
    assert max(len(part["body"]) for part in parts) == 2**18
    assert [part.get("more_body", False) for part in parts] == [True, True, True, False]


def test_uploads_at_a_time_are_few(gate):
    gate.uploading = MOST_UPLOADS
    assert ask(gate, f"/{TOKEN}/api/photos", method="POST")[0] == 503
    assert ask(gate)[0] == 200
    gate.uploading = 0
    ask(gate, f"/{TOKEN}/api/photos", method="POST")
    assert gate.uploading == 0  # counted down again
    gate.most_upload_bytes = 1
    assert ask(gate, f"/{TOKEN}/api/photos", method="POST", body=[b"xx"])[0] == 413
    assert gate.uploading == 0


@pytest.mark.parametrize(
    ("name", "safe"),
    [
        ("../../etc/passwd", "passwd"),
        ("..\\..\\boot.ini", "boot.ini"),
        ("/etc/cron.d/x.png", "x.png"),
        (".bashrc", "bashrc"),
        ("a\0b.png", "a_b.png"),
        ("photo 1.JPG", "photo_1.JPG"),
        ("", "photo"),
        ("...", "photo"),
        ("x" * 500 + ".png", "x" * 90 + ".png"),
    ],
)
def test_a_file_name_leads_nowhere_else(name, safe):
    assert safe_name(name) == safe
