"""The page in a real Chromium, with the simulated robot."""

from __future__ import annotations

import contextlib
import json
import math
import shutil
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from selenium.common.exceptions import StaleElementReferenceException
from selenium.webdriver import ActionChains, Chrome, ChromeOptions, Keys
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.by import By
from selenium.webdriver.remote.webelement import WebElement

from navigation.maps.grid_map import to_grid_map
from tests.peers.browser.page import TestPage
from tests.peers.browser.robot import WebRobot
from tests.support import wait
from tests.support.missing import BROWSER, DART, need
from tests.web import example_view
from tests.web.conftest import Desk
from yarp_compat.dev.mapgrid import MapFlag

FREE = (6.0, 4.8)
"""A place in the corridor."""
SPOTS = (FREE, (7.5, 4.8), (3.0, 7.4))
"""Free places to drive to, at least one of which is near the robot at any time."""
NEAR = 0.4
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
WINDOWS = ((1440, 760), (1536, 730), (1600, 789), (1440, 900), (1879, 1019), (1880, 920), (1920, 937), (2560, 1300))
"""Window sizes on common screens, and on both sides of the limits in the styles of the view Drive."""

until = partial(wait.until, every=0.2)
"""Interval between checks: each is a request to the browser, and one of its pixels is as costly as drawing them."""

HANGING = 8.0
HANG = f"const end = Date.now() + {1000 * HANGING}; setTimeout(() => {{ while (Date.now() < end); }}, 0)"
"""No script of the page runs for this many seconds."""


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[WebRobot]:
    for reason in (BROWSER, DART):
        need(reason)
    with contextlib.closing(WebRobot(tmp_path_factory.mktemp("web"))) as robot_:
        robot_.ready()
        yield robot_


@pytest.fixture(scope="module")
def chrome(robot: WebRobot, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Chrome]:
    options = ChromeOptions()
    profile = tmp_path_factory.mktemp("chrome")
    for argument in (
        "--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--disable-gpu", "--window-size=1280,800",
        f"--user-data-dir={profile}", "--disable-background-networking",
    ):  # fmt: skip
        options.add_argument(argument)
    options.binary_location = str(shutil.which("chromium"))
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = Chrome(options, Service(shutil.which("chromedriver")))
    try:
        driver.get(robot.address)
        yield driver
    finally:
        driver.quit()


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
        """Return the visible button with this text or name, within elements that match a selector."""

        def find() -> WebElement | None:
            for element in self.chrome.find_elements(By.CSS_SELECTOR, f"{within} button"):
                with contextlib.suppress(StaleElementReferenceException):  # the list has been filled again
                    if text in (element.text, element.accessible_name) and element.is_displayed():
                        return element
            return None

        shown = until(find, f"the button is shown:  {text!r}")
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
        """Return the texts of elements that may be filled again meanwhile."""
        script = "return [...document.querySelectorAll(arguments[0])].map((each) => each.textContent)"
        texts: list[str] = self.chrome.execute_script(script, selector)
        return texts

    def said(self) -> str:
        return " ".join(self.chrome.find_element(By.ID, name).text for name in ("said", "wrong"))

    def errors(self) -> list[str]:
        """Return the browser's errors: failed scripts and violations of the policy."""
        entries: list[dict[str, Any]] = self.chrome.get_log("browser")  # type: ignore[no-untyped-call]
        quiet = ("WebSocket connection", "ERR_CONNECTION_REFUSED")
        return [e["message"] for e in entries if e["level"] == "SEVERE" and not any(q in e["message"] for q in quiet)]


@pytest.fixture
def operator(chrome: Chrome, robot: WebRobot) -> Iterator[Operator]:
    person = Operator(chrome, robot)
    person.open("drive")
    person.choose("Send")
    yield person
    with TestPage(robot.web) as page:
        page.call("stop")
    assert person.errors() == []


@pytest.fixture
def watch(robot: WebRobot) -> Iterator[TestPage]:
    """Return another page that watches the robot."""
    with TestPage(robot.web) as page:
        page.watch("robot", "driving", "places", "topic:/cmd_vel", "topic:/odom")
        page.value("robot")
        yield page


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


