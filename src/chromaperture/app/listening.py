"""Listen on a port, with limits to how many connect and how long they may idle."""

from __future__ import annotations

import logging
import os
import socket
import threading
from collections.abc import Callable
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from chromaperture.app.certificate import NEEDS_EXTRA
from chromaperture.app.gate import HEADERS, Access, path_without_query
from chromaperture.system.errors import InputError, needed

_MOST_CONNECTIONS = 64  # at a time; a browser opens six; chosen by hand
_IDLE_S = 15  # seconds for the header of a request, and between requests; chosen by hand
NEXT_PORTS = 100  # tried from the wanted one on, where any will do; chosen by hand


def bound(host: str, port: int, *, ports: int = 1) -> socket.socket:
    """Return a socket on a port, or on the next free one of so many; raises InputError naming the option to change."""
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host or None, 0, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.bind(address)
    except OSError as error:
        raise InputError(f"cannot serve on {host} ({error}); give an address of this machine with --host") from None
    problem: str | None = "there is no such port"
    for number in range(port, min(port + ports, 65536)):
        found = socket.socket(family, kind, protocol)
        if os.name == "posix":  # elsewhere two servers on one port would share its requests
            found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            found.bind((address[0], number, *address[2:]))
            found.listen()  # a port that another server listens on fails here at the latest
        except (OSError, OverflowError) as error:
            found.close()
            problem = getattr(error, "strerror", None) or str(error)
        else:
            return found
    raise InputError(f"port {port} cannot be used ({problem}); choose another one with --port")


def require_extra() -> None:
    """Raise MissingDependencyError where the server's libraries are not installed."""
    for module in ("starlette", "uvicorn"):
        needed(module, NEEDS_EXTRA)


def make_server(
    application: Any,
    *,
    host: str,
    port: int,
    ports: int = 1,
    certificate: tuple[Path, Path] | None = None,
    ready: Callable[[], None] = lambda: None,
) -> Any:
    """Return a server; its ``run`` serves until Ctrl-C, or until its ``should_exit`` is set.

    Of so many ``ports`` from ``port`` on the first free one is taken, which is the server's ``port``. ``certificate``
    is a certificate and its key, for https; ``ready`` is called when the server can be reached. Raises InputError where
    nothing can be served, MissingDependencyError without the extra.
    """
    require_extra()
    import uvicorn
    from uvicorn.protocols.http.h11_impl import H11Protocol

    class Impatient(H11Protocol):
        """Closes connections that send no request: uvicorn waits for the first one for ever."""

        def connection_made(self, transport: Any) -> None:
            super().connection_made(transport)
            self.loop.call_later(_IDLE_S, self._close_unused)

        def _close_unused(self) -> None:
            if self.cycle is None and not self.transport.is_closing():
                self.transport.close()

    class Server(uvicorn.Server):
        port = 0

        async def startup(self, sockets: Any = None) -> None:
            await super().startup(sockets)
            if self.started:
                ready()

        def run(self, sockets: Any = None) -> None:
            super().run(sockets or [listening])

    logging.getLogger("uvicorn.error").setLevel(logging.ERROR)  # its banner; every scan of the port
    options: dict[str, Any] = {
        "http": Impatient, "ws": "none", "lifespan": "off", "access_log": False, "log_config": None,
        "limit_concurrency": _MOST_CONNECTIONS, "timeout_keep_alive": _IDLE_S, "server_header": False,
        "date_header": False, "proxy_headers": False, "h11_max_incomplete_event_size": 16384,
        "timeout_graceful_shutdown": 2,
    }  # fmt: skip
    if certificate is not None:
        options |= {"ssl_certfile": str(certificate[0]), "ssl_keyfile": str(certificate[1])}
    server = Server(uvicorn.Config(application, **options))
    listening = bound(host, port, ports=ports)
    server.port = listening.getsockname()[1]
    return server


# The page is one file: its scripts and styles are inside, and it connects to nothing.
_CONTENT = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src blob: data:; base-uri 'none'; "
    "form-action 'none'; frame-ancestors 'none'"
)


class PageServer:
    """Answer GET of one address with one page, an HTML text, until it is closed; a context manager."""

    def __init__(self, text: str, *, host: str = "127.0.0.1", port: int = 8080) -> None:
        self.access = Access(host, command="view")
        self._server = _Server(bound(host, port, ports=NEXT_PORTS), _handler(text.encode("utf-8"), self.access))
        self.url = self.access.url(self._server.server_address[1])
        self._thread = threading.Thread(target=self._server.serve_forever, name="page server", daemon=True)

    def __enter__(self) -> PageServer:
        self._thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


class _Server(ThreadingHTTPServer):
    daemon_threads = True

    def __init__(self, listening: socket.socket, handler: type[BaseHTTPRequestHandler]) -> None:
        super().__init__(listening.getsockname()[:2], handler, bind_and_activate=False)
        self.socket.close()
        self.socket = listening

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing: a browser that leaves in mid-answer is no fault of ours."""


def _handler(content: bytes, access: Access) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        timeout = 20  # s, of a client that sends nothing; chosen by hand

        def do_GET(self) -> None:
            hosts, origins, sites = (self.headers.get_all(n) or [] for n in ("Host", "Origin", "Sec-Fetch-Site"))
            mode = self.headers.get("Sec-Fetch-Mode", "")
            refusal = access.refusal(self.path, hosts, origins, sites=sites, mode=mode)
            if refusal is not None:
                self._answer(HTTPStatus.FORBIDDEN, f"{refusal}\n".encode(), "text/plain")
            elif access.inner_path(path_without_query(self.path)) != "/":
                self._answer(HTTPStatus.NOT_FOUND, b"there is one page only\n", "text/plain")
            else:
                self._answer(HTTPStatus.OK, content, "text/html")

        def _answer(self, status: HTTPStatus, body: bytes, kind: str) -> None:
            self.send_response(status)
            self.send_header("Content-Type", f"{kind}; charset=utf-8")
            self.send_header("Content-Length", str(len(body)))
            for name, value in (HEADERS | {"Content-Security-Policy": _CONTENT}).items():
                self.send_header(name, value)
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *arguments: Any) -> None:
            """Print nothing: the address of every request holds the token."""

    return Handler
