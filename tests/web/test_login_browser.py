"""A browser on another machine: the login, and a page that may only watch."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from selenium.webdriver import Chrome, ChromeOptions, Keys
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.by import By

from tests.peers.browser.page import TestPage
from tests.peers.browser.proxy import WEB, Proxy
from tests.support.missing import BROWSER, need
from tests.support.wait import until
from tests.web.test_access import DRIVE, WATCH, GuardedDesk


@pytest.fixture
def guarded(tmp_path: Path) -> Iterator[GuardedDesk]:
    need(BROWSER)
    desk = GuardedDesk(tmp_path, tmp_path / "keys")
    yield desk
    desk.close()


@pytest.fixture
def chrome(tmp_path: Path) -> Iterator[Chrome]:
    options = ChromeOptions()
    for argument in (
        "--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--disable-gpu", "--window-size=360,740",
        f"--user-data-dir={tmp_path / 'chrome'}", "--disable-background-networking", "--ignore-certificate-errors",
    ):  # fmt: skip
        options.add_argument(argument)
    options.binary_location = str(shutil.which("chromium"))
    driver = Chrome(options, Service(shutil.which("chromedriver")))
    yield driver
    driver.quit()


def text(chrome: Chrome, name: str) -> str:
    return chrome.find_element(By.ID, name).text


def log_in(chrome: Chrome, token: str) -> None:
    chrome.find_element(By.ID, "token").clear()
    chrome.find_element(By.ID, "token").send_keys(token + Keys.ENTER)


def test_a_client_logs_in_and_watches(guarded: GuardedDesk, chrome: Chrome, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bridge.web.serving.access.FIRST_WAIT", 0.01)
    address = f"https://127.0.0.1:{guarded.port}/"
    chrome.get(address)
    assert chrome.current_url == f"{address}login"
    log_in(chrome, "wrong")
    until(lambda: text(chrome, "why") == "Not logged in: no such token.", "the reason is shown")
    log_in(chrome, WATCH[0])
    until(lambda: chrome.current_url == address, "the console opens")
    until(lambda: text(chrome, "line-text") == "Watching", "the page is connected")
    assert text(chrome, "watching") == "Watching as hall: commands are disabled, including STOP."
    assert not chrome.find_element(By.ID, "stop").is_enabled()
    teleop = chrome.find_element(By.CSS_SELECTOR, ".teleop")
    assert teleop.get_attribute("inert") is not None
    assert chrome.execute_script("return document.cookie") == "", "no script can read the cookie"
    port = guarded.port
    guarded.console.close()
    guarded.console = guarded.open(web={"listen": f"127.0.0.1:{port}", "tokens": {"anna": {"sha256": DRIVE[1]}}})
    until(lambda: chrome.current_url == f"{address}login", "a page whose token was removed shows the login")
    log_in(chrome, DRIVE[0])
    until(
        lambda: chrome.current_url == address and text(chrome, "line-text") == "Connected",
        "a client with the role drive is accepted",
    )
    assert chrome.find_element(By.ID, "stop").is_enabled()
    assert text(chrome, "watching") == ""
    chrome.get(f"{address}login")
    until(lambda: text(chrome, "name") == "You are logged in as anna.", "the login page shows the client's name")
    chrome.find_element(By.ID, "out").click()
    until(lambda: not chrome.find_element(By.ID, "known").is_displayed(), "the client is logged out")
    chrome.get(address)
    assert chrome.current_url == f"{address}login"


def test_a_client_logs_in_through_a_proxy_with_a_path(guarded: GuardedDesk, chrome: Chrome, tmp_path: Path) -> None:
    guarded.open_with(web=WEB)
    with contextlib.closing(Proxy(tmp_path, guarded.keys, guarded.port, tokens=True)) as proxy:
        address = f"https://127.0.0.1:{proxy.port}/robot1/"
        chrome.get(address.removesuffix("/"))
        until(lambda: chrome.current_url == f"{address}login", "the login page is open")
        log_in(chrome, DRIVE[0])
        until(lambda: chrome.current_url == address, "the console's page is open")
        until(lambda: text(chrome, "line-text") == "Connected", "the page is connected")
        assert [cookie["name"] for cookie in chrome.get_cookies()] == ["__Host-midspan~robot1"]


def test_a_foreign_page_cannot_drive(
    guarded: GuardedDesk, chrome: Chrome, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """A page of another origin, in the browser of a logged-in client, gets neither a socket nor a response."""
    address = f"https://127.0.0.1:{guarded.port}/"
    chrome.get(f"{address}login")
    log_in(chrome, DRIVE[0])
    until(lambda: chrome.current_url == address, "the client is logged in")
    strange = tmp_path / "strange.html"
    strange.write_text(f"""<title>begun</title><script>
        const socket = new WebSocket("wss://127.0.0.1:{guarded.port}/socket", "midspan.console.1");
        socket.onopen = () => document.title = "open";
        socket.onerror = () => fetch("{address}whoami", {{credentials: "include"}})
            .then(() => document.title = "read", () => document.title = "refused");
    </script>""")
    chrome.get(strange.as_uri())
    until(lambda: chrome.title == "refused", "the foreign page is refused")
    assert caplog.text.count("a page of 'null' may not access") == 2, "neither socket nor request was accepted"
    with TestPage(guarded.port, ssl=guarded.tls(), additional_headers={"Authorization": f"Bearer {DRIVE[0]}"}) as page:
        assert page.call("ping")["ok"]
