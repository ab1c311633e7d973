"""Takes screenshots of the console: every view at phone and desktop width, light and dark, while the robot drives.

`make screenshots` updates the screenshots in the docs (docs/operate/console/*.png). With a FOLDER, all screenshots are
written there for inspection.
"""

from __future__ import annotations

import argparse
import io
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from PIL import Image
from selenium.webdriver import Chrome, ChromeOptions
from selenium.webdriver.chrome.service import Service

from tests.peers.browser.page import TestPage
from tests.peers.browser.robot import WebRobot
from tests.support.wait import until

DOCS = Path(__file__).resolve().parents[1] / "docs" / "operate" / "console"
VIEWS = ("drive", "places", "status", "topics//scan", "frames", "system")
WIDTHS = {"phone": (360, 740), "desk": (1440, 860)}
IN_DOCS = {
    "drive": ("drive", "desk", "light"),
    "phone": ("drive", "phone", "dark"),
    "status": ("status", "desk", "light"),
    "topic": ("topics//scan", "desk", "dark"),
}
"""The files in the docs, each with its view, width and color scheme."""
GOALS = ("kitchen", "bedroom")
"""The robot's tour during the screenshots."""
SETTLE_SECONDS = 3.0
"""Seconds after which plots have enough data."""


@contextmanager
def browser(folder: Path) -> Iterator[Chrome]:
    """Start a headless Chromium."""
    options = ChromeOptions()
    options.binary_location = str(shutil.which("chromium"))
    for option in ("--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--disable-dev-shm-usage"):
        options.add_argument(option)
    options.add_argument(f"--user-data-dir={folder / 'profile'}")
    chrome = Chrome(options, Service(shutil.which("chromedriver")))
    try:
        yield chrome
    finally:
        chrome.quit()


def picture(chrome: Chrome, address: str, view: str, width: str, colors: str) -> Image.Image:
    """Take a screenshot of one view."""
    across, down = WIDTHS[width]
    device = {"width": across, "height": down, "deviceScaleFactor": 1, "mobile": width == "phone"}
    chrome.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", device)
    scheme = {"features": [{"name": "prefers-color-scheme", "value": colors}]}
    chrome.execute_cdp_cmd("Emulation.setEmulatedMedia", scheme)
    chrome.get("about:blank")
    chrome.get(f"{address}#{view}")
    until(lambda: chrome.execute_script("return document.body.dataset.line") == "open", "the page is connected")
    time.sleep(SETTLE_SECONDS)
    return Image.open(io.BytesIO(chrome.get_screenshot_as_png())).convert("RGB")


def _keep(image: Image.Image, file: Path) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    image.quantize(128, dither=Image.Dither.NONE).save(file, optimize=True)
    print(file, flush=True)


def main(arguments: Sequence[str] | None = None) -> int:
    """Take the screenshots."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?", help="write all screenshots there, and do not change the docs")
    folder: Path | None = parser.parse_args(arguments).folder
    with tempfile.TemporaryDirectory() as place:
        robot = WebRobot(Path(place))
        try:
            robot.ready()
            with browser(Path(place)) as chrome, TestPage(robot.web) as page:
                if folder is None:
                    wanted = [(DOCS / f"{name}.png", *settings) for name, settings in IN_DOCS.items()]
                else:
                    wanted = [
                        (folder / f"{view.partition('/')[0]}-{width}-{colors}.png", view, width, colors)
                        for view in VIEWS
                        for width in WIDTHS
                        for colors in ("light", "dark")
                    ]
                for number, (file, *settings) in enumerate(wanted):
                    if number % 4 == 0:
                        page.call("goto_place", name=GOALS[number // 4 % 2])
                    _keep(picture(chrome, robot.address, *settings), file)
        finally:
            robot.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
