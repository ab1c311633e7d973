"""A person who uses the console's page in a real Chromium, and the robot's reaction."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator
from functools import partial
from typing import Any, cast

from selenium.common.exceptions import StaleElementReferenceException
from selenium.webdriver import Chrome
from selenium.webdriver.common.by import By
from selenium.webdriver.remote.webelement import WebElement

from tests.peers.browser.page import TestPage
from tests.peers.browser.robot import WebRobot
from tests.support import wait

FREE = (6.0, 4.8)
"""A place in the corridor."""
PIXELS = """
const canvas = document.querySelector("canvas");
const [color] = getComputedStyle(document.documentElement).getPropertyValue(arguments[0]).match(/[0-9a-f]{6}/);
const [r, g, b] = [0, 2, 4].map((at) => parseInt(color.slice(at, at + 2), 16));
const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
let count = 0;
for (let i = 0; i < data.length; i += 4) count += data[i] === r && data[i + 1] === g && data[i + 2] === b;
return count;
"""
MIDDLE = """
const canvas = document.querySelector("canvas");
const [x, y] = [canvas.width / 2, canvas.height / 2 - 10 * devicePixelRatio];
return [...canvas.getContext("2d").getImageData(x, y, 1, 1).data];
"""
BUTTONS = """
const [selector, text] = arguments;
return [...document.querySelectorAll(selector)].filter((button) => {
  const names = [button.textContent, button.innerText, button.ariaLabel, button.title];
  return button.checkVisibility() && names.some((name) => (name ?? "").trim() === text);
});
"""
"""Finds, in one request, the buttons that may have a text or name; a page has dozens of buttons."""
until = partial(wait.until, every=0.2)
"""Checks rarely, because each check is a request to the browser, and reading pixels costs as much as drawing them."""


class Operator:
    """A person who uses the page."""

    def __init__(self, chrome: Chrome, robot: WebRobot) -> None:
        self.chrome, self.robot = chrome, robot

    def open(self, view: str) -> None:
        self.chrome.get(f"{self.robot.address}#{view}")
        until(lambda: self.line() == "Connected", "the page is connected")

    def line(self) -> str:
        return self.chrome.find_element(By.ID, "line-text").text

    def button(self, text: str, within: str = "") -> WebElement:
        """Return the visible button with this text or name, within elements that match the selector ``within``."""

        def find() -> WebElement | None:
            for element in self.chrome.execute_script(BUTTONS, f"{within} button", text):
                with contextlib.suppress(StaleElementReferenceException):  # the list has been filled again
                    if text in (element.text, element.accessible_name) and element.is_displayed():
                        return cast("WebElement", element)
            return None

        shown = until(find, f"the button is shown: {text!r}")
        assert shown is not None
        return shown

    def choose(self, part: str) -> None:
        """Show a part of the panel, Send or Manual, if the window is too low for both."""
        if self.chrome.find_element(By.CSS_SELECTOR, ".panel .parts").is_displayed():
            self.button(part, ".panel .parts").click()

    def map_at(self, x: float, y: float) -> WebElement:
        """Return the map, centered on a place."""
        self.open(f"drive/{x},{y}")
        canvas = self.chrome.find_element(By.TAG_NAME, "canvas")
        until(lambda: canvas.is_displayed() and canvas.size["width"] > 100, "the map is shown")
        return canvas

    def pixels(self, color: str) -> int:
        """Return the number of pixels of the map in a color of the style."""
        count: int = self.chrome.execute_script(PIXELS, color)
        return count

    def middle(self) -> list[int]:
        """Return the color slightly above the center of the map."""
        color: list[int] = self.chrome.execute_script(MIDDLE)
        return color

    def texts(self, selector: str) -> list[str]:
        """Return the texts of elements that the page may refill meanwhile."""
        script = "return [...document.querySelectorAll(arguments[0])].map((each) => each.textContent)"
        texts: list[str] = self.chrome.execute_script(script, selector)
        return texts

    def messages(self) -> str:
        return " ".join(self.chrome.find_element(By.ID, name).text for name in ("notices", "wrong"))

    def errors(self) -> list[str]:
        """Return the browser's errors: failed scripts and violations of the policy."""
        entries: list[dict[str, Any]] = self.chrome.get_log("browser")  # type: ignore[no-untyped-call]
        quiet = ("WebSocket connection", "ERR_CONNECTION_REFUSED")
        return [e["message"] for e in entries if e["level"] == "SEVERE" and not any(q in e["message"] for q in quiet)]


def stands(page: TestPage) -> bool:
    twist = page.values.get("topic:/odom", {}).get("value")
    if not twist:
        return False
    speed = twist["message"]["twist"]["twist"]
    return abs(speed["linear"]["x"]) < 0.01 and abs(speed["angular"]["z"]) < 0.01


def moves(page: TestPage) -> bool:
    return bool(page.values.get("topic:/odom", {}).get("value")) and not stands(page)


def distance(place: dict[str, float], spot: tuple[float, float]) -> float:
    return math.dist((place["x"], place["y"]), spot)


def offset(page: TestPage, x: float, y: float) -> float:
    return distance(page.values["robot"]["value"]["pose"], (x, y))


@contextlib.contextmanager
def viewport(chrome: Chrome, width: int, height: int) -> Iterator[None]:
    """Give the page this size in pixels; a narrow page emulates a phone."""
    size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 500}
    chrome.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    try:
        yield
    finally:
        chrome.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
