"""Who may open the page, asked as browsers, strangers and broken clients would, over real connections."""

from __future__ import annotations

import contextlib
import http.client
import logging
import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

pytest.importorskip("viser")

import viser
import websockets.asyncio.server
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from rtarm.console.errors import Refusal
from rtarm.view import gate
from rtarm.view.gate import Gate, Opened, names_of, open_server

TOKEN = "t" * 43
STRICT = Gate(TOKEN, names_of("127.0.0.1", "127.0.0.1"))
WIDE = Gate(TOKEN, names_of("robot.lab", "192.168.1.5"), any_address=True)
VIEWER = f"viser-v{viser.__version__}"
PATIENCE_S = 20.0


# --- the rule -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("host", ["127.0.0.1:8460", "localhost:9000", "LocalHost:1", "[::1]:8460", "127.0.0.1"])
@pytest.mark.parametrize("path", [f"/{TOKEN}", f"/{TOKEN}/", f"/{TOKEN}/?darkMode", f"/{TOKEN}/x/y"])
def test_the_printed_address_opens_the_page(host: str, path: str) -> None:
    assert STRICT.refusal(path, [host], []) is None
    assert STRICT.refusal(path, [host], [f"http://{host}"]) is None


@pytest.mark.parametrize(
    "host",
    [
        "evil.example:8460",
        "127.0.0.1.evil.example",
        "localhost.evil.example",
        "localhost.:8460",
        "192.168.1.5:8460",
        "0.0.0.0:8460",
        "127.0.0.1:8460@evil.example",
        "127.0.0.1:8460, evil.example",
        "127.0.0.1 evil.example",
        "[::1",
        "",
        "127.0.0.1:",
        "localhost;default-src *",
        "локалхост",
    ],
)
def test_no_other_name_opens_it(host: str) -> None:
    assert "name" in str(STRICT.refusal(f"/{TOKEN}/", [host], []))


@pytest.mark.parametrize("hosts", [[], ["127.0.0.1", "127.0.0.1"], ["evil.example", "127.0.0.1"]])
def test_exactly_one_host_is_named(hosts: list[str]) -> None:
    assert STRICT.refusal(f"/{TOKEN}/", hosts, []) is not None


@pytest.mark.parametrize(
    "origin",
    [
        "http://evil.example",
        "http://127.0.0.1:9999",  # another user's page on this machine
        "http://127.0.0.1",
        "http://localhost:8460",
        "https://127.0.0.1:8460.evil.example",
        "ws://127.0.0.1:8460",
        "file://127.0.0.1:8460",
        "null",
        "",
        "127.0.0.1:8460",
    ],
)
def test_no_other_page_connects(origin: str) -> None:
    for origins in ([origin], ["http://127.0.0.1:8460", origin]):
        assert "Other pages" in str(STRICT.refusal(f"/{TOKEN}/", ["127.0.0.1:8460"], origins))


@example("")
@example("/")
@example(f"//{TOKEN}")
@example(f"/{TOKEN[:-1]}")
@example(f"/{TOKEN}t")
@example(f"/?token={TOKEN}")
@example(f"/x/{TOKEN}/")
@example(f"/{TOKEN.upper()}/")
@example("/\udcff\udcfe")
@example("/\ud800")
@given(st.text(alphabet=st.characters(exclude_categories=[])))
def test_no_other_path_opens_it(path: str) -> None:
    assert "token" in str(STRICT.refusal(path, ["127.0.0.1:8460"], []))


@given(st.text(), st.text(), st.text())
def test_whatever_comes_is_answered_in_a_sentence_without_the_token(path: str, host: str, origin: str) -> None:
    refusal = STRICT.refusal(path, [host], [origin])
    assert refusal is not None
    assert refusal.endswith(".") and TOKEN not in refusal


@pytest.mark.parametrize("host", ["192.168.1.5:8460", "10.0.0.7", "robot.lab:8460", f"{socket.gethostname()}:8460"])
def test_what_other_machines_may_open_answers_to_addresses_and_its_own_names(host: str) -> None:
    assert WIDE.refusal(f"/{TOKEN}/", [host], [f"http://{host}"]) is None


@pytest.mark.parametrize("host", ["evil.example", "robot.lab.evil.example", "10.0.0.7.evil.example"])
def test_what_other_machines_may_open_answers_to_no_other_name(host: str) -> None:
    assert WIDE.refusal(f"/{TOKEN}/", [host], []) is not None


