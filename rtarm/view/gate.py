"""Who may open the page: the address it is served at, the token in that address, and what is refused.

The page can move the arm. It must not be reached by another user of this machine, who can connect to 127.0.0.1 as well
as we can, nor by a page of some other site that is open in the same browser. So there is a token everywhere, and it is
the first part of the path, `http://127.0.0.1:8460/TOKEN/`. A browser shows a path to nobody but the server it asks, and
sends it only when this page does. A cookie would go to every port of the machine, whoever listens there. Behind the
token stand three checks that a slip elsewhere would need to pass as well:

- Host must be a name of this machine: another site's name that was made to point here (DNS rebinding) is none;
- Origin, where there is one, must be the page's own: browsers send it with every WebSocket;
- the page may connect to nothing else and be framed by nothing (Content-Security-Policy).

viser has no such checks, and no place for them. It builds its server with `websockets.asyncio.server.serve`, whose
public arguments have: `open_server` puts its own there while viser starts, and refuses to go on where that did not
happen.
"""

from __future__ import annotations

import contextlib
import errno
import io
import ipaddress
import logging
import re
import secrets
import socket
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from hmac import compare_digest
from http import HTTPStatus
from typing import TYPE_CHECKING, Any, NamedTuple

from rtarm.console.errors import Refusal, needs
from rtarm.console.niceness import nice_thread

if TYPE_CHECKING:
    import asyncio

    from viser import ViserServer
    from websockets.asyncio.server import ServerConnection
    from websockets.http11 import Request, Response

LOOPBACK = "127.0.0.1"
DEFAULT_PORT = 8460
TOKEN_BYTES = 32

MOST_PAGES = 8
MOST_CONNECTIONS = 64
"""Open at once, in whatever state: more are closed as soon as they come."""
LARGEST_MESSAGE_BYTES = 1 << 20
"""From the browser, which sends cameras and clicks."""
REQUEST_PATIENCE_S = 5.0
"""Within which a connection has to say what it wants."""
PING_EVERY_S = 10.0
PONG_PATIENCE_S = 20.0
"""A page that answers nothing for so long is closed, and with it whatever waits to be sent to it."""

OWN_NAMES = frozenset({"localhost", LOOPBACK, "::1"})

_HOST = re.compile(r"(?:\[(?P<v6>[0-9A-Fa-f:.]{2,45})\]|(?P<name>[0-9A-Za-z._-]{1,253}))(?::\d{1,5})?")


class Opened(NamedTuple):
    """A server that nobody reaches without its address."""

    server: ViserServer
    url: str
    """Holds the token: whoever has it may do all that the page can."""
    reachable_from_elsewhere: bool


@dataclass(frozen=True)
class Gate:
    """What a request must bring.

    Attributes:
        token: first part of the path.
        names: host names (lower case) and addresses under which the page is served.
        any_address: every address, though no other name, is right as well: what listens for other machines is often
            reached by an address it does not know, such as that of the machine around a container.
    """

    token: str
    names: Collection[str]
    any_address: bool = False

    def refusal(self, path: str, hosts: Sequence[str], origins: Sequence[str]) -> str | None:
        """Why a request is refused, in a sentence that gives nothing away; None if it may come in.

        Args:
            path: of the request, with whatever query there is.
            hosts: all its Host headers.
            origins: all its Origin headers; a browser sends none when a person opens an address.
        """
        if len(hosts) != 1 or not self._is_ours(hosts[0]):
            return "This page is not served under that name: open the address that rtarm printed."
        if any(origin not in (f"http://{hosts[0]}", f"https://{hosts[0]}") for origin in origins):
            return "Other pages may not connect here: open the address that rtarm printed."
        given = path.partition("?")[0].removeprefix("/").partition("/")[0]
        if not compare_digest(given.encode(errors="surrogatepass"), self.token.encode()):
            return "This page opens with its token only: open the address that rtarm printed, all of it."
        return None

    def _is_ours(self, host: str) -> bool:
        match = _HOST.fullmatch(host)
        if match is None:
            return False
        name = (match["v6"] or match["name"]).lower()
        return name in self.names or (self.any_address and _address(name) is not None)


