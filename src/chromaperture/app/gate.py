"""Who may ask a server of this package, how much is sent, and how slowly: nothing else runs before these checks.

`Access` is the check of one request; `Gate` puts it before an application of the ASGI standard.
"""

from __future__ import annotations

import asyncio
import hmac
import ipaddress
import secrets
import socket
from collections.abc import Awaitable, Callable, Iterator, MutableMapping
from dataclasses import dataclass, field
from http import HTTPStatus
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from chromaperture.system.errors import InputError

Scope = MutableMapping[str, Any]
Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
Application = Callable[[Scope, Receive, Send], Awaitable[None]]

_LOOPBACK_NAMES = frozenset({"localhost", "127.0.0.1", "::1"})
_TOKEN_BYTES = 16  # 128 bits cannot be guessed
# Bytes of a body, chosen by hand. A photograph of 24 megapixels in 16 bits is 144 MB as TIFF and at most 60 MB as RAW;
# everything else that is sent is a short JSON text.
MOST_UPLOAD_BYTES, MOST_BODY_BYTES = 256 * 2**20, 2**16
# Seconds, chosen by hand: for the next part of a body or of an answer, and for a whole body.
PART_S, BODY_S = 20.0, 120.0
_PART_BYTES = 2**18  # of an answer: 13 kB/s at the least
MOST_UPLOADS = 4  # at a time: they fill the disk for as long as they are read

# Nothing is loaded from, sent to, or framed by another server; no inline script runs.
_CONTENT = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; media-src 'self' blob:; "
    "connect-src 'self'; manifest-src 'self'; worker-src 'self'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'"
)
HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": _CONTENT,
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(self), microphone=(), geolocation=()",
    "Referrer-Policy": "no-referrer",  # the address holds the token
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}


def new_token() -> str:
    """Draw the part of an address that nobody can guess."""
    return secrets.token_urlsafe(_TOKEN_BYTES)


@dataclass(frozen=True)
class Access:
    """Who may connect."""

    host: str  # listened on; on 0.0.0.0 or :: every address of this machine leads here, and its name
    token: str = field(default_factory=new_token)  # first part of the path of every request
    scheme: str = "http"  # or https
    command: str = "live"  # that printed the address

    def is_own_host(self, name: str) -> bool:
        """Find whether a request may call the server by this name, which DNS rebinding cannot make ours."""
        if name in _LOOPBACK_NAMES or name == self.host.lower():
            return True
        if not is_every_address(self.host):
            return False
        own = socket.gethostname().lower()
        return name in (own, f"{own}.local") or _is_address(name)

    def refusal(
        self, path: str, hosts: list[str], origins: list[str], *, sites: list[str] | None = None, mode: str = ""
    ) -> str | None:
        """Return why a request to a path, with the token, is refused by its headers, None when it is not."""
        if len(hosts) != 1 or not self.is_own_host(_host_name(hosts[0])):
            return "this server does not go by that name"
        if len(origins) > 1 or any(_origin_host(origin) != hosts[0].lower() for origin in origins):
            return "another web page may not connect"
        if sites == ["cross-site"] and mode != "navigate":
            return "another web page may not connect"
        if not hmac.compare_digest(path_without_query(path).split("/")[1].encode(), self.token.encode()):
            return f"the token is missing or wrong: open the whole address that 'chromaperture {self.command}' printed"
        return None

    def inner_path(self, path: str) -> str:
        """Return the path of an accepted request without the token."""
        return path.removeprefix(f"/{self.token}") or "/"

    def url(self, port: int, *, host: str | None = None) -> str:
        """Return the address of the page, by default for a browser on this machine."""
        name = host or ("127.0.0.1" if is_every_address(self.host) else self.host)
        return f"{self.scheme}://{f'[{name}]' if ':' in name else name}:{port}/{self.token}/"


def path_without_query(path: str) -> str:
    """Return the path of a request, beginning with a slash."""
    path = path.partition("?")[0]
    return path if path.startswith("/") else f"/{path}"


def is_every_address(host: str) -> bool:
    """Find whether listening on this host means listening on every address of the machine."""
    return host in ("", "0.0.0.0", "::")


def _host_name(host: str) -> str:
    try:
        parts = urlsplit(f"//{host}")
        return "" if parts.netloc != host or "@" in host else parts.hostname or ""
    except ValueError:
        return ""


def _origin_host(origin: str) -> str:
    try:
        parts = urlsplit(origin)
    except ValueError:
        return ""
    return parts.netloc.lower() if parts.scheme in ("http", "https") else ""


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


class Refused(Exception):
    """A request that is answered with one line; ``status`` is its HTTP status."""

    def __init__(self, status: HTTPStatus, line: str) -> None:
        super().__init__(line)
        self.status = status


