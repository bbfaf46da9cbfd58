"""Serve one page to its owner, on this machine, with the checks of the live page; needs no extra."""

from __future__ import annotations

import threading
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from chromaperture.app.live.access import HEADERS, Access, path_without_query
from chromaperture.system.errors import InputError

_PORTS = 100  # tried, from the wanted one on; as many as viser's live page may have taken, chosen by hand


class PageServer:
    """Answer GET of one address with one page, until it is closed; a context manager.

    Parameters
    ----------
    text : str
        HTML.
    host : str
        127.0.0.1 is this machine only.
    port : int
        The first one tried.

    Raises
    ------
    InputError
        Nothing can be served on this host.
    """

    def __init__(self, text: str, *, host: str = "127.0.0.1", port: int = 8080) -> None:
        self.access = Access(host, command="view")
        self._server = _bound(host, port, _handler(text.encode("utf-8"), self.access))
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
    allow_reuse_address = False  # two servers on one port would share its requests on some systems

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing: a browser that leaves in mid-answer is no fault of ours."""


def _bound(host: str, port: int, handler: type[BaseHTTPRequestHandler]) -> _Server:
    problem: OSError | OverflowError | None = None
    for number in range(port, min(port + _PORTS, 65536)):
        try:
            return _Server((host, number), handler)
        except (OSError, OverflowError) as error:
            problem = error
    raise InputError(f"cannot serve on {host}:{port} ({problem}); choose another --port") from None


def _handler(content: bytes, access: Access) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        timeout = 20  # s, of a client that sends nothing; chosen by hand

        def do_GET(self) -> None:
            headers = self.headers
            refusal = access.refusal(self.path, headers.get_all("Host") or [], headers.get_all("Origin") or [])
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
            for name, value in HEADERS.items():
                self.send_header(name, value)
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *arguments: Any) -> None:
            """Print nothing: the address of every request holds the token."""

    return Handler