@given(st.from_regex(gate._HOST, fullmatch=True))
def test_a_host_adds_nothing_of_its_own_to_the_page_s_policy(host: str) -> None:
    policy = gate.headers_of_page(host)["Content-Security-Policy"]
    assert not set(" ;,'\"\r\n") & set(host)
    assert policy.count(";") == gate.headers_of_page("h")["Content-Security-Policy"].count(";")


# --- the server -----------------------------------------------------------------------------------------


@contextlib.contextmanager
def opened(host: str = "127.0.0.1", port: int | None = 0) -> Iterator[Opened]:
    found = open_server(host, port)
    try:
        yield found
    finally:
        found.server.stop()


@pytest.fixture(scope="module")
def page() -> Iterator[Opened]:
    with opened() as found:
        yield found


def place(page: Opened) -> tuple[str, int, str]:
    """Host, port and token of a page."""
    parts = urlsplit(page.url)
    assert parts.hostname is not None and parts.port is not None
    return parts.hostname, parts.port, parts.path.strip("/")


def get(page: Opened, path: str, headers: dict[str, str]) -> http.client.HTTPResponse:
    host, port, _ = place(page)
    with contextlib.closing(http.client.HTTPConnection(host, port, timeout=PATIENCE_S)) as connection:
        connection.putrequest("GET", path, skip_host="Host" in headers, skip_accept_encoding=True)
        for name, value in headers.items():
            connection.putheader(name, value)
        connection.endheaders()
        response = connection.getresponse()
        response.body = response.read()  # type: ignore[attr-defined]
        return response


def socket_of(page: Opened, path: str = "", origin: str | None = None, host: str = "") -> ClientConnection:
    """A WebSocket as the page opens it, which says that it comes to `host`."""
    address, port, token = place(page)
    return connect(
        f"ws://{host or address}:{port}/{path or token}",
        sock=socket.create_connection((address, port), timeout=PATIENCE_S),
        subprotocols=[VIEWER],  # type: ignore[list-item]
        origin=origin,  # type: ignore[arg-type]
        compression=None,
        proxy=None,
        open_timeout=PATIENCE_S,
    )


def test_the_address_that_is_printed_holds_a_long_token_of_its_own(page: Opened) -> None:
    _, _, token = place(page)
    with opened() as other:
        assert len(token) >= 43
        assert place(other)[2] != token
        assert get(page, f"/{place(other)[2]}/", {}).status == 403


def test_the_page_opens_at_its_address_and_keeps_itself_to_itself(page: Opened) -> None:
    host, port, token = place(page)
    response = get(page, f"/{token}/", {})
    assert (response.status, response.headers["Content-Type"]) == (200, "text/html")
    assert b"Viser" in response.body  # type: ignore[attr-defined]
    policy = response.headers["Content-Security-Policy"]
    assert "frame-ancestors 'none'" in policy
    assert f"connect-src 'self' ws://{host}:{port} wss://{host}:{port} data: blob:;" in policy
    assert response.headers["Referrer-Policy"] == "no-referrer"
    assert response.headers["Cache-Control"] == "no-store"
    assert response.headers["Server"] is None


def test_its_websocket_shows_the_page(page: Opened) -> None:
    host, port, _ = place(page)
    for origin in (f"http://{host}:{port}", None):
        with socket_of(page, origin=origin) as viewer:
            assert viewer.subprotocol == VIEWER
            assert isinstance(viewer.recv(timeout=PATIENCE_S), bytes)


@pytest.mark.parametrize(
    ("path", "headers"),
    [
        pytest.param("/", {}, id="no token"),
        pytest.param("/index.html", {}, id="the page itself"),
        pytest.param("/" + "x" * 43 + "/", {}, id="wrong token"),
        pytest.param("/?token={token}", {}, id="token elsewhere"),
        pytest.param("/{token}/", {"Host": "evil.example:{port}"}, id="DNS rebinding"),
        pytest.param("/{token}/", {"Origin": "http://evil.example"}, id="other origin"),
        pytest.param("/{token}/", {"Origin": "null"}, id="a file or a sandbox"),
        pytest.param("/../{token}/", {}, id="climbing"),
    ],
)
def test_http_is_refused_with_a_sentence(page: Opened, path: str, headers: dict[str, str]) -> None:
    _, port, token = place(page)
    response = get(
        page,
        path.format(token=token),
        {name: value.format(port=port) for name, value in headers.items()},
    )
    assert response.status == 403
    text = response.body.decode()  # type: ignore[attr-defined]
    assert "open the address that rtarm printed" in text
    assert token not in text