@dataclass
class Gate:
    """The checks before an application."""

    inner: Application  # sees paths without the token
    access: Access
    uploads: tuple[str, ...] = ()  # beginnings of the paths whose bodies may have `most_upload_bytes`
    most_upload_bytes: int = MOST_UPLOAD_BYTES
    part_s: float = PART_S
    body_s: float = BODY_S
    uploading: int = 0  # now

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] == "lifespan":
            await self.inner(scope, receive, send)
            return
        if scope["type"] != "http":  # the app has no WebSocket
            await send({"type": "websocket.close", "code": 1008})
            return
        started = [False]

        async def answer(message: Message) -> None:
            if message["type"] == "http.response.start":
                started[0] = True
                message["headers"] = [*_with_ours(message.get("headers", []))]
            for part in _parts(message):
                await asyncio.wait_for(send(part), self.part_s)

        try:
            await self._pass(scope, receive, answer)
        except Refused as refused:
            if not started[0]:
                await _say(answer, refused.status, str(refused))
        except TimeoutError:  # a reader who stopped reading: the server closes what is not answered to its end
            return

    async def _pass(self, scope: Scope, receive: Receive, send: Send) -> None:
        path, headers = scope["path"], scope["headers"]
        hosts, origins, sites, modes = (
            _values(headers, name) for name in (b"host", b"origin", b"sec-fetch-site", b"sec-fetch-mode")
        )
        reason = self.access.refusal(path, hosts, origins, sites=sites, mode="".join(modes))
        if reason is not None:
            raise Refused(HTTPStatus.FORBIDDEN, reason)
        inner = self.access.inner_path(path)
        is_upload = scope["method"] == "POST" and inner.startswith(self.uploads) if self.uploads else False
        most = self.most_upload_bytes if is_upload else MOST_BODY_BYTES
        declared = _values(headers, b"content-length")
        if declared and int(declared[0]) > most:
            raise Refused(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, too_large(most))
        if is_upload and self.uploading >= MOST_UPLOADS:
            raise Refused(HTTPStatus.SERVICE_UNAVAILABLE, "other uploads are still being read; try again in a moment")
        self.uploading += is_upload
        try:
            limited = self._limited(receive, most)
            await self.inner(dict(scope) | {"path": inner, "raw_path": inner.encode()}, limited, send)
        finally:
            self.uploading -= is_upload

    def _limited(self, receive: Receive, most_bytes: int) -> Receive:
        """Return ``receive`` that refuses a body which is too large or too slow."""
        clock = asyncio.get_running_loop().time
        seen, ended, end = 0, False, clock() + self.body_s

        async def part() -> Message:
            nonlocal seen, ended
            if ended:  # what follows the body is only whether the other side has gone
                return await receive()
            try:
                message = await asyncio.wait_for(receive(), min(self.part_s, max(end - clock(), 0)))
            except TimeoutError:
                raise Refused(HTTPStatus.REQUEST_TIMEOUT, "the upload was too slow; send it again") from None
            seen += len(message.get("body", b""))
            if seen > most_bytes:
                raise Refused(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, too_large(most_bytes))
            ended = not message.get("more_body", False)
            return message

        return part


def too_large(most_bytes: int) -> str:
    """Return what to say of a body above the limit."""
    return f"more than {most_bytes / 2**20:.3g} MB cannot be sent; choose a smaller file"


async def save_body(request: Any, path: Path) -> int:
    """Write the body of a request to a file as it arrives; returns its length; raises InputError for none."""
    length = 0
    with open(path, "wb") as file:
        async for part in request.stream():
            length += len(part)
            await asyncio.to_thread(file.write, part)
    if not length:
        raise InputError("nothing was sent; choose the file again")
    return length


def _parts(message: Message) -> Iterator[Message]:
    """Cut the body of an answer, so that no more waits in memory for a slow reader than a part."""
    body = message.get("body", b"")
    if len(body) <= _PART_BYTES:
        yield message
        return
    for start in range(0, len(body), _PART_BYTES):
        is_last = start + _PART_BYTES >= len(body)
        more = message.get("more_body", False) or not is_last
        yield {"type": message["type"], "body": body[start : start + _PART_BYTES], "more_body": more}


def _values(headers: list[tuple[bytes, bytes]], name: bytes) -> list[str]:
    return [value.decode("latin-1") for key, value in headers if key.lower() == name]


def _with_ours(headers: list[tuple[bytes, bytes]]) -> list[tuple[bytes, bytes]]:
    """Add the headers of every answer that it does not set itself."""
    known = {key.lower() for key, _ in headers}
    more = [(k.lower().encode(), v.encode()) for k, v in HEADERS.items() if k.lower().encode() not in known]
    return [*headers, *more]


async def _say(send: Send, status: HTTPStatus, line: str) -> None:
    """Answer with one line and close the connection, so that the rest of a body is not read."""
    body = line.encode() + b"\n"
    headers = [
        (b"content-type", b"text/plain; charset=utf-8"),
        (b"content-length", str(len(body)).encode()),
        (b"connection", b"close"),
    ]
    await send({"type": "http.response.start", "status": int(status), "headers": headers})
    await send({"type": "http.response.body", "body": body})
