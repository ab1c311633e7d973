"""The console: time to the first view, age of the displayed data, and the cost of ten pages.

A daemon with ROS 1, ROS 2 and the console; this program publishes the displayed data on the hub: transforms at 100 Hz,
a laser at 10 Hz, a map of 4,000 x 4,000 cells. A real Chromium with an empty profile opens the page; a script in it
records when the data of a message is drawn. Then ten pages without a browser are open for a while: each is a WebSocket
with the map view's feeds, and acknowledges each value at once. A topic is bridged from ROS 2 to the hub with and
without these pages.

The peer's column is the aim, except for the topic's latency, where it is the latency without pages.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import shutil
import signal
import statistics
import sys
import tempfile
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from benchmarks.endurance.deployment import Deployment
from benchmarks.footprints.measured import cpu_seconds
from benchmarks.rows import Row, add_json_option, need_peers, report
from bridge.daemon.query import ask_daemon
from bridge.hub.node import Hub
from bridge.hub.session import HubSettings
from bridge.hub.wire.qos import Qos
from bridge.messages.json import from_json
from bridge.messages.registry import Registry
from bridge.web.feeds.map_pictures import TILE

FIRST_VIEW, MAP_SEEN, AGE_MS, BACK, TEN_PERCENT = 1.0, 2.0, 100.0, 3.0, 15.0
"""The aims: seconds until the first view, and until the large map is drawn; ms from hub to pixels (p95); seconds from a
restarted console's first reply until the page is connected again; percent of a core for ten pages."""
CELLS, METERS = 4000, 0.05
TILES = math.ceil(CELLS / TILE) ** 2
FEEDS = ("robot", "robots", "driving", "map", "laser", "path", "places")
PAGES = 10
SMALL, RATE = "/small", 100.0
STEP = 0.001
"""Meters that the robot moves in 10 ms, and by which the laser's beam grows; they identify drawn values."""
MARKS = """
window.marks = { robot: [], laser: [], map: 0, tiles: 0 };
const Plain = window.WebSocket;
window.WebSocket = class extends Plain {
  constructor(...words) {
    super(...words);
    this.addEventListener("message", ({ data }) => {
      const { feed, value } = JSON.parse(data);
      const seen = feed === "robot" ? value?.pose?.x : feed === "laser" ? value?.points[1] : undefined;
      if (seen === undefined) return;
      requestAnimationFrame(() => setTimeout(() => marks[feed].push([seen, Date.now()])));
    });
  }
};
const draw = CanvasRenderingContext2D.prototype.drawImage;
CanvasRenderingContext2D.prototype.drawImage = function (...words) {
  draw.apply(this, words);
  if (!(words[0] instanceof ImageBitmap)) return;
  marks.tiles += 1;
  marks.map = performance.now();
};
"""