@pytest.mark.parametrize(
    ("path", "origin", "host"),
    [
        pytest.param("/", None, "", id="no token"),
        pytest.param("x" * 43, None, "", id="wrong token"),
        pytest.param("", "http://evil.example", "", id="a page of another site"),
        pytest.param("", "http://127.0.0.1:1", "", id="a page of another port"),
        pytest.param("", "http://evil.example:{port}", "evil.example", id="DNS rebinding"),
        pytest.param("", "null", "", id="a file or a sandbox"),
    ],
)
def test_websockets_are_refused(page: Opened, path: str, origin: str | None, host: str) -> None:
    if origin is not None:
        origin = origin.format(port=place(page)[1])
    with pytest.raises(InvalidStatus) as refused:
        socket_of(page, path, origin, host)
    assert refused.value.response.status_code == 403


def test_a_forwarded_port_has_another_number(page: Opened) -> None:
    """`ssh -L 9000:127.0.0.1:8460`: the browser says localhost:9000."""
    _, _, token = place(page)
    headers = {"Host": "localhost:9000", "Origin": "http://localhost:9000"}
    assert get(page, f"/{token}/", headers).status == 200


def test_files_outside_the_page_are_not_served(page: Opened) -> None:
    _, _, token = place(page)
    for path in ("/../_viser.py", "/%2e%2e/_viser.py", "//etc/passwd", "/..%5c_viser.py"):
        assert get(page, f"/{token}{path}", {}).status == 404


def test_nothing_that_is_said_or_logged_holds_the_token(
    caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture[str]
) -> None:
    caplog.set_level(logging.DEBUG)
    with opened() as page:
        host, port, token = place(page)
        assert get(page, f"/{token}/", {}).status == 200
        assert get(page, "/", {}).status == 403
        with socket_of(page, origin=f"http://{host}:{port}") as viewer:
            viewer.recv(timeout=PATIENCE_S)
        for request in (f"GET /{token}/ HTTP/1.0\r\n\r\n", f"POST /{token}/ HTTP/1.1\r\nHost: {host}\r\n\r\n", "\r\n"):
            with socket.create_connection((host, port), timeout=PATIENCE_S) as stranger:
                stranger.sendall(request.encode())
                assert closed_by_server(stranger)
    written = logging.Formatter()
    logged = [written.format(record) for record in caplog.records if record.name != "websockets.client"]
    assert not [line for line in logged if token in line]
    assert capfd.readouterr() == ("", "")


def test_a_message_that_is_too_large_ends_its_page_alone(page: Opened) -> None:
    with socket_of(page) as other, socket_of(page) as viewer:
        with contextlib.suppress(ConnectionClosed):
            viewer.send(bytes(gate.LARGEST_MESSAGE_BYTES + 1))
        with pytest.raises(ConnectionClosed) as closed:
            while True:
                viewer.recv(timeout=PATIENCE_S)
        assert closed.value.rcvd is not None and closed.value.rcvd.code == 1009
        other.ping().wait(PATIENCE_S)


def test_only_so_many_pages_are_open_at_once() -> None:
    with opened() as page, contextlib.ExitStack() as pages:
        for _ in range(gate.MOST_PAGES):
            pages.enter_context(socket_of(page)).recv(timeout=PATIENCE_S)
        with pytest.raises(InvalidStatus) as refused:
            socket_of(page)
        assert refused.value.response.status_code == 503
        assert get(page, f"/{place(page)[2]}/", {}).status == 200


def test_strangers_who_say_nothing_take_a_bounded_number_of_connections(monkeypatch: pytest.MonkeyPatch) -> None:
    with opened() as page, contextlib.ExitStack() as idle:
        host, port, _ = place(page)
        for _ in range(gate.MOST_CONNECTIONS):
            idle.enter_context(socket.create_connection((host, port), timeout=PATIENCE_S))
        one_more = idle.enter_context(socket.create_connection((host, port), timeout=PATIENCE_S))
        assert closed_by_server(one_more)


def test_who_says_nothing_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gate, "REQUEST_PATIENCE_S", 0.2)
    with opened() as page:
        host, port, _ = place(page)
        for begun in (b"", b"GET / HT", b"GET / HTTP/1.1\r\nHost: a\r\n"):
            with socket.create_connection((host, port), timeout=PATIENCE_S) as slow:
                slow.sendall(begun)
                assert closed_by_server(slow)


