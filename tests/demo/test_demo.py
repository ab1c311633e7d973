"""The demo with real programs: it ends by itself, reports what was bridged, and removes everything it started."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tempfile
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest
import yaml
from PIL import Image

from bridge.demo.sandbox import MARK
from tests.support.missing import COMPILER, DART, ROS1, ROS2, needs
from tests.support.sealed import seal
from tests.support.wait import until

ROOT = Path(__file__).parents[2]
CONFIGS = ROOT / "configs"

pytestmark = [needs(ROS1), needs(ROS2), needs(DART), needs(COMPILER)]


@pytest.fixture
def folder() -> Iterator[Path]:
    """Yield a folder for the demo's temporary files; in pytest's own, the names of its sockets would be too long."""
    with tempfile.TemporaryDirectory(prefix="midspan-t-") as name:
        yield Path(name)


SETTINGS = {"MIDSPAN_CONFIG": "/my/midspan.yaml", "MIDSPAN_WORKERS": "modules=my.package:Worker"}
"""A user's settings, which do not change the demo."""


def start(folder: Path, *options: str, what: str = "topics", out: Any = subprocess.PIPE) -> subprocess.Popen[str]:
    """Start the demo like a user, with this folder for temporary files."""
    env = {k: v for k, v in os.environ.items() if k not in ("STAY", "JSON")}
    env |= {"TMPDIR": str(folder), "PYTHONPATH": str(ROOT), **SETTINGS}
    command = [sys.executable, "-m", "bridge.cli.main", "demo", what, *options]
    # like the systemd units: no worker may need memory that is both writable and executable
    return subprocess.Popen(
        command, env=env, cwd=folder, stdout=out, stderr=subprocess.STDOUT, text=True, preexec_fn=seal
    )


def processes_of(folder: Path) -> list[str]:
    """Return the commands of the living processes of a demo with this temporary folder."""
    processes = []
    for process in psutil.process_iter():
        try:
            if process.environ().get(MARK, "").startswith(str(folder)) and process.status() != psutil.STATUS_ZOMBIE:
                processes.append(" ".join(process.cmdline()))
        except psutil.Error:
            continue
    return processes


def run(folder: Path, *options: str, what: str = "topics") -> tuple[int, str, dict[str, Any]]:
    """Run the demo to its end; return exit code, output, and the JSON file's content."""
    file = folder / "seen.json"
    demo = start(folder, "--json", str(file), *options, what=what)
    try:
        output, _ = demo.communicate(timeout=300)
    finally:
        demo.kill()
    document: dict[str, Any] = json.loads(file.read_text()) if file.exists() else {}
    return demo.returncode, output, document


def leftovers(folder: Path) -> list[str]:
    return processes_of(folder) + [p.name for p in folder.iterdir() if p.name.startswith("midspan-demo-")]


def test_every_topic_is_bridged_in_every_direction(folder: Path) -> None:
    code, output, seen = run(folder, "--seconds", "0")
    assert code == 0, output
    pairs = {(check["from"], check["to"]) for check in seen["checks"]}
    names = ("ROS 1", "ROS 2", "zenoh", "YARP")
    assert pairs >= {(a, b) for a in names for b in names if a != b}
    assert all(check["ok"] for check in seen["checks"])
    scan = [route for route in seen["routes"] if route["topic"] == "/scan"]
    assert {(route["worker"], route["direction"]) for route in scan} == {
        ("ros1", "in"),
        ("ros2", "out"),
        ("yarp", "out"),
    }
    assert all(route["messages"] > 0 for route in scan)
    assert leftovers(folder) == []


@pytest.mark.thorough
def test_a_topic_that_is_not_bridged_fails_the_demo_and_is_named(folder: Path) -> None:
    config = folder / "deny.yaml"
    config.write_text("routing:\n  rules:\n    - topic: /scan\n      deny: true\n")
    code, output, seen = run(folder, "--seconds", "0", "--config", str(config))
    assert code == 1, output
    failed = {(check["name"], check["to"], check["topic"]) for check in seen["checks"] if not check["ok"]}
    assert failed == {("laser scan", name, "/scan") for name in ("ROS 2", "zenoh", "YARP")}, output
    assert "3 of " in output
    assert "/scan: ros1" in output, "the worker's reason is shown"
    assert leftovers(folder) == []


@pytest.mark.thorough
def test_a_killed_demo_leaves_no_process(folder: Path) -> None:
    """`tests.demo.test_interrupted` has the other signals."""
    demo = start(folder, "--stay")
    try:
        until(lambda: any("robot" in line for line in processes_of(folder)), "the robot runs", 30.0)
    finally:
        demo.kill()
    demo.communicate(timeout=40)
    until(lambda: not processes_of(folder), "all processes of the demo end", 60.0)


def test_an_invalid_configuration_is_reported_before_anything_starts(folder: Path) -> None:
    config = folder / "wrong.yaml"
    config.write_text("routing:\n  ruels: []\n")
    code, output, _ = run(folder, "--config", str(config))
    assert code == 1
    assert "wrong.yaml:2" in output
    assert "rules" in output
    assert leftovers(folder) == []


PLACES = """Version:
4
Locations:
first apartment 3.0 7.7 -90.0 ""
second apartment 3.0 7.2 -90.0 ""
third apartment 3.0 6.7 -90.0 ""
Objects:
Areas:
Paths:
"""


def responds(address: str) -> bool:
    """Return whether the console at an address serves its page."""
    try:
        with urllib.request.urlopen(address, timeout=5) as answer:
            return b"Midspan" in answer.read()
    except OSError:
        return False


@pytest.mark.thorough
@pytest.mark.parametrize("ros1", ["rospy", "own"])
def test_clients_of_three_sides_send_the_robot_to_rooms(folder: Path, ros1: str) -> None:
    """The clients use configs/navigation.yaml and nearby places, also with Midspan's own ROS 1, as on Ubuntu 24.04."""
    config = yaml.safe_load((CONFIGS / "navigation.yaml").read_text())
    (folder / "near.ini").write_text(PLACES)
    config["store"] = {"maps": str(CONFIGS / config["store"]["maps"]), "locations": str(folder / "near.ini")}
    if ros1 == "own":
        config["ros1"] = {"packages": str(folder)}
    (folder / "near.yaml").write_text(yaml.safe_dump(config))
    drawn = folder / "way.png"
    file, printed = folder / "seen.json", folder / "printed.txt"
    options = ("--json", str(file), "--config", str(folder / "near.yaml"), "--png", str(drawn))
    with printed.open("w") as out:
        demo = start(folder, *options, "--to", "first", "second", "third", what="rooms", out=out)
    try:
        until(lambda: "\n" in printed.read_text(), "the demo prints the console's address", 60.0)
        address = re.match(r"console: (http://127\.0\.0\.1:\d+/) ", printed.read_text())
        assert address, printed.read_text()
        place = address[1]
        until(lambda: responds(place) or demo.poll() is not None, "the console responds", 60.0)
        assert demo.poll() is None, printed.read_text()
        assert demo.wait(300) == 0, printed.read_text()
    finally:
        demo.kill()
        demo.wait()
    output, seen = printed.read_text(), json.loads(file.read_text())
    reached = [(drive["client"], drive["reached"]) for drive in seen["drives"]]
    assert reached == [(client, True) for client in ("YARP", "ROS 1", "ROS 2")]
    assert ("Midspan's own master and client" in output) == (ros1 == "own")
    assert "##" in output  # the map
    with Image.open(drawn) as picture:
        assert picture.width > 500
    assert leftovers(folder) == []