def test_a_press_on_the_map_sends_the_robot(operator: Operator, watch: TestPage) -> None:
    spot = min(
        (point for point in SPOTS if offset(watch, *point) > 1.5 * NEAR), key=lambda point: offset(watch, *point)
    )
    canvas = operator.map_at(*spot)
    operator.button("Go here").click()
    ActionChains(operator.chrome).move_to_element(canvas).click().perform()
    watch.value("driving", lambda value: value["goal"] and distance(value["goal"], spot) < 0.1)
    watch.until(lambda: watch.values["driving"]["value"]["state"] == "goal_reached", "the robot arrives", 120)
    assert offset(watch, *spot) < NEAR
    until(lambda: "arriv" in operator.chrome.find_element(By.ID, "driving").text.lower(), "the page shows it")


@pytest.mark.thorough
def test_another_robot_has_its_own_color(operator: Operator, watch: TestPage) -> None:
    watch.watch("robots")
    watch.call("goto_place", name="corridor")
    (porter,) = watch.value("robots", lambda robots: robots and robots[0]["pose"] and robots[0]["path"])
    assert porter["name"] == "porter"
    operator.map_at(porter["pose"]["x"], porter["pose"]["y"])
    until(lambda: operator.pixels("--robot-0") > 50, "it is drawn in its color")


