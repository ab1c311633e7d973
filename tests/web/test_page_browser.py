"""The page in a real Chromium, with a console that has no robot."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from typing import Any

import pytest
from selenium.webdriver import Chrome, ChromeOptions
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.by import By

from bridge.stores.kinds import LOCATION
from bridge.stores.store import Store, Write
from tests.peers.browser.page import TestPage
from tests.support.missing import BROWSER, need
from tests.support.wait import until
from tests.web.conftest import Desk
from yarp_compat.dev.locations import Map2DLocation

GRID = {
    "header": {"frame_id": "map"},
    "info": {"resolution": 0.5, "width": 4, "height": 2, "origin": {"orientation": {"w": 1.0}}},
    "data": [0] * 8,
}
LINE = {"n": 1, "time": 0.0, "level": "info", "worker": "daemon", "text": "the first line"}
OFFLINE = """
window.dispatchEvent(new Event("offline"));
const level = document.querySelector("#system select");
level.value = "error";
level.dispatchEvent(new Event("change"));
"""
UNDO = """
const { PaintEditor } = await import("./views/drive/paint.js");
const map = { name: "house", width: 4, height: 4, resolution: 1, origin: { x: 0, y: 0, theta: 0 } };
const block = { values: { map }, view: {}, layers: { on: () => true }, redraw() {} };
let open = true;
const socket = { async call() {
  if (!open) throw new Error("No connection");
  return { undo: [[0, 0, 1, 0, 1]] };
} };
const editor = new PaintEditor(block, socket);
const settled = () => new Promise((go) => setTimeout(go, 20));
editor.paint({ points: [[0.5, 0.5]], radius: 0, flag: 1 });
await settled();
open = false;
editor.undoButton.click();
await settled();
const failed = [editor.undos.length, editor.redos.length];
open = true;
editor.undoButton.click();
await settled();
return [...failed, editor.undos.length, editor.redos.length];
"""


@pytest.fixture(scope="module")
def chrome(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Chrome]:
    need(BROWSER)
    options = ChromeOptions()
    for argument in (
        "--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--disable-gpu", "--window-size=1280,800",
        f"--user-data-dir={tmp_path_factory.mktemp('chrome')}", "--disable-background-networking",
    ):  # fmt: skip
        options.add_argument(argument)
    options.binary_location = str(shutil.which("chromium"))
    driver = Chrome(options, Service(shutil.which("chromedriver")))
    driver.set_script_timeout(10)
    driver.set_page_load_timeout(20)
    yield driver
    driver.quit()


def text(chrome: Chrome, selector: str) -> str:
    return chrome.find_element(By.CSS_SELECTOR, selector).text


def test_the_log_can_be_filtered_without_a_connection(
    desk: Desk, chrome: Chrome, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The page stays usable: it tries again with the feed's next value, not at once."""
    lines = [LINE]

    def ask_log(_config: Any, after: int) -> dict[str, Any]:
        return {"last": lines[-1]["n"], "lines": [line for line in lines if line["n"] > after]}

    monkeypatch.setattr("bridge.web.sources.log.ask_log", ask_log)
    chrome.get(f"http://127.0.0.1:{desk.port}/#system/log")
    until(lambda: "the first line" in text(chrome, "#system"), "the log is shown")
    chrome.execute_script(OFFLINE)
    assert "the first line" not in text(chrome, "#system")
    lines.append({**LINE, "n": 2, "level": "error", "text": "the second line"})
    until(lambda: "the second line" in text(chrome, "#system"), "the log is shown again")


@pytest.mark.parametrize("of", ["", "map"])
def test_places_are_shown_on_the_map_of_a_topic(desk: Desk, store: Store, chrome: Chrome, of: str) -> None:
    """Without a current map in the store, a place has no map, or the name of the frame; see `StoredPlaces.location`."""
    desk.open_with(navigation={"planner": "nav2", "map": "/map"})
    desk.far.publish(desk.far.advertise("/map", "nav_msgs/OccupancyGrid", latched=True, depth=1), GRID)
    store.write([Write(LOCATION, "kitchen", Map2DLocation(of, 1.0, 0.5))])
    chrome.get(f"http://127.0.0.1:{desk.port}/#drive")
    with TestPage(desk.port) as page:
        page.watch("map", "places")
        page.value("map")
        page.value("places", lambda value: value and value["locations"])
    until(lambda: text(chrome, "#drive .hint") == "", "the map is shown", every=0.2)
    until(lambda: text(chrome, ".send .places-list") == "kitchen", "the place is offered", every=0.2)


def test_a_failed_undo_can_be_tried_again(desk: Desk, chrome: Chrome) -> None:
    chrome.get(f"http://127.0.0.1:{desk.port}/#status")
    assert chrome.execute_script(UNDO) == [1, 0, 0, 1]
