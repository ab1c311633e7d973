"""One simulated robot and one Chromium for all tests of the page."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Iterator

import pytest
from selenium.webdriver import Chrome, ChromeOptions
from selenium.webdriver.chrome.service import Service

from tests.peers.browser.operator import Operator
from tests.peers.browser.page import TestPage
from tests.peers.browser.robot import WebRobot
from tests.support.missing import BROWSER, DART, need


@pytest.fixture(scope="package")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[WebRobot]:
    for reason in (BROWSER, DART):
        need(reason)
    with contextlib.closing(WebRobot(tmp_path_factory.mktemp("web"))) as robot_:
        robot_.ready()
        yield robot_


@pytest.fixture(scope="package")
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
    """Return another page, which watches the robot."""
    with TestPage(robot.web) as page:
        page.watch("robot", "driving", "places", "topic:/cmd_vel", "topic:/odom")
        page.value("robot")
        yield page