def table_about(x: float, y: float) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return a layer with a table around a place, and its heights; next to the table is a drop."""
    rows, columns, size = 20, 30, 0.05
    corner = (x - 0.5 * columns * size, y - 0.5 * rows * size)
    lowest = np.full((rows, columns), np.nan, np.float32)
    lowest[2:-2, 3:23] = 0.74
    blocked = ~np.isnan(lowest)
    blocked[2:-2, 25:] = True
    origin = {"position": {"x": corner[0], "y": corner[1]}, "orientation": {"w": 1.0}}
    info = {"resolution": size, "width": columns, "height": rows, "origin": origin}
    header = {"frame_id": "map"}
    heights = to_grid_map({"lowest": lowest}, corner, size, header)
    plain = {**heights, "data": [{**layer_, "data": layer_["data"].tolist()} for layer_ in heights["data"]]}
    return {"header": header, "info": info, "data": (100 * blocked).reshape(-1).tolist()}, plain


@pytest.mark.thorough
def test_the_layer_is_shown_as_a_tint_with_heights(operator: Operator, robot: WebRobot) -> None:
    far = robot.hub_program()
    try:
        layer, heights = table_about(*FREE)
        above = far.advertise("/mapper3d/layer_heights", "grid_map_msgs/GridMap", latched=True, depth=1)
        far.publish(above, heights)
        out = far.advertise("/mapper3d/layer", "nav_msgs/OccupancyGrid", latched=True, depth=1)
        far.publish(out, layer)
        canvas = operator.map_at(*FREE)
        tip = operator.chrome.find_element(By.CSS_SELECTOR, ".map .height")

        def over(dx: int) -> str:
            """Return the tip at a number of pixels to the right of the middle."""
            ActionChains(operator.chrome).move_to_element_with_offset(canvas, dx, 0).perform()
            return tip.text

        until(lambda: over(0) == "hit at 0.74 m", "the height of the table is shown")
        tinted = operator.middle()
        assert over(28) == "a drop, or unknown height"
        assert over(80) == "", "there is no obstacle"
        assert not tip.is_displayed()
        ActionChains(operator.chrome).move_to_element(canvas).click().perform()
        menu = operator.chrome.find_element(By.CSS_SELECTOR, ".pointmenu p")
        assert menu.text.endswith("hit at 0.74 m"), "touch users get it from the menu"
        operator.button("Layers").click()
        operator.button("3D layer").click()
        try:
            until(lambda: over(0) == "", "the layer is off")
            until(lambda: operator.middle() != tinted, "the tint is removed")
        finally:
            operator.button("3D layer").click()
        until(lambda: over(0) == "hit at 0.74 m", "the layer is on again")
    finally:
        far.hub.close()


def test_a_drag_sets_the_heading(operator: Operator, watch: TestPage) -> None:
    canvas = operator.map_at(*FREE)
    operator.button("Go here").click()
    ActionChains(operator.chrome).move_to_element(canvas).click_and_hold().move_by_offset(0, 80).release().perform()
    driving = watch.value("driving", lambda value: value["goal"] and abs(value["goal"]["theta"] + math.pi / 2) < 0.05)
    assert distance(driving["goal"], FREE) < 0.1


def test_a_pause_keeps_distance_and_path(operator: Operator, watch: TestPage) -> None:
    watch.watch("path")
    operator.button("bedroom" if offset(watch, 8.2, 7.4) > 2.0 else "kitchen", ".places-list").click()
    watch.until(lambda: moves(watch), "the robot drives", 60)
    watch.value("driving", lambda value: value["distance"])
    until(lambda: operator.pixels("--path") > 100, "the path is drawn")
    operator.button("Pause").click()
    driving = watch.value("driving", lambda value: value["state"] == "paused")
    watch.until(lambda: stands(watch), "the robot stands", 30)
    left = f"{driving['distance']:.1f} m"
    until(lambda: operator.texts(".doing .facts dd")[1] == left, "the panel shows the remaining distance")
    until(lambda: operator.chrome.find_element(By.ID, "driving").text == "Paused", "the page shows the pause")
    assert len(watch.values["path"]["value"]["points"]) >= 4
    operator.chrome.refresh()
    until(lambda: operator.pixels("--path") > 100, "a page that is loaded during the pause draws the path")
    operator.button("Resume").click()
    watch.until(lambda: moves(watch), "the robot continues", 60)


@pytest.mark.parametrize("how", ["button", "space"])
def test_stop_during_a_drive(operator: Operator, watch: TestPage, how: str) -> None:
    pose = watch.values["robot"]["value"]["pose"]
    place = max(
        watch.value("places")["locations"].items(),
        key=lambda item: math.dist((item[1]["x"], item[1]["y"]), (pose["x"], pose["y"])),
    )[0]
    operator.button(place).click()
    watch.until(lambda: moves(watch), "the robot drives", 60)
    operator.open("topics" if how == "button" else "drive")
    if how == "button":
        operator.button("STOP").click()
    else:
        operator.chrome.find_element(By.TAG_NAME, "body").send_keys(Keys.SPACE)
    watch.until(lambda: stands(watch), "the robot stands", 30)
    watch.value("driving", lambda value: value["state"] not in ("moving", "preparing_before_move"))


def drive_manually(operator: Operator, watch: TestPage) -> None:
    operator.choose("Manual")
    button = operator.button("Turn left")
    ActionChains(operator.chrome).click_and_hold(button).perform()
    watch.until(lambda: moves(watch), "the robot turns while the button is held", 30)


def test_manual_driving_lasts_while_the_button_is_held(operator: Operator, watch: TestPage) -> None:
    drive_manually(operator, watch)
    ActionChains(operator.chrome).release().perform()
    watch.until(lambda: stands(watch), "the robot stands after the release", 30)


@pytest.mark.parametrize(
    "how",
    [
        pytest.param("the page's script hangs", marks=pytest.mark.thorough),
        "the tab's socket is closed",
        pytest.param("the tab is hidden", marks=pytest.mark.thorough),
    ],
)
def test_manual_driving_stops_when_the_page_fails(operator: Operator, watch: TestPage, how: str) -> None:
    drive_manually(operator, watch)
    try:
        if how == "the page's script hangs":
            operator.chrome.execute_script(HANG)
            began = time.monotonic()
            watch.until(lambda: stands(watch), "the robot stands although the page is silent", 30)
            assert time.monotonic() - began < HANGING, "while the page still hangs"
        elif how == "the tab's socket is closed":
            operator.chrome.execute_cdp_cmd("Network.enable", {})
            operator.chrome.execute_cdp_cmd(
                "Network.emulateNetworkConditions",
                {"offline": True, "latency": 0, "downloadThroughput": 0, "uploadThroughput": 0},
            )
            watch.until(lambda: stands(watch), "the robot stands", 30)
        else:
            operator.chrome.switch_to.new_window("tab")
            watch.until(lambda: stands(watch), "the robot stands", 30)
    finally:
        if how == "the tab's socket is closed":
            operator.chrome.execute_cdp_cmd(
                "Network.emulateNetworkConditions",
                {"offline": False, "latency": 0, "downloadThroughput": -1, "uploadThroughput": -1},
            )
        if how == "the tab is hidden":
            operator.chrome.close()
            operator.chrome.switch_to.window(operator.chrome.window_handles[0])
        ActionChains(operator.chrome).release().perform()


@pytest.mark.thorough
def test_a_saved_place_is_visible_to_all(operator: Operator, watch: TestPage, robot: WebRobot) -> None:
    canvas = operator.map_at(*FREE)
    operator.button("Save place").click()
    ActionChains(operator.chrome).move_to_element(canvas).click().perform()
    name = until(lambda: operator.chrome.switch_to.active_element, "the name field is shown")
    name.send_keys("here be tea", Keys.ENTER)
    saved = watch.value("places", lambda value: "here be tea" in value["locations"])["locations"]["here be tea"]
    assert distance(saved, FREE) < 0.1
    assert "here be tea" in robot.command("location", "list").stdout
    with robot.yarp_maps() as yarp:
        place = yarp.locations["here be tea"]
        assert math.dist((place.x, place.y), FREE) < 0.1, "YARP clients see it"
    operator.open("places")
    operator.button("Delete here be tea").click()
    operator.button("Delete", "dialog").click()
    watch.value("places", lambda value: "here be tea" not in value["locations"])


@pytest.mark.thorough
def test_a_drawn_area_is_visible_to_all(operator: Operator, watch: TestPage, robot: WebRobot) -> None:
    canvas = operator.map_at(*FREE)
    operator.button("Edit map").click()
    chain = ActionChains(operator.chrome).move_to_element_with_offset(canvas, -40, -20)
    chain.click_and_hold().move_by_offset(80, 40).release().perform()
    name = until(lambda: operator.chrome.switch_to.active_element, "the name field is shown")
    name.send_keys("tea corner", Keys.ENTER)
    corners = watch.value("places", lambda value: "tea corner" in value["areas"])["areas"]["tea corner"]["points"]
    middle = (sum(x for x, _ in corners) / 4, sum(y for _, y in corners) / 4)
    assert math.dist(middle, FREE) < 0.1
    assert "tea corner" in robot.command("location", "list", "--kind", "area").stdout
    operator.button("Done").click()
    operator.open("places")
    operator.button("Rename tea corner").click()
    field = until(lambda: operator.chrome.switch_to.active_element, "the name field is shown")
    field.send_keys(Keys.CONTROL, "a", Keys.NULL, "coffee corner", Keys.ENTER)
    watch.value("places", lambda value: "coffee corner" in value["areas"] and "tea corner" not in value["areas"])
    operator.button("Delete coffee corner").click()
    operator.button("Delete", "dialog").click()
    watch.value("places", lambda value: "coffee corner" not in value["areas"])


@pytest.mark.thorough
def test_an_area_is_drawn_with_the_keyboard(operator: Operator, watch: TestPage) -> None:
    canvas = operator.map_at(*FREE)
    operator.button("Edit map").send_keys(Keys.ENTER)
    for key in (Keys.ARROW_RIGHT, Keys.ARROW_UP, Keys.ARROW_LEFT):
        canvas.send_keys(Keys.ENTER, key)
    canvas.send_keys(Keys.BACKSPACE, Keys.ENTER)
    operator.button("Finish").send_keys(Keys.ENTER)
    name = until(lambda: operator.chrome.switch_to.active_element, "the name field is shown")
    name.send_keys("by keys", Keys.ENTER)
    corners = watch.value("places", lambda value: "by keys" in value["areas"])["areas"]["by keys"]["points"]
    assert len(corners) == 3
    operator.button("Done").click()
    watch.call("delete_place", name="by keys", kind="area")


@pytest.mark.thorough
def test_a_map_is_exported_and_imported(operator: Operator, watch: TestPage, tmp_path: Path) -> None:
    watch.watch("maps")
    name = watch.value("maps")["current"]
    behavior = {"behavior": "allow", "downloadPath": str(tmp_path)}
    operator.chrome.execute_cdp_cmd("Page.setDownloadBehavior", behavior)
    operator.open("places")
    operator.button(f"Export the map {name}").click()
    packed = tmp_path / f"{name}.zip"
    until(packed.exists, "the zip is downloaded")
    operator.chrome.find_element(By.CSS_SELECTOR, "input[type=file]").send_keys(str(packed))
    field = until(
        lambda: operator.chrome.find_elements(By.CSS_SELECTOR, "dialog input"), "the dialog about replacing is shown"
    )[0]
    field.send_keys(Keys.CONTROL, "a", Keys.NULL, "copy", Keys.ENTER)
    watch.value("maps", lambda value: "copy" in value["names"])
    operator.button("Rename the map copy").send_keys(Keys.ENTER)
    field = until(lambda: operator.chrome.find_elements(By.CSS_SELECTOR, "dialog input"), "the name field is shown")[0]
    field.send_keys(Keys.CONTROL, "a", Keys.NULL, "spare", Keys.ENTER)
    maps = watch.value("maps", lambda value: "spare" in value["names"])
    assert maps == {"names": sorted([name, "spare"]), "current": name}


@pytest.mark.thorough
def test_a_goal_is_set_with_the_keyboard(operator: Operator, watch: TestPage) -> None:
    canvas = operator.map_at(*FREE)
    operator.button("Go here").send_keys(Keys.ENTER)
    canvas.send_keys(Keys.ENTER)
    driving = watch.value("driving", lambda value: value["goal"] and distance(value["goal"], FREE) < 0.1)
    assert driving["state"] not in ("idle", "goal_reached")


def keep_out_cells(robot: WebRobot) -> int:
    """Return the number of keep-out cells of the current map."""
    shown: dict[str, int] = next(
        row for row in json.loads(robot.command("map", "list", "--json").stdout) if row["current"]
    )["flags"]
    return shown.get("keep_out", 0)


@pytest.mark.thorough
def test_flags_are_painted_and_undone(operator: Operator, watch: TestPage, robot: WebRobot) -> None:
    watch.watch("map")
    clean = watch.value("map")["flags"]
    canvas = operator.map_at(*FREE)
    operator.button("Edit map").click()
    operator.button("Paint").click()
    chain = ActionChains(operator.chrome).move_to_element_with_offset(canvas, -30, 0)
    chain.click_and_hold().move_by_offset(30, 0).move_by_offset(30, 0).release().perform()
    watch.value("map", lambda value: value["flags"] != clean)
    painted = keep_out_cells(robot)
    assert painted > 10
    with robot.yarp_maps() as yarp:
        assert np.count_nonzero(yarp.maps["apartment"].flags == MapFlag.KEEP_OUT) == painted, "YARP clients see it"
    operator.button("Undo").click()
    watch.value("map", lambda value: value["flags"] == clean)
    until(lambda: operator.button("Redo").is_enabled(), "redo is possible")
    canvas.send_keys(Keys.CONTROL, "y")
    watch.value("map", lambda value: value["flags"] != clean)
    assert keep_out_cells(robot) == painted
    until(lambda: operator.button("Undo").is_enabled(), "undo is possible again")
    canvas.send_keys(Keys.CONTROL, "z")
    watch.value("map", lambda value: value["flags"] == clean)
    operator.button("Done").click()


@pytest.mark.thorough
def test_a_patrol_runs_until_it_is_ended(operator: Operator, watch: TestPage) -> None:
    watch.watch("patrol")
    places = watch.value("places")["locations"]
    first = min(places, key=lambda name: offset(watch, places[name]["x"], places[name]["y"]))
    second = "dock" if first != "dock" else "corridor"
    operator.button("Patrol …").click()
    for name in (first, second):
        operator.button(name, ".places-list").click()
    operator.button("Start patrol").click()
    watch.until(
        lambda: (watch.values.get("patrol", {}).get("value") or {}).get("at") == 1,
        "the robot drives to the second place",
        90,
    )
    turn = operator.chrome.find_element(By.CLASS_NAME, "turn")
    until(lambda: f"{second} (2 of 2, round 1)" in turn.text, "the page shows it")
    operator.button("End drive").click()
    patrol = watch.value("patrol", lambda value: value and value["state"] == "ended")
    assert "stopped" in patrol["why"]
    until(lambda: "Patrol ended" in operator.chrome.find_element(By.CLASS_NAME, "turn").text, "the page shows it")
    watch.until(lambda: stands(watch), "the robot stands", 30)


@pytest.mark.thorough
def test_two_tabs_show_the_same_state(operator: Operator, watch: TestPage) -> None:
    first = operator.chrome.current_window_handle
    operator.chrome.switch_to.new_window("tab")
    try:
        operator.open("drive")
        operator.button("kitchen").click()
        watch.until(lambda: moves(watch), "the robot drives", 60)
        operator.chrome.switch_to.window(first)
        until(lambda: "driv" in operator.chrome.find_element(By.ID, "driving").text.lower(), "the first tab shows it")
        operator.button("End drive").click()
        watch.until(lambda: stands(watch), "the robot stands", 30)
    finally:
        for handle in operator.chrome.window_handles:
            if handle != first:
                operator.chrome.switch_to.window(handle)
                operator.chrome.close()
        operator.chrome.switch_to.window(first)


_LESS = ("places", "topics", "frames", "system")


@pytest.mark.parametrize("width", [360, pytest.param(2560, marks=pytest.mark.thorough)])
@pytest.mark.parametrize(
    "view", ["drive", "status", *(pytest.param(view, marks=pytest.mark.thorough) for view in _LESS)]
)
def test_every_view_fits_the_window(operator: Operator, view: str, width: int) -> None:
    chrome = operator.chrome
    with viewport(chrome, width, 780):
        operator.open(view)
        wide = chrome.execute_script("return [document.documentElement.scrollWidth, innerWidth]")
        assert wide[0] <= wide[1], "nothing extends beyond the side"
        stop = chrome.find_element(By.ID, "stop")
        assert stop.is_displayed(), "STOP is visible"
        assert stop.location["x"] + stop.size["width"] <= width


SENDING = """
const list = document.querySelector(".places-list"), panel = document.querySelector(".panel");
if (!list || !panel) return {};  // not rendered yet
const [above, outer] = [list, panel].map((each) => each.getBoundingClientRect());
const [top, bottom] = [Math.max(above.top, outer.top), Math.min(above.bottom, outer.bottom)];
const boxes = [...list.querySelectorAll("button")].map((each) => each.getBoundingClientRect());
return {
  visible: boxes.filter((box) => box.height >= 40 && box.top >= top && box.bottom <= bottom).length,
  places: boxes.length, list: list.clientHeight, panel: panel.clientHeight, content: panel.scrollHeight,
};
"""


@contextlib.contextmanager
def viewport(chrome: Chrome, width: int, height: int) -> Iterator[None]:
    """Give the page this size in pixels; narrow ones emulate a phone."""
    size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 500}
    chrome.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    try:
        yield
    finally:
        chrome.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


@pytest.fixture
def places(watch: TestPage) -> Iterator[Callable[[int], None]]:
    """Set the number of places on the map; those added are deleted after the test."""
    added: list[str] = []

    def set_number(wanted: int) -> None:
        for number in range(wanted - len(watch.value("places")["locations"])):
            added.append(f"added_{number}")
            assert watch.call("keep_place", name=added[-1], x=FREE[0], y=FREE[1], theta=0.0)["ok"]

    yield set_number
    for name in added:
        watch.call("delete_place", name=name, kind="location")


@pytest.mark.parametrize(
    ("width", "height"),
    [(1366, 625), (1280, 757), *(pytest.param(*size, marks=pytest.mark.thorough) for size in WINDOWS)],
)
def test_the_goal_places_are_visible(
    operator: Operator, places: Callable[[int], None], width: int, height: int
) -> None:
    chrome = operator.chrome
    places(9)
    with viewport(chrome, width, height):
        operator.open("drive")
        operator.choose("Send")
        until(lambda: len(operator.texts(".places-list button")) == 9, "nine places are listed")
        until(lambda: chrome.execute_script(SENDING).get("visible") == 9, "nine places are visible")
        nine = chrome.execute_script(SENDING)
        assert nine["content"] <= nine["panel"], "the panel does not scroll"
        assert operator.button("End drive").is_displayed()
        operator.choose("Manual")
        assert operator.button("Turn left").is_displayed()
        panel = chrome.execute_script(SENDING)
        assert panel["content"] <= panel["panel"], "nor does it with the controls for manual driving"


@pytest.mark.thorough
def test_an_ended_patrol_covers_no_place(operator: Operator, places: Callable[[int], None], watch: TestPage) -> None:
    places(9)
    names = list(watch.value("places")["locations"])[:2]
    watch.watch("patrol")
    assert watch.call("patrol", places=names, wait=2)["ok"]
    watch.value("patrol", lambda value: value and value["state"] == "drives")
    assert watch.call("stop")["ok"]
    watch.value("patrol", lambda value: value and value["state"] == "ended")
    with viewport(operator.chrome, 1366, 625):
        operator.open("drive")
        operator.choose("Send")
        until(lambda: len(operator.texts(".places-list button")) == 9, "nine places are listed")
        until(lambda: operator.chrome.execute_script(SENDING).get("visible") == 9, "nine places are visible")


@pytest.mark.thorough
def test_many_places_scroll_in_their_list_only(operator: Operator, places: Callable[[int], None]) -> None:
    places(30)
    with viewport(operator.chrome, 1366, 625):
        operator.open("drive")
        operator.choose("Send")
        until(lambda: len(operator.texts(".places-list button")) == 30, "all places are listed")
        many = operator.chrome.execute_script(SENDING)
    assert many["content"] <= many["panel"]
    assert many["visible"] >= 8


ENDPOINTS = """
const { default: statusView } = await import("./views/status/view.js");
const [root, own] = [document.createElement("div"), { watch: (_, show) => ((own.show = show), () => {}), call() {} }];
document.body.append(root);
statusView(root, own).show();
const shown = (endpoints) => {
  own.show({ workers: [], machines: [], endpoints, routes: [], refused: [] });
  const block = root.querySelector(".endpoints");
  return block.hidden ? null : block.innerText;
};
const [name, why] = [{ daemon: "robot1", machine: "", since: 1.7e9 }, { reason: "another authority", cure: "copy it" }];
const good = { ...name, way: "listen", endpoint: "tls/0.0.0.0:7448", state: "listening", reason: "", cure: "" };
const bad = { ...name, way: "connect", endpoint: "tls/base:7448", state: "refused", ...why };
const result = [shown([good]), shown([good, bad]), shown([good])];
root.remove();
return result;
"""


def test_a_failing_endpoint_is_shown(operator: Operator) -> None:
    operator.open("status")
    before, failing, after = operator.chrome.execute_script(f"return (async () => {{{ENDPOINTS}}})()")
    assert before is after is None
    assert "tls/base:7448 refused since " in failing
    assert "(hub.open.connect of robot1)" in failing
    assert "another authority" in failing
    assert "copy it" in failing
    assert "7448 listening" not in failing


def test_the_view_of_the_documentation_is_shown(
    chrome: Chrome, desk: Desk, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    example_view.add(tmp_path / "copy", monkeypatch)
    desk.open_with()
    charge = desk.far.advertise("/battery_state", "sensor_msgs/BatteryState", latched=True, depth=1)
    desk.far.publish(charge, {"percentage": 0.25})
    chrome.get(f"http://127.0.0.1:{desk.port}/#battery")
    until(lambda: [each.text for each in chrome.find_elements(By.ID, "charge")] == ["25 %"], "the charge is shown")
    assert chrome.find_element(By.CSS_SELECTOR, '#tabs [aria-current="page"]').text == "Battery"


def test_status_and_frames_show_the_deployment(operator: Operator) -> None:
    chrome = operator.chrome
    operator.open("status")
    until(lambda: {"web-test", "YARP"} <= set(operator.texts(".graph .name")), "daemon and side are drawn")
    chrome.find_element(By.CSS_SELECTOR, ".asking input").send_keys("/cmd_vel", Keys.ENTER)
    until(lambda: operator.texts(".refused .crossing li"), "the decision is shown", 30)
    until(lambda: "0" in operator.texts(".workers td:last-child"), "the restarts of each worker are shown")
    operator.open("frames")
    script = "return [...document.querySelectorAll('.framepose select')].map((each) => each.value)"
    until(lambda: chrome.execute_script(script) == ["base_link", "map"], "the robot on the map is chosen")
    until(lambda: any(text.endswith(" m") for text in operator.texts(".framepose dd")), "the pose is shown")


TWO_FEEDS = """
const done = arguments[1];
import("./lib/socket.js").then(({ Socket }) => {
  const socket = new Socket(arguments[0]), received = [];
  let end = () => {};
  socket.watch("first", (value) => { received.push(value); end(); });
  end = socket.watch("second", (value) => received.push(value));
  socket.watch("third", (value) => received.push(value));
  const put = (name, value) => socket.keep({ feed: name, n: value, value });
  put("first", 1), put("second", 2), put("third", 3);
  requestAnimationFrame(() => { put("first", 4); requestAnimationFrame(() => done(received)); });
});
"""


def test_a_feed_that_ends_during_drawing_does_not_block_others(operator: Operator) -> None:
    """Like received transforms that make the page watch another pose."""
    address = operator.robot.address.replace("http", "ws", 1).rstrip("/") + "/socket"
    try:
        assert operator.chrome.execute_async_script(TWO_FEEDS, address) == [1, 3, 4]
    finally:
        operator.chrome.refresh()  # that socket would reconnect


@pytest.mark.thorough
def test_the_system_view_shows_log_configuration_and_doctor(operator: Operator, robot: WebRobot) -> None:
    chrome = operator.chrome
    operator.open("system")
    field = chrome.find_element(By.CSS_SELECTOR, ".logs input")
    field.send_keys("the console is at")
    expected = [f"the console is at {robot.address}"]
    until(lambda: operator.texts(".log .text") == expected, "the matching log lines are shown")
    operator.open("system/config")
    until(lambda: "No problem" in chrome.find_element(By.CSS_SELECTOR, ".verdict").text, "the configuration is checked")
    assert "name: web-test" in operator.texts(".config li")
    operator.open("system/doctor")
    operator.button("Run checks").click()
    until(lambda: chrome.find_elements(By.CSS_SELECTOR, ".findings li"), "the doctor's findings are shown", 60)


@pytest.mark.thorough
def test_a_message_and_a_call_from_a_form(operator: Operator, watch: TestPage) -> None:
    chrome = operator.chrome
    operator.open("topics/%2Fbattery_state")
    operator.button("Publish …").click()
    number = until(lambda: chrome.find_elements(By.CSS_SELECTOR, ".sending input"), "the form is shown")[0]
    number.clear()
    number.send_keys("3.5", Keys.ENTER)
    until(
        lambda: operator.texts(".form-wrong")[0].startswith("header.stamp.sec must be an integer from -2147483648"),
        "the error is shown before anything is sent",
    )
    number.clear()
    number.send_keys("3")
    voltage = chrome.find_elements(By.CSS_SELECTOR, ".sending input")[3]
    for text, limits in (("1e999", "must be between -1.8e308 and 1.8e308"), ("high", "must be a number")):
        voltage.clear()
        voltage.send_keys(text, Keys.ENTER)
        error = f"voltage {limits}, not “{text}”"
        until(lambda error=error: any(error in text_ for text_ in operator.texts(".form-wrong")), "the error is shown")
    voltage.clear()
    voltage.send_keys("12.5", Keys.ENTER)
    until(lambda: "published on /battery_state" in operator.texts(".told"), "it is published")
    operator.open("topics/service:%2Fsim%2Femergency_stop@std_srvs%2Fsrv%2FSetBool")
    form = until(
        lambda: chrome.find_elements(By.CSS_SELECTOR, "[aria-label=Service] .sending select"), "the form is shown"
    )
    assert form[0].is_displayed()
    operator.button("Call").click()
    until(lambda: "success" in operator.texts("[aria-label=Service] .message .key"), "the reply is shown as a tree", 30)


@pytest.mark.thorough
def test_the_page_reconnects_after_a_restart_of_the_daemon(operator: Operator, robot: WebRobot) -> None:
    robot.kill_daemon_and_start_again()
    until(lambda: operator.line() != "Connected", "the page shows the lost connection")
    until(lambda: operator.line() == "Connected", "the page reconnects automatically", 60)
    robot.ready()
    assert robot.command("web").stdout.strip() == robot.address