def test_a_page_that_reads_nothing_is_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    """However much is to be sent to it: what waits for it is let go with it."""
    monkeypatch.setattr(gate, "PING_EVERY_S", 0.1)
    monkeypatch.setattr(gate, "PONG_PATIENCE_S", 0.2)
    with opened() as page:
        host, port, token = place(page)
        with socket.create_connection((host, port), timeout=PATIENCE_S) as stuck:
            stuck.sendall(
                f"GET /{token} HTTP/1.1\r\nHost: {host}:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
                f"Sec-WebSocket-Key: {'A' * 22}==\r\nSec-WebSocket-Version: 13\r\n"
                f"Sec-WebSocket-Protocol: {VIEWER}\r\n\r\n".encode()
            )
            assert b" 101 " in stuck.recv(65536)
            assert closed_by_server(stuck)


def closed_by_server(connection: socket.socket) -> bool:
    """Reads to its end; whoever waits longer than the socket's timeout fails."""
    with contextlib.suppress(ConnectionResetError):
        while connection.recv(65536):
            pass
    return True


def test_a_browser_cannot_ask_for_a_way_out_into_the_world(page: Opened, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("viser._viser.ViserTunnel", None)
    page.server.request_share_url()
    assert page.server._share_tunnel is None


# --- where it is served ---------------------------------------------------------------------------------


def test_it_listens_on_the_loopback_address_alone(page: Opened) -> None:
    host, port, _ = place(page)
    assert host == "127.0.0.1" and not page.reachable_from_elsewhere
    rows = [line.split() for line in Path("/proc/net/tcp").read_text(encoding="ascii").splitlines()]
    assert [row[1] for row in rows if row[1].endswith(f":{port:04X}") and row[3] == "0A"] == [f"0100007F:{port:04X}"]


def test_a_port_that_is_taken_is_refused_when_it_was_asked_for() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(Refusal, match=rf"Port {port} of 127\.0\.0\.1 is taken: name another one"):
            open_server(port=port)


def test_a_port_that_nobody_asked_for_gives_way(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        monkeypatch.setattr(gate, "DEFAULT_PORT", taken.getsockname()[1])
        with opened(port=None) as page:
            assert place(page)[1] != taken.getsockname()[1]
            assert get(page, f"/{place(page)[2]}/", {}).status == 200


@pytest.mark.parametrize(
    ("host", "said"),
    [
        ("192.0.2.1", "is no address of this machine"),
        ("", "is no address"),
        ("no such name", "is no address"),
        ("x" * 300, "is no address"),
    ],
)
def test_an_address_that_is_none_is_refused_in_a_sentence(host: str, said: str) -> None:
    with pytest.raises(Refusal, match=said):
        open_server(host, 0)


def test_a_page_for_other_machines_names_this_machine() -> None:
    with opened("0.0.0.0") as page:
        _, port, token = place(page)
        assert page.url == f"http://{socket.gethostname()}:{port}/{token}/"
        assert page.reachable_from_elsewhere
        here = page._replace(url=f"http://127.0.0.1:{port}/{token}/")
        assert get(here, f"/{token}/", {}).status == 200
        assert get(here, f"/{token}/", {"Host": f"{socket.gethostname()}:{port}"}).status == 200
        assert get(here, f"/{token}/", {"Host": "evil.example"}).status == 403
        assert get(here, "/", {}).status == 403


def test_ipv6_is_written_as_addresses_are() -> None:
    try:
        socket.create_server(("::1", 0), family=socket.AF_INET6).close()
    except OSError:
        pytest.skip("this machine has no IPv6")
    with opened("::1") as page:
        assert page.url.startswith("http://[::1]:")
        assert get(page, f"/{place(page)[2]}/", {}).status == 200


def test_a_viser_that_cannot_be_guarded_is_not_started(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if a later version built its server in another way."""
    serve = websockets.asyncio.server.serve
    monkeypatch.setattr("viser.infra._infra.websockets", _as_it_was(serve))
    with pytest.raises(Refusal, match=f"viser {viser.__version__} starts its server in a way that rtarm does not know"):
        open_server(port=0)


def _as_it_was(serve: object) -> object:
    """The package `websockets`, where nothing that is put in place of `serve` is seen."""

    class Package:
        asyncio = type("asyncio", (), {"server": type("server", (), {"serve": serve})})

        def __getattr__(self, name: str) -> object:
            return getattr(websockets, name)

    return Package()


def test_a_missing_viser_is_told_with_what_to_install() -> None:
    program = (
        "import sys; sys.modules['viser'] = None\n"
        "from rtarm.view.gate import open_server\nfrom rtarm.console.errors import Refusal\n"
        "try: open_server()\nexcept Refusal as refusal: print(refusal)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], env=os.environ, capture_output=True, text=True, check=False, timeout=60
    )
    assert (done.stdout, done.stderr) == (
        "viser is not installed, and this needs it: `pip install viser`, then try again.\n",
        "",
    )
