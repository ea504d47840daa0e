"""The site: built without a warning, read without a request to anybody else, and searched in both languages."""

from __future__ import annotations

import functools
import http.server
import re
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path

import pytest
from pages import ROOT

from handbook.site import rewritten, source_place, sources_led_to, with_folders

pytest.importorskip("mkdocs")

FETCHING = {"link": "href", "script": "src", "img": "src", "iframe": "src", "source": "src", "object": "data"}
"""Elements for which a browser fetches something, and where they say what."""
NOT_FETCHED = {"canonical", "alternate", "next", "prev"}
FIRST = 5
"""Among so many pages stands what is looked for; the sections of a page, which are results too, do not count."""
CHROMIUM, CHROMEDRIVER = shutil.which("chromium"), shutil.which("chromedriver")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, made as `make docs` makes it."""
    folder = tmp_path_factory.mktemp("site")
    result = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--site-dir", str(folder)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    return folder


class Fetched(HTMLParser):
    """What a browser fetches for a page."""

    def __init__(self, page: Path) -> None:
        super().__init__()
        self.places: list[str] = []
        self.feed(page.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        given = dict(attributes)
        place = given.get(FETCHING.get(tag, ""))
        if place and not NOT_FETCHED & set((given.get("rel") or "").split()):
            self.places.append(place)


def test_no_page_fetches_anything_from_elsewhere(site: Path) -> None:
    pages = list(site.rglob("*.html"))
    assert len(pages) > 50
    foreign = {
        (page.relative_to(site).as_posix(), place)
        for page in pages
        for place in Fetched(page).places
        if re.match(r"^([a-z]+:)?//", place) and not place.startswith("data:")
    }
    assert not foreign
    sheets = [path.read_text(encoding="utf-8") for path in site.rglob("*.css")]
    assert sheets and not any(re.search(r"url\(['\"]?(https?:)?//|@import", sheet) for sheet in sheets)


def test_the_site_has_both_languages_and_the_readme_is_its_entry(site: Path) -> None:
    english, chinese = ((site / place).read_text(encoding="utf-8") for place in ("index.html", "zh/index.html"))
    assert 'lang="en"' in english and 'lang="zh"' in chinese
    assert "Read this before a motor has power" in english
    assert (site / "zh" / "guides" / "homing" / "index.html").read_text(encoding="utf-8") != (
        site / "guides" / "homing" / "index.html"
    ).read_text(encoding="utf-8")


def test_files_outside_docs_are_shown_and_led_to() -> None:
    text = "[a](../config/arms/mock.yaml) [b](homing.md#x) [c](https://example.org) [d](../README.md) [e](../nowhere)\n"
    led_to = sources_led_to(ROOT, "docs/faults/a.md", text.replace("](../", "](../../"))
    assert led_to == {"config/arms/mock.yaml"}
    places = {"docs/a.md": "a.md", "README.md": "index.md", "docs/homing.md": "homing.md"}
    places["config/arms/mock.yaml"] = source_place("config/arms/mock.yaml")
    assert rewritten("docs/a.md", text, places) == (
        "[a](source/config/arms/mock_yaml.md) [b](homing.md#x) [c](https://example.org) [d](index.md) [e](../nowhere)\n"
    )


def test_a_folder_in_the_navigation_is_its_pages_without_their_twins(tmp_path: Path) -> None:
    (tmp_path / "faults").mkdir()
    for name in ("bus_off.md", "bus_off.zh.md", "index.md", "index.zh.md", "wire.md"):
        (tmp_path / "faults" / name).touch()
    pages = ["faults/index.md", "faults/bus_off.md", "faults/wire.md"]
    assert with_folders({"Mending": ["top.md", {"Faults": "faults/*"}]}, tmp_path) == {
        "Mending": ["top.md", {"Faults": pages}]
    }


# --- in a browser ---


@pytest.fixture(scope="module")
def address(site: Path) -> Iterator[str]:
    """Where the site is served."""

    class Quiet(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *_: object) -> None:
            """Nothing is told."""

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Quiet, directory=str(site))) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_address[1]}"
        server.shutdown()
        thread.join()


@pytest.mark.process
@pytest.mark.skipif(not (CHROMIUM and CHROMEDRIVER), reason="needs chromium and chromedriver (Debian's packages)")
@pytest.mark.parametrize(
    ("page", "words", "found"),
    [
        ("", "bus-off", "/faults/bus_off/"),
        ("", "silence_brake_factor", "/reference/configuration/"),
        ("zh/", "停放", "/zh/guides/homing/"),
    ],
)
def test_search_finds_what_people_look_for(address: str, page: str, words: str, found: str) -> None:
    from selenium import webdriver
    from selenium.common.exceptions import StaleElementReferenceException
    from selenium.webdriver.common.by import By
    from selenium.webdriver.support.ui import WebDriverWait

    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    for argument in ("--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--window-size=1400,1000"):
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"performance": "ALL"})
    with webdriver.Chrome(options=options, service=webdriver.ChromeService(CHROMEDRIVER)) as browser:
        browser.get(f"{address}/{page}")
        browser.find_element(By.CSS_SELECTOR, "[data-md-component=search-query]").send_keys(words)

        def first_pages(here: webdriver.Chrome) -> list[str]:
            links = here.find_elements(By.CSS_SELECTOR, ".md-search-result__link")
            pages = dict.fromkeys(str(link.get_attribute("href")).partition("?")[0] for link in links)
            return list(pages)[:FIRST]

        # There are results for every letter that is typed: those of the whole word come last.
        WebDriverWait(browser, 60, ignored_exceptions=[StaleElementReferenceException]).until(
            lambda here: any(found in link for link in first_pages(here)), f"{found} is not among the first pages"
        )
        requests = [
            match.group(1)
            for entry in browser.get_log("performance")
            if (match := re.search(r'"Network.requestWillBeSent".*?"request":\{.*?"url":"([^"]+)"', entry["message"]))
        ]
    assert requests
    assert not [place for place in requests if not place.startswith((address, "data:", "blob:"))]
