"""The page in a real Chromium: it opens at its address, and a page of another site does not get at it."""

from __future__ import annotations

import functools
import http.server
import shutil
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("viser")
pytest.importorskip("selenium")

from selenium import webdriver
from selenium.webdriver.support.ui import WebDriverWait

from rtarm.view.gate import Opened, open_server

CHROMIUM, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")

pytestmark = [
    pytest.mark.process,
    pytest.mark.skipif(CHROMIUM is None or DRIVER is None, reason="no chromium and chromedriver here"),
]

PATIENCE_S = 60.0

INTRUDER = """<!doctype html><title>trying</title><iframe id="frame"></iframe><script>
const page = new URL(location.hash.slice(1));
function tried(address) {
  return new Promise((told) => {
    const socket = new WebSocket(address, ["viser-v1.1.1"]);
    socket.onopen = () => told("in");
    socket.onerror = () => told("out");
  });
}
async function try_all() {
  const socket = page.href.replace("http:", "ws:").slice(0, -1);
  const found = [await tried("ws://" + page.host + "/"), await tried(socket)];
  found.push(await fetch(page.href).then((answer) => answer.text()).then(() => "in", () => "out"));
  await new Promise((loaded) => {
    document.getElementById("frame").onload = loaded;
    document.getElementById("frame").src = page.href;
  });
  document.title = found.join(" ");
}
try_all();
</script>"""
"""Knows even the token, which it takes from its own address."""


@pytest.fixture(scope="module")
def page() -> Iterator[Opened]:
    opened = open_server(port=0)
    opened.server.gui.add_button("Hold")
    yield opened
    opened.server.stop()


@pytest.fixture(scope="module")
def browser() -> Iterator[webdriver.Chrome]:
    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    for option in ("--headless=new", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"):
        options.add_argument(option)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(DRIVER))
    yield driver
    driver.quit()


@pytest.fixture
def other_site(tmp_path: Path) -> Iterator[str]:
    """A page of another origin in the same browser; at 127.0.0.1 too, where cookies would have gone along."""
    (tmp_path / "intruder.html").write_text(INTRUDER, encoding="utf-8")

    class Quiet(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *_: object) -> None:
            pass

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Quiet, directory=str(tmp_path)))
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}/intruder.html"
    server.shutdown()
    server.server_close()
    thread.join()


def test_the_page_opens_at_its_address_and_breaks_no_rule_of_its_own(browser: webdriver.Chrome, page: Opened) -> None:
    browser.get_log("browser")
    browser.get(page.url)
    WebDriverWait(browser, PATIENCE_S).until(lambda seen: "Hold" in seen.find_element("tag name", "body").text)
    WebDriverWait(browser, PATIENCE_S).until(lambda _: len(page.server.get_clients()) == 1)
    said = [entry["message"] for entry in browser.get_log("browser")]
    assert not [line for line in said if "Content Security Policy" in line]
    browser.refresh()
    WebDriverWait(browser, PATIENCE_S).until(lambda seen: "Hold" in seen.find_element("tag name", "body").text)


def test_a_page_of_another_site_gets_nowhere(browser: webdriver.Chrome, page: Opened, other_site: str) -> None:
    browser.get("about:blank")
    WebDriverWait(browser, PATIENCE_S).until(lambda _: not page.server.get_clients())
    browser.get(f"{other_site}#{page.url}")
    WebDriverWait(browser, PATIENCE_S).until(lambda seen: seen.title != "trying")
    assert browser.title == "out out out"
    assert not page.server.get_clients()
    browser.switch_to.frame("frame")
    assert "Hold" not in browser.find_element("tag name", "body").text
    browser.switch_to.default_content()


def test_the_page_connects_to_no_other_server(browser: webdriver.Chrome, page: Opened) -> None:
    """viser's page would take another server from its address, and run what that one sends."""
    with_other = open_server(port=0)
    try:
        browser.get("about:blank")
        browser.get_log("browser")
        browser.get(f"{page.url}?websocket={with_other.url.replace('http:', 'ws:')}")
        said: list[str] = []
        WebDriverWait(browser, PATIENCE_S).until(
            lambda seen: (
                said.extend(entry["message"] for entry in seen.get_log("browser"))
                or any("Content Security Policy" in line for line in said)
            )
        )
        assert not with_other.server.get_clients()
    finally:
        with_other.server.stop()
