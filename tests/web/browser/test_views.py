"""The page's views in a real Chromium: layout, status, frames, system, topics, and reconnecting."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from selenium.webdriver import Chrome, Keys
from selenium.webdriver.common.by import By

from tests.peers.browser.operator import FREE, Operator, until, viewport
from tests.peers.browser.page import TestPage
from tests.peers.browser.robot import WebRobot
from tests.web import example_view
from tests.web.conftest import Desk

WINDOWS = ((1440, 760), (1536, 730), (1600, 789), (1440, 900), (1879, 1019), (1880, 920), (1920, 937), (2560, 1300))
"""Window sizes on common screens, and just above and below the breakpoints in the Drive view's styles."""
_MAIN, _LESS = ("drive", "status"), ("places", "topics", "frames", "system")


@pytest.mark.parametrize(
    ("width", "views"),
    [
        (360, _MAIN),
        pytest.param(360, _LESS, marks=pytest.mark.thorough),
        pytest.param(2560, (*_MAIN, *_LESS), marks=pytest.mark.thorough),
    ],
)
def test_every_view_fits_the_window(operator: Operator, width: int, views: tuple[str, ...]) -> None:
    chrome = operator.chrome
    with viewport(chrome, width, 780):
        for view in views:
            operator.open(view)
            wide = chrome.execute_script("return [document.documentElement.scrollWidth, innerWidth]")
            assert wide[0] <= wide[1], f"nothing extends beyond the right side of {view}"
            stop = chrome.find_element(By.ID, "stop")
            assert stop.is_displayed(), f"STOP is visible in {view}"
            assert stop.location["x"] + stop.size["width"] <= width, view


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


@pytest.fixture
def places(watch: TestPage) -> Iterator[Callable[[int], None]]:
    """Set the number of places on the map; added places are deleted after the test."""
    added: list[str] = []

    def set_number(wanted: int) -> None:
        for number in range(wanted - len(watch.value("places")["locations"])):
            added.append(f"added_{number}")
            assert watch.call("keep_place", name=added[-1], x=FREE[0], y=FREE[1], theta=0.0)["ok"]

    yield set_number
    for name in added:
        watch.call("delete_place", name=name, kind="location")
    # wait for the feed's next value, which may arrive after the reply, and which the next test would count
    watch.value("places", lambda value: not set(added) & set(value["locations"]), "the places are deleted")


@pytest.mark.parametrize(
    "sizes", [((1366, 625), (1280, 757)), pytest.param(WINDOWS, marks=pytest.mark.thorough)], ids=["small", "other"]
)
def test_the_goal_places_are_visible(
    operator: Operator, places: Callable[[int], None], sizes: tuple[tuple[int, int], ...]
) -> None:
    places(9)
    for width, height in sizes:
        with viewport(operator.chrome, width, height):
            assert_places_are_visible(operator, f"in {width}x{height}")


def assert_places_are_visible(operator: Operator, where: str) -> None:
    """Check that nine places and all controls are visible without scrolling."""
    chrome = operator.chrome
    operator.choose("Send")
    until(lambda: len(operator.texts(".places-list button")) == 9, f"nine places are listed {where}")
    until(lambda: chrome.execute_script(SENDING).get("visible") == 9, f"nine places are visible {where}")
    nine = chrome.execute_script(SENDING)
    assert nine["content"] <= nine["panel"], f"the panel does not scroll {where}"
    assert operator.button("End drive").is_displayed()
    operator.choose("Manual")
    assert operator.button("Turn left").is_displayed()
    panel = chrome.execute_script(SENDING)
    assert panel["content"] <= panel["panel"], (
        f"with the controls for manual driving, the panel does not scroll either {where}"
    )


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


EXPLAINED = """
const done = arguments[0], users = ["served by /a on Fast DDS 2 (Jazzy)"];
const decision = { daemon: "", side: "ros2", decision: "bridged", why: "", cure: "", users };
import("./lib/cure.js").then(({ explained }) => done(explained("/x", [decision]).map((item) => item.textContent)));
"""
"""Returns the text that the page shows for a decision with nodes of its side."""


def test_status_and_frames_show_the_deployment(operator: Operator) -> None:
    chrome = operator.chrome
    operator.open("status")
    until(lambda: {"web-test", "YARP"} <= set(operator.texts(".graph .name")), "daemon and side are drawn")
    chrome.find_element(By.CSS_SELECTOR, ".asking input").send_keys("/cmd_vel", Keys.ENTER)
    until(lambda: operator.texts(".refused .crossing li"), "the decision is shown", 30)
    assert chrome.execute_async_script(EXPLAINED) == ["ros2 bridgedserved by /a on Fast DDS 2 (Jazzy)"]
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
    """A feed ends, for example, if received transforms make the page watch another pose."""
    address = operator.robot.address.replace("http", "ws", 1).rstrip("/") + "/socket"
    try:
        assert operator.chrome.execute_async_script(TWO_FEEDS, address) == [1, 3, 4]
    finally:
        operator.chrome.refresh()  # the script's socket would reconnect


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
def test_forms_publish_a_message_and_call_a_service(operator: Operator, watch: TestPage) -> None:
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
    until(lambda: "published on /battery_state" in operator.texts(".outcome"), "the message is published")
    operator.open("topics/service:%2Fsim%2Femergency_stop@std_srvs%2Fsrv%2FSetBool")
    form = until(
        lambda: chrome.find_elements(By.CSS_SELECTOR, "[aria-label=Service] .sending select"), "the form is shown"
    )
    assert form[0].is_displayed()
    operator.button("Call").click()
    until(lambda: "success" in operator.texts("[aria-label=Service] .message .key"), "the reply is shown as a tree", 30)


@pytest.mark.thorough
def test_the_page_reconnects_after_a_restart_of_the_daemon(operator: Operator, robot: WebRobot) -> None:
    robot.kill_daemon()
    until(lambda: operator.line() != "Connected", "the page shows the lost connection")
    robot.run()
    until(lambda: operator.line() == "Connected", "the page reconnects automatically", 60)
    robot.ready()
    assert robot.command("web").stdout.strip() == robot.address
