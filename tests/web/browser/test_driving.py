"""Driving from the page in a real Chromium: goals, pause, stop, manual driving, patrols."""

from __future__ import annotations

import math
import time

import pytest
from selenium.webdriver import ActionChains, Keys
from selenium.webdriver.common.by import By

from tests.peers.browser.operator import FREE, Operator, distance, moves, offset, stands, until
from tests.peers.browser.page import TestPage

SPOTS = (FREE, (7.5, 4.8), (3.0, 7.4))
"""Free points to drive to; at any time, at least one is near the robot."""
NEAR = 0.4
HANGING = 8.0
HANG = f"const end = Date.now() + {1000 * HANGING}; setTimeout(() => {{ while (Date.now() < end); }}, 0)"
"""A script that keeps all other scripts of the page from running for `HANGING` seconds."""


def spot_elsewhere(watch: TestPage) -> tuple[float, float]:
    """Return the nearest spot where the robot does not stand: a goal there would end before the page shows it."""
    return min(
        (point for point in SPOTS if offset(watch, *point) > 1.5 * NEAR), key=lambda point: offset(watch, *point)
    )


def test_a_press_on_the_map_sends_the_robot(operator: Operator, watch: TestPage) -> None:
    spot = spot_elsewhere(watch)
    canvas = operator.map_at(*spot)
    operator.button("Go here").click()
    ActionChains(operator.chrome).move_to_element(canvas).click().perform()
    watch.value("driving", lambda value: value["goal"] and distance(value["goal"], spot) < 0.1)
    watch.until(lambda: watch.values["driving"]["value"]["state"] == "goal_reached", "the robot arrives", 120)
    watch.until(lambda: offset(watch, *spot) < NEAR, "the robot is shown there")
    until(lambda: "arriv" in operator.chrome.find_element(By.ID, "driving").text.lower(), "the page shows the arrival")


def test_a_drag_sets_the_heading(operator: Operator, watch: TestPage) -> None:
    spot = spot_elsewhere(watch)
    canvas = operator.map_at(*spot)
    operator.button("Go here").click()
    ActionChains(operator.chrome).move_to_element(canvas).click_and_hold().move_by_offset(0, 80).release().perform()
    driving = watch.value("driving", lambda value: value["goal"] and abs(value["goal"]["theta"] + math.pi / 2) < 0.05)
    assert distance(driving["goal"], spot) < 0.1


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
def test_a_stop_during_a_drive_halts_the_robot(operator: Operator, watch: TestPage, how: str) -> None:
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
        "the computer was suspended",
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
            assert time.monotonic() - began < HANGING, "the robot stops while the page still hangs"
        elif how == "the computer was suspended":
            operator.chrome.execute_script("window.realNow = Date.now; Date.now = () => window.realNow() + 3600000;")
            watch.until(lambda: stands(watch), "the robot stands, since the button may have been released", 30)
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
        if how == "the computer was suspended":
            operator.chrome.execute_script("Date.now = window.realNow;")
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
def test_a_goal_is_set_with_the_keyboard(operator: Operator, watch: TestPage) -> None:
    spot = spot_elsewhere(watch)
    canvas = operator.map_at(*spot)
    operator.button("Go here").send_keys(Keys.ENTER)
    canvas.send_keys(Keys.ENTER)
    driving = watch.value("driving", lambda value: value["goal"] and distance(value["goal"], spot) < 0.1)
    assert driving["state"] not in ("idle", "goal_reached")


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
    until(lambda: f"{second} (2 of 2, round 1)" in turn.text, "the page shows the patrol's second place")
    operator.button("End drive").click()
    patrol = watch.value("patrol", lambda value: value and value["state"] == "ended")
    assert "stopped" in patrol["why"]
    until(
        lambda: "Patrol ended" in operator.chrome.find_element(By.CLASS_NAME, "turn").text,
        "the page shows the end of the patrol",
    )
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
        until(
            lambda: "driv" in operator.chrome.find_element(By.ID, "driving").text.lower(),
            "the first tab shows the drive",
        )
        operator.button("End drive").click()
        watch.until(lambda: stands(watch), "the robot stands", 30)
    finally:
        for handle in operator.chrome.window_handles:
            if handle != first:
                operator.chrome.switch_to.window(handle)
                operator.chrome.close()
        operator.chrome.switch_to.window(first)