def open_server(host: str = LOOPBACK, port: int | None = None) -> Opened:
    """Start viser's server behind a gate, with a token of its own.

    Args:
        host: address or name of this machine; anything but the loopback address lets other machines connect.
        port: 0 is any free one; None is `DEFAULT_PORT`, or any free one where that is taken.

    Raises:
        Refusal: the address cannot be served, or viser is missing or not one that can be guarded.
    """
    server_type = _quiet_server()
    listener = listen(host, port)
    address, bound_port = listener.getsockname()[:2]
    gate = Gate(secrets.token_urlsafe(TOKEN_BYTES), names_of(host, address), not _is_loopback(address))
    with (
        _served_by(gate, listener) as served,
        contextlib.redirect_stdout(io.StringIO()),
        nice_thread() as thread,  # whose priority the server's own threads have
    ):
        # Where the gate is not taken up, this is where viser listens for the moment until it is stopped.
        server: ViserServer = thread.submit(server_type, host=LOOPBACK, port=0, verbose=False).result()
    if not served:
        server.stop()
        listener.close()
        import viser

        raise Refusal(
            f"viser {viser.__version__} starts its server in a way that rtarm does not know and could not guard, so it "
            "was not started: install the viser that rtarm's constraints.txt names."
        )
    return Opened(server, f"http://{_shown(host, address)}:{bound_port}/{gate.token}/", gate.any_address)


def listen(host: str, port: int | None) -> socket.socket:
    """A listening socket at an address of this machine (`port` as in `open_server`).

    Raises:
        Refusal: it is taken, or no address of this machine.
    """
    try:
        family, *_, place = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)[0]
    except (OSError, UnicodeError):
        raise Refusal(
            f"--host {host!r} is no address: name one of this machine's, or leave it out for {LOOPBACK}."
        ) from None
    try:
        return socket.create_server((place[0], DEFAULT_PORT if port is None else port), family=family)
    except OSError as error:
        if error.errno == errno.EADDRINUSE and port is None:
            return listen(host, 0)
        raise _cannot_listen(host, port, error) from None


def _cannot_listen(host: str, port: int | None, error: OSError) -> Refusal:
    if error.errno == errno.EADDRINUSE:
        return Refusal(f"Port {port} of {host} is taken: name another one, or --port 0 for any that is free.")
    if error.errno == errno.EADDRNOTAVAIL:
        return Refusal(
            f"--host {host} is no address of this machine: name one that it has, or leave it out for {LOOPBACK}."
        )
    if error.errno == errno.EACCES:
        return Refusal(f"Port {port} may be opened by root alone: name one from 1024 to 65535, or 0 for any.")
    return Refusal(f"{host}, port {port}, cannot be served ({error.strerror}): name another address or port.")


def names_of(host: str, address: str) -> frozenset[str]:
    """The names under which a page is served that was asked for at `host` and listens at `address`."""
    names = OWN_NAMES | {host.lower(), address}
    if _is_loopback(address):
        return names
    own = socket.gethostname().lower()
    return names | {own, own.partition(".")[0], f"{own.partition('.')[0]}.local"}


def _shown(host: str, address: str) -> str:
    """What stands for the host in the URL: where it listens everywhere, this machine's name."""
    shown = socket.gethostname() if ipaddress.ip_address(address).is_unspecified else host
    return f"[{shown}]" if ":" in shown else shown


