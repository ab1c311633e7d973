"""Some thousand hostile requests and frames; `python -m tests.fuzz --target web` sends more."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from bridge.hub.session import Hub
from bridge.messages.registry import Registry
from tests.contract.hubside import HubSide
from tests.fuzz.mutate import Mutator
from tests.fuzz.targets.web import WORDS, conversations, give, requests
from tests.support.wait import until
from tests.web.hostile import HostileConsole

INPUTS = 250


@pytest.fixture
def console(tmp_path: Path) -> Iterator[HostileConsole]:
    made = HostileConsole(tmp_path)
    yield made
    made.close()


def test_strangers_neither_end_it_nor_drive(console: HostileConsole) -> None:
    seeds = [*requests(), *conversations()]
    dice = Mutator(seeds, WORDS, 4000, "short")
    for content in (*seeds, *(dice.next() for _ in range(INPUTS))):
        give(console, content)
    console.look()
    assert console.sent > 1000
    assert console.drove > 0, "a valid hold among them drives, so that the rest is known not to"


def test_who_drives_without_a_hold_is_found_out(console: HostileConsole) -> None:
    far = HubSide(Hub.open(console.hubs.settings("other")), Registry())
    out = far.advertise("/cmd_vel", "geometry_msgs/Twist")

    def driven() -> bool:
        far.publish(out, {"linear": {"x": 0.1}})
        try:
            console.look()
        except AssertionError as err:
            return "though nobody holds" in str(err)
        return False

    try:
        until(driven, "it is found out")
    finally:
        far.hub.close()
