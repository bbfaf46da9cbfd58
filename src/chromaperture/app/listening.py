"""Listen on a port, with limits to how many connect and how long they may idle."""

from __future__ import annotations

import logging
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

from chromaperture.app.certificate import NEEDS_EXTRA
from chromaperture.app.live.access import require_host
from chromaperture.system.errors import InputError, MissingDependencyError

_MOST_CONNECTIONS = 64  # at a time; a browser opens six; chosen by hand
_IDLE_S = 15  # seconds for the header of a request, and between requests; chosen by hand


def make_server(
    application: Any,
    *,
    host: str,
    port: int,
    certificate: tuple[Path, Path] | None = None,
    ready: Callable[[], None] = lambda: None,
) -> Any:
    """Return a server; its ``run`` serves until Ctrl-C, or until its ``should_exit`` is set.

    Parameters
    ----------
    application : callable
        From `make_app`.
    host : str
    port : int
    certificate : (Path, Path), optional
        Certificate and key, for https.
    ready : callable, optional
        Called when the server can be reached.

    Raises
    ------
    InputError
        Nothing can be served there.
    MissingDependencyError
    """
    library, protocol = _uvicorn()
    require_host(host)
    _require_free(host, port)

    class Impatient(protocol()):  # type: ignore[misc]
        """Closes connections that send no request: uvicorn waits for the first one for ever."""

        def connection_made(self, transport: Any) -> None:
            super().connection_made(transport)
            self.loop.call_later(_IDLE_S, self._close_unused)

        def _close_unused(self) -> None:
            if self.cycle is None and not self.transport.is_closing():
                self.transport.close()

    class Server(library().Server):  # type: ignore[misc]
        async def startup(self, sockets: Any = None) -> None:
            await super().startup(sockets)
            if self.started:
                ready()

    logging.getLogger("uvicorn.error").setLevel(logging.ERROR)  # its banner; every scan of the port
    options: dict[str, Any] = {
        "http": Impatient, "ws": "none", "lifespan": "off", "access_log": False, "log_config": None,
        "limit_concurrency": _MOST_CONNECTIONS, "timeout_keep_alive": _IDLE_S, "server_header": False,
        "date_header": False, "proxy_headers": False, "h11_max_incomplete_event_size": 16384,
        "timeout_graceful_shutdown": 2,
    }  # fmt: skip
    if certificate is not None:
        options |= {"ssl_certfile": str(certificate[0]), "ssl_keyfile": str(certificate[1])}
    return Server(library().Config(application, host=host, port=port, **options))


def _uvicorn() -> tuple[Callable[[], Any], Callable[[], Any]]:
    """Return what gives the library, and its protocol in Python."""
    try:
        import uvicorn
        from uvicorn.protocols.http.h11_impl import H11Protocol
    except ImportError:
        raise MissingDependencyError(NEEDS_EXTRA) from None
    return lambda: uvicorn, lambda: H11Protocol


def _require_free(host: str, port: int) -> None:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError as error:
            raise InputError(f"port {port} cannot be used ({error.strerror}); choose another one with --port") from None
