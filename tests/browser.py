"""A real browser without a window, and the page of `rtarm view` in it as a person meets it."""

from __future__ import annotations

import io
import json
import os
import re
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np

CHROMIUM, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
PATIENCE_S = 120.0
OPTIONS = (
    "--headless=new",
    "--no-sandbox",  # a container's root has no other way
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--window-size=1280,887",  # of which the page gets 1280 × 800
    "--disable-background-networking",
    "--force-device-scale-factor=1",
)

CALM = "RTARM_PICTURES" not in os.environ
"""Whether a page draws less than people's browsers have it draw, which pictures and `bench/bench_view.py` show.

Without a graphics card threads draw a picture and hand it to each other some hundred times, and beside a full machine
each waits for its turn as often. So the scene is drawn twice a second, and the rest of the page without such threads.
"""
CALM_OPTIONS = ("--disable-gpu-compositing",) if CALM else ()
FRAME_MS = 500
CALMER = f"""window.requestAnimationFrame = draw => setTimeout(() => draw(performance.now()), {FRAME_MS})
window.cancelAnimationFrame = clearTimeout"""

FILM_SIZE, FILM_FRAMES, FILM_REST_MS = (800, 500), 60, 2000
"""A moving picture's size in pixels, the most frames that it has, and how long its last one is seen."""


