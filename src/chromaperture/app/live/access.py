"""Open the live page to its owner only: a token in its address, and no request on behalf of another web page."""

from __future__ import annotations

import contextlib
import hmac
import io
import ipaddress
import logging
import secrets
import socket
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from http import HTTPStatus
from typing import Any
from urllib.parse import urlsplit

from chromaperture.system.errors import InputError, MissingDependencyError

_LOOPBACK_NAMES = frozenset({"localhost", "127.0.0.1", "::1"})
_TOKEN_BYTES = 16  # 128 bits cannot be guessed
# No other page may frame this one, and its address, which holds the token, goes to no other server. viser's page is one
# file that unpacks itself: inline scripts, blobs and data are its own. Nothing else is loaded, nowhere else connected.
_CONTENT = (
    "default-src 'none'; script-src 'self' 'unsafe-inline' 'unsafe-eval' blob: data:; worker-src 'self' blob: data:; "
    "style-src 'self' 'unsafe-inline'; img-src 'self' blob: data:; font-src 'self' data:; "
    "connect-src 'self' blob: data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
HEADERS = {
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
    "Content-Security-Policy": _CONTENT,
}
_replacing = threading.Lock()


def new_token() -> str:
    """Draw the part of an address that nobody can guess."""
    return secrets.token_urlsafe(_TOKEN_BYTES)


@dataclass(frozen=True)
class Access:
    """Who may connect.

    Attributes
    ----------
    host : str
        Address or name that the server listens on. On 0.0.0.0 or :: it is reached by every address of this machine and
        by its name.
    token : str
        First part of the path of every request.
    scheme : str
        http, or https.
    command : str
        Which printed the address.
    """

    host: str
    token: str = field(default_factory=new_token)
    scheme: str = "http"
    command: str = "live"

    def is_own_host(self, name: str) -> bool:
        """Find whether a request may call the server by this name.

        A foreign page whose name was made to lead here ("DNS rebinding") has no address and not this machine's name.
        """
        if name in _LOOPBACK_NAMES or name == self.host.lower():
            return True
        if not is_every_address(self.host):
            return False
        own = socket.gethostname().lower()
        return name in (own, f"{own}.local") or _is_address(name)

    def refusal(self, path: str, hosts: list[str], origins: list[str]) -> str | None:
        """Return why a request is refused, None when it is not.

        Parameters
        ----------
        path : str
            As requested, with the token.
        hosts, origins : list of str
            Values of the headers Host and Origin. A browser sends Origin with every WebSocket; other programs need not.
        """
        if len(hosts) != 1 or not self.is_own_host(_host_name(hosts[0])):
            return "this server does not go by that name"
        if len(origins) > 1 or any(_origin_host(origin) != hosts[0].lower() for origin in origins):
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


def viser() -> Any:
    """Import viser; raises MissingDependencyError naming the extra."""
    try:
        import viser
    except ImportError:
        raise MissingDependencyError("the live page needs the extra: pip install 'chromaperture[viewer]'") from None
    return viser


def serve(access: Access, port: int, *, listener: Callable[[str], None]) -> Any:
    """Start viser's server behind the checks of ``access``; return its ViserServer.

    Parameters
    ----------
    access : Access
    port : int
        The first one tried.
    listener : callable
        Receives a line about the first message of a browser that could not be used.

    Raises
    ------
    InputError
        Nothing can be served on this host, or the installed viser does not let its requests be checked.
    """

    class Server(viser().ViserServer):  # type: ignore[misc]
        def request_share_url(self, verbose: bool = True) -> None:
            """Publish nothing: viser would send the page through a server on the internet."""

    require_host(access.host)
    with contextlib.redirect_stdout(io.StringIO()), _checked(access) as is_checked:  # its banner has no token
        server = Server(host=access.host, port=port, verbose=False)
    if not is_checked():
        server.stop()
        raise InputError("this version of viser does not let its requests be checked; install viser 1.1.1")
    said: set[str] = set()

    def unusable(loop: Any, context: dict[str, Any]) -> None:
        line = f"a message to the page could not be used ({context.get('exception') or context['message']!r})"
        if line not in said and len(said) < _MAX_COMPLAINTS:
            said.add(line)
            listener(line)

    loop = server.get_event_loop()
    loop.call_soon_threadsafe(loop.set_exception_handler, unusable)
    return server


_MAX_COMPLAINTS = 20  # lines about unusable messages in a run, chosen by hand: whoever sends them shall not fill a log


@contextlib.contextmanager
def _checked(access: Access) -> Iterator[Callable[[], bool]]:
    """Let servers of websockets that start meanwhile check every request; yields whether one did.

    viser offers no way to check its requests, HTTP or WebSocket. Both pass the ``process_request`` that it hands to
    websockets.
    """
    import websockets.asyncio.server
    from websockets.http11 import Request

    module: Any = websockets.asyncio.server
    original, started = module.serve, threading.Event()
    logger = logging.Logger("chromaperture.app.live", level=logging.CRITICAL)  # else every scan of the port is logged

    def checked_serve(*args: Any, process_request: Any = None, **options: Any) -> Any:
        def check(connection: Any, request: Any) -> Any:
            headers = request.headers
            refusal = access.refusal(request.path, headers.get_all("Host"), headers.get_all("Origin"))
            if refusal is not None:
                response = connection.respond(HTTPStatus.FORBIDDEN, refusal + "\n")
            else:
                response = process_request(connection, Request(access.inner_path(request.path), headers))
            if response is not None:
                for name, value in HEADERS.items():
                    response.headers[name] = value
            return response

        started.set()
        return original(*args, process_request=check, **options | {"logger": logger})

    with _replacing:
        module.serve = checked_serve
        try:
            yield started.is_set
        finally:
            module.serve = original


def require_host(host: str) -> None:
    """Refuse a host that this machine does not have: viser would try a thousand ports and then wait for ever."""
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host or None, 0, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.bind(address)
    except OSError as error:
        raise InputError(f"cannot serve on {host} ({error}); give an address of this machine with --host") from None


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
