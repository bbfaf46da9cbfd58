"""Serve one page to its owner, on this machine, with the checks of the app; needs no extra."""

from __future__ import annotations

import socket
import threading
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from chromaperture.app.gate import HEADERS, Access, path_without_query
from chromaperture.app.listening import NEXT_PORTS, bound

# The page is one file: its scripts and styles are inside, and it connects to nothing.
_CONTENT = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src blob: data:; base-uri 'none'; "
    "form-action 'none'; frame-ancestors 'none'"
)


class PageServer:
    """Answer GET of one address with one page, an HTML text, until it is closed; a context manager.

    The port, or the next free one, is taken; raises InputError where nothing can be served on this host.
    """

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
