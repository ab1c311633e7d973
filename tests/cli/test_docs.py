"""The examples in the documentation, and the documentation's table of the doctor's findings."""

from __future__ import annotations

import argparse
import re
import shlex
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from bridge.cli.main import VERBS, build_parser
from bridge.doctor.checks import CHECKS
from bridge.messages.json import from_json
from bridge.messages.registry import Registry
from bridge.tf.stamped import Stamped, write
from tests.cli.conftest import Midspan
from tests.peers.daemon.workers import EngineWorker
from tests.peers.hub.network import HubNetwork
from tests.support.wait import until

DOCS = Path(__file__).parents[2] / "docs"
TF = "tf2_msgs/msg/TFMessage"
SCAN, MAP, LOG = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/OccupancyGrid", "rcl_interfaces/msg/Log"


def examples(page: str) -> list[list[str]]:
    """Return the arguments of every example on a page."""
    text = (DOCS / page).read_text()
    return [shlex.split(line, comments=True) for line in re.findall(r"^\$ midspan (.*)$", text, re.MULTILINE)]


CLI = examples("operate/cli.md")
RUN = [
    command for command in CLI
    if command[0] in ("status", "top", "explain", "topic", "tf") and not {"--interval", "--router"} & set(command)
]  # fmt: skip


@pytest.mark.parametrize("command", CLI + examples("operate/troubleshooting.md"), ids=" ".join)
def test_every_example_is_understood(command: list[str]) -> None:
    args = build_parser([command[0]]).parse_args(command)
    assert isinstance(args, argparse.Namespace)


def test_every_verb_has_an_example_and_a_section() -> None:
    text = (DOCS / "operate" / "cli.md").read_text()
    assert {command[0] for command in CLI} == set(VERBS)
    for verb in VERBS:
        assert f"`{verb}`" in text.partition("## ")[0]


@pytest.fixture
def robot(network: HubNetwork, registry: Registry, closing: list[Any]) -> Any:
    """A side with the topics that the examples name."""
    worker = EngineWorker(network, registry)
    closing.append(worker)
    writers = [
        (worker.advertise("/scan", SCAN), from_json(registry, SCAN, {"ranges": [1.0] * 720})),
        (worker.advertise("/rosout", LOG), from_json(registry, LOG, {"msg": "hello"})),
    ]
    grid = from_json(registry, MAP, {"info": {"width": 2, "height": 2}, "data": [0, 0, 100, -1]})
    worker.side.write(worker.advertise("/map", MAP, latched=True), grid)
    mount = [Stamped("base_link", "laser", 0, (0.2, 0.0, 0.1), (0.0, 0.0, 0.0, 1.0))]
    worker.side.write(worker.advertise("/tf_static", TF, latched=True), write(mount))
    moving = worker.advertise("/tf", TF)
    until(lambda: len(worker.engine.routes()) == 4, "all routes exist")
    stop = threading.Event()

    def talk() -> None:
        while not stop.wait(0.02):
            at = time.time_ns()
            base = [Stamped("map", "base_link", at, (1.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))]
            for writer, cdr in [*writers, (moving, write(base))]:
                worker.side.write(writer, cdr)

    thread = threading.Thread(target=talk)
    thread.start()
    yield worker
    stop.set()
    thread.join()


@pytest.mark.usefixtures("robot")
@pytest.mark.parametrize("command", RUN, ids=" ".join)
def test_the_examples_work(midspan: Midspan, command: list[str]) -> None:
    done = midspan(*command)
    assert done.code == 0, done
    assert done.out or command[:2] == ["topic", "pub"]


def test_every_check_is_in_the_documentation() -> None:
    table = re.findall(r"^\| `([a-z0-9-]+)` \|", (DOCS / "operate" / "troubleshooting.md").read_text(), re.MULTILINE)
    assert table == [check.id for check in CHECKS]
