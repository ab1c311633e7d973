"""The page's map in a real Chromium: robots, layers, places, areas, flags, export and import."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from selenium.webdriver import ActionChains, Keys
from selenium.webdriver.common.by import By

from navigation.maps.grid_map import to_grid_map
from tests.peers.browser.operator import FREE, Operator, distance, until
from tests.peers.browser.page import TestPage
from tests.peers.browser.robot import WebRobot
from yarp_compat.dev.mapgrid import MapFlag


@pytest.mark.thorough
def test_another_robot_has_its_own_color(operator: Operator, watch: TestPage) -> None:
    watch.watch("robots")
    watch.call("goto_place", name="corridor")
    (porter,) = watch.value("robots", lambda robots: robots and robots[0]["pose"] and robots[0]["path"])
    assert porter["name"] == "porter"
    operator.map_at(porter["pose"]["x"], porter["pose"]["y"])
    until(lambda: operator.pixels("--robot-0") > 50, "the robot is drawn in its color")


def table_about(x: float, y: float) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return a layer with a table around x, y and a drop next to the table, and the heights of both."""
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
            """Return the tooltip at a number of pixels to the right of the middle."""
            ActionChains(operator.chrome).move_to_element_with_offset(canvas, dx, 0).perform()
            return tip.text

        until(lambda: over(0) == "hit at 0.74 m", "the height of the table is shown")
        tinted = operator.middle()
        assert over(28) == "a drop, or unknown height"
        assert over(80) == "", "a free cell has no tooltip"
        assert not tip.is_displayed()
        ActionChains(operator.chrome).move_to_element(canvas).click().perform()
        menu = operator.chrome.find_element(By.CSS_SELECTOR, ".pointmenu p")
        assert menu.text.endswith("hit at 0.74 m"), "touch users get the height from the menu"
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
        assert math.dist((place.x, place.y), FREE) < 0.1, "YARP clients see the place"
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
        assert np.count_nonzero(yarp.maps["apartment"].flags == MapFlag.KEEP_OUT) == painted, (
            "YARP clients see the painted cells"
        )
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
