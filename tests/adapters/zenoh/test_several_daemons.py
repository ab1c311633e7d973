"""Two daemons that speak a dialect on one network, on one hub or on two: nothing loops, nothing comes twice."""

from __future__ import annotations

from typing import Any

import pytest

from bridge.hub.session import Hub
from bridge.messages.registry import Registry
from tests.adapters.zenoh.conftest import Place
from tests.contract.hubside import HubSide
from tests.support.quick_hub import QuickHub
from tests.support.wait import until

STRING = "std_msgs/String"
JSON = {"dialect": "json", "keys": [{"key": "json/both", "topic": "/both", "type": "std_msgs/msg/String"}]}


@pytest.mark.parametrize("dialect", ["ros2dds", "ros1", "json"])
@pytest.mark.parametrize("hubs", ["one hub", "two hubs"])
def test_nothing_loops_and_nothing_comes_twice(place: Place, dialect: str, hubs: str) -> None:
    entry = JSON if dialect == "json" else {"dialect": dialect}
    program = {"ros2dds": place.ros2dds, "ros1": place.ros1, "json": place.json}[dialect]()
    topic = "/json/both" if dialect == "json" else "/both"
    heard, out = program.subscribe(topic, STRING), program.advertise(topic, STRING)
    far = [place.far]
    with QuickHub() as other:
        first = place.bridge(entry, name="one")
        hub = {"listen": other.endpoint if hubs == "two hubs" else place.hubs.endpoint}
        second = place.bridge(entry, name="two", hub=hub, state=place.folder / "two")
        if hubs == "two hubs":
            far.append(HubSide(Hub.open(other.settings("far")), Registry()))
        try:
            at_far = [end.subscribe("/both", STRING) for end in far]
            from_far = [end.advertise("/both", STRING) for end in far]
            _until_all_hear(program, out, heard, list(zip(far, from_far, at_far, strict=True)))
            for number in range(20):
                program.publish(out, {"data": f"program {number}"})
                for which, (end, sender) in enumerate(zip(far, from_far, strict=True)):
                    end.publish(sender, {"data": f"far {which} {number}"})
            from_program = [f"program {n}" for n in range(20)]
            from_hubs = [f"far {which} {n}" for which in range(len(far)) for n in range(20)]
            until(lambda: set(from_hubs) <= _texts(program, heard), "the program heard everything", 20)
            for end, subscription in zip(far, at_far, strict=True):
                until(lambda e=end, s=subscription: set(from_program) <= _texts(e, s), "a hub heard everything", 20)
            got = sorted(m["data"] for m in program.wait(heard, 10_000, 0.5) if "probe" not in m["data"])
            # the programs of one network hear each other, themselves among them
            assert got == sorted(from_hubs + from_program)
            for end, subscription in zip(far, at_far, strict=True):
                got = sorted(m["data"] for m in end.wait(subscription, 10_000, 0.2) if m["data"].startswith("program"))
                assert got == sorted(from_program)
            if hubs == "one hub":  # whoever stands by takes over
                active = min((first, second), key=lambda bridge: bridge.crossings[0].health().state != "running")
                active.stop()
                _until_all_hear(program, out, heard, [(far[0], from_far[0], far[0].subscribe("/both", STRING))])
            second.stop()
        finally:
            for end in far[1:]:
                end.hub.close()


def _texts(end: Any, heard: int) -> set[str]:
    return {m["data"] for m in end.wait(heard, 1, 0.1)}


def _until_all_hear(program: Any, out: int, heard: int, far: list[tuple[HubSide, int, int]]) -> None:
    """Until a new probe of the program is at every hub, and one of every hub at the program."""
    mark = f"probe {len(program.wait(heard, 0))}"

    def once() -> bool:
        program.publish(out, {"data": mark})
        for which, (end, sender, _) in enumerate(far):
            end.publish(sender, {"data": f"{mark} {which}"})
        there = all(mark in _texts(end, subscription) for end, _, subscription in far)
        return there and {f"{mark} {which}" for which in range(len(far))} <= _texts(program, heard)

    until(once, "probes cross", 30)