class Browser:
    """One tab, or several."""

    def __init__(self) -> None:
        from selenium import webdriver

        options = webdriver.ChromeOptions()
        options.binary_location = CHROMIUM
        for option in (*OPTIONS, *CALM_OPTIONS):
            options.add_argument(option)
        options.set_capability("goog:loggingPrefs", {"performance": "ALL", "browser": "ALL"})
        self.driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(DRIVER))
        self.driver.set_script_timeout(PATIENCE_S)
        self.driver.set_page_load_timeout(PATIENCE_S)
        self._tab = self.driver.current_window_handle
        self._calm()

    def close(self) -> None:
        self.driver.quit()

    def open(self, url: str) -> None:
        """Have a page in the first tab, as it was left, and wait until it shows an arm."""
        self.driver.switch_to.window(self._tab)
        if not self.driver.current_url.startswith(url):  # to load it takes a busy machine longer than all the rest
            self.driver.get(url)
        self.until(lambda: self.text("#rt-mode"))
        self.until(self._rendered)
        for notice in self._all("#webgl-software-rendering button"):
            notice.click()
        self.until(lambda: not self._all("#webgl-software-rendering"))

    @contextmanager
    def phone(self, height_px: int = 844) -> Iterator[None]:
        """Meanwhile the tab is as wide as a phone's."""
        size = {"width": 390, "height": height_px, "deviceScaleFactor": 1, "mobile": True}
        self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        try:
            self.until(lambda: self._lies_within(size["width"]))
            yield
        finally:
            self.driver.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})

    def _lies_within(self, width_px: int) -> bool:
        """Whether the page is laid out for that width: there are buttons, and none beyond it."""
        script = "return [...document.querySelectorAll('button')].map(e => e.getBoundingClientRect().right)"
        ends_px = self.driver.execute_script(script)
        return any(ends_px) and max(ends_px) <= width_px

    def scroll(self, to_px: float) -> None:
        """Scroll whatever can be scrolled."""
        script = "for (const e of document.querySelectorAll('*')) e.scrollTop = arguments[0]"
        self.driver.execute_script(script, to_px)

    def tap(self, text: str) -> None:
        """Put a finger where the first text is that begins so, scrolled to if it must be, whatever takes it."""
        script = """const which = `//body//*[starts-with(normalize-space(text()), '${arguments[0]}')]`
            const found = document.evaluate(which, document, null, XPathResult.FIRST_ORDERED_NODE_TYPE).singleNodeValue
            found.scrollIntoView({block: 'nearest'})
            const at = found.getBoundingClientRect()
            return [(at.left + at.right) / 2, (at.top + at.bottom) / 2]"""
        x, y = self.driver.execute_script(script, text)
        for kind in ("mousePressed", "mouseReleased"):
            event = {"type": kind, "x": x, "y": y, "button": "left", "clickCount": 1}
            self.driver.execute_cdp_cmd("Input.dispatchMouseEvent", event)

    def can_press(self, label: str) -> bool:
        """Whether a finger at the middle of that button meets it."""
        script = """for (const one of document.querySelectorAll('button')) {
            if (one.textContent.trim() !== arguments[0]) continue
            const at = one.getBoundingClientRect()
            const met = document.elementFromPoint((at.left + at.right) / 2, (at.top + at.bottom) / 2)
            return met !== null && one.contains(met)
        } return false"""
        return bool(self.driver.execute_script(script, label))

    def open_beside(self, url: str) -> None:
        """Open a page in one more tab, which is then the one that is looked at."""
        self.driver.switch_to.new_window("tab")
        self._calm()
        self.driver.get(url)
        self.until(lambda: self.text("#rt-mode"))

    def close_beside(self) -> None:
        """Back to the first tab."""
        self.driver.close()
        self.driver.switch_to.window(self._tab)

    def until(self, true: Callable[[], Any], patience_s: float = PATIENCE_S) -> Any:
        """Wait until something is seen; what it was."""
        from selenium.common.exceptions import StaleElementReferenceException

        deadline = time.monotonic() + patience_s
        while True:
            try:
                found = true()
            except StaleElementReferenceException:
                found = None
            if found:
                return found
            assert time.monotonic() < deadline, f"never seen:\n{self._what_is_there()}"
            time.sleep(0.05)

    def _what_is_there(self) -> str:
        """The page, its address and the last lines of its console: of an empty page they alone tell why."""
        body = self.driver.find_element("tag name", "body").text
        console = [f"{line['level']}: {line['message']}" for line in self.driver.get_log("browser")[-10:]]
        return "\n".join((body, self.driver.current_url, *console))

    def text(self, selector: str) -> str:
        """What stands in an element, "" while there is none."""
        return str(
            self.driver.execute_script(
                "const e = document.querySelector(arguments[0]); return e === null ? '' : e.textContent", selector
            )
        )

    def texts(self, selector: str) -> list[str]:
        return list(
            self.driver.execute_script(
                "return [...document.querySelectorAll(arguments[0])].map(e => e.textContent)", selector
            )
        )

    def said(self, what: str) -> str:
        """All sentences of one kind (trouble, problem, near, answer), joined."""
        return " ".join(self.texts(f"[data-say={what}]"))

    def buttons(self) -> list[str]:
        return self.texts("button .mantine-Button-label")

    def press(self, label: str) -> None:
        """Press the button whose label begins so."""
        path = f"//button[.//span[contains(@class,'Button-label') and starts-with(normalize-space(.), '{label}')]]"

        def pressed() -> bool:
            for button in self.driver.find_elements("xpath", path):
                if button.is_enabled():
                    button.click()
                    return True
            return False

        self.until(pressed)

    def tab(self, label: str) -> None:
        path = f"//*[@role='tab' and normalize-space(.)='{label}']"
        self.until(lambda: self.driver.find_elements("xpath", path))[0].click()

    def selected_tab(self) -> str:
        """The tab beside the arm that is shown."""
        return self.texts("[role=tab][aria-selected=true]")[-1]

    def page_text(self) -> str:
        """Everything that can be read on the page."""
        return str(self.driver.execute_script("return document.body.innerText"))

    def slide(self, label: str, value: float) -> None:
        """Type a number into the field of a slider."""
        from selenium.webdriver.common.keys import Keys

        field = self.until(lambda: self._field(label))[0]
        field.send_keys(Keys.CONTROL, "a")
        field.send_keys(f"{value:g}", Keys.TAB)

    def slider(self, label: str) -> float:
        """Where a slider stands."""
        return float(self._field(label)[0].get_attribute("value"))

    def look(self, enough: Callable[[np.ndarray], bool]) -> np.ndarray:
        """The first picture of the scene that shows enough."""

        def looked() -> list[np.ndarray]:
            picture = self.picture()
            return [picture] if enough(picture) else []

        found: np.ndarray = self.until(looked)[0]
        return found

    def picture(self) -> np.ndarray:
        """The scene as it is seen: (height, width, 3)."""
        import imageio.v3 as iio

        left, top, right, bottom = self.driver.execute_script(
            "const at = document.querySelector('canvas[data-engine]').getBoundingClientRect();"
            "return [at.left, at.top, at.right, at.bottom].map(Math.round)"
        )
        # The driver's own picture of an element scrolls the page to it.
        image: np.ndarray = iio.imread(io.BytesIO(self.driver.get_screenshot_as_png()))
        return image[top:bottom, left:right, :3].astype(int)

    def keep(self, name: str) -> None:
        """Save what is seen for the documentation, where `RTARM_PICTURES` names a folder."""
        if folder := os.environ.get("RTARM_PICTURES"):
            # The driver scrolls to what it presses.
            self.driver.execute_script("for (const e of document.querySelectorAll('*')) e.scrollLeft = e.scrollTop = 0")
            self.driver.save_screenshot(str(Path(folder, f"{name}.png")))

    def film(self, path: Path, going_on: Callable[[], bool], speed: float) -> None:
        """Save as a moving picture, at full speed, what is seen while something goes on at this factor of its speed."""
        from PIL import Image

        frames, times_ms = [], []
        while going_on():
            times_ms.append(time.monotonic() * 1000.0)
            picture = Image.open(io.BytesIO(self.driver.get_screenshot_as_png())).convert("RGB")
            frames.append(picture.resize(FILM_SIZE, Image.Resampling.LANCZOS))
        chosen = np.unique(np.linspace(0, len(frames) - 1, FILM_FRAMES).round().astype(int))
        durations = [*(np.diff(np.array(times_ms)[chosen]) * speed).round().astype(int).tolist(), FILM_REST_MS]
        first, *others = (frames[index] for index in chosen)
        first.save(path, save_all=True, append_images=others, duration=durations, loop=0, quality=60, method=6)

    def plotted(self, title: str) -> list[list[float]]:
        """The figures of a plot that is shown, a row a series, times first."""
        script = """for (const one of Object.values(window.__viserTestpoints.uplots)) {
            if (one.chart.root.querySelector('.u-title').textContent === arguments[0])
                return one.chart.data.map(row => [...row])
        } return []"""
        return list(self.driver.execute_script(script, title))

    def asked(self) -> Iterator[str]:
        """Every address that the page has asked for since the last call, that of its web socket included."""
        for entry in self.driver.get_log("performance"):
            message = json.loads(entry["message"])["message"]
            if message["method"] == "Network.requestWillBeSent":
                yield message["params"]["request"]["url"]
        for entry in self.driver.get_log("browser"):  # a worker has the web socket, and says where it connects to
            yield from re.findall(r"Connecting to: (\S+)", entry["message"])

    def _calm(self) -> None:
        """Have every page of this tab draw its scene no more often than a test needs it."""
        if CALM:
            self.driver.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": CALMER})

    def _rendered(self) -> bool:
        return bool(self._all("canvas[data-engine]"))

    def _all(self, selector: str) -> list[Any]:
        return list(self.driver.find_elements("css selector", selector))

    def _field(self, label: str) -> list[Any]:
        row = f"//label[normalize-space(.)='{label}']/ancestor::div[contains(@class,'Flex-root')][1]"
        return list(self.driver.find_elements("xpath", f"{row}//input[@type='text']"))


def host_of(url: str) -> str:
    """The host that an address names, "" for what is in the page itself (data:, blob:)."""
    return re.sub(r"^\[|\]$", "", urlsplit(url.removeprefix("blob:")).hostname or "")
