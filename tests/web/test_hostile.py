"""Sends over 1,000 hostile requests and frames to the console; `python -m tests.fuzz --target web` sends more."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from bridge.hub.node import Hub
from bridge.messages.registry import Registry
from tests.contract.hubside import HubSide
from tests.fuzz.mutate import Mutator
from tests.fuzz.targets.web import WORDS, conversations, give, requests
from tests.peers.browser.hostile import HostileConsole
from tests.support.wait import until

INPUTS = 250


@pytest.fixture
def console(tmp_path: Path) -> Iterator[HostileConsole]:
    hostile = HostileConsole(tmp_path)
    yield hostile
    hostile.close()


def test_hostile_input_neither_crashes_the_console_nor_drives_without_a_hold(console: HostileConsole) -> None:
    seeds = [*requests(), *conversations()]
    mutator = Mutator(seeds, WORDS, 4000, "short")
    for content in (*seeds, *(mutator.next() for _ in range(INPUTS))):
        give(console, content)
    console.check()
    assert console.sent > 1000
    assert console.drove > 0, "no valid hold drove the base, so the test could not have detected driving"


def test_the_test_detects_driving_without_a_hold(console: HostileConsole) -> None:
    far = HubSide(Hub.open(console.hubs.settings("other")), Registry())
    out = far.advertise("/cmd_vel", "geometry_msgs/Twist")

    def is_reported() -> bool:
        far.publish(out, {"linear": {"x": 0.1}})
        try:
            console.check()
        except AssertionError as err:
            return "although no page holds" in str(err)
        return False

    try:
        until(is_reported, "driving without a hold is detected")
    finally:
        far.hub.close()