class Robot:
    """Publishes a robot's transforms and laser on the hub, and records when it published each value."""

    def __init__(self, deployment: Deployment) -> None:
        hub = deployment.place.config.hub
        self._hub = Hub.open(
            HubSettings(domain=hub.domain, router=hub.listen, node="robot", daemon="robot", worker="robot")
        )
        self._registry = Registry()
        self.published: dict[str, dict[float, float]] = {"robot": {}, "laser": {}}
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._publish, name="robot")

    def start(self) -> None:
        self._thread.start()

    def close(self) -> None:
        self._over.set()
        if self._thread.is_alive():
            self._thread.join()
        self._hub.close()

    def _publisher(self, topic: str, type_: str, qos: Qos) -> Callable[[dict[str, Any]], None]:
        publisher = self._hub.publisher(topic, type_, self._registry.ros2(type_).type_id, qos)
        return lambda message: publisher.put(from_json(self._registry, type_, message))

    def _publish(self) -> None:
        frames = self._publisher("/tf", "tf2_msgs/msg/TFMessage", Qos(depth=100))
        laser = self._publisher("/scan", "sensor_msgs/msg/LaserScan", Qos(depth=5))
        number, due = 0, time.monotonic()
        while not self._over.wait(max(0.0, due - time.monotonic())):
            due += 1.0 / RATE
            number += 1
            now, x = time.time_ns(), round(number * STEP, 3)
            stamp = {"sec": now // 10**9, "nanosec": now % 10**9}
            self.published["robot"][x] = now / 1e6
            frames({"transforms": [_moved(stamp, "map", "odom", 0.0), _moved(stamp, "odom", "base_link", x)]})
            if number % 10 == 0:
                beam = round(1.0 + number * STEP, 3)
                self.published["laser"][beam] = now / 1e6
                turned = {"angle_min": math.pi / 2, "angle_increment": 0.01, "ranges": [beam] + [5.0] * 359}
                head = {"header": {"stamp": stamp, "frame_id": "base_link"}, "range_min": 0.05, "range_max": 200.0}
                laser({**head, **turned})


def _moved(stamp: dict[str, int], parent: str, child: str, x: float) -> dict[str, Any]:
    place = {"translation": {"x": x}, "rotation": {"w": 1.0}}
    return {"header": {"stamp": stamp, "frame_id": parent}, "child_frame_id": child, "transform": place}


def _with_map(folder: Path) -> dict[str, Any]:
    """Write a map of rooms of 5 m, and return the configuration of a console with it."""
    cells = np.full((CELLS, CELLS), 254, np.uint8)
    cells[::100] = cells[:, ::100] = 0
    (folder / "large.pgm").write_bytes(b"P5 %d %d 255\n" % (CELLS, CELLS) + cells.tobytes())
    origin = f"[{-CELLS * METERS / 2}, {-CELLS * METERS / 2}, 0]"
    settings = f"resolution: {METERS}\norigin: {origin}\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.2\n"
    (folder / "large.yaml").write_text(f"image: large.pgm\n{settings}")
    store = {"enabled": True, "maps": str(folder / "large.yaml")}
    return {"web": {"enabled": True}, "store": store, "navigation": {"map": "store"}}


def in_chromium(address: str, robot: Robot, worker: Callable[[], int], seconds: float) -> list[Row]:
    """Open the page in a browser with an empty profile, and measure what it shows."""
    from selenium.webdriver import Chrome, ChromeOptions
    from selenium.webdriver.chrome.service import Service

    options = ChromeOptions()
    options.binary_location = str(shutil.which("chromium"))
    with tempfile.TemporaryDirectory() as profile:
        for option in ("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"):
            options.add_argument(option)
        options.add_argument(f"--user-data-dir={profile}")
        chrome = Chrome(options, Service(shutil.which("chromedriver")))
        try:
            chrome.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": MARKS})
            chrome.get(f"{address}#drive")
            _until(lambda: chrome.execute_script("return marks.tiles") >= TILES, "the map is drawn")
            view = "return performance.getEntriesByName('first-contentful-paint')[0].startTime"
            first, seen = float(chrome.execute_script(view)), float(chrome.execute_script("return marks.map"))
            chrome.execute_script("marks.robot = []; marks.laser = []")
            time.sleep(seconds)
            marks: dict[str, list[list[float]]] = chrome.execute_script("return marks")
            back = _comes_back(lambda: str(chrome.execute_script("return document.body.dataset.line")), address, worker)
        finally:
            chrome.quit()
    rows = [
        Row("first view in Chromium", first / 1e3, FIRST_VIEW, "s"),
        Row(f"map of {CELLS} x {CELLS} visible", seen / 1e3, MAP_SEEN, "s"),
    ]
    for feed, published in robot.published.items():
        ages = [at - published[round(value, 3)] for value, at in marks[feed] if round(value, 3) in published]
        if len(ages) < 5 * seconds:
            raise RuntimeError(f"{feed}: {len(ages)} values were matched in {seconds:g} s, of {len(marks[feed])} drawn")
        rows.append(Row(f"{feed}, hub to pixels, p95", statistics.quantiles(ages, n=20)[-1], AGE_MS, "ms"))
    return [*rows, Row("page reconnects once a killed console is back", back, BACK, "s")]


def _comes_back(line: Callable[[], str], address: str, worker: Callable[[], int]) -> float:
    """Kill the console; return the seconds from its successor's first reply until the page is connected again."""
    os.kill(worker(), signal.SIGKILL)
    _until(lambda: line() != "open", "the page detects the loss")
    _until(lambda: _answers(address), "the console is back")
    begun = time.monotonic()
    _until(lambda: line() == "open", "the page is connected again")
    return time.monotonic() - begun


def _answers(address: str) -> bool:
    try:
        with urllib.request.urlopen(address, timeout=5) as answer:
            return bool(answer.status == 200)
    except OSError:
        return False


@contextlib.contextmanager
def ten_pages(address: str) -> Iterator[None]:
    """Open ten pages with the map view's feeds."""
    with contextlib.ExitStack() as stack:
        threads = []
        for _ in range(PAGES):
            url = address.replace("http", "ws", 1) + "socket"
            options: Any = {"origin": address.rstrip("/"), "subprotocols": [Subprotocol("midspan.console.1")]}
            socket = stack.enter_context(connect(url, max_size=None, **options))
            for feed in FEEDS:
                socket.send(json.dumps({"op": "watch", "feed": feed}))
            threads.append(threading.Thread(target=_receive, args=(socket,)))
            threads[-1].start()
        yield
    for thread in threads:
        thread.join()


def _receive(socket: Any) -> None:
    with contextlib.suppress(ConnectionClosed):
        for text in socket:
            message = json.loads(text)
            if message["op"] == "value":
                socket.send(json.dumps({"op": "took", "feed": message["feed"], "n": message["n"]}))


def _latency(deployment: Deployment, seconds: float) -> float:
    """Return the median latency from ROS 2 to the hub, in milliseconds."""
    deployment.drained("zenoh")
    deployment.ask("zenoh", "report")  # clear earlier counts
    deployment.ask("ros2", "flow", rates={SMALL: RATE})
    time.sleep(seconds)
    deployment.ask("ros2", "still")
    ages: dict[str, float] = deployment.ask("zenoh", "report")["received"][SMALL]["ages"]
    return ages["p50"]


def _until(condition: Callable[[], Any], what: str, seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > end:
            raise RuntimeError(f"not within {seconds:g} s: {what}")
        time.sleep(0.05)


def measure(seconds: float) -> list[Row]:
    """Measure everything, and return the rows."""
    with (
        tempfile.TemporaryDirectory() as folder,
        Deployment(config=_with_map(Path(folder))) as deployment,
        contextlib.closing(Robot(deployment)) as robot,
    ):
        address = f"http://127.0.0.1:{deployment.place.web_port}/"
        robot.start()

        def worker() -> int:
            status = ask_daemon(deployment.place.config)
            assert status is not None
            return next(report.pid for report in status.workers if report.worker == "web")

        rows = in_chromium(address, robot, worker, seconds)
        for side in ("ros2", "zenoh"):
            deployment.program(side)
        deployment.ask("ros2", "publish", topics=[deployment.topic("ros2", SMALL, "string")])
        deployment.ask("zenoh", "subscribe", topics=[deployment.topic("zenoh", SMALL, "string")])
        _until(lambda: _crosses(deployment), "the topic is bridged")
        alone = _latency(deployment, seconds)
        with ten_pages(address):
            time.sleep(2.0)  # until each page has the map and other initial values
            begun, before = time.monotonic(), cpu_seconds(pid := worker())
            beside = _latency(deployment, seconds)
            percent = 100 * (cpu_seconds(pid) - before) / (time.monotonic() - begun)
    rows.append(Row(f"{PAGES} pages", percent, TEN_PERCENT, "% of a core"))
    rows.append(Row(f"ROS 2 to the hub with {PAGES} pages, p50", beside, alone, "ms"))
    return rows


def _crosses(deployment: Deployment) -> bool:
    deployment.ask("ros2", "put", topics=[SMALL])
    return bool(deployment.ask("zenoh", "count")["count"])


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=10.0, help="seconds of each measurement (default %(default)s)")
    add_json_option(parser)
    args = parser.parse_args(arguments)
    need_peers("selenium", "websockets")
    if shutil.which("chromium") is None or shutil.which("chromedriver") is None:
        raise SystemExit("missing: chromium and chromedriver; 'apt install chromium chromium-driver' installs them")
    report(measure(args.seconds), args.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