def _address(name: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        return ipaddress.ip_address(name)
    except ValueError:
        return None


def _is_loopback(address: str) -> bool:
    return ipaddress.ip_address(address.partition("%")[0]).is_loopback


# --- in viser -------------------------------------------------------------------------------------------


def _quiet_server() -> type[ViserServer]:
    """viser's server, without lines of its own on standard output, and without a way out into the world."""
    needs("viser")
    import viser

    class QuietServer(viser.ViserServer):
        def request_share_url(self, verbose: bool = True) -> None:
            """A browser can ask for this: a tunnel from a public server to this one, for anybody."""

        def stop(self) -> None:
            with contextlib.redirect_stdout(io.StringIO()):
                super().stop()

    return QuietServer


@contextlib.contextmanager
def _served_by(gate: Gate, listener: socket.socket) -> Iterator[list[Any]]:
    """Meanwhile a server that viser builds is one behind the gate; yields those that were built."""
    from websockets.asyncio import server as websockets_server

    serve, name = websockets_server.serve, "serve"
    built: list[Any] = []

    def guarded(handler: Any, *_: Any, process_request: Callable[..., Response | None], **options: Any) -> Any:
        limits = {
            "create_connection": _counted_connection(),
            "max_size": LARGEST_MESSAGE_BYTES,
            "open_timeout": REQUEST_PATIENCE_S,
            "ping_interval": PING_EVERY_S,
            "ping_timeout": PONG_PATIENCE_S,
            "logger": _discreet_logger(),
            "server_header": None,
        }
        checked = _checked(gate, process_request)
        built.append(serve(handler, sock=listener, process_request=checked, **{**options, **limits}))
        return built[-1]

    setattr(websockets_server, name, guarded)
    try:
        yield built
    finally:
        setattr(websockets_server, name, serve)


def _checked(
    gate: Gate, answer: Callable[[ServerConnection, Request], Response | None]
) -> Callable[[ServerConnection, Request], Response | None]:
    """`answer` for those who may come in, which sees no token; None lets a WebSocket begin."""
    from websockets.http11 import Request

    def check(connection: ServerConnection, request: Request) -> Response | None:
        hosts, origins = request.headers.get_all("Host"), request.headers.get_all("Origin")
        refusal = gate.refusal(request.path, hosts, origins)
        if refusal is not None:
            return connection.respond(HTTPStatus.FORBIDDEN, f"{refusal}\n")
        if "Upgrade" in request.headers and len(connection.server.connections) >= MOST_PAGES:
            return connection.respond(
                HTTPStatus.SERVICE_UNAVAILABLE, f"{MOST_PAGES} pages are open already: close one of them.\n"
            )
        response = answer(connection, Request(request.path.removeprefix(f"/{gate.token}") or "/", request.headers))
        if response is not None:
            response.headers.update(headers_of_page(hosts[0]))
        return response

    return check


def headers_of_page(host: str) -> dict[str, str]:
    """What the browser is told about everything it gets here, from the host it asked.

    viser's page holds its scripts in itself, packed, and runs them with eval; a WebSocket of the page's own host is not
    'self' to every browser.
    """
    return {
        "Content-Security-Policy": "default-src 'self' 'unsafe-inline' 'unsafe-eval' data: blob:; "
        f"connect-src 'self' ws://{host} wss://{host} data: blob:; "
        "frame-ancestors 'none'; base-uri 'none'; form-action 'none'; object-src 'none'",
        "Referrer-Policy": "no-referrer",
        "X-Content-Type-Options": "nosniff",
        "Cache-Control": "no-store",
    }


def _counted_connection() -> type[ServerConnection]:
    from websockets.asyncio.server import ServerConnection

    class CountedConnection(ServerConnection):
        def connection_made(self, transport: asyncio.BaseTransport) -> None:
            full = len(self.server.handlers) >= MOST_CONNECTIONS
            super().connection_made(transport)
            if full:
                self.transport.abort()

    return CountedConnection


def _discreet_logger() -> logging.Logger:
    """Writes neither requests, which hold the token, nor what is wrong with those that strangers send."""
    from websockets.exceptions import InvalidHandshake

    def worth_telling(record: logging.LogRecord) -> bool:
        return not (record.exc_info and isinstance(record.exc_info[1], InvalidHandshake))

    logger = logging.getLogger(__name__)
    logger.setLevel(logging.WARNING)
    logger.addFilter(worth_telling)
    return logger
